"""Signs, frames, reference points and units: one place for all of them.

Signs (design equations, section 0)::

    n                     unit vector of the constrained direction, outward normal of the surface,
                          from the environment towards the robot, expressed in the world frame W.
    dx = x - x_0          displacement along n from the undeformed surface; pressing in means dx < 0.
    F > 0                 force exerted by the environment on the robot along +n (compression).
    wrench                [torque; force], six numbers, Drake's order for spatial vectors.
    measured_wrench       of the environment on the tool, at the origin of the sensor frame S, expressed in S.
    contact_force         truth, scalar along n, zero without contact, never negative.

Units are SI. A port or a logged signal has the unit of its name in `SIGNAL_UNITS`; a block may override or extend
the table with a class attribute `port_units: dict[str, str]`. The components of a logged port follow from its shape in
`SIGNALS`. For any other port a block gives them in `port_components: dict[str, str | Components]`; a text there is such
a shape: "n" means one component for each joint.

Signals between the parts of a loop are listed in `SIGNALS`: ports of these names are connected by name. Shapes are in
terms of n joints, a arms, k surfaces to press on and m parts, h of which the arms can hold.
"""

from __future__ import annotations

from typing import NamedTuple


class Signal(NamedTuple):
    """A signal that passes between the parts of a loop.

    Attributes:
        unit: unit of its elements.
        shape: shape of the port.
        meaning: description, with frame and sign.
        truth: whether it exists in the simulation only; no controller or estimator is connected to it.
    """

    unit: str
    shape: str
    meaning: str
    truth: bool = False


class Components(NamedTuple):
    """The components of a port, as a log names them.

    Attributes:
        dimension: name of the log's dimension along them; all signals along it have these labels.
        labels: names of the components.
        units: unit of each component; empty: all have the unit of the port.
    """

    dimension: str
    labels: tuple[str, ...]
    units: tuple[str, ...] = ()


SIGNALS: dict[str, Signal] = {
    # references
    "desired_force": Signal("N", "k", "desired force along the normal of each surface, pressing is positive"),
    "unconstrained_reference": Signal(
        "rad", "n", "joint motion in the unconstrained directions, from the start posture"
    ),
    # commands
    "joint_position_command": Signal("rad", "n", "set-points of the joint positions, for the drives"),
    "joint_velocity_command": Signal("rad/s", "n", "set-points of the joint velocities, for the drives"),
    "dithered_position": Signal("rad", "n", "joint_position_command with the dither of the drives"),
    "dithered_velocity": Signal("rad/s", "n", "joint_velocity_command with the dither of the drives"),
    "mode": Signal("1", "1", "number of the active mode of a reactive controller, from 0 on"),
    "joint_torque_feedforward": Signal("Nm", "n", "torques added to those of the drives, positive along the joints"),
    "gripper_command": Signal("1", "a", "above 0.5: close the gripper of the arm; else: open it"),
    # what is measured
    "measured_force": Signal("N", "k", "measured force of each surface on the tool along its normal"),
    "measured_wrench": Signal(
        "Nm,N", "6", "measured wrench of the environment on the tool, at the origin of the sensor frame S, in S"
    ),
    "motor_position": Signal("rad", "n", "positions of the motors, on the joint side of the gears"),
    "motor_velocity": Signal("rad/s", "n", "velocities of the motors, on the joint side of the gears"),
    "joint_position": Signal("rad", "n", "joint positions that the robot's interface reports"),
    "joint_velocity": Signal("rad/s", "n", "joint velocities that the robot's interface reports"),
    "motor_torque": Signal("Nm", "n", "motor torques that the robot's interface reports, mean over the last tick"),
    "gripper_holds": Signal("1", "a", "1 while the gripper of the arm is closed on an object, else 0"),
    # what is estimated
    "tare": Signal("1", "1", "above 0.5: estimated wrenches are tared; below -0.5: taring is undone"),
    "estimated_torque": Signal("Nm", "n", "estimated external joint torques"),
    "estimated_wrench": Signal("Nm,N", "6a", "estimated wrench of the environment on the robot at each TCP, in W"),
    "estimated_local_wrench": Signal("Nm,N", "6a", "estimated_wrench, but in the axes of a frame of the estimator"),
    # what exists in the simulation only
    "contact_force": Signal("N", "k", "true force of each surface on the tool along its normal, never negative", True),
    "contact_state": Signal("1", "k", "state of each contact: 0 not touched yet, 1 in contact, 2 contact lost", True),
    "contact_losses": Signal("1", "k", "number of times that the contact with each surface was lost so far", True),
    "contact_displacement": Signal("m", "k", "displacement of the tool along each normal, from motor positions", True),
    "link_position": Signal("rad", "n", "positions of the links, behind the joint elasticity", True),
    "link_velocity": Signal("rad/s", "n", "velocities of the links, behind the joint elasticity", True),
    "surface_height": Signal("m", "1", "height of the surface under the tool, along its normal", True),
    "surface_tilt": Signal("rad", "1", "slope of the surface under the tool, for a surface whose normal varies", True),
    "surface_stiffness": Signal("N/m", "1", "stiffness of the material under the tool", True),
    "surface_damping": Signal("N s/m", "1", "damping of the material under the tool", True),
    "external_torque": Signal("Nm", "n", "joint torques of all loads and contacts", True),
    "tip_wrench": Signal("Nm,N", "6a", "wrench of loads and contacts on the tools, at each TCP, in W", True),
    "applied_wrench": Signal("Nm,N", "6a", "wrench of the loads at each TCP, in W", True),
    "arm_contact_force": Signal("N", "a", "sum of the magnitudes of the contact forces on each arm", True),
    "part_released": Signal("1", "h", "1 while no gripper holds the part, else 0", True),
    "part_position": Signal("m", "3m", "positions of the frames of the parts in W", True),
    "part_orientation": Signal("1", "4m", "orientations of these frames in W, quaternions [w, x, y, z]", True),
    "body_contact_wrench": Signal(
        "Nm,N", "6", "contact wrench between the bodies of a `!ContactTruth`, in its frame", True
    ),
}

# Dimension of the coordinates of all tasks in a log.
TASK_COORDINATE = "task_coordinate"

# Components of a wrench.
WRENCH_PARTS = ("torque_x", "torque_y", "torque_z", "force_x", "force_y", "force_z")

# Units of ports inside of parts.
_FURTHER = {
    "force": "N",
    "model_force": "N",
    "wrench": "Nm,N",
    "displacement": "m",
    "displacement_velocity": "m/s",
    "displacement_command": "m",
    "displacement_velocity_command": "m/s",
    "motor_displacement": "m",
    "path_displacement": "m",
    "surface_offset": "m",
    "sliding": "1",
    "motor_state": "rad,rad/s",
    "spring_torque": "Nm",
    "load_torque": "Nm",
    "saturated": "1",
    "status": "1",
    "compliance": "m/N",
    "robot_compliance": "m/N",
    "environment_compliance": "m/N",
}
SIGNAL_UNITS: dict[str, str] = {name: signal.unit for name, signal in SIGNALS.items()} | _FURTHER
TRUTH = frozenset(name for name, signal in SIGNALS.items() if signal.truth)


def unit_of(name: str, overrides: dict[str, str] | None = None) -> str:
    """Unit of the signal called `name`, or "" when it is not in the table."""
    return (SIGNAL_UNITS | (overrides or {})).get(name, "")
