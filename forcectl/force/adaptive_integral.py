"""Adaptive integral force control: the integral law with the compliance that EWRLS estimates on line (Sec. 2.3)."""

from __future__ import annotations

from dataclasses import dataclass

from pydrake.systems.framework import DiagramBuilder

from forcectl.force.adaptive_force_law import Adaptation, AdaptiveForceLaw
from forcectl.force.integral import IntegralForceLaw, check_limits
from forcectl.framework.batch import check
from forcectl.plant.plant_model import PlantModel


@dataclass(kw_only=True)
class AdaptiveIntegralConfig(Adaptation):
    """Scenario part `!AdaptiveIntegral`."""

    integral_gain: float = 1.5  # K_I [1/s], >= 0
    dead_zone: float = 0.0  # [N], >= 0
    lower_limit: float = -0.1  # [m], below zero
    upper_limit: float = 0.1  # [m], above zero

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("integral_gain", "dead_zone"):
            check(name, getattr(self, name), "not negative")
        check_limits(self.lower_limit, self.upper_limit)

    def reference_model_bandwidth(self) -> float | None:
        """Bandwidth K_I [rad/s] of the nominal closed loop."""
        return self.integral_gain

    def add_to(self, builder: DiagramBuilder, model: PlantModel) -> AdaptiveForceLaw:
        """Add the law with its estimator."""
        law = IntegralForceLaw(
            model.size,
            integral_gain=self.integral_gain,
            dead_zone=self.dead_zone,
            lower_limit=self.lower_limit,
            upper_limit=self.upper_limit,
            period=model.period,
        )
        return self.adapt(builder, model, law)
