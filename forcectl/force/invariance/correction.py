"""Invariance control with a nominal force law: what the law asks for, corrected so that F does not pass F_bar (3.18)::

    min |u - u_nom|^2    s.t.  y'' <= a_max(y, y'),    y = -dx_bar - C_T_hat F_bar,    y'' = -u                    [56]

With one control this is u_nom clipped. a_max is the one-step form of the row y'' <= gamma of an active constraint. The
nominal control is the acceleration after which the corrected command moves as fast as the nominal one,

    u_nom = ((dx_nom[k] - dx_nom[k-1])/Ts - v[k])/Ts

So only changes of the nominal command count: a distance that the correction has left between the two is not made up.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import inf
from typing import Any

from numpy.typing import ArrayLike
from pydrake.systems.framework import DiagramBuilder, System

from forcectl.errors import BadInputError, about
from forcectl.force.adaptive_force_law import AdaptivePlanConfig
from forcectl.force.integral import IntegralConfig
from forcectl.force.invariance.force_law import InvarianceForceLaw, InvarianceLimits, one_step_acceleration
from forcectl.force.law import FORCES, model_bandwidth, require_force_law
from forcectl.framework.batch import BatchValue
from forcectl.framework.block import PythonDiagram
from forcectl.framework.fields import key, slot
from forcectl.framework.sampled_block import Memory
from forcectl.framework.wiring import Enclosed, input_names, optional_inputs
from forcectl.plant.plant_model import PlantModel


class InvarianceCorrection(InvarianceForceLaw):
    """Corrects the command of a nominal law for n independent force loops.

    ```
    name: InvarianceCorrection
    input_ports: [desired_force, measured_force, nominal_command, compliance (optional)]
    output_ports: [displacement_command, invariance_function, status]
    parameters: [gamma, upper_acceleration, speed_limit, lower_limit, upper_limit, compliance (optional)]
    ```

    nominal_command: shape (n,), displacement command of the nominal law [m]; only its changes count, beginning at 0.
    All outputs are feedthrough of all inputs at the tick.

    The other ports and parameters are those of `InvarianceForceLaw`, as are moving references and the safe behaviour;
    upper_acceleration [m/s^2] > 0 limits the control in both directions. While the constraint is violated, as after a
    step down, the command returns within gamma or as fast as the nominal law asks for, whichever is faster. (3.57)

    Sampling: every `period` [s]; no delay from nominal_command to displacement_command, see `SampledBlock`.
    """

    own_inputs = ("nominal_command",)
    own_memory = ("nominal",)

    def decide(
        self,
        memory: Memory,
        inputs: Memory,
        y: BatchValue,
        rate: BatchValue,
        retreat: BatchValue,
        gamma: BatchValue,
        upper: BatchValue,
    ) -> tuple[BatchValue, Memory]:
        """The nominal acceleration, at most the largest that keeps the constraint."""
        m, period = self.math, self._period
        last, nominal = memory["nominal"], inputs["nominal_command"]
        nominal = m.where(abs(nominal) < inf, nominal, last)
        wanted = (memory["velocity"] - (nominal - last) / period) / period
        largest = one_step_acceleration(y, rate, gamma, m.where(y > 0.0, -gamma, upper), period, m)
        return m.minimum(wanted, largest - retreat), {"nominal": nominal}


class InvarianceControl(PythonDiagram):
    """A nominal force law and its correction.

    ```
    name: InvarianceControl
    input_ports: [desired_force, measured_force, compliance (optional)]
    output_ports: [displacement_command, invariance_function, status]
    ```

    desired_force, measured_force: shape (n,) [N].
    compliance: shape (n,), C_T_hat [m/N], for whichever of the two laws has this input.
    displacement_command, invariance_function, status: shape (n,), of `InvarianceCorrection` [m, m, 1].
    All outputs are feedthrough of all inputs at the tick.

    Sampling: every `period` [s] of the laws; no delay from measured_force to displacement_command.

    Args:
        nominal: any force law with the ports of its slot. Only changes of its command count, so it should have no
            limits of its own: at a limit its command would no longer change.
        correction: of its command.
    """

    port_units = {"invariance_function": "m"}

    def __init__(self, nominal: System, correction: InvarianceCorrection):
        super().__init__()
        self.sample_delay = {("measured_force", "displacement_command"): 0.0}
        builder = DiagramBuilder()
        builder.AddNamedSystem("nominal", nominal)
        builder.AddNamedSystem("correction", correction)
        for name in (*FORCES, "compliance"):
            first, *others = [s.GetInputPort(name) for s in (nominal, correction) if s.HasInputPort(name)] or [None]
            if first is not None:
                index = builder.ExportInput(first, name)
                for other in others:
                    builder.ConnectInput(index, other)
        builder.Connect(nominal.GetOutputPort("displacement_command"), correction.GetInputPort("nominal_command"))
        for name in ("displacement_command", "invariance_function", "status"):
            builder.ExportOutput(correction.GetOutputPort(name), name)
        builder.BuildInto(self)


@dataclass(kw_only=True)
class InvarianceControlConfig(InvarianceLimits):
    """Scenario part `!InvarianceControl`: a force law whose command is corrected so that F does not pass F_bar."""

    nominal: Any = slot(
        "controller",
        lambda: IntegralConfig(integral_gain=3.0),
        meaning="force law that is corrected; the limits of the command of an integral law are not used",
    )
    upper_acceleration: float | None = key(
        10.0, "largest acceleration of the displacement command; null: -gamma", unit="m/s^2", bounds="positive"
    )

    def reference_model_bandwidth(self) -> float | None:
        """Bandwidth of the nominal law [rad/s]; None when the law does not state it."""
        return model_bandwidth(self.nominal)

    def law(self, model: PlantModel, compliance: ArrayLike | None) -> InvarianceControl:
        """The nominal law and its correction, which has this total compliance C_T_hat [m/N] or a port for it (None)."""
        correction = self.block(InvarianceCorrection, model, compliance)
        unlimited = getattr(self.nominal, "unlimited_law", None)
        if unlimited is not None:
            return InvarianceControl(unlimited(model, modelled=compliance is not None), correction)
        builder = DiagramBuilder()
        with about(self.nominal):
            nominal = self.nominal.add_to(builder, model)
            require_force_law(nominal, [])
            if missing := [name for name in input_names(nominal) if name not in (*FORCES, *optional_inputs(nominal))]:
                name = type(self.nominal).__name__
                raise BadInputError(f"{name} needs {', '.join(missing)}: must be a law of {', '.join(FORCES)} alone")
        return InvarianceControl(Enclosed(builder, nominal), correction)


@dataclass(kw_only=True)
class AdaptiveInvarianceControlConfig(AdaptivePlanConfig, InvarianceControlConfig):
    """Scenario part `!AdaptiveInvarianceControl`: `!InvarianceControl`, compliance estimated on line. (3.56)"""

    compliance_error: float = key(
        0.8,
        "initial estimate of the environment's compliance over its true value, C_E_hat / C_E; "
        "1/1.2: stiffness 20 % too high",
        bounds="from 0.001 to 1000",
    )
