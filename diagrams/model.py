"""The plant model that controllers and estimators use: scenario part `model`.

Made from the station's configuration, it agrees with the plant; a scenario may add model errors on purpose.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from forcectl.diagrams.workcell import Workcell
from forcectl.errors import BadInputError, check_distinct, invalid
from forcectl.framework.fields import Config, key
from forcectl.framework.reader import Reader
from forcectl.framework.yaml_tree import place
from forcectl.plant.drives.joint_friction import JointFriction
from forcectl.plant.plant_model import PlantModel
from forcectl.robot.checks import beyond_coulomb, beyond_viscous
from forcectl.robot.model import RobotModel
from forcectl.robot.parameters import read_keys

T = TypeVar("T")
FRICTION_KEYS = ("offset", "coulomb", "viscous_forward", "viscous_backward")
# Lag assumed for a measured force for which none is reported: bandwidth [rad/s], damping ratio [1], delay [s].
NO_LAG = (1e4, 1.0, 0.0)
# Coulomb and viscous friction count as exchanged if the mean |log| of their ratio to the robot's own exceeds _FAR, and
# an exchange would divide it by more than _NEARER: off by a factor of 1.6 as given, by 13 % after an exchange.
_FAR, _NEARER = 0.5, 4.0
_LARGEST_RATIO = 100.0  # largest factor between identified Coulomb friction and the robot's own, either way


@dataclass(kw_only=True)
class FrictionFile(Config):
    """A file of identified joint friction, as the analysis `FrictionIdentification` writes it."""

    joints: list[str] = key(meaning="names of the joints")
    offset: np.ndarray = key(meaning="friction offset tau_O of each joint", unit="Nm")
    coulomb: np.ndarray = key(meaning="Coulomb friction tau_C of each joint", unit="Nm", bounds="not negative")
    viscous_forward: np.ndarray = key(
        meaning="viscous friction D+ of each joint, forward", unit="Nms/rad", bounds="not negative"
    )
    viscous_backward: np.ndarray = key(
        meaning="viscous friction D- of each joint, backward", unit="Nms/rad", bounds="not negative"
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        check_distinct("joints", self.joints)
        for name in FRICTION_KEYS:
            if len(values := getattr(self, name)) != len(self.joints):
                raise invalid(name, values.tolist(), f"{len(self.joints)} numbers, one for each of joints")
        if not (self.coulomb.any() or self.viscous_forward.any() or self.viscous_backward.any()):
            raise invalid("coulomb", self.coulomb.tolist(), "above zero for some joint, unless a viscous part is")

    def of(self, robot: RobotModel) -> JointFriction:
        """The friction in the order of a robot's joints.

        Args:
            robot: with limits of its joints.

        Raises:
            BadInputError: the file is about other joints, or its friction is implausible for these joints.
        """
        joints = robot.parameters.arm_joints
        if sorted(self.joints) != sorted(joints):
            raise invalid("joints", self.joints, ", ".join(joints))
        order = [self.joints.index(name) for name in joints]
        found = JointFriction(len(joints), **{name: getattr(self, name)[order] for name in FRICTION_KEYS})
        torque, speed = robot.limits.torque, robot.limits.velocity
        wrong = {"coulomb": beyond_coulomb(found.coulomb + np.abs(found.offset), torque)}
        wrong |= {name: beyond_viscous(getattr(found, name), torque, speed) for name in FRICTION_KEYS[2:]}
        own = robot.parameters.coulomb_friction
        ratio = found.coulomb.sum() / own.sum() if own.any() else 1.0
        if found.coulomb.any() and not 1 / _LARGEST_RATIO <= ratio <= _LARGEST_RATIO:
            wrong["coulomb"] = f"in Nm, within {_LARGEST_RATIO:g} times the robot's {own.tolist()}"
        if _exchanged(found, robot):
            usual = f"{own.tolist()} Nm and {robot.parameters.viscous_friction.tolist()} Nms/rad"
            near = f"exchanged, the two would be near the robot's {usual}"
            wrong["coulomb"] = f"Coulomb friction, not viscous friction: {near}"
        for name, allowed in wrong.items():
            if allowed:
                raise invalid(name, getattr(self, name).tolist(), allowed)
        return found


def _exchanged(friction: JointFriction, robot: RobotModel) -> bool:
    """Whether Coulomb and viscous friction would be far nearer to the robot's own if they were exchanged."""
    found = np.array([friction.coulomb, friction.viscous_forward])
    own = np.array([robot.parameters.coulomb_friction, robot.parameters.viscous_friction])
    if not ((found > 0).all() and (own > 0).all()):
        return False
    as_given, exchanged = (np.abs(np.log(each / own)).mean() for each in (found, found[::-1]))
    return bool(as_given > max(_FAR, _NEARER * exchanged))


@dataclass(kw_only=True)
class PayloadConfig(Config):
    """A point mass that moves with the TCP of an arm."""

    mass: float = key(meaning="its mass", unit="kg", bounds="not negative")
    position: list[float] = key(
        [0.0, 0.0, 0.0], "its centre of mass in the TCP frame", unit="m", size=3, bounds="from -1 to 1"
    )


