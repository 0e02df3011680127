"""Scenario part `!InvarianceRobot`: the invariance controller of a robot, its constraints, and its adaptive form."""

from __future__ import annotations

from dataclasses import dataclass
from math import inf
from typing import Any, ClassVar

import numpy as np
from pydrake.systems.framework import DiagramBuilder, System

from forcectl.arrays import Array
from forcectl.errors import BadInputError, invalid
from forcectl.estimation.environment import EnvironmentComplianceEstimator
from forcectl.force.adaptive_force_law import Adaptation
from forcectl.force.approach import without_move
from forcectl.force.invariance.controller import METRICS, InvarianceController
from forcectl.force.invariance.regulated_output import RegulatedCoordinate
from forcectl.force.sensor_lag import SensorLag, sensor_model
from forcectl.framework.block import PythonDiagram
from forcectl.framework.fields import Config, key, slot
from forcectl.framework.wiring import export_all_inputs, export_all_outputs
from forcectl.plant.compliance import compliance_along, robot_compliance
from forcectl.plant.plant_model import PlantModel
from forcectl.qp.solvers import DEFAULT_SOLVER, solver_choices
from forcectl.robot.model import JointLimits, unit_normal
from forcectl.tasks.constraints.parts import at_keys, constraints_of

_TURN = 2 * np.pi  # [rad] how far position limits may be beyond the robot's; more is taken for degrees


class AdaptiveInvarianceController(PythonDiagram):
    """Invariance controller of a robot with the compliance that EWRLS estimates on line: adaptive constraint (3.56).

    ```
    name: AdaptiveInvarianceController
    input_ports: [desired_force, measured_force, motor_position, motor_velocity, unconstrained_reference,
    approach_displacement (optional)]
    output_ports: [joint_position_command, displacement_command, invariance_function, status, active_constraints, slack,
    constraint_violation, near_singular, contact_lost, approach_displacement (optional), environment_compliance]
    ```

    motor_position: shape (n_q,) [rad]; the estimator uses the displacement of the tool at it, filtered like the force
    and without that of a guarded move.
    environment_compliance: shape (1,), C_E_hat [m/N]. State.
    The other ports: see `InvarianceController`. All outputs are feedthrough of desired_force, measured_force,
    unconstrained_reference and approach_displacement at the tick.

    Sampling: every `period` [s] of the controller; every `posture_period` [s] the posture data of the estimator;
    the compliance that the controller uses is one tick old.
    """

    def __init__(self, controller: InvarianceController, estimator: EnvironmentComplianceEstimator, model: PlantModel):
        super().__init__()
        builder = DiagramBuilder()
        add, connect = builder.AddNamedSystem, builder.Connect
        add("law", controller)
        add("estimator", estimator)
        filter_ = add("displacement_filter", sensor_model(model, 1))
        tip = add("motor_displacement", model.tip_displacement())
        ports = export_all_inputs(builder, controller, but=["compliance"])
        builder.ConnectInput(ports["motor_position"], tip.get_input_port())
        builder.ConnectInput(ports["measured_force"], estimator.GetInputPort("measured_force"))
        displacement = tip.get_output_port()
        if controller.HasOutputPort("approach_displacement"):
            without = without_move(builder, "own_displacement", controller.GetOutputPort("approach_displacement"))
            connect(displacement, without.get_input_port(1))
            displacement = without.get_output_port()
        connect(displacement, filter_.get_input_port())
        connect(filter_.get_output_port(), estimator.GetInputPort("displacement"))
        connect(estimator.GetOutputPort("compliance"), controller.GetInputPort("compliance"))
        export_all_outputs(builder, controller)
        builder.ExportOutput(estimator.GetOutputPort("environment_compliance"), "environment_compliance")
        builder.BuildInto(self)


