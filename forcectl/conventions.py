"""Signs, frames, reference points and units: one place for all of them.

Signs (design equations, section 0)
    n                     unit vector of the constrained direction, outward normal of the surface,
                          from the environment towards the robot, expressed in the world frame W.
    dx = x - x_0          displacement along n from the undeformed surface; pressing in means dx < 0.
    F > 0                 force exerted by the environment on the robot along +n (compression).
    wrench                [torque; force], six numbers, Drake's order for spatial vectors.
    measured_wrench       of the environment on the tool, at the origin of the sensor frame S, expressed in S.
    contact_force         truth, scalar along n, zero without contact, never negative.

Units are SI. A port or a logged signal has the unit of its name in `SIGNAL_UNITS`; a block may override or extend
the table with a class attribute `port_units: dict[str, str]`.
"""

from __future__ import annotations

SIGNAL_UNITS: dict[str, str] = {
    "desired_force": "N",
    "measured_force": "N",
    "contact_force": "N",
    "force": "N",
    "model_force": "N",
    "measured_wrench": "Nm,N",
    "wrench": "Nm,N",
    "contact_displacement": "m",
    "displacement": "m",
    "displacement_velocity": "m/s",
    "displacement_command": "m",
    "motor_displacement": "m",
    "unconstrained_reference": "rad",
    "joint_position_command": "rad",
    "joint_position_reference": "rad",
    "joint_velocity_reference": "rad/s",
    "motor_position": "rad",
    "motor_velocity": "rad/s",
    "motor_state": "rad,rad/s",
    "link_position": "rad",
    "link_velocity": "rad/s",
    "spring_torque": "Nm",
    "load_torque": "Nm",
    "motor_torque": "Nm",
    "applied_wrench": "Nm,N",
    "contact_state": "1",
    "saturated": "1",
    "compliance": "m/N",
    "robot_compliance": "m/N",
    "environment_compliance": "m/N",
}


def unit_of(name: str, overrides: dict[str, str] | None = None) -> str:
    """Unit of the signal called `name`, or "" when the table does not know it."""
    if overrides and name in overrides:
        return overrides[name]
    return SIGNAL_UNITS.get(name, "")
