"""The YAML files beside a robot's and a tool's model: what control needs and URDF/SDF cannot say.

Position, velocity, acceleration and torque limits are not here: they are in the URDF/SDF (`RobotModel.limits`).
The classes are read by Drake's `yaml_load_typed`, which fills them field by field, so they cannot be declared frozen;
treat them as constants (their arrays are read-only).
"""

import dataclasses
import typing
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from pydrake.common.yaml import yaml_load_file, yaml_load_typed

from forcectl.errors import BadInputError, invalid, unknown
from forcectl.models import ROBOT_FACTS, TOOL_FACTS, facts_file

T = TypeVar("T")
_OPTIONAL = {"optional": True}


def _empty() -> np.ndarray:
    return np.zeros(0)


@dataclass
class ReferenceFilter:
    """Position loop of every joint, h(s) = w^2 / (s^2 + 2 z w s + w^2) (2.3)."""

    natural_frequency: float = 0.0  # w [rad/s]
    damping_ratio: float = 0.0  # z [1]


@dataclass
class MotorCoupling:
    """A motor that also turns with another joint.

    motor speed = gear ratio * (own joint speed + factor * other joint speed)
    """

    motor_of: str = ""  # joint whose motor it is
    driven_by: str = ""  # the other joint
    factor: float = 0.0  # [1]


@dataclass
class ArmFacts:
    """One arm of a robot that has several."""

    flange_frame: str = ""  # carries the tool; z out of the flange
    joints: list[str] = field(default_factory=list)  # consecutive in `arm_joints`
    # Links so near the flange that a tool on it touches their shapes in the ordinary: never checked against the tool.
    tool_neighbours: list[str] = field(default_factory=list, metadata=_OPTIONAL)


@dataclass
class ControlFacts:
    """A robot's `*.control.yaml`. Lists have one entry per arm joint, in the order of `arm_joints`; units are SI.

    Friction of motor and gear (5.2), joint side, at the joint speed v:
    friction_offset + coulomb_friction * sign(v) + v * (viscous_friction if v > 0 else viscous_friction_backward).
    """

    model: str = ""  # URDF or SDF file in the same folder
    base_frame: str = ""  # welded to the world
    arm_joints: list[str] = field(default_factory=list)  # of all arms, one arm after the other
    flange_frame: str = field(default="", metadata=_OPTIONAL)  # of a robot with one arm: carries the tool, z out of it
    arms: dict[str, ArmFacts] = field(default_factory=dict, metadata=_OPTIONAL)  # of a robot with several
    # Joints of the model that nothing drives here (a gripper's): made rigid at this position [rad] or [m].
    held_joints: dict[str, float] = field(default_factory=dict, metadata=_OPTIONAL)
    default_posture_deg: np.ndarray = field(default_factory=_empty)  # [deg]
    characteristic_length: float = 0.0  # [m], makes translations and rotations comparable in the singularity measure
    joint_stiffness: dict[str, np.ndarray] = field(default_factory=dict)  # named sets, joint side [Nm/rad]
    default_stiffness_set: str = ""
    transmission_damping: np.ndarray = field(default_factory=_empty)  # joint side [Nms/rad]
    reference_filter: ReferenceFilter = field(default_factory=ReferenceFilter)
    period: float = 0.0  # control sampling [s]
    gear_ratio: np.ndarray = field(default_factory=_empty)  # motor turns per joint turn, signed [1]
    rotor_inertia: np.ndarray = field(default_factory=_empty)  # motor side [kg m2]
    # What the velocity loops of the drives are tuned for, joint side [kg m2]; the rotors alone when left out.
    velocity_loop_inertia: np.ndarray = field(default_factory=_empty, metadata=_OPTIONAL)
    coulomb_friction: np.ndarray = field(default_factory=_empty)  # joint side [Nm]
    viscous_friction: np.ndarray = field(default_factory=_empty)  # joint side [Nms/rad]
    # At negative speeds [Nms/rad]; as `viscous_friction` when left out.
    viscous_friction_backward: np.ndarray = field(default_factory=_empty, metadata=_OPTIONAL)
    friction_offset: np.ndarray = field(default_factory=_empty, metadata=_OPTIONAL)  # [Nm]; zero when left out
    motor_coupling: list[MotorCoupling] = field(default_factory=list, metadata=_OPTIONAL)
    # Distal frame of a link -> six diagonal entries, rotations [rad/Nm] then translations [m/N], in that frame's axes.
    link_compliance: dict[str, np.ndarray] = field(default_factory=dict, metadata=_OPTIONAL)

    @property
    def num_joints(self) -> int:
        """Number of arm joints."""
        return len(self.arm_joints)

    @property
    def default_posture(self) -> np.ndarray:
        """Joint positions of the default posture, shape (n,) [rad]."""
        posture: np.ndarray = np.radians(self.default_posture_deg)
        return posture

    def stiffness(self, name: str | None = None) -> np.ndarray:
        """A joint-stiffness set, shape (n,) [Nm/rad]; the default one when `name` is None.

        Raises:
            BadInputError: there is no such set.
        """
        name = self.default_stiffness_set if name is None else name
        if name not in self.joint_stiffness:
            raise unknown("stiffness set", name, self.joint_stiffness)
        return self.joint_stiffness[name]

    def only(self, arm: str) -> "ControlFacts":
        """The facts of one arm of a robot that has several; the joints of the others are held in the default posture.

        Raises:
            BadInputError: there is no such arm.
        """
        if not self.arms:
            raise BadInputError(f"{self.model} has one arm, which needs no name: leave out '/{arm}'")
        if arm not in self.arms:
            raise unknown(f"arm of {self.model}", arm, self.arms)
        joints = self.arms[arm].joints
        first = self.arm_joints.index(joints[0])
        mine = slice(first, first + len(joints))
        others = {name: float(q) for name, q in zip(self.arm_joints, self.default_posture, strict=True)}
        return dataclasses.replace(
            self,
            arm_joints=joints,
            arms={arm: self.arms[arm]},
            held_joints=self.held_joints | {name: q for name, q in others.items() if name not in joints},
            joint_stiffness={name: values[mine] for name, values in self.joint_stiffness.items()},
            motor_coupling=[coupling for coupling in self.motor_coupling if coupling.motor_of in joints],
            **{name: getattr(self, name)[mine] for name in (*_PER_JOINT, "velocity_loop_inertia")},
        )


