"""Adaptive integral force control: the integral law with the compliance that EWRLS estimates on line (Sec. 2.3)."""

from __future__ import annotations

from dataclasses import dataclass

from forcectl.force.adaptive_force_law import AdaptiveLawConfig
from forcectl.force.integral import IntegralLawConfig
from forcectl.framework.fields import key


@dataclass(kw_only=True)
class AdaptiveIntegralConfig(IntegralLawConfig, AdaptiveLawConfig, in_batches=True):
    """Scenario part `!AdaptiveIntegral`."""

    compliance_error: float = key(
        0.8,
        "initial estimate of the environment compliance relative to the true one, C_E_hat / C_E; 1/1.2: stiffness 20 % "
        "too high",
        bounds="from 0.001 to 1000",
        each=True,
    )
