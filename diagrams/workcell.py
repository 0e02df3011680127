"""The workcell: a station's configuration, checked, with its robot at the start posture, before blocks are built."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from numbers import Real
from typing import TYPE_CHECKING, Any

import numpy as np
from pydrake.systems.framework import Context, DiagramBuilder, PortDataType, System

from forcectl.arrays import Vector
from forcectl.conventions import SIGNALS
from forcectl.errors import BadInputError, about, invalid, unknown
from forcectl.force.kinematic_inversion import check_start_posture
from forcectl.framework.batch import whole_multiple
from forcectl.framework.wiring import add_part, made_by
from forcectl.plant.compliance import compliance_along, robot_compliance
from forcectl.plant.contact.obstacle import ObstacleConfig
from forcectl.plant.contact.pairs.pair_contact import PairContactPart
from forcectl.plant.contact.part import PartConfig
from forcectl.plant.contact.surface import SurfaceConfig
from forcectl.plant.linear_contact import contact_response
from forcectl.plant.sensors.force_fault import check_acts
from forcectl.plant.sensors.joint_sensors import ReadingFault
from forcectl.robot.model import RobotModel, unit_normal

if TYPE_CHECKING:
    from scipy.signal import StateSpace

    from forcectl.diagrams.station import StationConfig

MOST_STEPS = 100  # largest number of plant steps in a control tick
_PERIOD = "station.period (null: the robot's)"


@dataclass(frozen=True)
class Contact:
    """A surface that the tool of one arm presses on, touched with zero force at the start.

    Attributes:
        name: name of the environment's part.
        environment: its configuration.
        arm: name of the arm that presses.
        n: outward unit normal in the world, shape (3,).
        robot: model of the workcell's robot, with the TCP of this arm.
        start: link positions at the start, shape (n_q,) [rad].
        direction: J^-1 n at the start, shape (n_q,) [rad/m].
        row: n'J at the start, displacement along n per joint motion, shape (n_q,) [m/rad].
        robot_compliance: C_R at the start, from the position command to the tool [m/N]; 0 for rigid joints.
        environment_compliance: C_E at the start [m/N].
    """

    name: str
    environment: Any
    arm: str
    n: Vector
    robot: RobotModel
    start: Vector
    direction: Vector
    row: Vector
    robot_compliance: float
    environment_compliance: float

    @property
    def surface(self) -> SurfaceConfig | None:
        """Heights and materials; None of an environment that has none."""
        return _surface_of(self.environment)

    @property
    def own_force(self) -> bool:
        """Whether the environment computes the force by a block of its own, not by the fidelity's contact model."""
        return getattr(self.environment, "own_block", hasattr(self.environment, "add_to"))

    @property
    def gap(self) -> float:
        """Distance from the tool to the surface at the start [m]."""
        return getattr(self.environment, "gap", getattr(self.surface, "gap", 0.0))

    def sampled_response(self, stiffness: float, period: float) -> StateSpace:
        """Response from [dx, dx'] of the motors to the contact force for this K_E [N/m].

        An environment without a `sampled_response` of its own counts as a spring.
        """
        if hasattr(self.environment, "sampled_response"):
            with about(self.environment):
                return self.environment.sampled_response(stiffness, self.robot_compliance, period)
        return contact_response(stiffness, 0.0, self.robot_compliance, period)

    def add_to(self, builder: DiagramBuilder, period: float, *, robot_compliance: float) -> System:
        """Add the block from displacement to contact force, in series with C_R [m/N], sampled every `period` [s]."""
        return add_part(self.environment, "environment", builder, 1, period, robot_compliance=robot_compliance)


