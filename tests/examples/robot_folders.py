"""Small robots written to disk, for tests of what a user's own robot folder may be."""

from pathlib import Path

LINK_LENGTH = 0.4  # [m]

_LINK = """  <link name="{name}">
    <inertial>
      <origin xyz="0.2 0 0"/>
      <mass value="2"/>
      <inertia ixx="0.001" iyy="0.03" izz="0.03" ixy="0" ixz="0" iyz="0"/>
    </inertial>
  </link>
"""
_JOINT = """  <joint name="{name}" type="{type}">
    <parent link="{parent}"/>
    <child link="{child}"/>
    <origin xyz="{x} 0 0"/>
    <axis xyz="0 0 1"/>
    <limit lower="-3" upper="3" effort="50" velocity="2"/>
  </joint>
"""
_ACTUATOR = """  <transmission>
    <type>transmission_interface/SimpleTransmission</type>
    <joint name="{name}"/>
    <actuator name="{name}_motor"/>
  </transmission>
"""

CONTROL = """model: planar.urdf
base_frame: base
flange_frame: hand
arm_joints: [shoulder, elbow, wrist]
default_posture_deg: [10, 60, -20]
characteristic_length: 0.5
joint_stiffness:
  soft: [1000, 800, 600]
  stiff: [10000, 8000, 6000]
default_stiffness_set: soft
transmission_damping: [1, 1, 1]
reference_filter: {natural_frequency: 50, damping_ratio: 0.9}
period: 0.004
gear_ratio: [100, -100, 50]
rotor_inertia: [1e-4, 1e-4, 1e-5]
coulomb_friction: [0, 0, 0]
viscous_friction: [0, 0, 0]
"""


def write_planar_robot(folder: Path, control: str = CONTROL, finger: bool = True) -> Path:
    """A three-joint arm in the horizontal plane with, if `finger`, a sliding finger that is not the arm's.

    The finger's joint comes first in the file, so that arm joints are not the first ones of the plant.
    """
    names = ["upper_arm", "forearm", "hand"]
    joints = ["shoulder", "elbow", "wrist"]
    parents = ["base", "upper_arm", "forearm"]
    parts = [_LINK.format(name=name) for name in ["base", *names]]
    if finger:
        parts += [
            _LINK.format(name="finger"),
            _JOINT.format(name="slide", type="prismatic", parent="hand", child="finger", x=0),
        ]
    for joint, parent, child, x in zip(joints, parents, names, (0, LINK_LENGTH, LINK_LENGTH), strict=True):
        parts.append(_JOINT.format(name=joint, type="revolute", parent=parent, child=child, x=x))
        parts.append(_ACTUATOR.format(name=joint))
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "planar.urdf").write_text(f'<robot name="planar">\n{"".join(parts)}</robot>\n')
    (folder / "planar.control.yaml").write_text(control)
    return folder