_NOT_NEGATIVE = (
    "transmission_damping",
    "rotor_inertia",
    "coulomb_friction",
    "viscous_friction",
    "viscous_friction_backward",
)
_PER_JOINT = (*_NOT_NEGATIVE, "default_posture_deg", "gear_ratio", "friction_offset")


@dataclass
class ToolFacts:
    """A tool's `*.tool.yaml`."""

    model: str = ""  # URDF or SDF file in the same folder
    mount_frame: str = ""  # welded to the robot's flange
    tcp_frame: str = ""  # z is the tool axis, away from the flange
    held_joints: dict[str, float] = field(default_factory=dict, metadata=_OPTIONAL)  # rigid at this position [rad], [m]
    contact_ball_frame: str | None = field(default=None, metadata=_OPTIONAL)  # centre of the ball that touches
    contact_ball_radius: float = field(default=0.0, metadata=_OPTIONAL)  # [m]; a sharp point is 0
    sensor_frame: str | None = field(default=None, metadata=_OPTIONAL)  # where the wrist sensor measures
    sensor_weld: str | None = field(default=None, metadata=_OPTIONAL)  # joint whose reaction the sensor measures


def load_control_facts(folder: Path) -> ControlFacts:
    """Read and check the control facts in a robot folder; what may be left out is filled in.

    Raises:
        BadInputError: no such file, an unknown or missing key, a wrong length, or a value that is not allowed.
    """
    file = facts_file(folder, ROBOT_FACTS)
    facts = _load(ControlFacts, file)
    if not facts.viscous_friction_backward.size:
        facts.viscous_friction_backward = facts.viscous_friction
    if not facts.friction_offset.size:
        facts.friction_offset = _constant(np.zeros(facts.num_joints))
    for where, value, allowed, ok in _control_checks(facts):
        if not ok:
            raise invalid(f"{file.name}: {where}", value, allowed)
    return facts


def load_tool_facts(folder: Path) -> ToolFacts:
    """Read and check the facts in a tool folder.

    Raises:
        BadInputError: no such file, an unknown or missing key, or a value that is not allowed.
    """
    file = facts_file(folder, TOOL_FACTS)
    facts = _load(ToolFacts, file)
    if not (np.isfinite(facts.contact_ball_radius) and facts.contact_ball_radius >= 0):
        raise invalid(f"{file.name}: contact_ball_radius", facts.contact_ball_radius, "a finite number >= 0")
    for joint, position in facts.held_joints.items():
        if not np.isfinite(position):
            raise invalid(f"{file.name}: held_joints.{joint}", position, "finite")
    return facts


Check = tuple[str, Any, str, bool]  # (field, value, what is allowed, whether it is)


def _control_checks(facts: ControlFacts) -> Iterator[Check]:
    n = facts.num_joints
    yield "arm_joints", facts.arm_joints, "different joint names, at least one", 0 < n == len(set(facts.arm_joints))
    yield from _arm_checks(facts)
    for name in _PER_JOINT:
        yield _numbers(name, getattr(facts, name), n, "not negative" if name in _NOT_NEGATIVE else "")
    if facts.velocity_loop_inertia.size:
        yield _numbers("velocity_loop_inertia", facts.velocity_loop_inertia, n, "positive")
    yield "gear_ratio", facts.gear_ratio.tolist(), "different from zero", bool(np.all(facts.gear_ratio != 0))
    for name, stiffness in facts.joint_stiffness.items():
        yield _numbers(f"joint_stiffness.{name}", stiffness, n, "positive")
    known = ", ".join(facts.joint_stiffness)
    chosen = facts.default_stiffness_set
    yield "default_stiffness_set", chosen, f"one of the stiffness sets ({known})", chosen in facts.joint_stiffness
    for frame, compliance in facts.link_compliance.items():
        yield _numbers(f"link_compliance.{frame}", compliance, 6, "not negative")
    for coupling in facts.motor_coupling:
        for name in ("motor_of", "driven_by"):
            joint = getattr(coupling, name)
            yield f"motor_coupling.{name}", joint, "one of the arm joints", joint in facts.arm_joints
        different = coupling.motor_of != coupling.driven_by
        yield "motor_coupling.driven_by", coupling.driven_by, "another joint than motor_of", different
        yield "motor_coupling.factor", coupling.factor, "finite", bool(np.isfinite(coupling.factor))
    for name, value in (
        ("period", facts.period),
        ("characteristic_length", facts.characteristic_length),
        ("reference_filter.natural_frequency", facts.reference_filter.natural_frequency),
        ("reference_filter.damping_ratio", facts.reference_filter.damping_ratio),
    ):
        yield name, value, "a positive finite number", bool(np.isfinite(value) and value > 0)


