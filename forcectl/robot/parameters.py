"""The YAML files next to a robot's and a tool's model: parameters for control that URDF/SDF cannot hold.

Position limits are in the URDF/SDF only, limits of velocity, acceleration and torque too where it has them
(`RobotModel.limits`). Parameters of elastic joints and drives may be left out: see `forcectl.robot.assumptions`. Treat
parameters as constants; their arrays are read-only.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from forcectl.errors import BadInputError, invalid, invalid_entries, unknown
from forcectl.framework.fields import Config, key, key_of, typed_fields
from forcectl.framework.files.text_file import yaml_text
from forcectl.framework.reader import Reader
from forcectl.framework.yaml_tree import Tagged, parse, place
from forcectl.models import ROBOT_PARAMETERS, TOOL_PARAMETERS, parameter_file
from forcectl.robot.ranges import GEAR_RATIO
from forcectl.robot.urdf import read_urdf

T = TypeVar("T")


def _empty() -> np.ndarray:
    return np.zeros(0)


_TURN = "roll, pitch, yaw of the tool's mount in the flange frame, for a frame whose z is not out of the flange"
_NEAR = "links near the flange whose collision shapes normally touch the tool: never checked against it"


@dataclass(kw_only=True)
class ReferenceFilter(Config):
    """Position loop of every joint, h(s) = w^2 / (s^2 + 2 z w s + w^2) (2.3)."""

    natural_frequency: float = key(meaning="natural frequency w of every joint", unit="rad/s", bounds="from 1 to 1e4")
    damping_ratio: float = key(meaning="damping ratio z of every joint", unit="1", bounds="from 0.01 to 10")


@dataclass(kw_only=True)
class MotorCoupling(Config):
    """A motor that also turns with another joint.

    motor speed = gear ratio * (own joint speed + factor * other joint speed)
    """

    motor_of: str = key(meaning="joint that the motor drives, its own joint")
    driven_by: str = key(meaning="other joint with which the motor also turns")
    factor: float = key(meaning="weight of the other joint's speed; own: 1", unit="1", bounds="from -10 to 10")

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.motor_of == self.driven_by:
            raise invalid("driven_by", self.driven_by, "another joint than motor_of")


@dataclass(kw_only=True)
class ArmParameters(Config):
    """One arm of a robot that has several."""

    flange_frame: str = key(meaning="frame of the flange, which carries the tool; z out of the flange")
    flange_turn_deg: list[float] = key([0.0, 0.0, 0.0], _TURN, unit="deg", bounds="from -360 to 360", size=3)
    joints: list[str] = key(meaning="joints of the arm, consecutive in `arm_joints`")
    tool_neighbours: list[str] = key([], _NEAR)


@dataclass(kw_only=True)
class ControlParameters(Config):
    """A robot's `*.control.yaml`. Arrays have one entry per arm joint, in the order of `arm_joints`; units are SI.

    Friction of motor and gear (5.2), joint side, at the joint speed v:
    friction_offset + coulomb_friction * sign(v) + v * (viscous_friction if v > 0 else viscous_friction_backward).
    """

    model: str = key(meaning="URDF or SDF file in the same folder")
    base_frame: str = key("", "frame welded to the world; empty: root of the model, which may be a `world` of its own")
    arm_joints: list[str] = key(meaning="names of the joints of all arms, one arm after the other")
    flange_frame: str = key("", "frame of the flange of a robot with one arm: carries the tool, z out of it")
    flange_turn_deg: list[float] = key(
        [0.0, 0.0, 0.0], f"of a robot with one arm: {_TURN}", unit="deg", bounds="from -360 to 360", size=3
    )
    tool_neighbours: list[str] = key([], f"of a robot with one arm: {_NEAR}")
    arms: dict[str, ArmParameters] = key({}, "arms by name, of a robot with several")
    ignored_collisions: list[list[str]] = key(
        [], "pairs of links whose collision shapes normally overlap: never checked against each other"
    )
    held_joints: dict[str, float] = key(
        {}, "joints of the model without a drive here, such as a gripper's: fixed at this position", unit="rad, m"
    )
    default_posture_deg: np.ndarray = key(meaning="default posture; sliding joints: [m] times 180/pi", unit="deg")
    characteristic_length: float = key(
        meaning="divisor of lengths in the singularity measure: half the reach", unit="m", bounds="from 1e-3 to 100"
    )
    velocity_limit: np.ndarray = key(
        _empty, "largest joint speeds; empty: the model's", unit="rad/s", bounds="from 1e-3 to 50"
    )
    acceleration_limit: np.ndarray = key(
        _empty, "largest joint accelerations; empty: the model's, or assumed", unit="rad/s2", bounds="from 0.01 to 1e5"
    )
    torque_limit: np.ndarray = key(
        _empty, "largest joint torques, joint side; empty: the model's", unit="Nm", bounds="from 1e-4 to 1e5"
    )
    joint_stiffness: dict[str, np.ndarray] = key(
        {}, "joint stiffness, joint side, as sets by name; empty: assumed", unit="Nm/rad", bounds="from 0.01 to 1e8"
    )
    default_stiffness_set: str = key("", "name of the set of joint stiffness that is used by default")
    transmission_damping: np.ndarray = key(
        _empty, "damping of the elastic joints, joint side; empty: assumed", unit="Nms/rad", bounds="from 0 to 1e5"
    )
    reference_filter: ReferenceFilter = key(meaning="position loop of every joint")
    period: float = key(meaning="sampling period of the control", unit="s", bounds="above 0 and at most 1")
    gear_ratio: np.ndarray = key(
        _empty, "motor turns per joint turn, signed, from 1e-3 to 1e5 in size; empty: assumed", unit="1"
    )
    rotor_inertia: np.ndarray = key(_empty, "rotors, motor side; empty: assumed", unit="kg m2", bounds="from 0 to 10")
    velocity_loop_inertia: np.ndarray = key(
        _empty,
        "inertia velocity loops are tuned for, joint side, 0.01 to 1e4 times the rotors; empty: the rotors, or assumed",
        unit="kg m2",
        bounds="from 1e-6 to 1e4",
    )
    coulomb_friction: np.ndarray = key(
        _empty,
        "Coulomb friction, joint side; its sum with friction_offset is below torque_limit; empty: assumed",
        unit="Nm",
        bounds="from 0 to 1e5",
    )
    viscous_friction: np.ndarray = key(
        _empty, "viscous friction, joint side; empty: assumed", unit="Nms/rad", bounds="from 0 to 1e6"
    )
    viscous_friction_backward: np.ndarray = key(
        _empty, "viscous friction at negative speeds; empty: as at positive", unit="Nms/rad", bounds="from 0 to 1e6"
    )
    friction_offset: np.ndarray = key(_empty, "constant part of joint friction, joint side; empty: zero", unit="Nm")
    motor_coupling: list[MotorCoupling] = key([], "motors that also turn with another joint")
    link_compliance: dict[str, np.ndarray] = key(
        {},
        "compliance of links by frame: six diagonal entries, rotations then translations, in that frame's axes",
        unit="rad/Nm, m/N",
        bounds="from 0 to 0.1",
    )
    link_compliance_sets: list[str] | None = key(
        None, "sets of joint stiffness to which link_compliance is added; null: all. The others include it already"
    )
    assumed: dict[str, str] = field(default_factory=dict, init=False)  # keys that were left out, and the rule for them

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.viscous_friction_backward.size:
            self.viscous_friction_backward = self.viscous_friction
        if not self.friction_offset.size:
            self.friction_offset = np.zeros(self.num_joints)
        for name, value, allowed, ok in _control_checks(self):
            if not np.all(ok):
                raise (
                    invalid_entries(name, value, ok, allowed) if isinstance(ok, list) else invalid(name, value, allowed)
                )
        for value in vars(self).values():
            for item in value.values() if isinstance(value, dict) else [value]:
                if isinstance(item, np.ndarray):
                    item.flags.writeable = False

    @property
    def num_joints(self) -> int:
        """Number of arm joints."""
        return len(self.arm_joints)

    @property
    def default_posture(self) -> np.ndarray:
        """Joint positions of the default posture, shape (n,) [rad]."""
        return np.radians(self.default_posture_deg)

    @property
    def reflected_inertia(self) -> np.ndarray:
        """Inertia of each rotor at its joint, without couplings between motors, shape (n,) [kg m^2]."""
        return self.rotor_inertia * self.gear_ratio**2

    def coupling(self) -> np.ndarray:
        """Motor speeds before their gears per joint speeds, shape (n, n) [1]."""
        T = np.eye(self.num_joints)
        for coupling in self.motor_coupling:
            T[self.arm_joints.index(coupling.motor_of), self.arm_joints.index(coupling.driven_by)] = coupling.factor
        return T

    def stiffness(self, name: str | None = None) -> np.ndarray:
        """A joint-stiffness set, shape (n,) [Nm/rad], the default one when None; BadInputError when there is none."""
        name = self.default_stiffness_set if name is None else name
        if name not in self.joint_stiffness:
            raise unknown("stiffness set", name, self.joint_stiffness)
        return self.joint_stiffness[name]

    def bending(self, name: str | None = None) -> dict[str, np.ndarray]:
        """The link compliance to add to a joint-stiffness set; empty where the set includes it."""
        name = self.default_stiffness_set if name is None else name
        chosen = self.link_compliance_sets
        return {} if chosen is not None and name not in chosen else self.link_compliance

    def only(self, arm: str) -> ControlParameters:
        """The parameters of one arm, others held in the default posture; BadInputError when there is no such arm."""
        if not self.arms:
            raise BadInputError(f"{self.model} has one arm, which needs no name: leave out '/{arm}'")
        if arm not in self.arms:
            raise unknown(f"arm of {self.model}", arm, self.arms).at("robot")
        joints = self.arms[arm].joints
        first = self.arm_joints.index(joints[0])
        mine = slice(first, first + len(joints))
        others = {name: float(q) for name, q in zip(self.arm_joints, self.default_posture, strict=True)}
        return replace(
            self,
            arm_joints=joints,
            arms={arm: self.arms[arm]},
            held_joints=self.held_joints | {name: q for name, q in others.items() if name not in joints},
            joint_stiffness={name: values[mine] for name, values in self.joint_stiffness.items()},
            motor_coupling=[coupling for coupling in self.motor_coupling if coupling.motor_of in joints],
            **{name: getattr(self, name)[mine] for name in PER_JOINT},
        )


# Parameters that are assumed from the limits where they are left out.
DERIVED = ("joint_stiffness", "transmission_damping", "rotor_inertia", "coulomb_friction", "viscous_friction")
PER_JOINT = (
    "transmission_damping",
    "rotor_inertia",
    "coulomb_friction",
    "viscous_friction",
    "viscous_friction_backward",
    "default_posture_deg",
    "gear_ratio",
    "friction_offset",
    "velocity_loop_inertia",
    "velocity_limit",
    "acceleration_limit",
    "torque_limit",
)
_GIVEN = ("default_posture_deg", "friction_offset")  # of PER_JOINT, those that may not be empty


@dataclass(kw_only=True)
class ToolParameters(Config):
    """A tool's `*.tool.yaml`."""

    model: str = key(meaning="URDF or SDF file in the same folder")
    mount_frame: str = key(meaning="frame of the tool that is welded to the robot's flange")
    tcp_frame: str = key(meaning="frame of the tool centre point; z is the tool axis, away from the flange")
    held_joints: dict[str, float] = key({}, "joints of the tool that are fixed, at this position", unit="rad, m")
    contact_ball_frame: str | None = key(None, "frame at the centre of the contact ball; null: none")
    contact_ball_radius: float = key(0.0, "radius of the contact ball; 0: a point", unit="m", bounds="from 0 to 0.5")
    sensor_frame: str | None = key(None, "frame in which the wrist sensor measures; null: none")
    sensor_weld: str | None = key(None, "joint whose reaction the wrist sensor measures; null: none")


