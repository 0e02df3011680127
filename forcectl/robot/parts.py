"""A robot and its tools in a plant: parsing them, and where their joints, actuators and frames are."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from pydrake.common.eigen_geometry import AngleAxis
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import (
    Frame,
    Joint,
    JointActuator,
    ModelInstanceIndex,
    PrismaticJoint,
    RevoluteJoint,
)

from forcectl.errors import BadInputError, invalid, unknown
from forcectl.models import add_packages, robot_and_arm, tool_folder
from forcectl.robot.parameters import (
    ArmParameters,
    ControlParameters,
    ToolParameters,
    load_control_parameters,
    load_tool_parameters,
)


@dataclass(frozen=True)
class ArmParts:
    """One arm of a robot, and its tool if it has one."""

    name: str
    joints: slice  # its joints among the robot's
    flange_frame: Frame
    tcp_frame: Frame  # the flange when there is no tool
    tool_instance: ModelInstanceIndex | None = None
    contact_ball_frame: Frame | None = None
    sensor_frame: Frame | None = None
    sensor_weld: Joint | None = None


@dataclass(frozen=True)
class RobotParts:
    """A robot and its tools as they are in a plant.

    Joints and actuators are those of all arms, in the order of the parameters. `arms` has at least one entry.
    """

    parameters: ControlParameters
    tool_parameters: ToolParameters | None
    instance: ModelInstanceIndex
    joints: tuple[Joint, ...]
    actuators: tuple[JointActuator, ...]
    arms: dict[str, ArmParts]

    @property
    def first_arm(self) -> ArmParts:
        """The only arm of most robots."""
        return next(iter(self.arms.values()))


def add_robot(
    plant: MultibodyPlant, robot: str | Path, tool: str | Path | None, X_WB: RigidTransform | None = None
) -> RobotParts:
    """Parse a robot into `plant`, weld its base to the world and a tool to each flange, and set the default posture.

    Joints that the parameters hold (those of the other arms of "robot/arm" are) become welds.

    Args:
        plant: not yet finalized; gets the geometry too when it is registered with a scene graph.
        robot: name of a shipped robot or path of a robot folder; "yumi/left" is one arm of a robot that has several.
        tool: name of a shipped tool, path of a tool folder, or None for the bare flange.
        X_WB: pose of the robot's base frame in the world; identity when None.

    Raises:
        BadInputError: unknown robot, arm or tool, or a model that does not fit its parameters.
    """
    folder, arm = robot_and_arm(robot)
    parameters = load_control_parameters(folder)
    if arm is not None:
        parameters = parameters.only(arm)
    arms = parameters.arms or {"arm": ArmParameters(flange_frame=parameters.flange_frame, joints=parameters.arm_joints)}
    whole = _ModelFile.look(folder / parameters.model)
    models, filters = {whole.name: whole}, []
    tool_parameters, tools = None, {}  # the latter: what each arm's tool is called in the plant
    if tool is not None:
        tool_at = tool_folder(tool)
        tool_parameters = load_tool_parameters(tool_at)
        tool_file = _ModelFile.look(tool_at / tool_parameters.model)
        tools = {name: tool_file.name if len(arms) == 1 else f"{name}_{tool_file.name}" for name in arms}
        models |= dict.fromkeys(tools.values(), tool_file)
        filters = [(name, whole.name, arms[arm].tool_neighbours) for arm, name in tools.items()]
    instances = _parse(plant, models, filters)
    instance = instances[whole.name]

    plant.WeldFrames(plant.world_frame(), frame_named(plant, parameters.base_frame, instance), X_WB or RigidTransform())
    _hold(plant, parameters.held_joints, instance)
    joints = tuple(_revolute_or_prismatic(plant, name, instance) for name in parameters.arm_joints)
    for joint, position in zip(joints, parameters.default_posture, strict=True):
        if not joint.position_lower_limits()[0] <= position <= joint.position_upper_limits()[0]:
            raise invalid(f"default posture of {joint.name()} [rad]", float(position), "within the joint's limits")
        joint.set_default_positions(np.array([position]))
    actuators = tuple(_actuator(plant, joint) for joint in joints)

    parts, first = {}, 0
    for name, one in arms.items():
        mine, flange = slice(first, first + len(one.joints)), frame_named(plant, one.flange_frame, instance)
        parts[name] = ArmParts(name, mine, flange, tcp_frame=flange)
        if tool_parameters is not None:
            parts[name] = _with_tool(plant, parts[name], instances[tools[name]], tool_parameters)
        first = mine.stop
    return RobotParts(parameters, tool_parameters, instance, joints, actuators, parts)


@dataclass(frozen=True)
class _ModelFile:
    """A URDF or SDF file, the name of its one model, and its bodies."""

    path: Path
    name: str
    bodies: tuple[str, ...]

    @classmethod
    def look(cls, path: Path) -> _ModelFile:
        if not path.is_file():
            raise BadInputError(f"model = {path.name!r}: there is no such file in folder {str(path.parent)!r}")
        plant = MultibodyPlant(time_step=0.0)
        parser = Parser(plant)
        add_packages(parser.package_map())
        try:
            instances: list[ModelInstanceIndex] = parser.AddModels(path)
        except RuntimeError as error:
            raise BadInputError(f"{path.name}: cannot be read: {_one_line(error)}") from error
        if len(instances) != 1:
            raise BadInputError(f"{path.name} holds {len(instances)} models: must hold exactly one")
        bodies = tuple(plant.get_body(index).name() for index in plant.GetBodyIndices(instances[0]))
        return cls(path, plant.GetModelInstanceName(instances[0]), bodies)


def _parse(
    plant: MultibodyPlant, models: dict[str, _ModelFile], filters: list[tuple[str, str, list[str]]]
) -> dict[str, ModelInstanceIndex]:
    """Add models under the names given; `filters` are (tool, robot, links that are never checked against the tool).

    All in one go: Drake refuses a collision filter between models that were not parsed together.
    """
    parser = Parser(plant)
    add_packages(parser.package_map())
    directives: list[dict[str, Any]] = []
    for name, model in models.items():
        parser.package_map().Add(f"folder_of_{name}", str(model.path.parent))
        directives.append({"add_model": {"name": name, "file": f"package://folder_of_{name}/{model.path.name}"}})
    for tool, robot, links in filters:
        for link in links:
            if link not in models[robot].bodies:
                raise unknown(f"link in tool_neighbours of {robot}", link, models[robot].bodies)
        sides = {f"{tool}_bodies": (tool, models[tool].bodies), f"beside_{tool}": (robot, links)}
        for (group, (owner, bodies)), other in zip(sides.items(), reversed(sides), strict=True):
            members = [f"{owner}::{body}" for body in bodies]
            entry = {"name": group, "members": members, "ignored_collision_filter_groups": [other]}
            directives += [{"add_collision_filter_group": entry}] if links else []
    try:
        parser.AddModelsFromString(json.dumps({"directives": directives}), "dmd.yaml")
    except RuntimeError as error:
        files = " or ".join(dict.fromkeys(model.path.name for model in models.values()))
        raise BadInputError(f"{files}: cannot be added: {_one_line(error)}") from error
    return {name: plant.GetModelInstanceByName(name) for name in models}


def _one_line(error: RuntimeError) -> str:
    return " ".join(str(error).split())


def _with_tool(plant: MultibodyPlant, arm: ArmParts, tool: ModelInstanceIndex, parameters: ToolParameters) -> ArmParts:
    """`arm` with a tool welded to its flange."""
    plant.WeldFrames(arm.flange_frame, frame_named(plant, parameters.mount_frame, tool))
    _hold(plant, parameters.held_joints, tool)
    ball, sensor, weld = parameters.contact_ball_frame, parameters.sensor_frame, parameters.sensor_weld
    return replace(
        arm,
        tcp_frame=frame_named(plant, parameters.tcp_frame, tool),
        tool_instance=tool,
        contact_ball_frame=frame_named(plant, ball, tool) if ball else None,
        sensor_frame=frame_named(plant, sensor, tool) if sensor else None,
        sensor_weld=_joint(plant, weld, tool) if weld else None,
    )


def frame_named(plant: MultibodyPlant, name: str, instance: ModelInstanceIndex, kind: str = "frame") -> Frame:
    """A frame of a model by name; BadInputError, with the names there are, when it has none such."""
    if not plant.HasFrameNamed(name, instance):
        frames = [plant.get_frame(i) for i in plant.GetFrameIndices(instance)]
        raise unknown(f"{kind} of {plant.GetModelInstanceName(instance)}", name, [f.name() for f in frames if f.name()])
    return plant.GetFrameByName(name, instance)


def _hold(plant: MultibodyPlant, positions: dict[str, float], instance: ModelInstanceIndex) -> None:
    """Replace joints, and what drives them, by welds at `positions`."""
    for name, position in positions.items():
        joint = _revolute_or_prismatic(plant, name, instance)
        if not joint.position_lower_limits()[0] <= position <= joint.position_upper_limits()[0]:
            raise invalid(f"held joint {name} [rad, m]", position, "within the joint's limits")
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


def _joint(plant: MultibodyPlant, name: str, instance: ModelInstanceIndex) -> Joint:
    if not plant.HasJointNamed(name, instance):
        known = [plant.get_joint(i).name() for i in plant.GetJointIndices(instance)]
        raise unknown(f"joint of {plant.GetModelInstanceName(instance)}", name, known)
    return plant.GetJointByName(name, instance)


def _revolute_or_prismatic(plant: MultibodyPlant, name: str, instance: ModelInstanceIndex) -> Joint:
    joint = _joint(plant, name, instance)
    if joint.num_positions() != 1:
        raise BadInputError(f"arm joint {name!r} has {joint.num_positions()} positions: must have one")
    return joint


def _actuators(plant: MultibodyPlant, joint: Joint) -> list[JointActuator]:
    # Asked for one model instance before Finalize, Drake returns an empty list.
    actuators = [plant.get_joint_actuator(index) for index in plant.GetJointActuatorIndices()]
    return [actuator for actuator in actuators if actuator.joint().index() == joint.index()]


def _actuator(plant: MultibodyPlant, joint: Joint) -> JointActuator:
    actuators = _actuators(plant, joint)
    if not actuators:
        raise BadInputError(f"arm joint {joint.name()!r} has no actuator: the model must give it one")
    return actuators[0]
