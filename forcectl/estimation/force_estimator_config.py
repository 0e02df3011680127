"""Scenario parts `!ForceEstimator` and `!KalmanForceEstimator`."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from pydrake.multibody.tree import Frame
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import TrajectorySource
from pydrake.trajectories import PiecewisePolynomial

from forcectl.errors import invalid, unknown
from forcectl.estimation.force_estimator import ForceEstimator
from forcectl.estimation.momentum_observer import MomentumObserver
from forcectl.estimation.wrench import WrenchEstimator
from forcectl.estimation.wrench_between_filter import WrenchBetweenFilter
from forcectl.estimation.wrench_filter import WrenchFilter
from forcectl.framework.fields import Config, key
from forcectl.framework.linear_batch import state_space
from forcectl.plant.plant_model import PlantModel
from forcectl.robot.model import RobotModel
from forcectl.robot.momentum_model import MomentumModel
from forcectl.robot.parts import ArmParts

if TYPE_CHECKING:
    from scipy.signal import StateSpace

_TICK = 0.004  # [s] of a joint interface
_LEVER = 0.36  # [m] lever arm of a force, over all joints of an arm; YuMi's are 0.23 to 0.44
_JUMP = 4.0  # speed change / acceleration limit above which a reading counts as wrong
_STOP = 2.0  # deceleration / acceleration limit above which a repeated position is a frozen encoder and no stop
_FROZEN = 0.1  # [rad/s] speed above which it is one, where there is no acceleration limit


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
    elastic_joints: bool = key(
        False,
        "whether the observer computes how the links swing on their elastic joints, from the speeds of the motors; "
        "without effect where the joints of the plant are rigid",
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
            joint_stiffness=model.joint_stiffness if self.elastic_joints and model.joint_stiffness.size else None,
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
    short_lever: float = key(
        0.0,
        "lever arm of a force over all joints of an arm, the root of the sum of their squares, below which force_walk "
        "is smaller in the direction of the force, by the cube of the ratio; twice as much for the filter of "
        "`between`; near a singularity false forces are smaller, and forces are found later; 0: none",
        unit="m",
        bounds="from 0 to 10",
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
        own["short_lever"] = 2.0 * self.short_lever  # both arms measure the force
        return WrenchBetweenFilter(momentum, friction, (first, second), axes, **(self._options(model) | own))

    def _options(self, model: PlantModel) -> dict[str, Any]:
        names = ("moment", "noise", "jerk_noise", "force_walk", "moment_walk", "bias", "bias_walk", "slow", "hold")
        return {
            **{name: getattr(self, name) for name in (*names, "short_lever", "tare_window", "tare_change")},
            "velocity_bandwidth": _speed_bandwidth(model),
            "period": model.period,
        }


def _speed_bandwidth(model: PlantModel) -> float | None:
    """Of the filter of the measured speeds [rad/s]; None where they are not filtered."""
    return model.velocity_bandwidth if np.isfinite(model.velocity_bandwidth) else None