@dataclass(frozen=True)
class Workcell:
    """A station's configuration with its robot loaded and evaluated at the start posture.

    Attributes:
        config: of the station.
        robot: kinematics, dynamics and parameters.
        start: link positions at the start, shape (n_q,) [rad].
        period: control tick [s].
        posture_period: update period of quantities that depend on the posture only [s].
        contacts: the surfaces that are pressed on, in the order of the environment's parts.
        obstacles: boxes around the robot, by name.
        parts: of assemblies, fixed or held, by name.
        pairs: contacts of two parts without meshes, by name.
    """

    config: StationConfig
    robot: RobotModel
    start: Vector
    period: float
    posture_period: float
    contacts: tuple[Contact, ...]
    obstacles: dict[str, ObstacleConfig]
    parts: dict[str, PartConfig]
    pairs: dict[str, PairContactPart]

    @property
    def num_joints(self) -> int:
        """Number of joints n_q."""
        return self.robot.num_joints

    @property
    def contact(self) -> Contact:
        """The one surface that is pressed on.

        Raises:
            BadInputError: there is none, or more than one.
        """
        if len(self.contacts) != 1:
            raise BadInputError(f" has {len(self.contacts)} surfaces: must have one here", key="environment")
        return self.contacts[0]

    @property
    def has_dynamics(self) -> bool:
        """Whether the bodies of the robot have inertia in this fidelity."""
        return bool(self.config.fidelity.has_dynamics)

    @property
    def self_collision(self) -> bool:
        """Whether links collide with each other; by default only with several arms whose shapes are all there."""
        parts, chosen = self.robot.parts, self.config.self_collision
        return chosen if chosen is not None else len(parts.arms) > 1 and not parts.missing_shapes

    @property
    def has_gravity(self) -> bool:
        """Whether gravity acts on the robot."""
        return self.has_dynamics and self.config.gravity

    @property
    def rotor_inertia(self) -> Vector:
        """Inertia of the rotors at the joints, without couplings between motors, shape (n_q,) [kg m2]."""
        return np.diag(self.robot.motor_inertia).copy()

    @property
    def drive_compliance(self) -> Vector:
        """Part of each C_R between the position command and the motors, shape (k,) [m/N].

        In stations without dynamics the compliance of a drive is part of the joint springs, so that motor positions do
        not include it.
        """
        if not self.has_dynamics:
            return np.zeros(len(self.contacts))
        return np.array([float(np.sum(each.row**2 / self.drive_stiffness)) for each in self.contacts])

    @property
    def drive_stiffness(self) -> Vector:
        """Stiffness with which the drives hold their command, shape (n_q,) [Nm/rad]; infinite for position loops."""
        return holding_stiffness(self.config.drive, self.robot)

    @property
    def spring_stiffness(self) -> Vector:
        """Stiffness of the joint springs, shape (n_q,) [Nm/rad]; without dynamics in series with that of the drives.

        Infinite for rigid joints, except where a drive moves a multibody plant through springs. These are then as stiff
        as the plant's step can resolve: well above every other stiffness, and below the bound at which the contact
        solver would soften them by itself.
        """
        rigid = np.full(self.num_joints, np.inf)
        joints: Vector = self.robot.joint_stiffness if self.config.elastic_joints else rigid
        if not self.has_dynamics:
            drive = self.drive_stiffness
            return 1 / (1 / joints + 1 / drive) if np.isfinite(drive).all() else joints
        if self.config.elastic_joints or getattr(self.config.drive, "moves_links", False):
            return joints
        inertia = np.diag(self.robot.mass_matrix(self.start_context()))
        return 10.0 * inertia / self.config.time_step**2

    @property
    def gravity_torque(self) -> Vector:
        """Torque that balances gravity at the start, shape (n_q,) [Nm]."""
        if not self.has_gravity:
            return np.zeros(self.num_joints)
        return self.robot.gravity_torque(self.start_context())

    @property
    def motor_start(self) -> Vector:
        """Motor positions at the start, q_0 of (2.12), shape (n_q,) [rad]."""
        if not self.has_dynamics:
            return self.start + np.zeros(self.num_joints)
        return self.start + self.gravity_torque / self.spring_stiffness

    def signal_size(self, name: str) -> int | None:
        """Size of the signal of this name, see `SIGNALS`; None for a name that is not there."""
        if name not in SIGNALS:
            return None
        held = sum(bool(part.arm) for part in self.parts.values())
        counts = {"n": self.num_joints, "a": len(self.robot.parts.arms), "k": len(self.contacts)}
        counts |= {"m": len(self.parts), "h": held, "": 1}
        shape = SIGNALS[name].shape
        of = shape.lstrip("0123456789")
        return int(shape.removesuffix(of) or 1) * counts[of]

    def check_sizes(self, system: System) -> None:
        """Raise BadInputError where the size of a part's output differs from that of the signal of its name."""
        for port in map(system.get_output_port, range(system.num_output_ports())):
            name = port.get_name()
            size, vector = self.signal_size(name), port.get_data_type() == PortDataType.kVectorValued
            one_of_several = name == "measured_force" and port.size() == 1
            if size is not None and vector and port.size() != size and not one_of_several:
                raise BadInputError(f" outputs {name} of size {port.size()}: must be {size} ({SIGNALS[name].shape})")

    def with_environment(self, config: StationConfig) -> Workcell:
        """The workcell of a station that differs in its environments only."""
        parts = config.environment_parts()
        contacts = [
            replace(each, environment=(part := parts[each.name]), environment_compliance=1 / part.first_stiffness)
            for each in self.contacts
        ]
        return replace(self, config=config, contacts=tuple(contacts))

    def start_context(self) -> Context:
        """A context of `robot.plant` in the start posture."""
        return self.robot.context_at(self.start)


