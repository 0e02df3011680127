"""Scenario part `!InvarianceRobot`: the invariance controller of a robot, its constraints, and its adaptive form."""

from __future__ import annotations

from dataclasses import dataclass, field
from inspect import get_annotations
from math import inf
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.framework import Diagram, DiagramBuilder, System

from forcectl.errors import BadInputError, invalid
from forcectl.estimation.environment import EnvironmentComplianceEstimator
from forcectl.force.adaptive_force_law import Adaptation
from forcectl.force.invariance.controller import InvarianceController, check_gamma
from forcectl.force.invariance.regulated_output import RegulatedCoordinate
from forcectl.force.sensor_lag import SensorLag
from forcectl.framework.batch import check, whole_multiple
from forcectl.framework.imports import import_object
from forcectl.framework.wiring import export_all_outputs
from forcectl.plant.plant_model import PlantModel
from forcectl.plant.sensors.force_sensor import sensor_filter
from forcectl.qp.solvers import DEFAULT_SOLVER, check_solver
from forcectl.robot.model import JointLimits, unit_normal
from forcectl.tasks.constraints.base import CartesianWall, Constraint

Array = NDArray[np.float64]
_INTERFACE = "a class with relative_degree and evaluate(motion)"


class AdaptiveInvarianceController(Diagram):
    """Invariance controller of a robot with the compliance that EWRLS estimates on line: adaptive constraint (3.56).

    ```
    name: AdaptiveInvarianceController
    input_ports: [desired_force, measured_force, motor_position, motor_velocity, unconstrained_reference]
    output_ports: [joint_position_command, displacement_command, invariance_function, status, active_constraints, slack,
      constraint_violation, near_singular, contact_lost, environment_compliance]
    ```

    motor_position: shape (n_q,) [rad]: where the tool really is; filtered like the force before it is regressed.
    environment_compliance: shape (1,), C_E_hat [m/N]. State.
    The other ports: see `InvarianceController`. All outputs are feedthrough of desired_force, measured_force and
    unconstrained_reference at the tick.

    Sampling: every `period` [s] of the controller; every `posture_period` [s] what the estimator needs of the posture;
    the compliance it uses is one tick old.
    """

    def __init__(self, controller: InvarianceController, estimator: EnvironmentComplianceEstimator, model: PlantModel):
        super().__init__()
        builder = DiagramBuilder()
        add, connect = builder.AddNamedSystem, builder.Connect
        add("law", controller)
        add("estimator", estimator)
        delay = whole_multiple("delay", model.sensor_delay, model.period, "period")
        filter_ = sensor_filter(1, model.sensor_bandwidth, model.sensor_damping_ratio, model.period, delay)
        add("displacement_filter", filter_)
        tip = add("motor_displacement", model.tip_displacement())
        ports = {}
        for name in ("desired_force", "measured_force", "motor_position", "motor_velocity", "unconstrained_reference"):
            ports[name] = builder.ExportInput(controller.GetInputPort(name), name)
        builder.ConnectInput(ports["motor_position"], tip.get_input_port())
        builder.ConnectInput(ports["measured_force"], estimator.GetInputPort("measured_force"))
        connect(tip.get_output_port(), filter_.get_input_port())
        connect(filter_.get_output_port(), estimator.GetInputPort("displacement"))
        connect(estimator.GetOutputPort("compliance"), controller.GetInputPort("compliance"))
        export_all_outputs(builder, controller)
        builder.ExportOutput(estimator.GetOutputPort("environment_compliance"), "environment_compliance")
        builder.BuildInto(self)


@dataclass(kw_only=True)
class JointLimitConfig:
    """Joint limits that replace the robot's: one number per joint, or none at all for the robot's."""

    position_lower: list[float] = field(default_factory=list)  # [rad]
    position_upper: list[float] = field(default_factory=list)  # [rad]
    velocity: list[float] = field(default_factory=list)  # [rad/s], > 0
    acceleration: list[float] = field(default_factory=list)  # [rad/s^2], > 0
    torque: list[float] = field(default_factory=list)  # joint side [Nm], > 0

    def limits(self, robot: JointLimits) -> JointLimits:
        """These, and the robot's where nothing is said."""
        chosen = {}
        for name in ("position_lower", "position_upper", "velocity", "acceleration", "torque"):
            given, own = getattr(self, name), getattr(robot, name)
            if given and len(given) != len(own):
                raise BadInputError(
                    f" has {len(given)} values: must have {len(own)}, one per joint", key=f"limits.{name}"
                )
            chosen[name] = np.array(given, dtype=float) if given else own
        return JointLimits(**chosen)


@dataclass(kw_only=True)
class WallConfig:
    """A plane that the tool centre point stays in front of."""

    point: list[float]  # on the plane, in W [m]
    normal: list[float]  # towards the free side, in W
    gamma: float = -1.0  # [m/s^2], < 0: deceleration towards it

    def __post_init__(self) -> None:
        if len(self.point) != 3:
            raise invalid("point", self.point, "three numbers")
        unit_normal(self.normal)
        check_gamma("gamma", self.gamma)