@dataclass(kw_only=True)
class JointLimitConfig(Config):
    """Joint limits that replace the robot's: one number per joint; an empty list keeps the robot's."""

    position_lower: list[float] = key([], "lower position limit of each joint; empty: the robot's", unit="rad")
    position_upper: list[float] = key([], "upper position limit of each joint; empty: the robot's", unit="rad")
    velocity: list[float] = key(
        [], "speed limit of each joint; empty: the robot's", unit="rad/s", bounds="positive and at most 30"
    )
    acceleration: list[float] = key(
        [], "acceleration limit of each joint; empty: the robot's", unit="rad/s^2", bounds="positive"
    )
    torque: list[float] = key(
        [], "torque limit of each joint, on the joint side; empty: the robot's", unit="Nm", bounds="positive"
    )

    def limits(self, robot: JointLimits) -> JointLimits:
        """These limits, and the robot's where a list is empty."""
        chosen = {}
        for name in ("position_lower", "position_upper", "velocity", "acceleration", "torque"):
            given, own = getattr(self, name), getattr(robot, name)
            if given and len(given) != len(own):
                raise BadInputError(
                    f" has {len(given)} values: must have {len(own)}, one per joint", key=f"limits.{name}"
                )
            chosen[name] = np.array(given, dtype=float) if given else own
            beyond = chosen[name] > own + _TURN if name == "position_upper" else chosen[name] < own - _TURN
            if name.startswith("position") and beyond.any():
                allowed = f"within 2 pi rad of the robot's, {np.round(own, 3).tolist()} rad"
                raise invalid(f"limits.{name}", given, allowed)
        return JointLimits(**chosen)


