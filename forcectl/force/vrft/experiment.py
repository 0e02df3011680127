"""The experiment of Sec. 4.5 in the slot of a force law: excite and tune, then regulate with what was tuned.

Step 1, `EXCITE`     dx_bar = u_hat - C_R_hat F, u_hat an excitation; the gains are tuned meanwhile   (4.12), (4.19)
Step 2, `REGULATE`   u_hat = C_rho (F_bar - F) with the gains found, without a jump of the command         (4.13)
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from pydrake.systems.framework import BasicVector, Context, Diagram, DiagramBuilder, DiscreteValues

from forcectl.errors import invalid
from forcectl.estimation.recursive_vrft import GAINS, RecursiveVrft
from forcectl.force.integral import check_limits
from forcectl.force.linear_law import REGULATE, LinearForceLaw
from forcectl.force.vrft.adaptive import add_tuned_law
from forcectl.framework.batch import BatchParameter, LaneBlock, check
from forcectl.framework.slots import slot
from forcectl.framework.wiring import checked_system
from forcectl.motion.excitation import ExcitationConfig, TrapezoidalMovesConfig
from forcectl.plant.plant_model import PlantModel

_MEMORY = ("mode", "excitation", "since", *(f"{name}_then" for name in GAINS[:2]))


class ExperimentSequencer(LaneBlock):
    """Decides for n loops when Step 1 is over: at a time, or at rest once the gains have converged.

    ```
    name: ExperimentSequencer
    input_ports: [excitation, proportional_gain, integral_gain]
    output_ports: [mode]
    parameters: [hand_over_time, window, tolerance]
    ```

    excitation: shape (n,) [m]. proportional_gain, integral_gain: shape (n,), as tuned so far [m/N, m/(N s)].
    mode: shape (n,), `EXCITE` (0), then `REGULATE` (1) for good [1]. State, no direct feedthrough.

    Parameters (Context, shape (n,)): hand_over_time [s] >= 0, infinite: not at a time; window [s] > 0 during which both
    gains have changed by less than tolerance [1] >= 0 of their value, infinite: not by convergence.

    There is no hand-over with gains that cannot regulate: the integral gain must be finite and below zero.

    Sampling: every `period` [s]; the mode changes one tick after the condition is met.
    """

    port_units = {"excitation": "m", "proportional_gain": "m/N", "integral_gain": "m/(N s)", "mode": "1"}

    def __init__(
        self,
        size: int,
        *,
        hand_over_time: ArrayLike = np.inf,
        window: ArrayLike = np.inf,
        tolerance: ArrayLike = 0.01,
        period: float = 0.002,
    ):
        super().__init__(
            size,
            {
                "hand_over_time": BatchParameter(hand_over_time, "not negative", "s"),
                "window": BatchParameter(window, "positive", "s"),
                "tolerance": BatchParameter(tolerance, "not negative", "1"),
            },
        )
        self._half_tick = 0.5 * check("period", period, "positive")
        self._inputs = [self.DeclareVectorInputPort(name, size) for name in ("excitation", *GAINS[:2])]
        self._memory = self.DeclareDiscreteState(np.zeros(len(_MEMORY) * size))
        reads: Any = {self.discrete_state_ticket(self._memory)}
        self.DeclareVectorOutputPort("mode", size, self._show, prerequisites_of_calc=reads)
        self.DeclarePeriodicDiscreteUpdateEvent(period_sec=period, offset_sec=0.0, update=self._update)

    def _update(self, context: Context, next_state: DiscreteValues) -> None:
        m, time = self.math, context.get_time()
        hand_over_time, window, tolerance = self._values.Eval(context)
        excitation, kp, ki = (self.lane(port.Eval(context)) for port in self._inputs)
        known = (abs(kp) < np.inf) & (abs(ki) < np.inf)
        kp, ki = m.where(known, kp, 0.0), m.where(known, ki, 0.0)
        mode, last, since, kp_then, ki_then = self.lanes(context.get_discrete_state(self._memory).value())
        changed = (abs(kp - kp_then) > tolerance * abs(kp)) | (abs(ki - ki_then) > tolerance * abs(ki))
        since = m.where(changed, time, since)
        kp_then, ki_then = m.where(changed, kp, kp_then), m.where(changed, ki, ki_then)
        over = time >= hand_over_time - self._half_tick
        converged = (time - since >= window) & (excitation == last)
        mode = m.where((over | converged) & (ki < 0), REGULATE, mode)
        next_state.set_value(self._memory, self.stack(mode, excitation, since, kp_then, ki_then))

    def _show(self, context: Context, output: BasicVector) -> None:
        self.write(output, self.lanes(context.get_discrete_state(self._memory).value())[0])


class VrftExperiment(Diagram):
    """A force law that tunes itself in an open-loop experiment before it regulates.

    ```
    name: VrftExperiment
    input_ports: [desired_force, measured_force]
    output_ports: [displacement_command, controller_output, proportional_gain, integral_gain, derivative_gain, mode]
    ```

    desired_force, measured_force: shape (n,) [N]. displacement_command: shape (n,) [m].
    controller_output: shape (n,), u_hat [m].
    proportional_gain, integral_gain, derivative_gain: shape (n,), as tuned so far [m/N, m/(N s), m s/N]. State.
    mode: shape (n,), `EXCITE` (0) or `REGULATE` (1) [1]. State.
    All outputs are feedthrough of all inputs at the tick.

    Sampling: every `period` [s]; no delay from measured_force to displacement_command.

    Args:
        compliance: C_E [m/N], shape (n,), that the excitation is scaled by. law: with `open_loop` and gains from ports.
    """

    def __init__(
        self,
        excitation: ExcitationConfig,
        compliance: ArrayLike,
        law: LinearForceLaw,
        tuner: RecursiveVrft,
        sequencer: ExperimentSequencer,
    ):
        super().__init__()
        self.sample_delay = dict(law.sample_delay)
        builder = DiagramBuilder()
        source = checked_system(excitation.add_to(builder, compliance), "excitation").GetOutputPort("excitation")
        add_tuned_law(builder, law, tuner)
        builder.AddNamedSystem("sequencer", sequencer)
        mode = sequencer.GetOutputPort("mode")
        for port in (law.GetInputPort("excitation"), sequencer.GetInputPort("excitation")):
            builder.Connect(source, port)
        for block in (law, tuner):
            builder.Connect(mode, block.GetInputPort("mode"))
        for name in GAINS[:2]:
            builder.Connect(tuner.GetOutputPort(name), sequencer.GetInputPort(name))
        builder.ExportOutput(mode, "mode")
        builder.BuildInto(self)


@dataclass(kw_only=True)
class RecursiveVrftConfig:
    """Scenario part `!RecursiveVrft`: excite and tune, then regulate. (Sec. 4.5.2)

    Let the reference step after the hand-over: the command does not jump at the hand-over, whatever the error, so a
    reference that waits there is approached by the integral only.
    """

    excitation: Any = slot("excitation", TrapezoidalMovesConfig)
    reference_bandwidth: float = 1.5  # w_c of the reference model [rad/s], > 0
    prefilter: bool = True  # false: as in Sec. 4.5
    initial_covariance: float = 100.0  # P_0, > 0
    forgetting: float = 1.0  # (0, 1]
    data_resolution: float = 0.0  # the force is rounded to this for the tuning [N], >= 0
    hand_over_time: float | None = None  # [s], >= 0; null: when the excitation is over
    convergence_window: float | None = None  # [s], > 0; hand over earlier, when the gains have not changed for so long
    convergence_tolerance: float = 0.01  # by more than this share of their value, >= 0
    derivative_filter: float = 0.0  # T_D [s], >= 0; 0: the derivative of (4.20)
    robot_compliance_error: float = 1.0  # C_R_hat / C_R, >= 0
    lower_limit: float = -0.1  # [m], below zero: deepest command
    upper_limit: float = 0.1  # [m], above zero: furthest retreat

    def __post_init__(self) -> None:
        for name in ("reference_bandwidth", "initial_covariance"):
            check(name, getattr(self, name), "positive")
        if not 0 < check("forgetting", self.forgetting) <= 1:
            raise invalid("forgetting", self.forgetting, "above 0 and at most 1")
        for name in ("data_resolution", "convergence_tolerance", "derivative_filter", "robot_compliance_error"):
            check(name, getattr(self, name), "not negative")
        if self.hand_over_time is not None:
            check("hand_over_time", self.hand_over_time, "not negative")
        if self.convergence_window is not None:
            check("convergence_window", self.convergence_window, "positive")
        if not isinstance(self.prefilter, bool):
            raise invalid("prefilter", self.prefilter, "true or false")
        check_limits(self.lower_limit, self.upper_limit)

    def reference_model_bandwidth(self) -> float | None:
        """Bandwidth w_c [rad/s] of the reference model."""
        return self.reference_bandwidth

    def add_to(self, builder: DiagramBuilder, model: PlantModel) -> VrftExperiment:
        """Add the law; it knows `robot_compliance_error` times the true compliance of the robot."""
        law = LinearForceLaw(
            model.size,
            robot_compliance=self.robot_compliance_error * model.robot_compliance,
            derivative_filter=self.derivative_filter,
            lower_limit=self.lower_limit,
            upper_limit=self.upper_limit,
            open_loop=True,
            period=model.period,
        )
        tuner = RecursiveVrft(
            model.size,
            bandwidth=self.reference_bandwidth,
            forgetting=self.forgetting,
            resolution=self.data_resolution,
            initial_covariance=self.initial_covariance,
            prefilter=self.prefilter,
            period=model.period,
        )
        sequencer = ExperimentSequencer(
            model.size,
            hand_over_time=self.excitation.end_time() if self.hand_over_time is None else self.hand_over_time,
            window=np.inf if self.convergence_window is None else self.convergence_window,
            tolerance=self.convergence_tolerance,
            period=model.period,
        )
        experiment = VrftExperiment(self.excitation, model.environment_compliance, law, tuner, sequencer)
        return builder.AddNamedSystem("force_law", experiment)
