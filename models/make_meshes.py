"""Draws the meshes of the shipped models: `python -m forcectl.models.make_meshes` writes them again.

Every mesh is a loft (see `lofts`). Dimensions are in metres, in the frame of the link that shows the mesh. The meshes
are for the eye; collision shapes are primitives in the model files.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from forcectl.models import yumi_meshes
from forcectl.models.lofts import Mesh, along, circle, coil, loft, rounded, slab, two_circles, write_obj


def base() -> Mesh:
    """Foot plate and column; COMAU base."""
    foot = slab("z", rounded(0.30, 0.30, 0.05), 0.0, 0.03, 0.006)
    column = along("z", [(0.025, circle(0.148)), (0.06, circle(0.14)), (0.17, circle(0.135)), (0.205, circle(0.15))])
    return loft(foot, column)


def base_box() -> Mesh:
    """Connector box behind the base."""
    return loft(slab("x", rounded(0.20, 0.15, 0.025, 0.0, 0.105), -0.469, -0.10, 0.012))


def turret() -> Mesh:
    """Rotating column that leans forward to the shoulder; COMAU link_1."""
    foot = slab("z", circle(0.187), -0.24, -0.175, 0.012)
    body = along(
        "z",
        [
            (-0.18, circle(0.170)),
            (-0.15, rounded(0.335, 0.320, 0.15, 0.008)),
            (-0.08, rounded(0.300, 0.270, 0.11, 0.055)),
            (0.00, rounded(0.255, 0.235, 0.06, 0.105)),
            (0.06, rounded(0.225, 0.220, 0.05, 0.125)),
            (0.09, rounded(0.170, 0.190, 0.05, 0.130)),
        ],
    )
    shoulder = slab("y", circle(0.118, 0.0, 0.15), -0.092, 0.150, 0.014)
    return loft(foot, body, shoulder)


def upper_arm() -> Mesh:
    """Tapered arm beside the shoulder, with a rib; COMAU link_2."""
    outline = two_circles(0.098, 0.084, 0.59)[:, ::-1][::-1]  # (z, x)
    plate = slab("y", outline, -0.222, -0.118, 0.022)
    shoulder = slab("y", circle(0.092), -0.245, -0.094, 0.012)
    elbow = slab("y", circle(0.078, 0.59), -0.240, -0.094, 0.012)
    return loft(plate, shoulder, elbow)


def elbow() -> Mesh:
    """Elbow housing that carries the forearm and its motors; COMAU link_3."""
    hub = slab("y", circle(0.112), -0.092, 0.135, 0.014)
    body = along(
        "x",
        [
            (-0.100, rounded(0.130, 0.130, 0.04, 0.0, 0.125)),
            (-0.090, rounded(0.150, 0.150, 0.04, 0.0, 0.122)),
            (-0.020, rounded(0.168, 0.180, 0.05, 0.0, 0.115)),
            (0.050, rounded(0.165, 0.172, 0.06, 0.0, 0.122)),
            (0.090, circle(0.080, 0.0, 0.13)),
            (0.106, circle(0.074, 0.0, 0.13)),
        ],
    )
    return loft(hub, body)


def forearm() -> Mesh:
    """Tapered forearm with the fork that holds the wrist; COMAU link_4."""
    tube = along(
        "x",
        [
            (0.098, circle(0.066)),
            (0.110, circle(0.066)),
            (0.111, circle(0.072)),
            (0.150, circle(0.072)),
            (0.180, circle(0.060)),
            (0.440, circle(0.052)),
            (0.520, rounded(0.132, 0.098, 0.045)),
            (0.570, rounded(0.132, 0.094, 0.040)),
            (0.578, rounded(0.124, 0.086, 0.040)),
        ],
    )
    cheek = two_circles(0.047, 0.045, 0.107) + np.array([0.0, 0.54])  # (z, x)
    return loft(tube, slab("y", cheek, -0.066, -0.0435, 0.006), slab("y", cheek, 0.0435, 0.066, 0.006))


def wrist() -> Mesh:
    """Wrist body between the cheeks of the fork; COMAU link_5."""
    barrel = slab("y", circle(0.0405), -0.0425, 0.0425, 0.004)
    neck = along("x", [(0.0, circle(0.038)), (0.055, circle(0.038)), (0.068, circle(0.033)), (0.076, circle(0.033))])
    return loft(barrel, neck)


def spring() -> Mesh:
    """One coil spring below the plate."""
    return loft(coil(0.016, 0.0025, -0.079, -0.011, 6.0))


MESHES: dict[str, Callable[[], Mesh]] = {
    "comau_smart_six/meshes/base.obj": base,
    "comau_smart_six/meshes/base_box.obj": base_box,
    "comau_smart_six/meshes/link_1.obj": turret,
    "comau_smart_six/meshes/link_2.obj": upper_arm,
    "comau_smart_six/meshes/link_3.obj": elbow,
    "comau_smart_six/meshes/link_4.obj": forearm,
    "comau_smart_six/meshes/link_5.obj": wrist,
    "spring_plate/meshes/spring.obj": spring,
    **yumi_meshes.MESHES,
}


def write_all(folder: Path) -> None:
    """Write every mesh below `folder`."""
    for name, make in MESHES.items():
        write_obj(make(), folder / name)


if __name__ == "__main__":
    write_all(Path(__file__).parent)