@dataclass(kw_only=True)
class ModelConfig(Config, in_batches=True):
    """Scenario part `model`: how the model differs from the plant."""

    robot_compliance: float = key(
        1.0, "robot compliance C_R of the model / that of the plant", bounds="from 0.001 to 1000", each=True
    )
    environment_compliance: float = key(
        1.0, "environment compliance C_E of the model / that of the plant", bounds="from 0.001 to 1000", each=True
    )
    friction: str = key(
        "",
        "file with the joint friction of the model, as the analysis `FrictionIdentification` writes it; "
        "empty: that of the plant",
    )
    friction_scale: float = key(1.0, "factor on the joint friction of the model", bounds="from 0 to 20")
    inertia_scale: float = key(
        1.0, "masses and inertias of the model / those of the plant's robot", bounds="from 0.001 to 1000"
    )
    joint_stiffness: float = key(
        1.0, "stiffness of the elastic joints of the model / that of the plant", bounds="from 0.001 to 1000"
    )
    payload: dict[str, PayloadConfig] = key(
        {}, "masses in the hands of the model that its tools do not have, by arm, as of a part that the arm holds"
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.friction:
            self._of_file(read_friction)

    def applied(self, model: PlantModel) -> PlantModel:
        """A model that agrees with the plant, with these errors added.

        Raises:
            BadInputError: friction of another number of joints, or a payload of an arm that the robot does not have.
        """
        friction = model.friction
        if self.friction and model.robot is not None:
            robot_of_file = model.robot
            friction = self._of_file(lambda path: friction_of(path, robot_of_file))
        robot = model.robot
        if robot is not None and (self.inertia_scale != 1.0 or self.payload):
            loads = {arm: (each.mass, np.array(each.position)) for arm, each in self.payload.items()}
            robot = robot.with_other_masses(self.inertia_scale, loads)
        if robot is not None and self.payload:
            masses = {arm: each.mass for arm, each in self.payload.items()}
            robot.check_torque("payload", masses, robot.gravity_torque(robot.context_at(model.start)))
        return replace(
            model,
            robot_compliance=self.robot_compliance * model.robot_compliance,
            drive_compliance=self.robot_compliance * model.drive_compliance,
            environment_compliance=self.environment_compliance * model.environment_compliance,
            friction=friction.scaled(self.friction_scale),
            joint_stiffness=self.joint_stiffness * model.joint_stiffness,
            robot=robot,
        )

    def _of_file(self, read: Callable[[str], T]) -> T:
        """The result of reading the file; an error in it is reported about the key `friction`."""
        try:
            return read(self.friction)
        except BadInputError as error:
            raise BadInputError(str(error), key="friction", value=self.friction) from None


@dataclass(frozen=True)
class Setting:
    """The input of an analysis beside the log of a run.

    Attributes:
        model: the plant model that controllers and estimators use.
        truth: that model without the errors of the scenario's part `model`.
    """

    workcell: Workcell
    model: PlantModel
    truth: PlantModel = field(repr=False)


def plant_model(workcell: Workcell, lag: tuple[float, float, float] | None = None) -> PlantModel:
    """The model that agrees with a workcell.

    Args:
        lag: of the measured force: bandwidth [rad/s], damping ratio [1] and delay [s]; None: that of the first sensor
            that reports one.
    """
    contacts, config = workcell.contacts, workcell.config
    friction = getattr(config.drive, "true_friction", None)
    rotors = workcell.rotor_inertia if friction else np.zeros(workcell.num_joints)
    bandwidth, damping_ratio, delay = force_lag(config.sensors) if lag is None else lag
    sensor = None if lag else next((each for each in config.sensors.values() if hasattr(each, "force_lag")), None)
    interface = next((each for each in config.sensors.values() if hasattr(each, "velocity_bandwidth")), None)
    sticking = getattr(config.drive, "sticking_travel", None)
    elastic = workcell.has_dynamics and config.elastic_joints
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
        joint_stiffness=workcell.robot.joint_stiffness if elastic else np.zeros(0),
        velocity_bandwidth=getattr(interface, "velocity_bandwidth", np.inf),
        obstacles=workcell.obstacles,
        unseen_travel=sticking(workcell) + getattr(interface, "quantum", 0.0) if sticking else np.zeros(0),
    )


def force_lag(parts: Mapping[str, Any]) -> tuple[float, float, float]:
    """Lag of the measured force, of the first sensor or estimator that reports one, see `plant_model`."""
    for part in parts.values():
        if hasattr(part, "force_lag"):
            return part.force_lag()
    return NO_LAG


def read_friction(path: str) -> FrictionFile:
    """Identified joint friction from a YAML file.

    Raises:
        BadInputError: the file cannot be read, or is not of this form.
    """
    tree = read_keys(Path(path))
    return Reader(lambda key: place(Path(path).name, tree.lines, key)).dataclass(FrictionFile, tree)


def friction_of(path: str, robot: RobotModel) -> JointFriction:
    """Identified friction from a file, in the order of a robot's joints; see `FrictionFile`.

    Raises:
        BadInputError: the file cannot be read, is about other joints, or its friction is implausible for them.
    """
    file = read_friction(path)
    try:
        return file.of(robot)
    except BadInputError as error:
        raise error.at(error.key, place(Path(path).name, read_keys(Path(path)).lines, error.key)) from None