def _arm_checks(facts: ControlFacts) -> Iterator[Check]:
    if not facts.arms:
        yield "flange_frame", facts.flange_frame, "a frame of the model (or give `arms`)", bool(facts.flange_frame)
    else:
        yield "flange_frame", facts.flange_frame, "left out beside `arms`: each arm has its own", not facts.flange_frame
        joints = [joint for arm in facts.arms.values() for joint in arm.joints]
        yield "arms: joints", joints, "those of arm_joints, in the same order", joints == facts.arm_joints
        for name, arm in facts.arms.items():
            yield f"arms.{name}: joints", arm.joints, "at least one joint", bool(arm.joints)
    for joint, position in facts.held_joints.items():
        yield f"held_joints.{joint}", position, "finite", bool(np.isfinite(position))
        yield "held_joints", joint, "another joint than the arm joints", joint not in facts.arm_joints
    for coupling in facts.motor_coupling:
        pair = {coupling.motor_of, coupling.driven_by}
        in_one = not facts.arms or any(pair <= set(arm.joints) for arm in facts.arms.values())
        yield "motor_coupling", sorted(pair), "two joints of one arm", in_one or not pair <= set(facts.arm_joints)


def _numbers(where: str, values: np.ndarray, length: int, sign: str = "") -> Check:
    ok = values.shape == (length,) and bool(np.isfinite(values).all())
    ok = ok and not (sign == "positive" and (values <= 0).any()) and not (sign == "not negative" and (values < 0).any())
    return where, values.tolist(), f"{length} finite numbers" + (f", each {sign}" if sign else ""), ok


def _load(schema: type[T], file: Path) -> T:
    try:
        data = yaml_load_file(str(file))
        _check_shape(schema, data, file.name)
        facts: T = yaml_load_typed(schema=schema, filename=str(file))
    except BadInputError:
        raise
    # The YAML reader raises a dozen types on a malformed file; all mean that the file cannot be used.
    except Exception as error:
        raise BadInputError(f"{file.name}: cannot be read: {' '.join(str(error).split())}") from error
    for value in _arrays(facts):
        _constant(value)
    return facts


def _constant(values: np.ndarray) -> np.ndarray:
    values.flags.writeable = False
    return values


def _check_shape(schema: Any, data: Any, where: str) -> None:
    """Refuse unknown and missing keys and wrong types; Drake's messages do not say which field or what is allowed."""
    origin, arguments = typing.get_origin(schema), typing.get_args(schema)
    if dataclasses.is_dataclass(schema):
        _require(isinstance(data, dict), where, data, "keys and values")
        fields = {f.name: f for f in dataclasses.fields(schema)}
        for key in data:
            if key not in fields:
                raise unknown(f"key in {where}:", str(key), fields)
        for name, f in fields.items():
            if name in data:
                _check_shape(f.type, data[name], f"{where}: {name}")
            elif not f.metadata.get("optional"):
                raise BadInputError(f"{where}: key {name!r} is missing")
    elif origin is list:
        _require(isinstance(data, list), where, data, "a list")
        for item in data:
            _check_shape(arguments[0], item, where)
    elif origin is dict:
        _require(isinstance(data, dict), where, data, "names and values")
        for name, item in data.items():
            _check_shape(arguments[1], item, f"{where}.{name}")
    elif schema is np.ndarray:
        _require(isinstance(data, list) and all(map(_is_number, data)), where, data, "a list of numbers")
    elif schema is float:
        _require(_is_number(data), where, data, "a number")
    else:  # text, or text that may be left out
        _require(isinstance(data, str) or (data is None and schema is not str), where, data, "text")


def _is_number(value: Any) -> bool:
    try:
        return not isinstance(value, bool) and np.isscalar(float(value))  # YAML reads 1e-4 as text
    except (TypeError, ValueError):
        return False


def _require(ok: bool, where: str, value: Any, allowed: str) -> None:
    if not ok:
        raise invalid(where, value, allowed)


def _arrays(facts: Any) -> Iterator[np.ndarray]:
    for value in vars(facts).values():
        for item in value.values() if isinstance(value, dict) else [value]:
            if isinstance(item, np.ndarray):
                yield item
