"""Adaptive integral force control: the integral law with the compliance that EWRLS estimates on line (Sec. 2.3)."""

from __future__ import annotations

from dataclasses import dataclass

from pydrake.systems.framework import DiagramBuilder

from forcectl.force.adaptive_force_law import Adaptation, AdaptiveForceLaw
from forcectl.force.integral import IntegralForceLaw
from forcectl.framework.fields import key
from forcectl.plant.plant_model import PlantModel


@dataclass(kw_only=True)
class AdaptiveIntegralConfig(Adaptation):
    """Scenario part `!AdaptiveIntegral`."""

    integral_gain: float = key(1.5, "gain K_I", unit="1/s", bounds="not negative")
    dead_zone: float = key(0.0, "force error that is left alone", unit="N", bounds="not negative")
    lower_limit: float = key(-0.1, "deepest command", unit="m", bounds="below zero")
    upper_limit: float = key(0.1, "furthest retreat", unit="m", bounds="above zero")

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
