"""Impedance control with force tracking, and adaptive admittance, for a position-controlled robot::

    H e'' + D (e' + phi) + K e = F - F_bar,    dx_bar = x_r + e,    x_r = -C_T_hat F_r                 target impedance
    phi[k+1] = phi[k] + s Ts (F_bar[k] - F[k])/D                                                       adaptation

    a = (F[k] - F_bar[k] - K e[k] - D phi[k] - D v[k])/H
    e[k+1] = e[k] + Ts v[k] + Ts^2/2 a,    v[k+1] = v[k] + Ts a,    dx_bar = x_r[k] + e[k+1]          as implemented
    F_r[k] = F_r[k-1] + (F_bar[k] - F_r[k-1]) Ts/(T_F + Ts)

`!Impedance`: K > 0, and the reference x_r is the displacement at which the model has the desired force. N. Hogan,
Impedance control, Journal of Dynamic Systems, Measurement, and Control 107(1), 1985; x_r from the compliance of the
environment: H. Seraji and R. Colbaugh, Force tracking in impedance control, International Journal of Robotics Research
16(1), 1997. Without adaptation the steady state is F/F_bar = (1 + K C_T_hat)/(1 + K C_T).

`!AdaptiveAdmittance`: K = 0 and no model; phi adapts the damping on line, to track a surface that moves. J.
Duan, Y. Gan, M. Chen and X. Dai, Adaptive variable impedance control for dynamic contact force tracking in uncertain
environment, Robotics and Autonomous Systems 102, 2018, where D phi is written as a change of D, Delta D = D phi/e', and
s Ts is the update rate sigma; S. Jung, T. C. Hsia and R. G. Bonitz, Force tracking impedance control of robot
manipulators under unknown environment, IEEE Transactions on Control Systems Technology 12(3), 2004. Without adaptation
it is `!Admittance`.

Stability on the ideal plant F[k] = -dx_bar[k-1]/C_T, exactly (Routh after the bilinear map), with Q = K + 1/C_T::

    H > D Ts/2,    2 D - Q Ts + s Ts^2/(2 C_T) > 0,    Q C_T > s Ts
    (2 D - Q Ts + s Ts^2/(2 C_T)) (Q C_T - s Ts) > (2 H - D Ts) s

the last two only with s > 0. For short ticks this is s < Q C_T D/H; an adaptation near that oscillates.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from pydrake.systems.framework import Context

from forcectl.arrays import Array
from forcectl.errors import invalid
from forcectl.force.admittance import admittance_step
from forcectl.force.law import ForceLaw, LinearLawConfig, low_pass
from forcectl.framework.batch import BatchParameter, BatchValue, check
from forcectl.framework.fields import Config, key
from forcectl.framework.sampled_block import Memory
from forcectl.plant.plant_model import PlantModel


class ImpedanceForceLaw(ForceLaw):
    """Target impedance, with a reference from the desired force and an adapted velocity, for n independent force loops.

    ```
    name: ImpedanceForceLaw
    input_ports: [desired_force, measured_force]
    output_ports: [displacement_command, adapted_velocity]
    parameters: [inertia, damping, stiffness, adaptation_rate, reference_compliance, reference_filter, lower_limit,
    upper_limit]
    ```

    desired_force, measured_force: shape (n,) [N].
    displacement_command: shape (n,), dx_bar [m], held over [t_k, t_k+1).
    adapted_velocity: shape (n,), phi after the tick [m/s]: velocity into the surface at zero force error.
    All outputs are feedthrough of all inputs at the tick.

    Parameters (Context, shape (n,)): inertia H [kg] and damping D [N s/m], positive, stiffness K [N/m] >= 0,
    adaptation_rate s [1/s] >= 0, reference_compliance C_T_hat [m/N] >= 0, reference_filter T_F [s] >= 0, lower_limit
    and upper_limit of dx_bar [m]. H > D Ts/2 and D > K Ts/2: else the impedance alone is unstable.

    At a limit the command stops, and phi is only adapted away from the limit. A force that is not a number holds the
    command and all states.

    Sampling: every `period` [s]; no delay from measured_force to displacement_command, see `SampledBlock`.
    """

    port_units = {"adapted_velocity": "m/s"}
    uses_compliance = False

    def __init__(
        self,
        size: int,
        *,
        inertia: ArrayLike,
        damping: ArrayLike,
        stiffness: ArrayLike = 0.0,
        adaptation_rate: ArrayLike = 0.0,
        reference_compliance: ArrayLike = 0.0,
        reference_filter: ArrayLike = 0.0,
        lower_limit: ArrayLike = -np.inf,
        upper_limit: ArrayLike = np.inf,
        period: float = 0.002,
    ):
        self._period = check("period", period, "positive")
        parameters = {
            "inertia": BatchParameter(inertia, "positive and finite", "kg"),
            "damping": BatchParameter(damping, "positive and finite", "N s/m"),
            "stiffness": BatchParameter(stiffness, "not negative", "N/m"),
            "adaptation_rate": BatchParameter(adaptation_rate, "not negative and finite", "1/s"),
            "reference_compliance": BatchParameter(reference_compliance, "not negative and finite", "m/N"),
            "reference_filter": BatchParameter(reference_filter, "not negative and finite", "s"),
        }
        super().__init__(
            size,
            parameters,
            {"displacement": 0.0, "velocity": 0.0, "adapted_velocity": 0.0, "expected_force": 0.0},
            period,
            lower_limit=lower_limit,
            upper_limit=upper_limit,
            shows=("adapted_velocity",),
        )

    def check_together(self, values: Mapping[str, Array]) -> None:
        """Check that the impedance alone is stable, and that the limits are in order."""
        super().check_together(values)
        for name, by in (("inertia", "damping"), ("damping", "stiffness")):
            least = 0.5 * self._period * values[by]
            if not np.all(values[name] > least):
                allowed = f"above {by} times half a tick, {least.tolist()}: else the impedance alone is unstable"
                raise invalid(name, values[name].tolist(), allowed)

    def step(self, context: Context, memory: Memory, inputs: Memory) -> dict[str, BatchValue]:
        """One tick of the law."""
        m, period = self.math, self._period
        inertia, damping, stiffness, rate, compliance, filter_time, lower, upper = self.values(context)
        desired, force = inputs["desired_force"], inputs["measured_force"]
        good = (abs(desired) < np.inf) & (abs(force) < np.inf)
        desired, force = m.where(good, desired, 0.0), m.where(good, force, 0.0)
        e, v, phi = memory["displacement"], memory["velocity"], memory["adapted_velocity"]
        expected = low_pass(memory["expected_force"], desired, filter_time, period)
        pushed = force - desired - stiffness * e - damping * phi
        e, v = admittance_step(e, v, pushed, inertia, damping, period)
        reference = -compliance * expected
        free = reference + e
        command = m.minimum(m.maximum(free, lower), upper)
        beyond, change = free - command, rate * period * (desired - force) / damping
        new = {
            "displacement_command": command,
            "displacement": command - reference,
            "velocity": m.where(beyond == 0.0, v, 0.0),
            # Positive phi moves into the surface: no change that leads further beyond the limit.
            "adapted_velocity": m.where(beyond * change < 0.0, phi, phi + change),
            "expected_force": expected,
        }
        return self.choose(good & (abs(free) < np.inf), new, memory)


@dataclass(kw_only=True)
class AdaptiveAdmittanceConfig(Config, LinearLawConfig, in_batches=True):
    """Scenario part `!AdaptiveAdmittance`: an admittance whose damping is adapted on line to surfaces that move."""

    inertia: float = key(26.5, "inertia H of the admittance", unit="kg", bounds="positive", each=True)
    damping: float = key(2650.0, "damping D of the admittance", unit="N s/m", bounds="positive", each=True)
    adaptation_rate: float = key(
        0.3, "rate s at which the force error adapts the velocity phi", unit="1/s", bounds="positive", each=True
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

    def law(self, model: PlantModel) -> ImpedanceForceLaw:
        """The block."""
        return ImpedanceForceLaw(
            model.size,
            inertia=self.inertia,
            damping=self.damping,
            adaptation_rate=self.adaptation_rate,
            lower_limit=self.lower_limit,
            upper_limit=self.upper_limit,
            period=model.period,
        )


@dataclass(kw_only=True)
class ImpedanceConfig(Config, LinearLawConfig, in_batches=True):
    """Scenario part `!Impedance`: a target impedance whose reference is the depth modelled for the desired force."""

    inertia: float = key(66.0, "inertia H of the target impedance", unit="kg", bounds="positive", each=True)
    damping: float = key(6620.0, "damping D of the target impedance", unit="N s/m", bounds="positive", each=True)
    stiffness: float = key(5000.0, "stiffness K of the target impedance", unit="N/m", bounds="positive", each=True)
    adaptation_rate: float = key(
        0.0,
        "rate s at which the force error adapts the velocity phi; 0: a wrong compliance leaves a force error",
        unit="1/s",
        bounds="not negative",
        each=True,
    )
    reference_filter: float = key(
        0.67, "time constant T_F of the filter of the desired force", unit="s", bounds="positive", each=True
    )
    compliance_error: float = key(
        1.0, "modelled total compliance relative to the true one, C_T_hat / C_T", bounds="from 0.001 to 1000", each=True
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
        """Bandwidth 1/T_F [rad/s] for C_T_hat = C_T."""
        return 1 / self.reference_filter

    def law(self, model: PlantModel) -> ImpedanceForceLaw:
        """The block."""
        return ImpedanceForceLaw(
            model.size,
            inertia=self.inertia,
            damping=self.damping,
            stiffness=self.stiffness,
            adaptation_rate=self.adaptation_rate,
            reference_compliance=self.compliance_error * model.total_compliance,
            reference_filter=self.reference_filter,
            lower_limit=self.lower_limit,
            upper_limit=self.upper_limit,
            period=model.period,
        )