def load_control_parameters(folder: Path) -> ControlParameters:
    """Read and check the control parameters in a robot folder.

    Raises:
        BadInputError: no such file, unknown or missing keys, a wrong length, or a value that is not allowed.
    """
    try:
        return _load(ControlParameters, parameter_file(folder, ROBOT_PARAMETERS))
    except BadInputError as error:
        if "is missing: " in str(error) or not list(folder.glob(ROBOT_PARAMETERS)):
            error.text += f"; `forcectl robot {folder}` proposes values"
        raise


def load_tool_parameters(folder: Path) -> ToolParameters:
    """Read and check the parameters in a tool folder.

    Raises:
        BadInputError: no such file, unknown or missing keys, or a value that is not allowed.
    """
    return _load(ToolParameters, parameter_file(folder, TOOL_PARAMETERS))


def read_keys(file: Path) -> Tagged:
    """The keys of a file of parameters, unchecked; none for an empty file. BadInputError where it is no YAML."""
    try:
        tree = parse(yaml_text(file), file.name)
    except (OSError, UnicodeDecodeError) as error:
        raise BadInputError(f"{file.name}: cannot be read: {' '.join(str(error).split())}") from None
    if not isinstance(tree, Tagged | None):
        raise BadInputError(f"{file.name} is no mapping: must be keys and values")
    return Tagged() if tree is None else tree


