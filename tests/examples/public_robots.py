"""Robots written to disk as public packages bring them: own world link, package addresses, STL meshes, mimic joints."""

import struct
from pathlib import Path

import numpy as np

# Of each link of the arm: mass [kg], size of its box [m], its middle. A six-axis arm of 0.9 m, wrist included.
_LINKS = {
    "link_1": (8.0, (0.14, 0.14, 0.2), (0, 0, 0.1)),
    "link_2": (6.0, (0.08, 0.08, 0.34), (0, 0.09, 0.2)),
    "link_3": (4.0, (0.08, 0.08, 0.14), (0, 0, 0.0)),
    "link_4": (2.5, (0.2, 0.07, 0.07), (0.19, 0, 0)),
    "link_5": (1.0, (0.06, 0.06, 0.06), (0, 0, 0)),
    "link_6": (0.3, (0.02, 0.06, 0.06), (0.06, 0, 0)),
}
# Of each joint: place in the link before it [m], axis, limits [deg].
_JOINTS = {
    "joint_1": ((0, 0, 0.1), "0 0 1", 170),
    "joint_2": ((0, 0, 0.2), "0 1 0", 120),
    "joint_3": ((0, 0, 0.4), "0 1 0", 130),
    "joint_4": ((0, 0, 0.03), "1 0 0", 180),
    "joint_5": ((0.35, 0, 0), "0 1 0", 115),
    "joint_6": ((0.07, 0, 0), "1 0 0", None),
}
GRIPPER = """<link name="{side}palm"><inertial><mass value="0.2"/>
 <inertia ixx="1e-4" iyy="1e-4" izz="1e-4" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="{side}palm_mount" type="fixed"><parent link="{side}tool0"/><child link="{side}palm"/></joint>
<link name="{side}finger_a"><inertial><mass value="0.02"/></inertial></link>
<link name="{side}finger_b"><inertial><mass value="0.02"/></inertial></link>
<joint name="{side}finger_a_joint" type="prismatic"><parent link="{side}palm"/><child link="{side}finger_a"/>
 <axis xyz="1 0 0"/><limit lower="0.01" upper="0.04" effort="20" velocity="0.1"/></joint>
<joint name="{side}finger_b_joint" type="prismatic"><parent link="{side}palm"/><child link="{side}finger_b"/>
 <axis xyz="1 0 0"/><limit lower="-0.04" upper="0.0" effort="20" velocity="0.1"/>
 <mimic joint="{side}finger_a_joint" multiplier="-0.5" offset="-0.003"/></joint>
"""


def write_stl(
    file: Path, size: tuple[float, float, float], middle: tuple[float, float, float], text: bool = False
) -> None:
    """A box of twelve triangles, as binary or as text."""
    signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    corners = np.array(middle) + 0.5 * signs * np.array(size)
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    faces = [corners[list(pick)] for a, b, c, d in quads for pick in ((a, b, c), (a, c, d))]
    file.parent.mkdir(parents=True, exist_ok=True)
    if text:
        lines = [f"vertex {x} {y} {z}" for face in faces for x, y, z in face]
        file.write_text("solid box\nfacet normal 0 0 0\nouter loop\n" + "\n".join(lines) + "\nendsolid box\n")
        return
    facets = [struct.pack("<12fH", 0, 0, 0, *face.ravel(), 0) for face in faces]
    file.write_bytes(b"box".ljust(80) + struct.pack("<I", len(facets)) + b"".join(facets))


def arm_xml(package: str, side: str = "", effort: float = 0.0) -> str:
    """Links and joints of an arm from `base_link` on; meshes at package addresses, no actuators."""
    parts, before = [], "base_link"
    for (joint, (place, axis, limit)), (link, (mass, size, middle)) in zip(
        _JOINTS.items(), _LINKS.items(), strict=True
    ):
        a, b, c = np.square(size)
        inertia = {"ixx": mass * (b + c) / 12, "iyy": mass * (a + c) / 12, "izz": mass * (a + b) / 12}
        numbers = " ".join(f'{name}="{value + 1e-4:.6g}"' for name, value in inertia.items())
        at = " ".join(map(str, middle))
        shapes = "".join(
            f'<{kind}><geometry><mesh filename="package://{package}/meshes/{link}.stl"/></geometry></{kind}>'
            for kind in ("visual", "collision")
        )
        parts.append(
            f'<link name="{side}{link}"><inertial><mass value="{mass}"/><origin xyz="{at}"/>'
            f'<inertia {numbers} ixy="0" ixz="0" iyz="0"/></inertial>{shapes}</link>'
        )
        turn = f'lower="{-np.radians(limit)}" upper="{np.radians(limit)}"' if limit else ""
        shift = " ".join(map(str, place))
        parts.append(
            f'<joint name="{side}{joint}" type="{"revolute" if limit else "continuous"}"><parent link="{before}"/>'
            f'<child link="{side}{link}"/><origin xyz="{shift}"/><axis xyz="{axis}"/>'
            f'<limit {turn} effort="{effort}" velocity="3.0"/></joint>'
        )
        before = f"{side}{link}"
    parts.append(f'<link name="{side}tool0"/><joint name="{side}tool0_mount" type="fixed"><parent link="{before}"/>')
    parts.append(f'<child link="{side}tool0"/><origin xyz="0.07 0 0"/></joint>')
    return "\n".join(parts)


def write_public_robot(
    folder: Path, name: str = "acme_support", arms: tuple[str, ...] = ("",), effort: float = 0.0
) -> Path:
    """A package of one or several arms with grippers: `folder/name/urdf/arm.urdf` and meshes beside; its urdf folder.

    Several arms stand beside each other, each on a base of its own that is fixed to `base_link`.
    """
    package = folder / name
    for link, (_, size, middle) in _LINKS.items():
        write_stl(package / "meshes" / f"{link}.stl", size, middle, text=link == "link_3")
    parts = ['<link name="world"/><link name="base_link"/>']
    parts.append('<joint name="stand" type="fixed"><parent link="world"/><child link="base_link"/>')
    parts.append('<origin xyz="0 0 0.3"/></joint>')
    for i, side in enumerate(arms):
        body = arm_xml(name, side, effort)
        if side:
            body = body.replace('parent link="base_link"', f'parent link="{side}base"')
            parts.append(f'<link name="{side}base"/><joint name="{side}stand" type="fixed"><parent link="base_link"/>')
            parts.append(f'<child link="{side}base"/><origin xyz="0 {0.8 * i} 0"/></joint>')
        parts += [body, GRIPPER.format(side=side)]
    urdf = package / "urdf"
    urdf.mkdir(parents=True, exist_ok=True)
    (urdf / "arm.urdf").write_text('<robot name="arm">\n' + "\n".join(parts) + "\n</robot>\n")
    return urdf
