"""The model of the plant that controllers and estimators are given: scenario part `model`.

Made from the station's configuration, it agrees with the plant; the scenario may make it wrong on purpose.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import yaml

from forcectl.diagrams.workcell import Workcell
from forcectl.errors import BadInputError, invalid
from forcectl.framework.fields import Config, key
from forcectl.plant.drives.joint_friction import JointFriction
from forcectl.plant.plant_model import PlantModel

FRICTION_KEYS = ("offset", "coulomb", "viscous_forward", "viscous_backward")
# Lag of a measured force that does not report its own: [rad/s], [1], [s].
NO_LAG = (1e4, 1.0, 0.0)


@dataclass(kw_only=True)
class ModelConfig(Config, in_batches=True):
    """Scenario part `model`: how the model differs from the plant."""

    robot_compliance: float = key(1.0, "C_R of the model / C_R", bounds="from 0.001 to 1000", each=True)
    environment_compliance: float = key(1.0, "C_E of the model / C_E", bounds="from 0.001 to 1000", each=True)
    friction: str = key("", "file of identified joint friction, see `FrictionIdentification`; empty: the plant's")
    friction_scale: float = key(1.0, "factor on that friction", bounds="from 0 to 20")
    inertia_scale: float = key(
        1.0, "masses and inertias of the model / those of the robot", bounds="from 0.001 to 1000"
    )
    payload: float = key(0.0, "mass at every TCP that only the model has", unit="kg", bounds="not negative")

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.friction:
            read_friction(self.friction)

    def applied(self, model: PlantModel) -> PlantModel:
        """The model that agrees with the plant, with these errors.

        Raises:
            BadInputError: friction of another number of joints.
        """
        friction = model.friction
        if self.friction and model.robot is not None:
            friction = friction_of(self.friction, model.robot.parameters.arm_joints)
        robot = model.robot
        if robot is not None and (self.inertia_scale != 1.0 or self.payload > 0):
            robot = robot.with_inertia_error(self.inertia_scale, self.payload)
        if robot is not None and self.payload > 0:
            robot.check_torque("payload", self.payload, robot.gravity_torque(robot.context_at(model.start)))
        return replace(
            model,
            robot_compliance=self.robot_compliance * model.robot_compliance,
            environment_compliance=self.environment_compliance * model.environment_compliance,
            friction=friction.scaled(self.friction_scale),
            robot=robot,
        )


@dataclass(frozen=True)
class Setting:
    """What an analysis is given of a run beside its log.

    Attributes:
        model: what controllers and estimators were given.
        truth: the model without the errors of the scenario's part `model`.
    """

    workcell: Workcell
    model: PlantModel
    truth: PlantModel = field(repr=False)


def plant_model(workcell: Workcell, lag: tuple[float, float, float] | None = None) -> PlantModel:
    """The model that agrees with a workcell.

    Args:
        lag: of the measured force: bandwidth [rad/s], damping ratio [1] and delay [s]; that of the first sensor that
            reports one when None.
    """
    contacts, config = workcell.contacts, workcell.config
    friction = getattr(config.drive, "true_friction", None)
    rotors = workcell.rotor_inertia if friction else np.zeros(workcell.num_joints)
    bandwidth, damping_ratio, delay = force_lag(config.sensors) if lag is None else lag
    sensor = None if lag else next((each for each in config.sensors.values() if hasattr(each, "force_lag")), None)
    speeds = [getattr(sensor, "velocity_bandwidth", None) for sensor in config.sensors.values()]
    return PlantModel(
        size=len(contacts),
        period=workcell.period,
        robot_compliance=np.array([contact.robot_compliance for contact in contacts]),
        environment_compliance=np.array([contact.environment_compliance for contact in contacts]),
        sensor_bandwidth=bandwidth,
        sensor_damping_ratio=damping_ratio,
        sensor_delay=delay,
        sensor_range=getattr(sensor, "range", np.inf),
        sensor_noise=getattr(sensor, "noise_std", 0.0),
        sensor_quantum=getattr(sensor, "quantum", 0.0),
        pulls=not all(getattr(contact.environment, "one_sided", True) for contact in contacts),
        drive_compliance=workcell.drive_compliance,
        gap=np.array([contact.gap for contact in contacts]),
        robot=contacts[0].robot if contacts else workcell.robot,
        start=workcell.motor_start.copy(),
        normals=np.array([contact.n for contact in contacts]).reshape(-1, 3),
        arms=tuple(contact.arm for contact in contacts),
        posture_period=workcell.posture_period,
        singularity_limit=config.singularity_limit,
        constant_jacobian=bool(config.fidelity.constant_jacobian),
        has_gravity=workcell.has_gravity,
        friction=friction(workcell.robot) if friction else JointFriction(workcell.num_joints),
        rotor_inertia=rotors,
        velocity_bandwidth=next((speed for speed in speeds if speed is not None), np.inf),
        obstacles=workcell.obstacles,
    )


def force_lag(parts: Mapping[str, Any]) -> tuple[float, float, float]:
    """Lag of the measured force, of the first sensor or estimator that reports one, see `plant_model`."""
    for part in parts.values():
        if hasattr(part, "force_lag"):
            return part.force_lag()
    return NO_LAG


def read_friction(path: str) -> dict[str, Any]:
    """Identified joint friction from a file.

    Args:
        path: of a YAML file with `joints` and, of each, `offset` [Nm], `coulomb` [Nm], `viscous_forward` and
            `viscous_backward` [Nms/rad].

    Raises:
        BadInputError: the file cannot be read, or is not of this form.
    """
    try:
        with open(path, encoding="utf-8") as file:
            data = yaml.safe_load(file)
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        reason = getattr(error, "strerror", None) or "it is not YAML text"
        raise BadInputError(f" = {path!r}: cannot be read: {reason}", key="friction") from None
    wanted = ("joints", *FRICTION_KEYS)
    if not isinstance(data, dict) or set(data) != set(wanted):
        raise invalid("friction", path, f"a file with the keys {', '.join(wanted)}")
    counts = {len(value) if isinstance(value, list) else -1 for value in data.values()}
    if len(counts) != 1 or -1 in counts:
        raise invalid("friction", path, "a file whose values are lists of equal length")
    return data


def friction_of(path: str, joints: list[str]) -> JointFriction:
    """Identified friction of the named joints, in this order, from a file; see `read_friction`.

    Raises:
        BadInputError: the file has other joints.
    """
    data = read_friction(path)
    if sorted(data["joints"]) != sorted(joints):
        raise invalid("friction", path, f"a file about the joints {', '.join(joints)}")
    order = [data["joints"].index(name) for name in joints]
    values = {key: np.array([float(data[key][i]) for i in order]) for key in FRICTION_KEYS}
    return JointFriction(len(joints), **values)