def describe(config: StationConfig) -> Workcell:
    """Load the robot of a station and evaluate it at the start posture.

    Raises:
        BadInputError: unknown robot, arm or tool, a posture of the wrong length, beyond the joint limits or singular
            along a normal, periods that do not divide, or a part that this fidelity cannot realise.
    """
    robot = RobotModel.load(config.robot, config.tool, config.stiffness_set or None)
    robot.joint_stiffness = config.stiffness_scale * robot.joint_stiffness
    if not config.gravity:
        robot.plant.mutable_gravity_field().set_gravity_vector(np.zeros(3))
    period = robot.parameters.period if config.period is None else config.period
    _check_times(config, period)
    start = _start_posture(config, robot)
    for i, fault in enumerate(config.faults):
        if hasattr(fault, "fault"):
            made = made_by(fault, "fault", f"faults.{i}", ReadingFault, "a ReadingFault", robot.parameters.arm_joints)
            try:
                made.check(robot.num_joints)
            except BadInputError as error:
                raise error.at(f"faults.{i}.{error.field}") from None
            check_acts(f"faults.{i}.duration", made.start, made.end - made.start, period)
    environment = config.environment_parts()
    parts = {name: part for name, part in environment.items() if hasattr(part, "placement")}
    obstacles = {name: part for name, part in environment.items() if hasattr(part, "pose")}
    pairs = {name: part for name, part in environment.items() if hasattr(part, "roles")}
    for pair in pairs.values():
        with about(pair):
            named = {role: getattr(pair, role) for role in pair.roles}
            for role, part in named.items():
                if part not in parts:
                    raise unknown("part", part, parts).at(role)
            pair.check_models(*(parts[part].model for part in named.values()))
            (one, first), (other, second) = named.items()
            if parts[first].hand and parts[first].hand == parts[second].hand:
                allowed = (
                    f"a part that another arm holds than {one} = {first!r}: both are in the {parts[first].hand} hand"
                )
                raise invalid(other, second, allowed)
    _check_clear(robot, start, obstacles)
    contacts = []
    for name, part in environment.items():
        if name not in {**obstacles, **parts, **pairs}:
            with about(part):
                contacts.append(_contact(config, robot, start, name, part))
    pressed = [each.arm for each in contacts]
    if len(set(pressed)) < len(pressed):
        raise invalid("environment", sorted(environment), "at most one surface for each arm")
    workcell = Workcell(config, robot, start, period, config.posture_period, tuple(contacts), obstacles, parts, pairs)
    with about(config.fidelity):
        config.fidelity.check(workcell)
    return workcell