def _load(kind: type[T], file: Path) -> T:
    tree = read_keys(file)
    model = tree.get("model")
    try:
        return Reader(lambda key: place(file.name, tree.lines, key)).dataclass(kind, tree, "")
    except BadInputError as error:
        if kind is ControlParameters and isinstance(model, str) and " is missing: " in str(error):
            error.text += "".join(f"; {text}" for text in missing_limits(tree, file.parent / model))
        if isinstance(model, str) and not os.path.isfile(file.parent / model):
            error.text += f"; model = {model!r}: there is no such file in folder {str(file.parent)!r}"
        raise


def missing_limits(keys: Mapping[str, Any], model: Path) -> list[str]:
    """Messages about limits that a URDF file does not give, and from which drive parameters are to be assumed.

    Args:
        keys: of the control parameters; without arm joints, all joints that mimic no other count.
        model: the file; no messages for other files than URDF.
    """
    if model.suffix.lower() != ".urdf" or all(name in keys for name in DERIVED):
        return []
    known = read_urdf(model).joints
    named = keys.get("arm_joints")
    if not isinstance(named, list):
        named = [name for name, joint in known.items() if joint.mimics is None]
    texts = []
    for name, quantity in (("velocity_limit", "velocity"), ("torque_limit", "effort")):
        limits = {each: getattr(known[each], quantity) for each in map(str, named) if each in known}
        without = [each for each, limit in limits.items() if not np.isfinite(limit)]
        if without and name not in keys:
            declared = next(key_of(each) for each, _ in typed_fields(ControlParameters) if each.name == name)
            meaning = f"{declared.meaning.partition(';')[0]} [{declared.unit}]"
            texts.append(
                f"{name} is missing: must be a list of numbers ({meaning}): "
                f"{model.name} gives none, or 0, of {', '.join(without)}"
            )
    return texts