@dataclass(kw_only=True)
class ConstraintConfig:
    """A constraint of the user's: a class with `relative_degree` and `evaluate(motion)`, see `Constraint`."""

    path: str  # "package.module:ClassName"
    parameters: dict[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.constraint()

    def constraint(self) -> Constraint:
        """The constraint, built anew."""
        kind = import_object(self.path)
        # Looked at before it is called: the parameters are the scenario's.
        if not isinstance(kind, type) or not _has_interface(kind):
            raise invalid("path", self.path, _INTERFACE)
        try:
            made = kind(**self.parameters)
        except BadInputError:
            raise
        except Exception as error:  # whatever the user's class does
            reason = " ".join(f"{type(error).__name__}: {error}".split())
            raise BadInputError(
                f" = {self.path!r}: cannot be built with these parameters: {reason}", key="path"
            ) from error
        if not isinstance(made, Constraint):
            raise invalid("path", self.path, _INTERFACE)
        return made


@dataclass(kw_only=True)
class OutputConfig:
    """A Cartesian coordinate that is regulated beside the force."""

    axis: list[float]  # in W, perpendicular to the normal and to other axes
    displacement: float  # set point from the start [m]
    gamma: float = -0.1  # [m/s^2], < 0: deceleration towards it

    def __post_init__(self) -> None:
        unit_normal(self.axis, "axis")
        check("displacement", self.displacement)
        check_gamma("gamma", self.gamma)


@dataclass(kw_only=True)
class InvarianceRobotConfig:
    """Scenario part `!InvarianceRobot`."""

    gamma: float = -0.1  # [m/s^2], < 0: deceleration towards the constraint
    upper_acceleration: float | None = None  # [m/s^2], > 0; null: -gamma
    compliance_error: float = 1.0  # C_T_hat / C_T, > 0
    adaptation: Adaptation | None = None  # of the environment's compliance; null: known
    nominal_gain: float | None = None  # K_I [1/s], > 0, of an integral law to be corrected; null: no such law
    maximum_force: float = inf  # [N], > 0
    tracking_bandwidth: float = 30.0  # w [1/s], > 0, of the unconstrained directions
    tracking_acceleration: float = 2.0  # [m/s^2], > 0, in the unconstrained directions
    limits: JointLimitConfig = field(default_factory=JointLimitConfig)
    walls: list[WallConfig] = field(default_factory=list)
    constraints: list[ConstraintConfig] = field(default_factory=list)
    outputs: list[OutputConfig] = field(default_factory=list)
    solver: str = DEFAULT_SOLVER  # of the quadratic program: daqp, clarabel, osqp, ...

    def __post_init__(self) -> None:
        check_gamma("gamma", self.gamma)
        for name in ("upper_acceleration", "nominal_gain"):
            if getattr(self, name) is not None:
                check(name, getattr(self, name), "positive")
        for name in ("compliance_error", "tracking_bandwidth", "tracking_acceleration"):
            check(name, getattr(self, name), "positive")
        if not self.maximum_force > 0:
            raise invalid("maximum_force", self.maximum_force, "above zero")
        check_solver(self.solver)

    def add_to(self, builder: DiagramBuilder, model: PlantModel) -> System:
        """Add the controller; without adaptation it believes in `compliance_error` times the true total compliance."""
        tip = _tip(_checked(model))
        for i, wall in enumerate(self.walls):
            if unit_normal(wall.normal) @ (tip - wall.point) < 0:
                behind = f"so that the tool is in front of the wall where it starts, {np.round(tip, 4).tolist()} m"
                raise invalid(f"walls.{i}.point", wall.point, behind)
        constraints = [CartesianWall(wall.point, wall.normal, wall.gamma) for wall in self.walls]
        known = self.compliance_error * model.total_compliance.item()
        controller = InvarianceController(
            model,
            compliance=known if self.adaptation is None else None,
            gamma=self.gamma,
            upper_acceleration=self.upper_acceleration,
            maximum_force=self.maximum_force,
            nominal_gain=self.nominal_gain,
            limits=self.limits.limits(model.known_robot().limits),
            constraints=[*constraints, *(part.constraint() for part in self.constraints)],
            outputs=[RegulatedCoordinate(unit_normal(o.axis), o.displacement, o.gamma) for o in self.outputs],
            tracking_bandwidth=self.tracking_bandwidth,
            tracking_acceleration=self.tracking_acceleration,
            sensor=SensorLag.of(model),
            period=model.period,
            solver=self.solver,
        )
        if self.adaptation is None:
            return builder.AddNamedSystem("invariance_controller", controller)
        block = AdaptiveInvarianceController(controller, self.adaptation.estimator(model), model)
        return builder.AddNamedSystem("invariance_controller", block)


def _has_interface(kind: type) -> bool:
    # A field of a dataclass without a default is an annotation only.
    annotated = any("relative_degree" in get_annotations(base) for base in kind.__mro__)
    return callable(getattr(kind, "evaluate", None)) and (annotated or hasattr(kind, "relative_degree"))


def _checked(model: PlantModel) -> PlantModel:
    if model.robot is None:
        raise BadInputError("controller !InvarianceRobot commands joints: there must be a robot in the loop")
    return model


def _tip(model: PlantModel) -> Array:
    """Where the tool centre point is at the start, in W (3,) [m]."""
    robot = model.known_robot()
    context = robot.create_context()
    robot.set_positions(context, model.start)
    return robot.tip_position(context)
