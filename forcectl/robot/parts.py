"""A robot and its tools in a plant: parsing, and access to joints, actuators and frames."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from pydrake.common.eigen_geometry import AngleAxis
from pydrake.geometry import SceneGraph
from pydrake.math import RigidTransform, RollPitchYaw, RotationMatrix
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import (
    FixedOffsetFrame,
    Frame,
    Joint,
    JointActuator,
    ModelInstanceIndex,
    PrismaticJoint,
    RevoluteJoint,
)
from pydrake.systems.framework import DiagramBuilder

from forcectl.errors import BadInputError, invalid, unknown
from forcectl.models import ROBOT_PARAMETERS, TOOL_PARAMETERS, parameter_file, robot_and_arm, tool_folder
from forcectl.robot.assumptions import completed
from forcectl.robot.checks import (
    about_file,
    check_drives,
    check_joints_move_flange,
    check_lists,
    check_moved_mass,
    check_range,
    check_tool_mass,
    check_weight,
    sort_conditional_faults,
)
from forcectl.robot.model_file import ModelFile, all_bodies, parse_models, some_bodies
from forcectl.robot.parameters import (
    ArmParameters,
    ControlParameters,
    ToolParameters,
    load_control_parameters,
    load_tool_parameters,
)
from forcectl.robot.urdf import Urdf, UrdfJoint

Tool = str | Path | None  # shipped name, tool folder, or the bare flange


@dataclass(frozen=True)
class ArmParts:
    """One arm of a robot, and its tool if it has one."""

    name: str
    joints: slice  # its joints among the robot's
    flange_frame: Frame
    tcp_frame: Frame  # the flange when there is no tool
    tool: ToolParameters | None = None
    tool_instance: ModelInstanceIndex | None = None
    contact_ball_frame: Frame | None = None
    sensor_frame: Frame | None = None
    sensor_weld: Joint | None = None


@dataclass(frozen=True)
class RobotParts:
    """A robot and its tools as they are in a plant.

    Joints and actuators are those of all arms, in the order of the parameters. `arms` has at least one entry.
    `missing_shapes` are collision shapes of the models without a substitute, see `forcectl.robot.urdf`;
    `accepted_faults` are wrong numbers of the robot's model that have no effect here, see `sort_conditional_faults`.
    """

    parameters: ControlParameters
    instance: ModelInstanceIndex
    joints: tuple[Joint, ...]
    actuators: tuple[JointActuator, ...]
    arms: dict[str, ArmParts]
    missing_shapes: tuple[str, ...] = ()
    accepted_faults: tuple[str, ...] = ()

    def require_shapes(self) -> None:
        """Refuse models some of whose collision shapes are missing.

        Raises:
            BadInputError: there are such shapes.
        """
        if self.missing_shapes:
            raise BadInputError(f"collision shapes are missing: {'; '.join(self.missing_shapes)}")

    @property
    def first_arm(self) -> ArmParts:
        """The first arm; most robots have only this one."""
        return next(iter(self.arms.values()))


def add_plant(builder: DiagramBuilder, time_step: float) -> tuple[MultibodyPlant, SceneGraph]:
    """An empty plant and the geometry around it, connected.

    Instead of Drake's `AddMultibodyPlantSceneGraph`, whose binding in Drake 1.51 never releases plant and geometry.

    Args:
        builder: of the diagram.
        time_step: of the plant [s]; 0: continuous.
    """
    plant = builder.AddNamedSystem("plant", MultibodyPlant(time_step))
    geometry = builder.AddNamedSystem("scene_graph", SceneGraph())
    source = plant.RegisterAsSourceForSceneGraph(geometry)
    builder.Connect(plant.get_geometry_pose_output_port(), geometry.get_source_pose_port(source))
    deformed = plant.get_deformable_body_configuration_output_port()
    builder.Connect(deformed, geometry.get_source_configuration_port(source))
    builder.Connect(geometry.get_query_output_port(), plant.get_geometry_query_input_port())
    return plant, geometry


def add_robot(
    plant: MultibodyPlant, robot: str | Path, tool: Tool | Mapping[str, Tool], X_WB: RigidTransform | None = None
) -> RobotParts:
    """Parse a robot into `plant`, weld its base to the world and a tool to each flange, and set the default posture.

    Held joints of the parameters become welds; with "robot/arm" these include the joints of the other arms.

    Args:
        plant: not yet finalized; gets the geometry too when it is registered with a scene graph.
        robot: name of a shipped robot or path of a robot folder; "yumi/left" is one arm of a robot that has several.
        tool: of every arm: name of a shipped tool, path of a tool folder, or None for the bare flange; or that of each
            arm by its name, where an arm that is not named has none.
        X_WB: pose of the robot's base frame in the world; identity when None.

    Raises:
        BadInputError: unknown robot, arm or tool, or a model that does not fit its parameters.
    """
    folder, arm = robot_and_arm(robot)
    parameters, file = load_control_parameters(folder), parameter_file(folder, ROBOT_PARAMETERS)
    with about_file(ControlParameters, file):
        check_lists(parameters)
        parts = add_robot_with(plant, folder, parameters if arm is None else parameters.only(arm), tool, X_WB)
        check_drives(parts.parameters, parts.actuators)
        check_weight(plant, parts.instance, parts.parameters, parts.actuators)
    return parts


def add_robot_with(
    plant: MultibodyPlant,
    folder: Path,
    parameters: ControlParameters,
    tool: Tool | Mapping[str, Tool],
    X_WB: RigidTransform | None = None,
    refused: list[str] | None = None,
) -> RobotParts:
    """As `add_robot`, with control parameters that are not read from the robot's folder.

    Errors in joints and links that move are added to `refused`, or raised when None.
    """
    arms = parameters.arms or {"arm": _only_arm(parameters)}
    whole = ModelFile.read(folder / parameters.model, everything=False)
    models, filters = {whole.name: whole}, []
    tools = {}  # of each arm that has one: its parameters, and what it is called in the plant
    tool_of = _tool_of_each(tool, arms)
    for arm, folder_or_name in tool_of.items():
        tool_at = tool_folder(folder_or_name)
        tool_parameters = load_tool_parameters(tool_at)
        tool_file = ModelFile.read(tool_at / tool_parameters.model)
        called = tool_file.name if len(arms) == 1 else f"{arm}_{tool_file.name}"
        tools[arm] = tool_parameters, called
        models[called] = tool_file
        neighbours = some_bodies(whole, arms[arm].tool_neighbours, "tool_neighbours")
        filters.append((all_bodies(called, tool_file), neighbours))
    for i, pair in enumerate(parameters.ignored_collisions):
        a, b = some_bodies(whole, pair, f"ignored_collisions.{i}")
        filters.append(([a], [b]))
    instances = parse_models(plant, models, filters)
    instance = instances[whole.name]

    _fix_base(plant, parameters.base_frame, instance, X_WB)
    followers = _mimics(plant, whole.urdf.joints, parameters, instance)
    _hold(plant, parameters.held_joints | followers, instance)
    wrong, accepted_faults = sort_conditional_faults(plant, instance, whole, parameters)
    if wrong and refused is None:
        raise BadInputError("; ".join(wrong))
    refused = [] if refused is None else refused
    refused += wrong
    names = enumerate(parameters.arm_joints)
    joints = tuple(_revolute_or_prismatic(plant, name, instance, f"arm_joints.{i}") for i, name in names)
    for i, (joint, position) in enumerate(zip(joints, parameters.default_posture, strict=True)):
        check_range(joint, float(position), parameters.model, f"default_posture_deg.{i}")
        joint.set_default_positions(np.array([position]))
    actuators = tuple(_actuator(plant, joint, whole.urdf) for joint in joints)
    parameters = _completed(parameters, joints, actuators, whole.urdf)

    parts, first = {}, 0
    for name, one in arms.items():
        mine, flange = slice(first, first + len(one.joints)), _flange(plant, one, name, instance)
        parts[name] = ArmParts(name, mine, flange, tcp_frame=flange)
        check_joints_move_flange(plant, joints[mine], flange)
        if name in tools:
            tool_parameters, called = tools[name]
            with about_file(ToolParameters, parameter_file(tool_folder(tool_of[name]), TOOL_PARAMETERS)):
                parts[name] = _with_tool(plant, parts[name], instances[called], tool_parameters)
        first = mine.stop
    for joint in () if refused else joints:
        check_moved_mass(plant, joint, parameters.model)
    missing_shapes = tuple(text for model in models.values() for text in model.urdf.missing_shapes)
    return RobotParts(parameters, instance, joints, actuators, parts, missing_shapes, tuple(accepted_faults))


def _tool_of_each(tool: Tool | Mapping[str, Tool], arms: Iterable[str]) -> dict[str, str | Path]:
    """The tools of the arms that have one."""
    each = tool if isinstance(tool, Mapping) else dict.fromkeys(arms, tool)
    for name, one in each.items():
        if name not in arms:
            raise unknown("arm", name, arms).at("tool")
        if not isinstance(one, Tool):
            raise invalid("tool", one, "the name of a shipped tool, a tool folder, or null; or these by arm")
    return {name: one for name, one in each.items() if one is not None}


def _only_arm(parameters: ControlParameters) -> ArmParameters:
    """The arm of a robot that has one."""
    return ArmParameters(
        flange_frame=parameters.flange_frame,
        flange_turn_deg=parameters.flange_turn_deg,
        joints=parameters.arm_joints,
        tool_neighbours=parameters.tool_neighbours,
    )


def _flange(plant: MultibodyPlant, arm: ArmParameters, name: str, instance: ModelInstanceIndex) -> Frame:
    flange = frame_named(plant, arm.flange_frame, instance, "flange_frame")
    if not any(arm.flange_turn_deg):
        return flange
    turn = RigidTransform(RollPitchYaw(np.radians(arm.flange_turn_deg)), np.zeros(3))
    return plant.AddFrame(FixedOffsetFrame(f"{name}_flange_turned", flange, turn, instance))


def _fix_base(plant: MultibodyPlant, name: str, instance: ModelInstanceIndex, X_WB: RigidTransform | None) -> None:
    """Weld the base to the world, unless the model has a `world` of its own, which then gives the pose."""
    joints = [plant.get_joint(i) for i in plant.GetJointIndices(instance)]
    if any(joint.parent_body().index() == plant.world_body().index() for joint in joints):
        if X_WB is not None:
            raise BadInputError("pose of the base: must be left out for a model with a `world` of its own")
        if name not in ("", "world"):
            frame_named(plant, name, instance, "base_frame")
        return
    if not name:
        children = {joint.child_body().index() for joint in joints}
        roots = [plant.get_body(i).name() for i in plant.GetBodyIndices(instance) if i not in children]
        if len(roots) != 1:
            raise invalid("base_frame", name, f"one of the bodies without a parent, {', '.join(roots)}")
        (name,) = roots
    frame = frame_named(plant, name, instance, "base_frame")
    plant.WeldFrames(plant.world_frame(), frame, X_WB or RigidTransform())


def _mimics(
    plant: MultibodyPlant, joints: dict[str, UrdfJoint], parameters: ControlParameters, instance: ModelInstanceIndex
) -> dict[str, float]:
    """Positions at which mimicking and mimicked joints are held that are not among the held joints of the parameters.

    A mimicked joint is held at the position nearest to zero; all stay within their limits.

    Raises:
        BadInputError: a joint mimics an arm joint, or is one.
    """
    held = dict(parameters.held_joints)

    def position(name: str, seen: tuple[str, ...] = ()) -> float:
        mimics = joints[name].mimics if name in joints else None
        if name in seen:
            raise BadInputError(f"joints {', '.join(seen)} mimic each other")
        if name not in held:
            if name in parameters.arm_joints:
                follower = seen[0] if seen else name
                raise BadInputError(
                    f"joint {follower!r} mimics an arm joint, which is not supported: must be one of held_joints"
                )
            wanted = 0.0 if mimics is None else mimics[1] * position(mimics[0], (*seen, name)) + mimics[2]
            joint = _revolute_or_prismatic(plant, name, instance, "held_joints")
            held[name] = float(np.clip(wanted, joint.position_lower_limits()[0], joint.position_upper_limits()[0]))
        return held[name]

    for name, joint in joints.items():
        if joint.mimics is not None:
            position(name)
    return {name: at for name, at in held.items() if name not in parameters.held_joints}


def _completed(
    parameters: ControlParameters, joints: tuple[Joint, ...], actuators: tuple[JointActuator, ...], urdf: Urdf
) -> ControlParameters:
    """Parameters with assumed values filled in; joints and actuators get the limits of the parameters."""
    limits = {
        "velocity": np.array([float(joint.velocity_upper_limits()[0]) for joint in joints]),
        "acceleration": np.array([float(joint.acceleration_upper_limits()[0]) for joint in joints]),
        "torque": np.array([actuator.effort_limit() for actuator in actuators]),
    }
    for name in limits:
        given = getattr(parameters, f"{name}_limit")
        limits[name] = given if given.size else limits[name]
    known = [urdf.joints.get(joint.name(), UrdfJoint("revolute")) for joint in joints]
    drives = {
        "gear_ratio": np.array([one.reduction for one in known]),
        "coulomb_friction": np.array([one.friction for one in known]),
        "viscous_friction": np.array([one.damping for one in known]),
    }
    parameters = completed(parameters, **limits, drives=drives)
    for i, (joint, actuator) in enumerate(zip(joints, actuators, strict=True)):
        if parameters.velocity_limit.size:
            joint.set_velocity_limits(-limits["velocity"][[i]], limits["velocity"][[i]])
        if parameters.acceleration_limit.size:
            largest = parameters.acceleration_limit[[i]]
            joint.set_acceleration_limits(-largest, largest)
        if parameters.torque_limit.size:
            actuator.set_effort_limit(float(limits["torque"][i]))
    return parameters


def _with_tool(plant: MultibodyPlant, arm: ArmParts, tool: ModelInstanceIndex, parameters: ToolParameters) -> ArmParts:
    """`arm` with a tool welded to its flange."""
    check_tool_mass(plant, tool)
    plant.WeldFrames(arm.flange_frame, frame_named(plant, parameters.mount_frame, tool, "mount_frame"))
    _hold(plant, parameters.held_joints, tool)
    ball, sensor, weld = parameters.contact_ball_frame, parameters.sensor_frame, parameters.sensor_weld
    return replace(
        arm,
        tool=parameters,
        tcp_frame=frame_named(plant, parameters.tcp_frame, tool, "tcp_frame"),
        tool_instance=tool,
        contact_ball_frame=frame_named(plant, ball, tool, "contact_ball_frame") if ball else None,
        sensor_frame=frame_named(plant, sensor, tool, "sensor_frame") if sensor else None,
        sensor_weld=_joint(plant, weld, tool, "sensor_weld") if weld else None,
    )


def frame_named(plant: MultibodyPlant, name: str, instance: ModelInstanceIndex, kind: str = "frame") -> Frame:
    """A frame of a model by name; BadInputError, with the names there are, when it does not exist."""
    if not plant.HasFrameNamed(name, instance):
        frames = [plant.get_frame(i) for i in plant.GetFrameIndices(instance)]
        raise unknown(f"{kind} of {plant.GetModelInstanceName(instance)}", name, [f.name() for f in frames if f.name()])
    return plant.GetFrameByName(name, instance)


def _hold(plant: MultibodyPlant, positions: dict[str, float], instance: ModelInstanceIndex) -> None:
    """Replace joints by welds at `positions`, and remove their actuators."""
    for name, position in positions.items():
        key = f"held_joints.{name}"
        joint = _revolute_or_prismatic(plant, name, instance, key)
        low, high = float(joint.position_lower_limits()[0]), float(joint.position_upper_limits()[0])
        if not low <= position <= high:
            raise invalid(key, position, f"within the joint's limits, {low:g} to {high:g} [rad, m]")
        parent, child, X = joint.frame_on_parent(), joint.frame_on_child(), _across(joint, position)
        for actuator in _actuators(plant, joint):
            plant.RemoveJointActuator(actuator)
        plant.RemoveJoint(joint)
        plant.WeldFrames(parent, child, X)


def _across(joint: Joint, position: float) -> RigidTransform:
    """Pose of the frame on the child in the frame on the parent."""
    if isinstance(joint, RevoluteJoint):
        return RigidTransform(RotationMatrix(AngleAxis(position, joint.revolute_axis())), np.zeros(3))
    if isinstance(joint, PrismaticJoint):
        return RigidTransform(position * joint.translation_axis())
    raise BadInputError(f"held joint {joint.name()!r}: must be revolute or prismatic")


def _joint(plant: MultibodyPlant, name: str, instance: ModelInstanceIndex, key: str) -> Joint:
    if not plant.HasJointNamed(name, instance):
        known = [plant.get_joint(i).name() for i in plant.GetJointIndices(instance)]
        raise unknown(f"joint of {plant.GetModelInstanceName(instance)}", name, known).at(key)
    return plant.GetJointByName(name, instance)


def _revolute_or_prismatic(plant: MultibodyPlant, name: str, instance: ModelInstanceIndex, key: str) -> Joint:
    joint = _joint(plant, name, instance, key)
    if joint.num_positions() != 1:
        text = f"joint {name!r} has {joint.num_positions()} positions: must have one"
        raise BadInputError(text, key=key)
    return joint


def _actuators(plant: MultibodyPlant, joint: Joint) -> list[JointActuator]:
    # Asked for one model instance before Finalize, Drake returns an empty list.
    actuators = [plant.get_joint_actuator(index) for index in plant.GetJointActuatorIndices()]
    return [actuator for actuator in actuators if actuator.joint().index() == joint.index()]


def _actuator(plant: MultibodyPlant, joint: Joint, urdf: Urdf) -> JointActuator:
    """The actuator of an arm joint; few public models have any, so one is added where there is none."""
    actuators = _actuators(plant, joint)
    if actuators:
        return actuators[0]
    effort = urdf.joints[joint.name()].effort if joint.name() in urdf.joints else np.inf
    return plant.AddJointActuator(f"{joint.name()}_motor", joint, effort)
