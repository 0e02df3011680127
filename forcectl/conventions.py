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
the table with a class attribute `port_units: dict[str, str]`. What the components of a logged port are follows from
its shape in `SIGNALS`; of any other port a block says it in `port_components: dict[str, str | Components]`, where a
text is such a shape: "n" is one for each joint.

Signals that pass between the parts of a loop stand in `SIGNALS`: ports of these names are connected by name. Shapes are
in terms of n joints, a arms, k surfaces that are pressed on and m parts, of which arms can hold h.
"""

from __future__ import annotations

from typing import NamedTuple


class Signal(NamedTuple):
    """A signal that passes between the parts of a loop.

    Attributes:
        unit: of its elements.
        shape: of the port.
        meaning: with frame and sign.
        truth: exists in the simulation only; no controller or estimator is connected to it.
    """

    unit: str
    shape: str
    meaning: str
    truth: bool = False


class Components(NamedTuple):
    """What the components of a port are, which a log names.

    Attributes:
        dimension: that they are along; all signals along it have these labels.
        labels: their names.
        units: of each; empty: all have the unit of the port.
    """

    dimension: str
    labels: tuple[str, ...]
    units: tuple[str, ...] = ()


SIGNALS: dict[str, Signal] = {
    # references
    "desired_force": Signal("N", "k", "force wanted along the normal of each surface, pressing is positive"),
    "unconstrained_reference": Signal("rad", "n", "joint motion in the unconstrained directions, from the start"),
    # commands
    "joint_position_command": Signal("rad", "n", "joint positions that the drives are to reach"),
    "joint_velocity_command": Signal("rad/s", "n", "speeds of that motion"),
    "mode": Signal("1", "1", "number of the mode of a reactive controller, from 0 on"),
    "joint_torque_feedforward": Signal("Nm", "n", "torques on top of the drives' own, positive along the joints"),
    "gripper_command": Signal("1", "a", "above 0.5 the gripper of the arm is to be closed, else open"),
    # what is measured
    "measured_force": Signal("N", "k", "force of each surface on the tool along its normal"),
    "measured_wrench": Signal("Nm,N", "6", "of the environment on the tool, at the sensor frame S in S"),
    "motor_position": Signal("rad", "n", "of the motors, joint side"),
    "motor_velocity": Signal("rad/s", "n", "of the motors, joint side"),
    "joint_position": Signal("rad", "n", "readings of the robot's interface"),
    "joint_velocity": Signal("rad/s", "n", "readings of the robot's interface"),
    "motor_torque": Signal("Nm", "n", "readings of the robot's interface, mean over the last tick"),
    "gripper_holds": Signal("1", "a", "1 where the gripper of the arm is closed and something is between its fingers"),
    # what is estimated
    "tare": Signal("1", "1", "above 0.5 estimated wrenches are tared, below -0.5 that is forgotten"),
    "estimated_torque": Signal("Nm", "n", "external joint torques"),
    "estimated_wrench": Signal("Nm,N", "6a", "of the environment on the robot at each TCP in the world"),
    "estimated_local_wrench": Signal("Nm,N", "6a", "the same, in the axes of another frame that the estimator names"),
    # what exists in the simulation only
    "contact_force": Signal("N", "k", "force of each surface on the tool along its normal, never negative", True),
    "contact_state": Signal("1", "k", "of each surface: 0 not touched yet, 1 in contact, 2 contact lost", True),
    "contact_losses": Signal("1", "k", "how often the contact with each surface was lost so far", True),
    "contact_displacement": Signal("m", "k", "of the tool along each normal by the motors, from the start", True),
    "link_position": Signal("rad", "n", "of the links", True),
    "link_velocity": Signal("rad/s", "n", "of the links", True),
    "surface_height": Signal("m", "1", "of the surface under the tool", True),
    "surface_tilt": Signal("rad", "1", "slope of the surface under the tool, where its normal turns", True),
    "surface_stiffness": Signal("N/m", "1", "of the material under the tool", True),
    "surface_damping": Signal("N s/m", "1", "of the material under the tool", True),
    "external_torque": Signal("Nm", "n", "of all loads and contacts on the joints", True),
    "tip_wrench": Signal("Nm,N", "6a", "of loads and contacts on the tools, at each TCP in the world", True),
    "applied_wrench": Signal("Nm,N", "6a", "of the loads at each TCP in the world", True),
    "arm_contact_force": Signal("N", "a", "sum of the magnitudes of the contact forces on each arm", True),
    "part_released": Signal("1", "h", "1 while no gripper holds the part", True),
    "part_position": Signal("m", "3m", "of the frames of the parts in the world", True),
    "part_orientation": Signal("1", "4m", "of these frames in the world, quaternions [w, x, y, z]", True),
    "body_contact_wrench": Signal("Nm,N", "6", "between the bodies of a `!ContactTruth`, in its frame", True),
}

# Components of a wrench.
WRENCH_PARTS = ("torque_x", "torque_y", "torque_z", "force_x", "force_y", "force_z")

# Names of ports inside of parts.
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