@dataclass(kw_only=True)
class OutputConfig(Config):
    """A Cartesian coordinate, an angle of the tool, or the force on a second surface, regulated beside the force."""

    axis: list[float] = key(
        meaning="axis in W, of a force the surface's outward normal; of coordinates and forces perpendicular to the "
        "normal of the first surface and to each other",
        bounds="not all zero",
        size=3,
    )
    displacement: float | None = key(
        None, "set point of the tool's displacement along the axis, from the start; null: not regulated", unit="m"
    )
    angle: float | None = key(
        None,
        "set point of the tool's angle about the axis, from the start; null: not regulated",
        unit="rad",
        bounds="from -1 to 1",
    )
    force: float | None = key(
        None,
        "desired force on a second surface, touched at the start, regulated by its compliance; null: not regulated",
        unit="N",
        bounds="positive",
    )
    stiffness: float = key(1e4, "stiffness of the second surface, for its force", unit="N/m", bounds="from 1 to 1e+08")
    gamma: float = key(
        -0.1,
        "braking deceleration before the set point, as a negative number; of an angle in rad/s^2",
        unit="m/s^2",
        bounds="below zero",
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if sum(each is not None for each in (self.displacement, self.angle, self.force)) != 1:
            raise BadInputError(" needs one of displacement, angle and force", key="axis")

    def output(self, compliance: Array, n: Array) -> RegulatedCoordinate:
        """The regulated output.

        Args:
            compliance: of the robot at the TCP in W, shape (3, 3) [m/N].
            n: outward normal of the first surface in W, shape (3,).
        """
        axis = unit_normal(self.axis)
        if self.angle is not None:
            return RegulatedCoordinate(axis, self.angle, self.gamma, turns=True)
        if self.force is None:
            return RegulatedCoordinate(axis, self.displacement or 0.0, self.gamma)
        own = float(axis @ compliance @ axis) + 1 / self.stiffness
        return RegulatedCoordinate(
            -axis, own * self.force, self.gamma, force=self.force, coupling=float(n @ compliance @ axis)
        )


@dataclass(kw_only=True)
class InvarianceRobotConfig(Config):
    """Scenario part `!InvarianceRobot`: invariance force control in joint accelerations, with constraints. (3.53)*"""

    reads_of_model: ClassVar[tuple[str, ...]] = ("masses",)

    gamma: float = key(
        -0.1,
        "braking deceleration of the displacement command before its set point, as a negative number",
        unit="m/s^2",
        bounds="below zero",
    )
    upper_acceleration: float | None = key(
        None,
        "largest acceleration of the displacement command when it speeds up; null: -gamma",
        unit="m/s^2",
        bounds="positive",
    )
    compliance_error: float = key(
        1.0, "modelled total compliance relative to the true one, C_T_hat / C_T", bounds="from 0.001 to 1000"
    )
    adaptation: Adaptation | None = key(
        None, "on-line estimation of the environment's compliance; null: none, it is taken as known"
    )
    nominal_gain: float | None = key(
        None,
        "gain K_I of a nominal integral law that is corrected; null: no nominal law",
        unit="1/s",
        bounds="positive",
    )
    metric: str = key("task", "accelerations in which the correction of the nominal law is minimal", choices=METRICS)
    maximum_force: float = key(inf, "limit of the contact force", unit="N", bounds="above zero")
    tracking_bandwidth: float = key(
        30.0, "bandwidth w of the tracking in the unconstrained directions", unit="1/s", bounds="positive"
    )
    tracking_acceleration: float = key(
        2.0, "largest acceleration of the tracking in the unconstrained directions", unit="m/s^2", bounds="positive"
    )
    limits: JointLimitConfig = key(JointLimitConfig, "limits of the joints; the robot's where none is given")
    constraints: list[Any] = slot("constraint", list, "further constraints, beside those of joints and force")
    outputs: list[OutputConfig] = key([], "coordinates, angles and further forces that are regulated beside the force")
    solver: str = key(DEFAULT_SOLVER, "solver of the quadratic program", choices=solver_choices)

    def add_to(self, builder: DiagramBuilder, model: PlantModel) -> System:
        """Add the controller; without adaptation its model has `compliance_error` times the true total compliance.

        That of the robot alone has the same error.
        """
        return self._add(builder, model, approached=False)

    def add_approached(self, builder: DiagramBuilder, model: PlantModel) -> System:
        """The same with a guarded move in its command, see `forcectl.force.slot`."""
        return self._add(builder, model, approached=True)

    def _add(self, builder: DiagramBuilder, model: PlantModel, approached: bool) -> System:
        if model.robot is None:
            raise BadInputError("controller !InvarianceRobot commands joints: there must be a robot in the loop")
        known = self.compliance_error * model.total_compliance.item()
        compliance = self.compliance_error * _robot_compliance(model)
        constraints = constraints_of(self.constraints, model)
        with at_keys((f"constraints.{i}", one) for i, one in enumerate(constraints)):
            controller = InvarianceController(
                model,
                compliance=known if self.adaptation is None else None,
                gamma=self.gamma,
                upper_acceleration=self.upper_acceleration,
                maximum_force=self.maximum_force,
                nominal_gain=self.nominal_gain,
                metric=self.metric,
                limits=self.limits.limits(model.known_robot().limits),
                constraints=constraints,
                outputs=[output.output(compliance, model.n) for output in self.outputs],
                tracking_bandwidth=self.tracking_bandwidth,
                tracking_acceleration=self.tracking_acceleration,
                sensor=SensorLag.of(model),
                period=model.period,
                solver=self.solver,
                approached=approached,
            )
        if self.adaptation is None:
            return builder.AddNamedSystem("invariance_controller", controller)
        block = AdaptiveInvarianceController(controller, self.adaptation.estimator(model), model)
        return builder.AddNamedSystem("invariance_controller", block)


def _robot_compliance(model: PlantModel) -> Array:
    """Compliance of the TCP at the start, shape (3, 3) [m/N], scaled to the C_R that the model has along n."""
    robot = model.known_robot()
    whole = robot_compliance(robot, robot.context_at(model.start), robot.joint_stiffness)
    return whole[3:, 3:] * (model.robot_compliance.item() / compliance_along(model.n, whole))
