"""Implicit integral force control::

    dx_bar[k] = dx_bar[k-1] - C_T_hat K_I Ts e(F_bar - F[k])                                          (2.11)*

The minus sign goes with F = -dx/C_T (2.8). e(.) is an optional dead zone against hunting with static friction (Sec.
2.1.1). The command is limited; the law is a pure integrator, so the limit of its state is its anti-windup.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike
from pydrake.systems.framework import Context, DiagramBuilder
from pydrake.systems.primitives import Multiplexer

from forcectl.force.law import ForceLaw, LawConfig
from forcectl.framework.batch import BatchParameter, BatchValue, batch_values, check
from forcectl.framework.block import PythonDiagram
from forcectl.framework.fields import Config, key
from forcectl.framework.linear_batch import sampled_system
from forcectl.framework.sampled_block import Memory
from forcectl.plant.plant_model import PlantModel

if TYPE_CHECKING:
    from scipy.signal import StateSpace


def dead_zone(error: BatchValue, width: BatchValue, m: Any = np) -> BatchValue:
    """The part of `error` [N] beyond +-width [N]."""
    return m.copysign(m.maximum(abs(error) - width, 0.0), error)


def integral_step(
    command: BatchValue, error: BatchValue, gain: BatchValue, lower: BatchValue, upper: BatchValue, m: Any = np
) -> BatchValue:
    """One tick of the integral law; the last command where the step is not finite.

    Args:
        command: last displacement command dx_bar [m].
        error: F_bar - F after the dead zone [N].
        gain: C_T_hat K_I Ts [m/N].
        lower, upper: limits of the command [m].
    """
    free = command - gain * error
    # Infinity minus infinity is not a number, so one comparison catches both NaN and overflow.
    return m.where(free - free == 0, m.minimum(m.maximum(free, lower), upper), command)


class IntegralForceLaw(ForceLaw):
    """Integral force controller for n independent force loops.

    ```
    name: IntegralForceLaw
    input_ports: [desired_force, measured_force, compliance (optional)]
    output_ports: [displacement_command]
    parameters: [integral_gain, dead_zone, lower_limit, upper_limit, compliance (optional)]
    ```

    desired_force, measured_force: shape (n,) [N].
    compliance: shape (n,), C_T_hat [m/N], > 0; the port exists when no `compliance` is given, else it is a parameter.
    displacement_command: shape (n,), dx_bar [m], held over [t_k, t_k+1). Feedthrough of all inputs at the tick.

    Parameters (Context, shape (n,)): integral_gain K_I [1/s] >= 0, dead_zone [N] >= 0, lower_limit and upper_limit [m],
    compliance C_T_hat [m/N] > 0.

    A force or compliance that is not a finite number holds the last command.

    Sampling: every `period` [s]; no delay from measured_force to displacement_command, see `SampledBlock`.
    """

    def __init__(
        self,
        size: int,
        *,
        integral_gain: ArrayLike,
        compliance: ArrayLike | None = None,
        dead_zone: ArrayLike = 0.0,
        lower_limit: ArrayLike = -np.inf,
        upper_limit: ArrayLike = np.inf,
        period: float = 0.002,
    ):
        parameters = {
            "integral_gain": BatchParameter(integral_gain, "not negative and finite", "1/s"),
            "dead_zone": BatchParameter(dead_zone, "not negative", "N"),
        }
        super().__init__(
            size, parameters, {}, period, lower_limit=lower_limit, upper_limit=upper_limit, compliance=compliance
        )

    def derive(self, values: tuple[BatchValue, ...]) -> tuple[BatchValue, ...]:
        """(K_I Ts [C_T_hat], dead zone, limits)."""
        gain, width, lower, upper, *compliance = values
        return gain * self._period * (compliance[0] if compliance else 1.0), width, lower, upper

    def step(self, context: Context, memory: Memory, inputs: Memory) -> dict[str, BatchValue]:
        """One tick of the law."""
        m = self.math
        gain, width, lower, upper = self.values(context)
        if "compliance" in inputs:
            gain = gain * inputs["compliance"]
        error = dead_zone(inputs["desired_force"] - inputs["measured_force"], width, m)
        return {"displacement_command": integral_step(memory["displacement_command"], error, gain, lower, upper, m)}


class LinearIntegralForceLaw(PythonDiagram):
    """The law without dead zone and limits: a linear system, so that its loop can be linearised and scalar-converted.

    ```
    name: LinearIntegralForceLaw
    input_ports: [desired_force, measured_force]
    output_ports: [displacement_command]
    ```

    desired_force, measured_force: shape (n,) [N]. displacement_command: shape (n,) [m]. Feedthrough of all inputs.

    Sampling: every `period` [s]; no delay. For diagrams in which everything runs at this period: after its update event
    at a tick, the output is already that of the next tick.
    """

    def __init__(self, size: int, *, integral_gain: ArrayLike, compliance: ArrayLike, period: float = 0.002):
        super().__init__()
        gain = batch_values("integral_gain", integral_gain, size, "not negative")
        gain = gain * batch_values("compliance", compliance, size, "positive") * check("period", period, "positive")
        builder = DiagramBuilder()
        both = builder.AddNamedSystem("forces", Multiplexer([size, size]))
        one, step = np.ones((size, 1, 1)), np.array([[[-g, g]] for g in gain])
        law = builder.AddNamedSystem("integrator", sampled_system(one, step, one, step, period))
        builder.Connect(both.get_output_port(), law.get_input_port())
        builder.ExportInput(both.get_input_port(0), "desired_force")
        builder.ExportInput(both.get_input_port(1), "measured_force")
        builder.ExportOutput(law.get_output_port(), "displacement_command")
        builder.BuildInto(self)


@dataclass(kw_only=True)
class IntegralLawConfig(Config, LawConfig):
    """What the configurations of integral laws share."""

    integral_gain: float = key(
        1.5, "integral gain K_I of the force error", unit="1/s", bounds="from 0.000001 to 10000", each=True
    )
    compliance_error: float = key(
        1.0, "modelled total compliance relative to the true one, C_T_hat / C_T", bounds="from 0.001 to 1000", each=True
    )
    dead_zone: float = key(
        0.0,
        "size of the force error up to which it is ignored; 0: no dead zone",
        unit="N",
        bounds="not negative",
        each=True,
    )
    lower_limit: float = key(
        -0.1,
        "lower limit of the displacement command, into the surface",
        unit="m",
        bounds="from -10 to -0.000001",
        each=True,
    )
    upper_limit: float = key(
        0.1,
        "upper limit of the displacement command, off the surface",
        unit="m",
        bounds="from 0.000001 to 10",
        each=True,
    )

    def reference_model_bandwidth(self) -> float | None:
        """Bandwidth K_I [rad/s] of the nominal closed loop M(s) = K_I/(s + K_I)."""
        return self.integral_gain

    def law(self, model: PlantModel, compliance: ArrayLike | None, *, limited: bool = True) -> IntegralForceLaw:
        """The block with this modelled total compliance [m/N], or with an input port for it (None)."""
        return IntegralForceLaw(
            model.size,
            integral_gain=self.integral_gain,
            compliance=compliance,
            dead_zone=self.dead_zone,
            lower_limit=self.lower_limit if limited else -np.inf,
            upper_limit=self.upper_limit if limited else np.inf,
            period=model.period,
        )


@dataclass(kw_only=True)
class IntegralConfig(IntegralLawConfig, in_batches=True):
    """Scenario part `!Integral`."""

    def unlimited_law(self, model: PlantModel, *, modelled: bool) -> IntegralForceLaw:
        """The block without limits of its command.

        Args:
            model: of the plant.
            modelled: whether the compliance is a parameter, `compliance_error` times the total one; else it is a port.
        """
        return self.law(model, self.compliance_error * model.total_compliance if modelled else None, limited=False)

    def sampled_response(self, model: PlantModel) -> StateSpace:
        """From the measured force to displacement and rate of the command, without the dead zone."""
        law = replace(self, dead_zone=0.0).law(model, self.compliance_error * model.total_compliance)
        return law.sampled_response()

    def linear_law(self, model: PlantModel) -> LinearIntegralForceLaw | None:
        """The block without limits as a linear system; None with a dead zone."""
        compliance = self.compliance_error * model.total_compliance
        if self.dead_zone:
            return None
        return LinearIntegralForceLaw(
            model.size, integral_gain=self.integral_gain, compliance=compliance, period=model.period
        )
