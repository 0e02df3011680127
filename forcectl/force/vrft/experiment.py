"""The experiment of Sec. 4.5 in the slot of a force law: excite and tune, then regulate with the gains found.

Step 1, `EXCITE`     dx_bar = u_hat - C_R_hat F, u_hat an excitation; the gains are tuned   (4.12), (4.19)
Step 2, `REGULATE`   u_hat = C_rho (F_bar - F) with the gains found, without a jump of the command  (4.13)

The gains are tuned on the command or on the motor positions, see `forcectl.tuning.motor_positions`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike
from pydrake.systems.framework import Context, DiagramBuilder

from forcectl.errors import about, invalid
from forcectl.estimation.recursive_vrft import GAINS, RecursiveVrft
from forcectl.force.linear_law import REGULATE, LinearForceLaw
from forcectl.force.vrft.adaptive import add_tuned_law
from forcectl.force.vrft.motor_side import MotorSideRecord
from forcectl.framework.batch import BatchParameter, BatchValue, check
from forcectl.framework.fields import Config, key, slot
from forcectl.framework.sampled_block import Memory, SampledBatch
from forcectl.framework.wiring import Around, add_part
from forcectl.motion.excitation import ExcitationConfig, TrapezoidalMovesConfig
from forcectl.plant.plant_model import PlantModel
from forcectl.tuning.motor_positions import INPUTS, DriveFilter

_MEMORY = ("mode", "excitation", "since", *(f"{name}_then" for name in GAINS[:2]))


class ExperimentSequencer(SampledBatch):
    """Switches n loops from Step 1 to Step 2: at a given time, or at rest once the gains have converged.

    ```
    name: ExperimentSequencer
    input_ports: [excitation, proportional_gain, integral_gain]
    output_ports: [mode]
    parameters: [hand_over_time, window, tolerance]
    ```

    excitation: shape (n,) [m]. proportional_gain, integral_gain: shape (n,), as tuned so far [m/N, m/(N s)].
    mode: shape (n,), `EXCITE` (0), then `REGULATE` (1) for good [1]. State, no direct feedthrough.

    Parameters (Context, shape (n,)): hand_over_time [s] >= 0, infinite: no hand-over at a time; window [s] > 0, time in
    which both gains must have changed by less than tolerance [1] >= 0 of their value, infinite: no hand-over by
    convergence.

    There is no hand-over with gains that cannot regulate: the integral gain must be finite and below zero.

    Sampling: every `period` [s]; the mode changes one tick after the condition is met.
    """

    port_units = {"excitation": "m", "proportional_gain": "m/N", "integral_gain": "m/(N s)"}

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
        inputs = [self.DeclareVectorInputPort(name, size) for name in ("excitation", *GAINS[:2])]
        self.declare_memory(dict.fromkeys(_MEMORY, 0.0), inputs, period)
        self.show_held("mode")

    def step(self, context: Context, memory: Memory, inputs: Memory) -> dict[str, BatchValue]:
        """One tick of the decision."""
        m, time = self.math, context.get_time()
        hand_over_time, window, tolerance = self.values(context)
        excitation, kp, ki = inputs["excitation"], *(inputs[name] for name in GAINS[:2])
        known = (abs(kp) < np.inf) & (abs(ki) < np.inf)
        kp, ki = m.where(known, kp, 0.0), m.where(known, ki, 0.0)
        mode, last, since, kp_then, ki_then = (memory[name] for name in _MEMORY)
        changed = (abs(kp - kp_then) > tolerance * abs(kp)) | (abs(ki - ki_then) > tolerance * abs(ki))
        since = m.where(changed, time, since)
        kp_then, ki_then = m.where(changed, kp, kp_then), m.where(changed, ki, ki_then)
        over = time >= hand_over_time - self._half_tick
        converged = (time - since >= window) & (excitation == last)
        mode = m.where((over | converged) & (ki < 0), REGULATE, mode)
        return dict(zip(_MEMORY, (mode, excitation, since, kp_then, ki_then), strict=True))


class VrftExperiment(Around):
    """A force law that tunes itself in an open-loop experiment before it regulates.

    ```
    name: VrftExperiment
    input_ports: [desired_force, measured_force, motor_displacement (optional)]
    output_ports: [displacement_command, controller_output, proportional_gain, integral_gain, derivative_gain, mode]
    ```

    desired_force, measured_force: shape (n,) [N].
    motor_displacement: shape (n,), actual motor-side dx along n [m]; the port exists with `motor_side`.
    displacement_command: shape (n,) [m].
    controller_output: shape (n,), u_hat [m].
    proportional_gain, integral_gain, derivative_gain: shape (n,), as tuned so far [m/N, m/(N s), m s/N]. State.
    mode: shape (n,), `EXCITE` (0) or `REGULATE` (1) [1]. State.
    All outputs are feedthrough of desired_force and measured_force at the tick.

    Sampling: every `period` [s]; no delay from measured_force to displacement_command.

    Args:
        compliance: C_E [m/N], shape (n,), by which the excitation is scaled.
        law: with `open_loop` and input ports for its gains.
        motor_side: source of the tuner's data instead of the command; None: the command.
    """

    def __init__(
        self,
        excitation: ExcitationConfig,
        compliance: ArrayLike,
        law: LinearForceLaw,
        tuner: RecursiveVrft,
        sequencer: ExperimentSequencer,
        motor_side: MotorSideRecord | None = None,
    ):
        super().__init__(law)
        builder = DiagramBuilder()
        source = add_part(excitation, "excitation", builder, compliance).GetOutputPort("excitation")
        add_tuned_law(builder, law, tuner, motor_side)
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
class RecursiveVrftConfig(Config):
    """Scenario part `!RecursiveVrft`: excite and tune, then regulate. (Sec. 4.5.2)

    The reference should step after the hand-over, not before it. The command does not jump at the hand-over, whatever
    the force error; an error that exists then is reduced by the integral part only.
    """

    excitation: Any = slot(
        "excitation", TrapezoidalMovesConfig, meaning="open-loop displacement during which the gains are tuned"
    )
    input: str = key(
        "command",
        "displacement that the gains are tuned on: the command, or motor positions, which leave friction out",
        choices=INPUTS,
    )
    drive: DriveFilter = key(DriveFilter, "nominal filter and delay of the joint references, for `input: motor`")
    reference_bandwidth: float = key(1.5, "bandwidth w_c of the reference model", unit="rad/s", bounds="positive")
    prefilter: bool = key(True, "whether the tuning data pass the prefilter L = M (1 - M); false: as in Sec. 4.5")
    initial_covariance: float = key(
        100.0, "initial covariance P_0 of the gains in the tuning", bounds="above 0 and at most 1e12"
    )
    forgetting: float = key(
        1.0, "forgetting factor per sample of the tuning; 1: nothing is forgotten", bounds="from 0.9 to 1"
    )
    data_resolution: float = key(
        0.0,
        "resolution to which the measured force is rounded for the tuning; 0: no rounding",
        unit="N",
        bounds="not negative",
    )
    hand_over_time: float | None = key(
        None,
        "time at which excitation ends and regulation begins; null: end of the excitation",
        unit="s",
        bounds="not negative",
    )
    convergence_window: float | None = key(
        None,
        "time without a change of the gains after which regulation begins earlier; null: never earlier",
        unit="s",
        bounds="positive",
    )
    convergence_tolerance: float = key(
        0.01, "largest relative change of the gains that counts as none for convergence_window", bounds="not negative"
    )
    derivative_filter: float = key(
        0.0,
        "time constant T_D of the derivative's filter; 0: no filter, as in (4.20)",
        unit="s",
        bounds="from 0 to 100",
    )
    robot_compliance_error: float = key(
        1.0, "assumed compliance of the robot over the true one, C_R_hat / C_R", bounds="from 0 to 1000"
    )
    lower_limit: float = key(
        -0.1, "lower limit of the displacement command, into the surface", unit="m", bounds="from -10 to -0.000001"
    )
    upper_limit: float = key(
        0.1, "upper limit of the displacement command, off the surface", unit="m", bounds="from 0.000001 to 10"
    )

    finds_gains: ClassVar[tuple[str, ...]] = GAINS

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.input == "command" and self.drive != DriveFilter():
            raise invalid("input", self.input, "motor with a drive")

    def reference_model_bandwidth(self) -> float | None:
        """Bandwidth w_c [rad/s] of the reference model."""
        return self.reference_bandwidth

    def gain_scale(self, bandwidth: float) -> float:
        """The factor on the gains for a reference model of another bandwidth.

        Without a prefilter the virtual error (M^-1 - 1) y is proportional to 1/w_c, so the gains are proportional to
        w_c, but for the effect of P_0 (1e-5 of them in a record of 19 s).

        Args:
            bandwidth: of that model [rad/s].

        Raises:
            BadInputError: another bandwidth, with a prefilter.
        """
        if self.prefilter and bandwidth != self.reference_bandwidth:
            own = f"{self.reference_bandwidth:g}, the experiment's own: with its prefilter the gains hold for no other"
            raise invalid("reference_bandwidth", bandwidth, own)
        return bandwidth / self.reference_bandwidth

    def _check_excitation(self, excitation: ExcitationConfig, model: PlantModel) -> None:
        """BadInputError unless the deepest excitation is within the limits and the first move before the hand-over."""
        deepest = excitation.deepest(model.environment_compliance)
        if deepest < self.lower_limit:
            allowed = f"at most {deepest:.4g} m, the deepest displacement of the excitation"
            raise invalid("lower_limit", self.lower_limit, allowed)
        if self.hand_over_time is not None and self.hand_over_time <= (first := excitation.first_move()):
            raise invalid("hand_over_time", self.hand_over_time, f"above {first:g} s, when the first move begins")

    def add_to(self, builder: DiagramBuilder, model: PlantModel) -> VrftExperiment:
        """Add the law; its model has `robot_compliance_error` times the true compliance of the robot."""
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
        with about(self.excitation):
            end = float(self.excitation.end_time())
        if isinstance(self.excitation, ExcitationConfig):
            self._check_excitation(self.excitation, model)
        hand_over_time = end if self.hand_over_time is None else self.hand_over_time
        if self.convergence_window is not None and self.convergence_window >= hand_over_time:
            allowed = f"below {hand_over_time:g} s, the hand-over time of the experiment"
            raise invalid("convergence_window", self.convergence_window, allowed)
        sequencer = ExperimentSequencer(
            model.size,
            hand_over_time=hand_over_time,
            window=np.inf if self.convergence_window is None else self.convergence_window,
            tolerance=self.convergence_tolerance,
            period=model.period,
        )
        motor_side = None
        if self.input == "motor":
            fed_back = self.robot_compliance_error * model.robot_compliance
            motor_side = MotorSideRecord(model.size, fed_back, self.drive, model.period)
        experiment = VrftExperiment(self.excitation, model.environment_compliance, law, tuner, sequencer, motor_side)
        return builder.AddNamedSystem("force_law", experiment)
