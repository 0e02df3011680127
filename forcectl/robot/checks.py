"""Plausibility checks of a robot in a plant: drives, weight, joints and tools that do not fit together."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import BodyIndex, Frame, Joint, JointActuator, ModelInstanceIndex, RevoluteJoint, RigidBody

from forcectl.arrays import Array
from forcectl.errors import BadInputError, check_distinct, invalid
from forcectl.framework.yaml_tree import place
from forcectl.models import TOOL_PARAMETERS, parameter_file, tool_folder
from forcectl.robot.model_file import ModelFile
from forcectl.robot.parameters import ControlParameters, ToolParameters, read_keys
from forcectl.robot.ranges import densest_moment

if TYPE_CHECKING:
    from forcectl.robot.model import RobotModel
    from forcectl.robot.parts import ArmParts

_HEAVIEST_TOOL = 2000.0  # [kg]: the largest robots carry little more
_FRICTION_SHARE = 10.0  # largest viscous friction at the speed limit / torque limit: beyond it is an input error
_LOOP_INERTIA = 0.01, 1e4  # accepted range of the inertia a velocity loop is tuned for / its rotor inertia
# [rad] accepted range of the twist of a joint at its torque limit. Gears of robots have 1e-3 to 4e-2, intended springs
# up to 0.5, a shaft without a gear 1e-4. Beyond are wrong units: Nm/mrad or Nmm/rad, or Nm/arcmin, a factor of 3438.
_TWIST = 1e-5, 1.0
# Largest torque limit / torque of the weight of all that moves at the end of the reach. Arms of 0.5 kg and of 3 t have
# 1 to 5, and public models with 1 kg and 1000 Nm as placeholders of unknown values have 30.
_STRONGEST = 100.0
_GRAVITY = 9.81  # [m/s2]
# [rad/s2] accepted range of the acceleration of a rotor alone at the torque limit of its joint: servos have 1e3 to 1e5,
# small ones 1e6. If all joints are above it, the unit is wrong; a single one may have a placeholder torque.
SLOWEST, _QUICKEST = 50.0, 5e6
DAMPING_TIME = 1.0  # [s] largest damping / stiffness of a transmission; usual are some ms
_OF_REACH = 0.02, 5.0  # accepted range of the characteristic length / reach
_BALL = 1.5, 1e-3  # largest distance from the centre of a tool's ball to its TCP: so many radii plus so many [m]
# Moments of inertia are checked in links with at least this share of the mass that moves. They must be at least this
# share of the moment of the densest body of that mass: below, the unit is wrong by a thousand. Lighter links of public
# models have guessed moments; in 74 models every heavier link that moves has at least twice that, and most ten times.
_SHARE, _DENSE = 0.1, 0.3


@contextmanager
def about_file(kind: Any, path: Path) -> Iterator[None]:
    """Add the file and the line to errors about keys of these parameters that are raised within."""
    try:
        yield
    except BadInputError as error:
        if not error.where and error.field.partition(".")[0] in {each.name for each in dataclasses.fields(kind)}:
            lines = read_keys(path).lines if path.suffix == ".yaml" else {}
            raise error.at(error.field, place(path.name, lines, error.field)) from error.__cause__
        raise


def sort_conditional_faults(
    plant: MultibodyPlant, instance: ModelInstanceIndex, model: ModelFile, parameters: ControlParameters
) -> tuple[list[str], list[str]]:
    """Messages about wrong numbers of a robot's model that have an effect in the plant, and about those that have none.

    Args:
        plant: with the robot, its held joints already welded.
        instance: the robot.
        model: of the robot.
        parameters: of the robot; their limits replace those of the model.
    """
    rigid = {body.index() for body in plant.GetBodiesWeldedTo(plant.world_body())}
    wrong, passed = list[str](), list[str]()
    for fault in model.conditional_faults:
        key = fault.key if fault.joint in parameters.arm_joints else ""
        if fault.joint and not plant.HasJointNamed(fault.joint, instance):
            passed.append(f"{fault.text}; accepted, as the joint is held")
        elif fault.link and plant.GetBodyByName(fault.link, instance).index() in rigid:
            passed.append(f"{fault.text}; accepted, as the link does not move")
        elif key and len(getattr(parameters, key)):
            passed.append(f"{fault.text}; accepted, as {key} is given")
        else:
            instead = f", or {key} given" if key else ""
            wrong.append(f"{model.path.name}: cannot be used: {fault.text}{instead}")
    return wrong, passed


def check_joints_move_flange(plant: MultibodyPlant, joints: Sequence[Joint], flange: Frame) -> None:
    """BadInputError unless every joint of an arm moves its flange."""
    above = {joint.child_body().index(): joint for joint in map(plant.get_joint, plant.GetJointIndices())}
    body, passed = flange.body().index(), set()
    while body in above and body not in passed:
        passed.add(body)
        body = above[body].parent_body().index()
    for joint in joints:
        if joint.child_body().index() not in passed:
            raise invalid("flange_frame", flange.name(), f"moved by every joint of the arm, also by {joint.name()}")


def check_range(joint: Joint, position: float, file: str, key: str) -> None:
    """BadInputError unless an arm joint can move, and its position in the default posture [rad, m] is within limits."""
    low, high = float(joint.position_lower_limits()[0]), float(joint.position_upper_limits()[0])
    if not low < high:
        allowed = "lower below upper, or the joint one of held_joints"
        raise BadInputError(f"{file}: joint {joint.name()!r}: limit from {low:g} to {high:g}: must be {allowed}")
    if not low <= position <= high:
        low, high, given = np.degrees([low, high, position])
        raise invalid(key, float(f"{given:.9g}"), f"from {low:.6g} to {high:.6g}, the limits of {joint.name()}")


def check_moved_mass(plant: MultibodyPlant, joint: Joint, file: str) -> None:
    """BadInputError unless a joint moves a mass: that of its link, or of what is welded to it."""
    moved = plant.GetBodiesWeldedTo(joint.child_body())
    if not sum(body.default_mass() for body in moved) > 0:
        name = joint.child_body().name()
        raise BadInputError(f"{file}: link {name!r}: mass = 0 kg: must be above zero in a link that moves")


def check_tool_mass(plant: MultibodyPlant, tool: ModelInstanceIndex) -> None:
    """BadInputError for a tool that is too heavy for any robot."""
    mass = sum(plant.get_body(i).default_mass() for i in plant.GetBodyIndices(tool))
    if mass > _HEAVIEST_TOOL:
        name = plant.GetModelInstanceName(tool)
        raise BadInputError(f"tool {name!r}: mass = {mass:g} kg: must be at most {_HEAVIEST_TOOL:g} kg", key="tool")


def check_weight(
    plant: MultibodyPlant, robot: ModelInstanceIndex, parameters: ControlParameters, actuators: Sequence[JointActuator]
) -> None:
    """Refuse robots far too light for their torque limits, and heavy links with far too small moments of inertia.

    Args:
        plant: with the robot.
        robot: without its tools.
        parameters: completed with assumed values.
        actuators: of the joints, with their limits.

    Raises:
        BadInputError: it is such a robot.
    """
    rigid = {body.index() for body in plant.GetBodiesWeldedTo(plant.world_body())}
    moving = [plant.get_body(i) for i in plant.GetBodyIndices(robot) if i not in rigid]
    mass = sum(body.default_mass() for body in moving)
    limits = {each.joint().name(): each.effort_limit() for each in actuators if _turns(each)}
    name, torque = max(limits.items(), key=lambda each: each[1], default=("", 0.0))
    reach = 2 * parameters.characteristic_length
    least = torque / (_STRONGEST * _GRAVITY * reach)
    if np.isfinite(torque) and mass < least:
        allowed = f"at least {least:.3g} kg: {name} with {torque:g} Nm can hold {_STRONGEST:g} times that"
        where = f"{reach:g} m away, twice characteristic_length"
        raise BadInputError(f"{parameters.model}: links that move have {mass:.3g} kg in all: must be {allowed} {where}")
    for body in moving:
        own = body.default_mass()
        largest, least = principal_moments(body).max(), _DENSE * densest_moment(own)
        if own >= _SHARE * mass and 0 < largest < least:
            wrong = f"link {body.name()!r}: largest moment of inertia = {largest:.3g} kg m2"
            allowed = f"at least {least:.2g} kg m2, for {own:.3g} kg of the {mass:.3g} kg that move"
            raise BadInputError(f"{parameters.model}: {wrong}: must be {allowed}")


def principal_moments(body: RigidBody) -> Array:
    """Principal moments of inertia of a body with mass, about its centre of mass, shape (3,) [kg m2]."""
    inertia = body.default_spatial_inertia()
    moments = inertia.Shift(inertia.get_com()).CalcRotationalInertia().CalcPrincipalMomentsOfInertia()
    return np.asarray(moments)


def check_drives(parameters: ControlParameters, actuators: Sequence[JointActuator]) -> None:
    """Refuse drives that cannot overcome their friction, velocity loops tuned for an implausible inertia, and
    implausible joint stiffness.

    Args:
        parameters: completed with assumed values.
        actuators: of the joints, with their limits.

    Raises:
        BadInputError: there are such drives.
    """
    torque = np.array([actuator.effort_limit() for actuator in actuators])
    speed = np.array([float(actuator.joint().velocity_upper_limits()[0]) for actuator in actuators])
    turns = np.array([_turns(each) for each in actuators])
    _check_rotors(parameters, torque, turns)
    tuned, rotors = parameters.velocity_loop_inertia, parameters.reflected_inertia
    least, most = _LOOP_INERTIA
    coulomb = parameters.coulomb_friction + np.abs(parameters.friction_offset)
    if allowed := beyond_coulomb(coulomb, torque):
        name = "coulomb_friction"
    elif allowed := beyond_viscous(parameters.viscous_friction, torque, speed):
        name = "viscous_friction"
    elif allowed := beyond_viscous(parameters.viscous_friction_backward, torque, speed):
        name = "viscous_friction_backward"
    elif tuned.size and ((rotors > 0) & ((tuned < least * rotors) | (tuned > most * rotors))).any():
        name, allowed = "velocity_loop_inertia", f"{least:g} to {most:g} times the rotors, joint side {rotors.tolist()}"
    else:
        return _check_stiffness(parameters, torque, turns)
    raise invalid(name, getattr(parameters, name).tolist(), allowed)


def beyond_coulomb(coulomb: np.ndarray, torque: np.ndarray) -> str:
    """The allowed range in words, if Coulomb friction with its offset [Nm] reaches a torque limit [Nm]; else ""."""
    return f"with friction_offset below the torque limits {torque.tolist()}" if (coulomb >= torque).any() else ""


def beyond_viscous(viscous: np.ndarray, torque: np.ndarray, speed: np.ndarray) -> str:
    """The allowed range in words, if friction [Nms/rad] far exceeds torque [Nm] / speed [rad/s] limits; else ""."""
    most, known = np.full(len(speed), np.inf), np.isfinite(speed) & np.isfinite(torque)
    most[known] = _FRICTION_SHARE * torque[known] / speed[known]
    allowed = f"at most {_FRICTION_SHARE:g} times torque limits over velocity limits, {most.round(1).tolist()}"
    return allowed if (viscous > most).any() else ""


def _check_rotors(parameters: ControlParameters, torque: np.ndarray, turns: np.ndarray) -> None:
    """Refuse rotors far too heavy or too light for their motors, and damping far too large for the stiffness."""
    motor, rotors = torque / np.abs(parameters.gear_ratio), parameters.rotor_inertia
    known = turns & np.isfinite(motor) & (rotors > 0)
    too_quick = known.any() and (rotors < motor / _QUICKEST)[known].all()
    if too_quick or (known & (rotors > motor / SLOWEST)).any():
        ends = f"{_rounded(motor / _QUICKEST)} to {_rounded(motor / SLOWEST)} kg m2, motor side"
        allowed = f"zero, or from {ends}: {SLOWEST:g} to {_QUICKEST:g} rad/s2 at the torque limits"
        raise invalid("rotor_inertia", rotors.tolist(), allowed)
    stiffness = parameters.stiffness()
    if (parameters.transmission_damping > DAMPING_TIME * stiffness).any():
        allowed = f"at most {DAMPING_TIME:g} s times the joint stiffness, {_rounded(DAMPING_TIME * stiffness)}"
        raise invalid("transmission_damping", parameters.transmission_damping.tolist(), allowed)


def _rounded(values: np.ndarray) -> list[float]:
    return [float(f"{value:.3g}") for value in values]


def _check_stiffness(parameters: ControlParameters, torque: np.ndarray, turns: np.ndarray) -> None:
    for name, stiffness in parameters.joint_stiffness.items():
        twist = torque / stiffness
        if (turns & np.isfinite(twist) & ((twist < _TWIST[0]) | (twist > _TWIST[1]))).any():
            least, most = (np.round(torque / each, 1).tolist() for each in reversed(_TWIST))
            allowed = f"from {least} to {most}: {_TWIST[0]:g} to {_TWIST[1]:g} rad of twist at the torque limits"
            raise invalid(f"joint_stiffness.{name}", stiffness.tolist(), allowed)


def _turns(actuator: JointActuator) -> bool:
    return isinstance(actuator.joint(), RevoluteJoint)


def check_lists(parameters: ControlParameters) -> None:
    """BadInputError for links, or pairs of links, that are twice in a list."""
    check_distinct("tool_neighbours", parameters.tool_neighbours)
    check_distinct("ignored_collisions", [sorted(pair) for pair in parameters.ignored_collisions])
    for name, arm in parameters.arms.items():
        check_distinct(f"arms.{name}.tool_neighbours", arm.tool_neighbours)


def check_length(parameters: ControlParameters, reach: float) -> None:
    """BadInputError for a characteristic length far from half the reach of the robot.

    Args:
        parameters: of the robot.
        reach: approximate reach of an arm [m].
    """
    least, most = (share * reach for share in _OF_REACH)
    if not least <= parameters.characteristic_length <= most:
        allowed = f"from {least:.2g} to {most:.2g} m: half the reach, which is about {reach:.2g} m"
        raise invalid("characteristic_length", parameters.characteristic_length, allowed)


def check_arms(robot: RobotModel) -> None:
    """Refuse arms whose size does not fit the characteristic length, and implausible tools.

    Args:
        robot: in the default posture.

    Raises:
        BadInputError: there are such arms or tools.
    """
    context = robot.create_context()
    lengths = []
    for arm in robot.parts.arms.values():
        joints = robot.parts.joints[arm.joints]
        frames = [robot.plant.world_frame(), *(joint.frame_on_child() for joint in joints), arm.tcp_frame]
        places = np.array([frame.CalcPoseInWorld(context).translation() for frame in frames])
        lengths.append(float(np.linalg.norm(np.diff(places, axis=0), axis=1).sum()))
        _check_neighbours(robot, arm)
        if arm.tool is not None:
            of_all = robot.source[1]
            tool = of_all[arm.name] if isinstance(of_all, Mapping) else of_all
            with about_file(ToolParameters, parameter_file(tool_folder(str(tool)), TOOL_PARAMETERS)):
                _check_tool(robot, arm, context)
    if all(isinstance(joint, RevoluteJoint) for joint in robot.parts.joints):
        check_length(robot.parameters, max(lengths))


def _check_neighbours(robot: RobotModel, arm: ArmParts) -> None:
    """Refuse links of another arm among those that are never checked against the tool of this arm."""
    plant, joints = robot.plant, robot.parts.joints
    moved, others = (
        set(plant.GetBodiesKinematicallyAffectedBy([joint.index() for joint in each])) if each else set()
        for each in (joints[arm.joints], joints[: arm.joints.start] + joints[arm.joints.stop :])
    )
    one = robot.parameters.arms.get(arm.name)
    for i, name in enumerate(one.tool_neighbours if one else ()):
        if plant.GetBodyByName(name, robot.parts.instance).index() in others - moved:
            key, allowed = f"arms.{arm.name}.tool_neighbours.{i}", "a link of this arm or of its support"
            raise invalid(key, name, f"{allowed}: ignored_collisions is for links of another arm")


def _held_without(plant: MultibodyPlant, weld: Joint, arm: ArmParts) -> set[BodyIndex]:
    """Bodies that stay connected to the flange when a weld is removed."""
    joints = [plant.get_joint(i) for i in plant.GetJointIndices() if i != weld.index()]
    pairs = [{joint.parent_body().index(), joint.child_body().index()} for joint in joints]
    held = {arm.flange_frame.body().index()}
    while reached := {body for pair in pairs if held & pair for body in pair - held}:
        held |= reached
    return held


def _check_tool(robot: RobotModel, arm: ArmParts, context: Any) -> None:
    """Refuse a tool that is not at the flange, is longer than the arm, or too heavy for the joints to hold."""
    tool: Any = arm.tool
    plant, longest = robot.plant, 2 * robot.parameters.characteristic_length
    bodies = [plant.get_body(i) for i in plant.GetBodyIndices(arm.tool_instance)]
    mass = sum(body.default_mass() for body in bodies)
    away = {"tcp_frame": arm.tcp_frame, "sensor_frame": arm.sensor_frame, "contact_ball_frame": arm.contact_ball_frame}
    for key, frame in away.items():
        if frame is not None:
            far = float(np.linalg.norm(frame.CalcPose(context, arm.flange_frame).translation()))
            if far > longest:
                allowed = f"at most {longest:g} m from the flange, twice characteristic_length, not {far:.3g} m"
                raise invalid(key, frame.name(), allowed)
    if mass > 0:
        centre = plant.CalcCenterOfMassPositionInWorld(context, [arm.tool_instance])
        far = float(np.linalg.norm(centre - arm.flange_frame.CalcPoseInWorld(context).translation()))
        if far > longest:
            allowed = f"a model with its centre of mass at most {longest:g} m from the flange, not {far:.3g} m"
            raise invalid("model", tool.model, allowed)
    if arm.sensor_weld is not None and arm.sensor_weld.num_velocities():
        raise invalid("sensor_weld", arm.sensor_weld.name(), "a fixed joint: the sensor measures its reaction")
    radius, ball = tool.contact_ball_radius, arm.contact_ball_frame
    if ball is not None:
        far = float(np.linalg.norm(arm.tcp_frame.CalcPose(context, ball).translation()))
        if far > (most := _BALL[0] * radius + _BALL[1]):
            allowed = f"in or on the ball around {ball.name()}: {far:.3g} m away, at most {most:.3g} m"
            raise invalid("tcp_frame", arm.tcp_frame.name(), f"{allowed} with contact_ball_radius = {radius:g}")
        if radius > (most := float(np.linalg.norm(ball.CalcPose(context, arm.flange_frame).translation()))):
            raise invalid("contact_ball_radius", radius, f"at most {most:.3g} m, the distance of the flange")
        if arm.sensor_weld is not None and ball.body().index() in _held_without(plant, arm.sensor_weld, arm):
            between = f"between mount_frame and contact_ball_frame = {ball.name()!r}"
            allowed = f"{between}: else the sensor does not measure the contact"
            raise invalid("sensor_weld", arm.sensor_weld.name(), allowed)
    robot.check_torque(
        "tool",
        f"{mass:g} kg",
        _GRAVITY * mass * robot.jacobian_of(context, arm.tcp_frame)[5] if mass else np.zeros(len(robot.parts.joints)),
    )
