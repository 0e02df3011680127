"""Estimator of a scenario: the momentum observer (5.6)* and a wrench estimate per arm, (5.8) or a Kalman filter."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from pydrake.multibody.tree import Frame
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import Multiplexer, TrajectorySource
from pydrake.trajectories import PiecewisePolynomial

from forcectl.conventions import unit_of
from forcectl.errors import BadInputError, invalid, unknown
from forcectl.estimation.momentum_observer import MomentumObserver
from forcectl.estimation.wrench import WrenchEstimator
from forcectl.estimation.wrench_between_filter import WrenchBetweenFilter
from forcectl.estimation.wrench_filter import WrenchFilter
from forcectl.framework.block import PythonDiagram
from forcectl.framework.fields import Config, key
from forcectl.framework.linear_batch import state_space
from forcectl.framework.wiring import export_outputs
from forcectl.plant.plant_model import PlantModel
from forcectl.robot.model import RobotModel
from forcectl.robot.momentum_model import MomentumModel
from forcectl.robot.parts import ArmParts

if TYPE_CHECKING:
    from scipy.signal import StateSpace

READINGS = ("joint_position", "joint_velocity", "motor_torque")
_COMPONENTS = {"wrench_deviation": "6a", "joint_bias": "n", "moving": "n", "wrench_between": "6"}
_TICK = 0.004  # [s] of a joint interface
_LEVER = 0.36  # [m] lever arm of a force, over all joints of an arm; YuMi's are 0.23 to 0.44
_JUMP = 4.0  # speed change / acceleration limit above which a reading counts as wrong
_STOP = 2.0  # deceleration / acceleration limit above which a repeated position is a frozen encoder and no stop
_FROZEN = 0.1  # [rad/s] speed above which it is one, where there is no acceleration limit


class ForceEstimator(PythonDiagram):
    """External joint torques and the wrench at each TCP.

    ```
    name: ForceEstimator
    input_ports: [joint_position, joint_velocity, motor_torque, tare (optional)]
    output_ports: [estimated_torque, estimated_wrench (optional), estimated_local_wrench (optional), near_singular
    (optional), wrench_deviation (optional), joint_bias (optional), moving (optional), torque_elsewhere (optional),
    wrench_between (optional), residual, torque_balance, balance_ok]
    ```

    joint_position, joint_velocity, motor_torque: shape (n,), readings of the tick [rad, rad/s, Nm].
    estimated_torque: shape (n,), external joint torques beyond the friction threshold, else zero [Nm].
    estimated_wrench: shape (6a,), of the environment on the robot at each TCP in the world, [torque; force] [Nm, N].
    estimated_local_wrench: shape (6a,), the same in the axes of other frames [Nm, N]; with `local` the port exists
    instead of estimated_wrench.
    tare: shape (1,) [1], may be left unconnected; the port exists where no `tare` is given. See the wrench estimates.
    residual: shape (n,), r [Nm]. torque_balance: shape (n,), of the tick, see `MomentumObserver` [Nm].
    balance_ok: shape (n,) [1].
    near_singular: shape (a,), 1 where a direction is damped [1]; of a `WrenchEstimator`.
    wrench_deviation: shape (6a,), in the axes of each TCP [Nm, N]; joint_bias: shape (n,) [Nm]; moving: shape (n,) [1];
    torque_elsewhere: shape (a,) [Nm]; of a `WrenchFilter`, joints arm by arm.
    wrench_between: shape (6,), of one arm on another at the TCP of that [Nm, N]; of a `WrenchBetweenFilter`.
    All outputs are feedthrough of all inputs at the tick.

    Sampling: every `period` [s]; no delay. With filtered speeds the estimate has their lag.

    Args:
        observer: of the n joints.
        wrenches: by arm, at least one, all of the same n joints, of one class and with the period of the observer.
        tare: source of the input `tare` of the wrench estimates; None: `tare` is an input of the diagram.
        between: filter of two of the arms, of the same n joints and with the period of the observer; None: none.
        local: whether the wrenches are expressed in other frames than the world.
    """

    def __init__(
        self,
        observer: MomentumObserver,
        wrenches: Mapping[str, WrenchEstimator] | Mapping[str, WrenchFilter],
        tare: TrajectorySource | None = None,
        between: WrenchBetweenFilter | None = None,
        *,
        local: bool = False,
    ):
        super().__init__()
        if not wrenches:
            raise BadInputError("wrenches: must have at least one arm; a MomentumObserver alone has the joint torques")
        name_of_wrench = "estimated_local_wrench" if local else "estimated_wrench"
        builder = DiagramBuilder()
        add, connect = builder.AddNamedSystem, builder.Connect
        add("observer", observer)
        for name in READINGS:
            builder.ExportInput(observer.GetInputPort(name), name)
        if tare is not None:
            add("tare", tare)
        self.optional_inputs = ("tare",) if tare is None else ()
        untared = []
        every: dict[str, Any] = {f"wrench_{arm}": wrench for arm, wrench in wrenches.items()}
        if between is not None:
            every["wrench_between"] = between
        for name_of_part, wrench in every.items():
            add(name_of_part, wrench)
            for port in map(wrench.get_input_port, range(wrench.num_input_ports())):
                name = port.get_name()
                if name in READINGS:
                    builder.ConnectInput(name, port)
                elif name != "tare":
                    connect(observer.GetOutputPort(name), port)
                elif tare is not None:
                    connect(tare.get_output_port(), port)
                else:
                    untared.append(port)
        if untared:
            builder.ExportInput(untared[0], "tare")
            for port in untared[1:]:
                builder.ConnectInput("tare", port)
        outputs = {"estimated_torque": observer.GetOutputPort("external_torque")}
        self.port_units: dict[str, str] = {}
        self.port_components = dict(_COMPONENTS)
        if len(wrenches) > 1:
            self.port_components |= dict.fromkeys(("near_singular", "torque_elsewhere"), "a")
        first = next(iter(wrenches.values()))
        for port in map(first.get_output_port, range(first.num_output_ports())):
            parts = [wrench.GetOutputPort(port.get_name()) for wrench in wrenches.values()]
            name = name_of_wrench if port.get_name() == "wrench" else port.get_name()
            together = add(name, Multiplexer([part.size() for part in parts]))
            for i, part in enumerate(parts):
                connect(part, together.get_input_port(i))
            outputs[name] = together.get_output_port()
            self.port_units[name] = unit_of(port.get_name(), first.port_units)
        if between is not None:
            outputs["wrench_between"] = between.GetOutputPort("wrench")
            self.port_units["wrench_between"] = unit_of("wrench")
        outputs |= {name: observer.GetOutputPort(name) for name in ("residual", "torque_balance", "balance_ok")}
        export_outputs(builder, outputs)
        builder.BuildInto(self)


@dataclass(kw_only=True)
class ForceEstimatorConfig(Config):
    """Scenario part `!ForceEstimator`: momentum observer and wrench estimates.

    The observer uses the dynamics of the plant without error, and `friction_scale` times its friction. The threshold
    (5.3)* is given relative to the Coulomb friction of each joint.
    """

    reads_of_model: ClassVar[tuple[str, ...]] = ("friction", "masses")

    gain: float = key(25.0, "gain K_R of the momentum observer", unit="1/s", bounds="positive")
    friction_scale: float = key(
        1.0, "joint friction assumed by the estimator / true joint friction", bounds="from 0 to 20"
    )
    threshold_move: float = key(
        0.0,
        "external torque up to which a joint's estimate is zero, tau_move / Coulomb friction tau_C; 0: none",
        bounds="from 0 to 100",
    )
    threshold_still: float = key(
        0.0,
        "increase of threshold_move for a joint at rest, tau_still / Coulomb friction tau_C; 0: none",
        bounds="from 0 to 100",
    )
    limit_share: float = key(
        1.0, "limit of the observer's residual / torque limit of the joint", bounds="from 0.01 to 100"
    )
    moment: bool = key(True, "whether torques at the TCPs are estimated; false: only forces, the torques are zero")
    expressed_in: str = key(
        "world",
        "axes of the wrenches, which act at the TCPs: world; else they are estimated_local_wrench, in tcp (each in its "
        "own) or in any frame or body of the robot's model",
    )
    smallest_singular_value: float = key(
        0.02,
        "singular value of the TCP Jacobian below which the wrench estimate is damped in that direction",
        unit="1",
        bounds="above 0 and at most 1",
    )
    tare_start: float = key(
        0.0,
        "start of taring: the mean of the estimates during it is subtracted from the later ones",
        unit="s",
        bounds="not negative",
    )
    tare_duration: float = key(
        0.0,
        "duration of the taring from tare_start on; 0: taring by the input tare only",
        unit="s",
        bounds="not negative",
    )

    def force_lag(self) -> tuple[float, float, float]:
        """Lag of the estimated forces as that of a sensor: bandwidth [rad/s], damping ratio [1] and delay [s].

        The estimate lags by 1/w; this is the critically damped filter of second order with the same lag.
        """
        return 2 * self._bandwidth(_TICK), 1.0, 0.0

    def _bandwidth(self, period: float) -> float:
        """Bandwidth w of the estimated forces at ticks of this period [s]: K_R of the observer [rad/s]."""
        return self.gain

    def force_response(self, model: PlantModel) -> StateSpace:
        """Discrete-time model from a force to its estimate, without thresholds.

        Three stages in series: mean over the tick, filter of the speeds, estimate.
        """
        period = model.period
        kept = math.exp(-model.velocity_bandwidth * period)
        decay = math.exp(-self._bandwidth(period) * period)
        # y = kept y_last + (1 - kept)/2 (u + u_last), and r = decay r_last + (1 - decay) y
        half, gain = 0.5 * (1 - kept), 1 - decay
        late = state_space([[kept]], [[1.0]], [[half * (1 + kept)]], [[half]], period)
        observed = state_space([[decay]], [[1.0]], [[gain * decay]], [[gain]], period)
        mean = state_space([[0.0]], [[1.0]], [[0.5]], [[0.5]], period)
        return observed * late * mean

    def add_to(self, builder: DiagramBuilder, model: PlantModel) -> ForceEstimator:
        """Add the estimator."""
        momentum = model.momentum_model()
        wrenches = {
            name: self._wrench(model, momentum, arm, self._axes(model.known_robot(), arm.tcp_frame))
            for name, arm in model.known_robot().parts.arms.items()
        }
        tare = None
        if self.tare_duration > 0:
            start, end = self.tare_start, self.tare_start + self.tare_duration
            breaks, values = ([0.0], [0.0]) if start > 0 else ([], [])
            held = PiecewisePolynomial.ZeroOrderHold([*breaks, start, end, end + 1.0], [[*values, 1.0, 0.0, 0.0]])
            tare = TrajectorySource(held)
        between = self._between(model, momentum)
        local = self.expressed_in != "world"
        made = ForceEstimator(self._observer(model, momentum), wrenches, tare, between, local=local)
        return builder.AddNamedSystem("estimator", made)

    def _wrench(self, model: PlantModel, momentum: MomentumModel, arm: ArmParts, axes: Frame | None) -> Any:
        return WrenchEstimator(
            momentum,
            arm.tcp_frame,
            axes,
            joints=arm.joints,
            moment=self.moment,
            smallest=self.smallest_singular_value,
            length=model.known_robot().parameters.characteristic_length,
            period=model.period,
        )

    def _between(self, model: PlantModel, momentum: MomentumModel) -> WrenchBetweenFilter | None:
        return None

    def _observer(self, model: PlantModel, momentum: MomentumModel) -> MomentumObserver:
        robot, coulomb = model.known_robot(), model.friction.coulomb
        # Within a tick a joint can only stop from a low speed; a position that repeats at a higher one is frozen.
        fastest_stop = _STOP * robot.limits.acceleration * model.period
        return MomentumObserver(
            momentum,
            model.friction.scaled(self.friction_scale),
            gain=self.gain,
            move=self.threshold_move * coulomb,
            still=self.threshold_still * coulomb,
            limit=self.limit_share * robot.limits.torque,
            period=model.period,
            velocity_bandwidth=_speed_bandwidth(model),
            frozen_speed=np.where(np.isfinite(fastest_stop), fastest_stop, _FROZEN),
            largest_acceleration=_JUMP * robot.limits.acceleration,
        )

    def _axes(self, robot: RobotModel, tcp: Frame) -> Frame | None:
        """The frame that wrenches at a TCP are expressed in; None for the world."""
        instance = robot.parts.instance
        if self.expressed_in in ("world", "tcp"):
            return tcp if self.expressed_in == "tcp" else None
        if not robot.plant.HasFrameNamed(self.expressed_in, instance):
            bodies = [robot.plant.get_body(index).name() for index in robot.plant.GetBodyIndices(instance)]
            raise unknown("expressed_in", self.expressed_in, ["world", "tcp", *sorted(bodies)])
        return robot.plant.GetFrameByName(self.expressed_in, instance)


@dataclass(kw_only=True)
class KalmanForceEstimatorConfig(ForceEstimatorConfig):
    """Scenario part `!KalmanForceEstimator`: momentum observer and, per arm, a Kalman filter of the moving joints.

    Wrenches are estimated from joints that move: all of them with a `dither` of the drive, nearly all with
    `null_space: !SelfMotion {}`. Model and friction are those of `!ForceEstimator`; the thresholds apply to
    `estimated_torque` alone.
    """

    noise: float = key(
        0.25,
        "standard deviation of the torque balance of a joint over one tick",
        unit="Nm",
        bounds="above 0 and at most 100",
    )
    jerk_noise: float = key(
        0.0,
        "standard deviation of the torque balance of a joint per jerk of the joint / its Coulomb friction: links swing "
        "on elastic joints where an arm stops suddenly; a contact that jerks the joints is found later",
        unit="s^3/rad",
        bounds="from 0 to 1",
    )
    force_walk: float = key(
        1.25, "random walk of a force: standard deviation of its change in 1 s", unit="N", bounds="positive"
    )
    moment_walk: float = key(
        0.04,
        "random walk of a torque at the TCP: standard deviation of its change in 1 s",
        unit="Nm",
        bounds="positive",
    )
    bias: float = key(
        0.05,
        "initial standard deviation of the error of the assumed Coulomb friction tau_C of a joint / tau_C",
        bounds="above 0 and at most 10",
    )
    bias_walk: float = key(
        0.008,
        "random walk of the torque offset of a joint: standard deviation of its change in 1 s / Coulomb friction tau_C",
        bounds="above 0 and at most 10",
    )
    slow: float = key(
        0.004,
        "speed over a tick below which a joint may be in static friction and its torque is ignored",
        unit="rad/s",
        bounds="above 0 and at most 10",
    )
    hold: float = key(
        0.008,
        "time after a reversal or a standstill for which the torque of a moving joint is still ignored; longer for "
        "joints whose friction takes longer to reach its sliding value",
        unit="s",
        bounds="from 0 to 10",
    )
    tare_window: list[float] = key(
        [],
        "past window whose mean wrench is subtracted while the input tare is above 0.5: how long ago it ended and "
        "began; empty: the mean since tare rose is subtracted afterwards, and the wrench is zero meanwhile",
        unit="s",
    )
    tare_change: float = key(
        0.5, "change of a force from the mean of tare_window above which taring pauses", unit="N", bounds="positive"
    )
    between: list[str] = key(
        [],
        "names of two arms that touch each other: the signal wrench_between is the wrench of the first on the second, "
        "at its TCP; empty: there is none",
    )
    between_force_walk: float | None = key(
        None, "force_walk of the filter of `between`; null: that of the arms", unit="N", bounds="positive"
    )
    between_outlier: float = key(
        0.0,
        "residual of a joint's balance / its standard deviation, above which the filter of `between` raises the latter "
        "in proportion: strikes and swings of a few ticks count less, sudden forces are found later; 0: none",
        bounds="from 0 to 100",
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.between and (len(self.between) != 2 or len(set(self.between)) != 2):
            raise invalid("between", self.between, "two different arms, or empty")

    def _bandwidth(self, period: float) -> float:
        """Steady-state bandwidth of the filter for a force with a lever arm of 0.36 m over the moving joints."""
        return _LEVER * self.force_walk / (self.noise * math.sqrt(period))

    def _wrench(self, model: PlantModel, momentum: MomentumModel, arm: ArmParts, axes: Frame | None) -> Any:
        friction = model.friction.scaled(self.friction_scale)
        return WrenchFilter(momentum, friction, arm.tcp_frame, axes, joints=arm.joints, **self._options(model))

    def _between(self, model: PlantModel, momentum: MomentumModel) -> WrenchBetweenFilter | None:
        if not self.between:
            return None
        robot = model.known_robot()
        for name in self.between:
            if name not in robot.parts.arms:
                raise unknown("between", name, list(robot.parts.arms))
        first, second = (robot.parts.arms[name] for name in self.between)
        axes, friction = self._axes(robot, second.tcp_frame), model.friction.scaled(self.friction_scale)
        own = {"outlier": self.between_outlier, "force_walk": self.between_force_walk or self.force_walk}
        return WrenchBetweenFilter(momentum, friction, (first, second), axes, **(self._options(model) | own))

    def _options(self, model: PlantModel) -> dict[str, Any]:
        names = ("moment", "noise", "jerk_noise", "force_walk", "moment_walk", "bias", "bias_walk", "slow", "hold")
        return {
            **{name: getattr(self, name) for name in (*names, "tare_window", "tare_change")},
            "velocity_bandwidth": _speed_bandwidth(model),
            "period": model.period,
        }


def _speed_bandwidth(model: PlantModel) -> float | None:
    """Of the filter of the measured speeds [rad/s]; None where they are not filtered."""
    return model.velocity_bandwidth if np.isfinite(model.velocity_bandwidth) else None