_LARGEST_CONDITION = 1e9  # condition number of the matrix of motor couplings
Check = tuple[str, Any, str, bool | list[bool]]  # (field, value, what is allowed, whether it is, or each entry)


def _control_checks(parameters: ControlParameters) -> Iterator[Check]:
    n, names = parameters.num_joints, parameters.arm_joints
    yield "arm_joints", names, "joint names, at least one", n > 0
    yield "arm_joints", names, "a joint not yet in it", [name not in names[:i] for i, name in enumerate(names)]
    yield from _arm_checks(parameters)
    for name in PER_JOINT:
        values = getattr(parameters, name)
        if values.size or name in _GIVEN:
            yield _numbers(name, values, n)
    frequency, fastest = parameters.reference_filter.natural_frequency, np.pi / parameters.period
    allowed = f"below {fastest:.4g} rad/s, half the rate of control with its period of {parameters.period:g} s"
    yield "reference_filter.natural_frequency", frequency, allowed, frequency < fastest
    geared = np.abs(parameters.gear_ratio)
    allowed = f"from {GEAR_RATIO.smallest:g} to {GEAR_RATIO.largest:g} in size"
    sizes = (geared >= GEAR_RATIO.smallest) & (geared <= GEAR_RATIO.largest)
    yield "gear_ratio", parameters.gear_ratio.tolist(), allowed, sizes.tolist()
    for name, stiffness in parameters.joint_stiffness.items():
        yield _numbers(f"joint_stiffness.{name}", stiffness, n)
    known, chosen = ", ".join(parameters.joint_stiffness), parameters.default_stiffness_set
    right = chosen in parameters.joint_stiffness or not (chosen or parameters.joint_stiffness)
    yield "default_stiffness_set", chosen, f"one of the stiffness sets ({known})", right
    for i, pair in enumerate(parameters.ignored_collisions):
        yield f"ignored_collisions.{i}", pair, "two different links", len(pair) == 2 and len(set(pair)) == 2
    for frame, compliance in parameters.link_compliance.items():
        yield _numbers(f"link_compliance.{frame}", compliance, 6)
    bent = parameters.link_compliance_sets
    yield "link_compliance_sets", bent, f"at least one of the stiffness sets ({known}), or left out", bent != []
    for name in bent or []:
        yield "link_compliance_sets", name, f"stiffness sets ({known})", name in parameters.joint_stiffness
    pairs = []
    for i, coupling in enumerate(parameters.motor_coupling):
        for name in ("motor_of", "driven_by"):
            joint = getattr(coupling, name)
            yield f"motor_coupling.{i}.{name}", joint, "one of the arm joints", joint in names
        pair = [coupling.motor_of, coupling.driven_by]
        yield f"motor_coupling.{i}", pair, "another pair than those before", pair not in pairs
        pairs.append(pair)
    # Two motors may drive two joints together, as those of a differential wrist do, but not both in the same way.
    independent = bool(np.linalg.cond(parameters.coupling()) < _LARGEST_CONDITION)
    yield "motor_coupling", pairs, "such that no two motors turn in the same way", independent