def _check_times(config: StationConfig, period: float) -> None:
    if whole_multiple("period", period, config.time_step, "time_step") < 1:
        raise invalid("time_step", config.time_step, f"at most the period, {period:g} s")
    if config.time_step < period / MOST_STEPS:
        if config.period is not None:
            raise invalid("period", period, f"at most {MOST_STEPS} time_step, {MOST_STEPS * config.time_step:g} s")
        raise invalid(
            "time_step", config.time_step, f"at least the period over {MOST_STEPS}, {period / MOST_STEPS:g} s"
        )
    if whole_multiple("posture_period", config.posture_period, period, "station.period") < 1:
        raise invalid("posture_period", config.posture_period, f"at least the period, {period:g} s")
    for name, delay in config.delays().items():
        whole_multiple(name, delay, period, _PERIOD if config.period is None else "station.period")


def _start_posture(config: StationConfig, robot: RobotModel) -> Vector:
    posture = robot.parameters.default_posture
    if config.posture_deg:
        if len(config.posture_deg) != robot.num_joints:
            wrong = f" has {len(config.posture_deg)} angles: must have {robot.num_joints}"
            raise BadInputError(wrong, key="posture_deg")
        posture = np.radians(config.posture_deg)
    outside = (posture < robot.limits.position_lower) | (posture > robot.limits.position_upper)
    if outside.any():
        joint = int(np.argmax(outside))
        low, high = np.degrees([robot.limits.position_lower[joint], robot.limits.position_upper[joint]])
        raise invalid(
            f"posture_deg.{joint}", float(f"{np.degrees(posture[joint]):.9g}"), f"from {low:.4g} to {high:.4g}"
        )
    return posture


def _check_clear(robot: RobotModel, start: Vector, obstacles: Mapping[str, ObstacleConfig]) -> None:
    """Raise BadInputError where a link of the robot has its origin inside a box at the start."""
    if not obstacles:
        return
    context, plant = robot.context_at(start), robot.plant
    places = {
        (body := plant.get_body(index)).name(): body.EvalPoseInWorld(context).translation()
        for index in plant.GetBodyIndices(robot.parts.instance)
    }
    for box in obstacles.values():
        for link, place in places.items():
            if box.holds(place):
                fault = f" of size {box.size} at {box.position} has the origin of {link} of the robot inside, at"
                with about(box):
                    raise BadInputError(f"{fault} {np.round(place, 3).tolist()} at the start: must be clear of it")


def holding_stiffness(drive: Any, robot: RobotModel) -> Vector:
    """Stiffness of a drive that holds its command, shape (n_q,) [Nm/rad]; infinite where the drive states none."""
    if not hasattr(drive, "holding_stiffness"):
        return np.full(robot.num_joints, np.inf)
    with about(drive):
        stiffness: Vector = drive.holding_stiffness(robot)
    return stiffness


def _surface_of(part: Any) -> SurfaceConfig | None:
    surface = getattr(part, "surface", None)
    return surface if isinstance(surface, SurfaceConfig) else None


def _contact(config: StationConfig, robot: RobotModel, start: Vector, name: str, part: Any) -> Contact:
    acts = callable(getattr(part, "add_to", None)) or hasattr(part, "touching_points")
    if not acts or not hasattr(part, "first_stiffness"):
        raise invalid("environment", part, "a part that fills the slot environment, with add_to and first_stiffness")
    stiffness = part.first_stiffness
    if isinstance(stiffness, bool) or not isinstance(stiffness, Real) or not float(stiffness) > 0:
        raise invalid("first_stiffness", stiffness, "a positive number")
    arm = getattr(part, "arm", "") or next(iter(robot.parts.arms))
    own = robot.for_arm(arm)
    n = unit_normal(getattr(part, "normal", None) or config.normal)
    surface = _surface_of(part)
    if surface is not None and not surface.uniform:
        surface.direction_across(n)
    direction = check_start_posture(own, start, n, config.singularity_limit)
    context = own.context_at(start)
    row: Vector = n @ own.jacobian(context)[3:]
    compliance = 0.0
    if config.elastic_joints:
        matrix = robot_compliance(own, context, own.joint_stiffness)
        compliance = compliance_along(n, matrix)
    compliance += float(np.sum(row**2 / holding_stiffness(config.drive, own)))
    return Contact(name, part, arm, n, own, start, direction, row, compliance, 1 / float(stiffness))
