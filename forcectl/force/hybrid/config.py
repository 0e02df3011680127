"""Scenario part `!Hybrid`: forces and torques along and about axes of a task frame, motion in all other directions.

    x_i selected:    dx_bar_i = law(w_bar_i, w_i),     other:    x_i by the reference in the unconstrained directions

w is the measured wrench at the TCP in the task frame. Every selected direction has its own scalar force law, any that
fills the slot `controller`. About an axis it has torques [Nm] as inputs in place of forces, and commands angles [rad]
in place of displacements. Signs are those of forces along a normal: the axis points out of the surface, and F = -dx/C.
A torque on the tool is positive about its axis, with tau = -theta/C for a tool that is turned by theta.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from pydrake.math import RollPitchYaw
from pydrake.systems.framework import DiagramBuilder, OutputPort, System
from pydrake.systems.primitives import ConstantVectorSource

from forcectl.errors import BadInputError, about, invalid, unknown
from forcectl.estimation.surface_offset import Sliding
from forcectl.force.combined import CombinedLaw, CombinedLaws, linear_laws
from forcectl.force.hybrid.motion import HybridMotion
from forcectl.force.hybrid.surface_normal import SurfaceNormal
from forcectl.force.hybrid.task_axes import DIRECTIONS, TaskAxes, TaskWrench
from forcectl.force.integral import IntegralConfig
from forcectl.force.law import FORCES
from forcectl.framework.block import PythonDiagram
from forcectl.framework.fields import Config, key, slot
from forcectl.framework.wiring import Enclosed, add_part, input_names, optional_inputs, split, stacked
from forcectl.plant.compliance import compliance_along, robot_compliance
from forcectl.plant.plant_model import PlantModel

_SOFTEST = 1.0  # [m/N] largest compliance along an axis
_ALONG_NORMAL = 0.7  # least cosine between an axis and the normal for which the axis has the model's C_E
_ACROSS = 1e-6  # square of the cosine between an axis and the normal up to which the axis counts as tangential
_OFFERED = (*FORCES, "motor_displacement", "path_displacement", "sliding")


@dataclass(kw_only=True)
class DirectionConfig(Config):
    """A direction whose force or torque is controlled."""

    law: Any = slot(
        "controller", IntegralConfig, meaning="force law of this direction; about an axis its forces are torques"
    )
    desired: float | None = key(
        None,
        "desired force along, or torque about, an axis; null: the loop's reference along an axis, zero about one",
        unit="N or Nm",
    )
    compliance: float | None = key(
        None,
        "compliance C_E of the environment in this direction; null: the model's, for an axis along the normal only",
        unit="m/N or rad/Nm",
        bounds="positive",
    )


@dataclass(kw_only=True)
class HybridConfig(Config):
    """Scenario part `!Hybrid`."""

    measured_signal = "measured_wrench"  # that the controller reads in place of measured_force

    directions: dict[str, DirectionConfig] = key(
        meaning="force-controlled directions x, y, z along, and rx, ry, rz about, the axes of the task frame; the "
        "others are motion-controlled"
    )
    rotation_deg: list[float] = key(
        [180.0, 0.0, 0.0],
        "roll, pitch and yaw of the task frame relative to the TCP frame; its z axis points out of the surface",
        unit="deg",
        size=3,
    )
    fixed_in: str = key(
        "tool",
        "axes of the task frame; tool: move with the tool; world: stay as at the start; surface: z follows the surface "
        "normal, estimated from the measured force",
        choices=("tool", "world", "surface"),
    )
    smallest_singular_value: float = key(
        0.02,
        "singular value of the Jacobian below which its inverse is damped",
        unit="1",
        bounds="above 0 and at most 1",
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        for name, each in self.directions.items():
            if name not in DIRECTIONS:
                raise unknown("direction", name, DIRECTIONS).at(f"directions.{name}")
            if not name.startswith("r") and each.desired is not None and each.desired < 0:
                raise invalid(f"directions.{name}.desired", each.desired, "not negative: a contact cannot pull")
        if not 1 <= len(self.directions) < len(DIRECTIONS):
            raise invalid("directions", sorted(self.directions), "from one to five directions: the others are moved")
        referred = [name for name, each in self.directions.items() if _follows_reference(name, each)]
        if len(referred) > 1:
            raise BadInputError("must be given in all but one of x, y, z", key=f"directions.{referred[1]}.desired")

    def add_to(self, builder: DiagramBuilder, model: PlantModel) -> Hybrid:
        """Add the controller.

        Raises:
            BadInputError: a law is no scalar force law, or has inputs that a direction does not offer.
        """
        hybrid = Hybrid(self.directions, self._axes(model), model, smallest=self.smallest_singular_value)
        return builder.AddNamedSystem("hybrid", hybrid)

    def force_laws(self, model: PlantModel) -> list[tuple[Any, float]]:
        """The laws along axes that are not tangential to the surface at the start; see `forcectl.force.slot`.

        The component a'n of the force acts along an axis a, and a'n of its command moves the tool along the normal: the
        share is (a'n)^2. All of them act on the one normal at the same time: the shares of equal laws add up, and
        unlike laws are combined, each with the model of its direction. A force at the TCP has no torque about an axis.
        """
        axes = self._axes(model)
        rotation = axes.rotation(axes.robot.context_at(model.start), model.n if axes.follow else None)
        shares = zip(DIRECTIONS[3:], ((model.n @ rotation) ** 2).tolist(), strict=True)
        loaded = [(name, share) for name, share in shares if name in self.directions and share > _ACROSS]
        laws = [self.directions[name].law for name, _ in loaded]
        if all(law == laws[0] for law in laws):
            return [(laws[0], sum(share for _, share in loaded))] if loaded else []
        combined: list[CombinedLaw] = []
        separate: list[tuple[Any, float]] = []
        for name, share in loaded:
            direction = self.directions[name]
            inside = linear_laws(direction.law, model, share)
            if len(inside) == 1:
                combined.append(CombinedLaw(*inside[0], partial(_designed, direction, name, axes)))
            else:
                separate += inside
        if len(combined) > 1:
            return [*separate, (CombinedLaws(tuple(combined), "Hybrid"), 1.0)]
        return [*separate, *((each.law, each.share) for each in combined)]

    def _axes(self, model: PlantModel) -> TaskAxes:
        rotation = RollPitchYaw(np.radians(self.rotation_deg)).ToRotationMatrix().matrix()
        world, follow = self.fixed_in == "world", self.fixed_in == "surface"
        return TaskAxes(model.known_robot(), model.start, rotation, fixed_in_world=world, follow=follow)


def _follows_reference(name: str, direction: DirectionConfig) -> bool:
    return direction.desired is None and not name.startswith("r")


def direction_model(model: PlantModel, axes: TaskAxes, name: str, compliance: float | None) -> PlantModel:
    """The model of the plant along or about one axis at the start, for the law of that direction.

    The robot's compliance is the model's, times the ratio of (2.7) in this direction to (2.7) along the normal.

    Args:
        model: with one force loop.
        axes: of the task frame.
        name: of the direction.
        compliance: C_E in this direction [m/N, rad/Nm]; None: that of the model along the normal.

    Raises:
        BadInputError: C_E is not given, and the direction is not that of the normal.
    """
    robot, index = axes.robot, DIRECTIONS.index(name)
    context = robot.context_at(model.start)
    axis = axes.rotation(context)[:, index % 3]
    turns = index < 3
    environment = model.environment_compliance
    if compliance is not None and not turns and compliance > _SOFTEST:
        raise invalid("compliance", compliance, f"at most {_SOFTEST:g} m/N along an axis")
    if compliance is not None:
        environment = np.array([compliance])
    elif turns or abs(axis @ model.n) < _ALONG_NORMAL:
        raise BadInputError("must be given: the model of the plant has one along the normal only", key="compliance")
    matrix = robot_compliance(robot, context, robot.joint_stiffness)
    block = matrix[:3, :3] if turns else matrix[3:, 3:]
    share = float(axis @ block @ axis) / compliance_along(model.n, matrix)
    return replace(
        model,
        robot_compliance=share * model.robot_compliance,
        drive_compliance=share * np.broadcast_to(model.drive_compliance, 1),
        environment_compliance=environment,
        normals=axis.reshape(1, 3),
        sensor_range=np.inf if turns else model.sensor_range,
        pulls=turns or model.pulls,
    )


def _designed(direction: DirectionConfig, name: str, axes: TaskAxes, model: PlantModel) -> PlantModel:
    with about(direction):
        return direction_model(model, axes, name, direction.compliance)


class Hybrid(PythonDiagram):
    """Force control in selected directions of a task frame, motion control in the others.

    ```
    name: Hybrid
    input_ports: [measured_wrench, motor_position, unconstrained_reference, desired_force (optional)]
    output_ports: [joint_position_command, task_wrench, task_displacement, near_singular]
    ```

    measured_wrench: shape (6,), of the environment on the tool, at S in S, [torque; force] [Nm, N].
    motor_position, unconstrained_reference: shape (n,) [rad]; the last is the joint motion in the unconstrained
    directions, from the start.
    desired_force: shape (1,), of the direction that follows the reference [N]; the port exists if there is one.
    joint_position_command: shape (n,) [rad]. Feedthrough of all inputs.
    task_wrench: shape (6,), of the environment on the tool, at the TCP in the task frame [Nm, N]. Feedthrough of
    measured_wrench and motor_position.
    task_displacement: shape (m,), commanded in the selected directions, in the order rx, ry, rz, x, y, z [m, rad].
    Feedthrough of measured_wrench, motor_position and desired_force.
    near_singular: shape (1,), 1 while the inverse is damped, else 0 [1]. Feedthrough of all inputs.

    Sampling: every `period` [s] of the model; no delay beyond that of the laws.

    Args:
        directions: by name.
        axes: of the task frame.
        model: of the plant, with one force loop.
        smallest: singular value of the Jacobian below which its inverse is damped [1].

    Raises:
        BadInputError: a law is no scalar force law, or has inputs that a direction does not offer.
    """

    port_units = {"task_displacement": "m,rad"}

    def __init__(
        self, directions: Mapping[str, DirectionConfig], axes: TaskAxes, model: PlantModel, *, smallest: float = 0.02
    ):
        super().__init__()
        builder = DiagramBuilder()
        add, connect = builder.AddNamedSystem, builder.Connect
        names = [name for name in DIRECTIONS if name in directions]
        selected = [DIRECTIONS.index(name) for name in names]
        laws = {name: _add_law(builder, name, directions[name], axes, model) for name in names}
        wrench = add("task_wrench", TaskWrench(axes))
        forces = split(builder, "task_forces", [1] * len(DIRECTIONS), wrench.get_output_port())
        motion = add("motion", HybridMotion(axes, selected, model.start, smallest=smallest, period=model.period))
        moved = motion.GetOutputPort("motor_displacement")
        displacements = split(builder, "motor_displacements", [1] * len(names), moved)
        measured = builder.ExportInput(wrench.GetInputPort("measured_wrench"), "measured_wrench")
        position = builder.ExportInput(wrench.GetInputPort("motor_position"), "motor_position")
        builder.ConnectInput(position, motion.GetInputPort("motor_position"))
        if axes.follow:
            normal = add("surface_normal", SurfaceNormal(axes, period=model.period))
            for name, port in (("measured_wrench", measured), ("motor_position", position)):
                builder.ConnectInput(port, normal.GetInputPort(name))
            for block in (wrench, motion):
                connect(normal.get_output_port(), block.GetInputPort("task_normal"))
        reference = builder.ExportInput(motion.GetInputPort("unconstrained_reference"), "unconstrained_reference")
        offered = {name: {"motor_displacement": port} for name, port in zip(names, displacements, strict=True)}
        if any("path_displacement" in input_names(law) for law in laws.values()):
            # The reference has no motion in a selected direction.
            still = add("no_path", ConstantVectorSource(np.zeros(1))).get_output_port()
            offered = {name: ports | {"path_displacement": still} for name, ports in offered.items()}
        if any("sliding" in input_names(law) for law in laws.values()):
            slides = add("sliding", Sliding(model.num_joints, period=model.period))
            builder.ConnectInput(reference, slides.get_input_port())
            offered = {name: ports | {"sliding": slides.get_output_port()} for name, ports in offered.items()}
        for name, law in laws.items():
            direction = directions[name]
            connect(forces[DIRECTIONS.index(name)], law.GetInputPort("measured_force"))
            if _follows_reference(name, direction):
                builder.ExportInput(law.GetInputPort("desired_force"), "desired_force")
            else:
                wanted = add(f"desired_{name}", ConstantVectorSource([direction.desired or 0.0]))
                connect(wanted.get_output_port(), law.GetInputPort("desired_force"))
            for port, source in offered[name].items():
                if port in input_names(law):
                    connect(source, law.GetInputPort(port))
        commands: list[OutputPort] = [law.GetOutputPort("displacement_command") for law in laws.values()]
        displacement = stacked(builder, "task_displacement", commands)
        connect(displacement, motion.GetInputPort("displacement_command"))
        builder.ExportOutput(motion.GetOutputPort("joint_position_command"), "joint_position_command")
        builder.ExportOutput(wrench.get_output_port(), "task_wrench")
        builder.ExportOutput(displacement, "task_displacement")
        builder.ExportOutput(motion.GetOutputPort("near_singular"), "near_singular")
        builder.BuildInto(self)


def _add_law(
    builder: DiagramBuilder, name: str, direction: DirectionConfig, axes: TaskAxes, model: PlantModel
) -> System:
    """Add the law of a direction."""
    own = _designed(direction, name, axes, model)
    inner, tag = DiagramBuilder(), type(direction.law).__name__
    law = add_part(direction.law, f"directions.{name}.law", inner, own)
    inputs = input_names(law)
    if not law.HasOutputPort("displacement_command") or not set(FORCES) <= set(inputs):
        raise BadInputError(f"{tag} is no force law: must be a law of a scalar force", key=f"directions.{name}.law")
    missing = [port for port in inputs if port not in (*_OFFERED, *optional_inputs(law))]
    if missing:
        fault = f"{tag} needs {', '.join(missing)}: must be a law of {', '.join(_OFFERED)} alone"
        raise BadInputError(fault, key=f"directions.{name}.law")
    return builder.AddNamedSystem(f"law_{name}", Enclosed(inner, law))