def _arm_checks(parameters: ControlParameters) -> Iterator[Check]:
    flange = parameters.flange_frame
    if not parameters.arms:
        yield "flange_frame", flange, "a frame of the model (or give `arms`)", bool(flange)
    else:
        yield "flange_frame", flange, "left out beside `arms`: each arm has its own", not flange
        joints = [joint for arm in parameters.arms.values() for joint in arm.joints]
        yield "arms", joints, "those of arm_joints, in the same order", joints == parameters.arm_joints
        for name, arm in parameters.arms.items():
            yield f"arms.{name}.joints", arm.joints, "at least one joint", bool(arm.joints)
    for joint, position in parameters.held_joints.items():
        yield f"held_joints.{joint}", position, "another joint than the arm joints", joint not in parameters.arm_joints
    for coupling in parameters.motor_coupling:
        pair = {coupling.motor_of, coupling.driven_by}
        in_one = not parameters.arms or any(pair <= set(arm.joints) for arm in parameters.arms.values())
        yield "motor_coupling", sorted(pair), "two joints of one arm", in_one or not pair <= set(parameters.arm_joints)


def _numbers(where: str, values: np.ndarray, length: int) -> Check:
    ok = values.shape == (length,) and bool(np.isfinite(values).all())
    return where, values.tolist(), f"{length} finite numbers", ok
