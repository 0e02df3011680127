"""Adaptive integral force control: the integral law with the compliance that EWRLS estimates on line (Sec. 2.3)."""

from __future__ import annotations

from dataclasses import dataclass

from numpy.typing import ArrayLike
from pydrake.systems.framework import Diagram, DiagramBuilder

from forcectl.control.force_law import LoopFacts
from forcectl.control.integral import IntegralForceLaw, check_limits
from forcectl.errors import invalid
from forcectl.estimation.environment import EnvironmentComplianceEstimator
from forcectl.lanes import check, whole_multiple
from forcectl.plant.force_sensor import sensor_filter


class AdaptiveIntegralForceLaw(Diagram):
    """Integral law whose compliance comes from the EWRLS estimator.

    ```
    name: AdaptiveIntegralForceLaw
    input_ports: [desired_force, measured_force, motor_displacement]
    output_ports: [displacement_command, environment_compliance]
    ```

    desired_force, measured_force: shape (n,) [N].
    motor_displacement: shape (n,), actual motor-side dx along n [m], unfiltered: the block filters it like the force.
    displacement_command: shape (n,) [m]. environment_compliance: shape (n,), C_E_hat [m/N].

    Sampling: `period` [s]; no delay from measured_force to displacement_command.
    """

    def __init__(
        self,
        law: IntegralForceLaw,
        estimator: EnvironmentComplianceEstimator,
        *,
        filter_bandwidth: ArrayLike,
        filter_damping_ratio: ArrayLike,
        filter_delay_ticks: int,
        period: float,
    ):
        super().__init__()
        self.sample_delay = {("measured_force", "displacement_command"): 0.0}
        builder = DiagramBuilder()
        builder.AddNamedSystem("law", law)
        builder.AddNamedSystem("estimator", estimator)
        filter_ = sensor_filter(law.size, filter_bandwidth, filter_damping_ratio, period, filter_delay_ticks)
        builder.AddNamedSystem("displacement_filter", filter_)
        builder.ExportInput(law.GetInputPort("desired_force"), "desired_force")
        measured = builder.ExportInput(law.GetInputPort("measured_force"), "measured_force")
        builder.ConnectInput(measured, estimator.GetInputPort("measured_force"))
        builder.ExportInput(filter_.get_input_port(), "motor_displacement")
        builder.Connect(filter_.get_output_port(), estimator.GetInputPort("displacement"))
        builder.Connect(estimator.GetOutputPort("compliance"), law.GetInputPort("compliance"))
        builder.ExportOutput(law.GetOutputPort("displacement_command"), "displacement_command")
        builder.ExportOutput(estimator.GetOutputPort("environment_compliance"), "environment_compliance")
        builder.BuildInto(self)


@dataclass(kw_only=True)
class AdaptiveIntegralConfig:
    """Scenario part `!AdaptiveIntegral`."""

    integral_gain: float = 1.5  # K_I [1/s], >= 0
    compliance_error: float = 0.8  # initial C_E_hat / C_E, > 0; 1/1.2 = stiffness 20 % too high
    forgetting: float = 0.995  # mu, (0, 1]
    initial_covariance: float = 1e-6  # P_0 [1/N^2], > 0
    minimum_force: float = 0.2  # [N], >= 0
    dead_zone: float = 0.0  # [N], >= 0
    lower_limit: float = -0.1  # [m], below zero
    upper_limit: float = 0.1  # [m], above zero

    def __post_init__(self) -> None:
        for name in ("compliance_error", "initial_covariance"):
            check(name, getattr(self, name), "positive")
        for name in ("integral_gain", "minimum_force", "dead_zone"):
            check(name, getattr(self, name), "not negative")
        if not 0 < check("forgetting", self.forgetting) <= 1:
            raise invalid("forgetting", self.forgetting, "above 0 and at most 1")
        check_limits(self.lower_limit, self.upper_limit)

    def reference_model_bandwidth(self) -> float | None:
        """Bandwidth K_I [rad/s] of the nominal closed loop."""
        return self.integral_gain

    def add_to(self, builder: DiagramBuilder, facts: LoopFacts) -> AdaptiveIntegralForceLaw:
        """Add the law; it starts from `compliance_error` times the true environment compliance."""
        law = IntegralForceLaw(
            facts.size,
            integral_gain=self.integral_gain,
            dead_zone=self.dead_zone,
            lower_limit=self.lower_limit,
            upper_limit=self.upper_limit,
            period=facts.period,
        )
        estimator = EnvironmentComplianceEstimator(
            facts.size,
            initial_compliance=self.compliance_error * facts.environment_compliance,
            initial_covariance=self.initial_covariance,
            forgetting=self.forgetting,
            robot_compliance=facts.robot_compliance,
            minimum_force=self.minimum_force,
            period=facts.period,
        )
        block = AdaptiveIntegralForceLaw(
            law,
            estimator,
            filter_bandwidth=facts.sensor_bandwidth,
            filter_damping_ratio=facts.sensor_damping_ratio,
            filter_delay_ticks=whole_multiple("delay", facts.sensor_delay, facts.period, "period"),
            period=facts.period,
        )
        return builder.AddNamedSystem("force_law", block)
