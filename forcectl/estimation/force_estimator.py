"""The estimator slot filled by the momentum observer and a wrench estimate per arm (5.6)*, (5.8)."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from pydrake.multibody.tree import Frame
from pydrake.systems.framework import Diagram, DiagramBuilder
from pydrake.systems.primitives import Multiplexer, TrajectorySource
from pydrake.trajectories import PiecewisePolynomial
from scipy.signal import StateSpace

from forcectl.errors import unknown
from forcectl.estimation.momentum_observer import MomentumObserver
from forcectl.estimation.wrench import WrenchEstimator
from forcectl.framework.fields import Config, key
from forcectl.framework.wiring import export_outputs
from forcectl.plant.plant_model import PlantModel
from forcectl.robot.model import RobotModel

READINGS = ("joint_position", "joint_velocity", "motor_torque")
_JUMP = 4.0  # a speed that changes so many times faster than joints may accelerate was not read right
_STOP = 2.0  # nor one that comes to rest so many times faster, at once and to the last bit
_FROZEN = 0.1  # [rad/s] from which it may where there is no limit of the acceleration


class ForceEstimator(Diagram):
    """External joint torques and the wrench at each TCP.

    ```
    name: ForceEstimator
    input_ports: [joint_position, joint_velocity, motor_torque]
    output_ports: [estimated_torque, estimated_wrench (optional), estimated_local_wrench (optional), residual,
    reading_ok, near_singular]
    ```

    joint_position, joint_velocity, motor_torque: shape (n,), readings of the tick [rad, rad/s, Nm].
    estimated_torque: shape (n,), external joint torques beyond the threshold of the friction [Nm].
    estimated_wrench: shape (6a,), of the environment on the robot at each TCP in the world, [torque; force] [Nm, N].
    estimated_local_wrench: shape (6a,), the same in the axes of other frames [Nm, N]; the port exists instead when
    `local`.
    residual: shape (n,), r [Nm]. reading_ok: shape (n,) [1]. near_singular: shape (a,), 1 where a direction is damped
    [1]. All outputs are feedthrough of all inputs at the tick.

    Sampling: every `period` [s]; no delay. Speeds that are filtered make the estimate as late as they are.

    Args:
        observer: of the n joints.
        wrenches: by arm, all of the same n joints.
        tare: their input of that name, or None.
        local: whether they are expressed in other frames than the world.
    """

    def __init__(
        self,
        observer: MomentumObserver,
        wrenches: Mapping[str, WrenchEstimator],
        tare: TrajectorySource | None = None,
        *,
        local: bool = False,
    ):
        super().__init__()
        name_of_wrench = "estimated_local_wrench" if local else "estimated_wrench"
        self.port_units = {"estimated_torque": "Nm", name_of_wrench: "Nm,N", "near_singular": "1"}
        builder = DiagramBuilder()
        add, connect, export = builder.AddNamedSystem, builder.Connect, builder.ExportInput
        add("observer", observer)
        if tare is not None:
            add("tare", tare)
        for name in READINGS:
            export(observer.GetInputPort(name), name)
        both = add("wrenches", Multiplexer([6] * len(wrenches)))
        flags = add("near_singular", Multiplexer([1] * len(wrenches)))
        for i, (arm, wrench) in enumerate(wrenches.items()):
            add(f"wrench_{arm}", wrench)
            connect(observer.GetOutputPort("external_torque"), wrench.GetInputPort("external_torque"))
            builder.ConnectInput("joint_position", wrench.GetInputPort("joint_position"))
            if tare is not None:
                connect(tare.get_output_port(), wrench.GetInputPort("tare"))
            connect(wrench.GetOutputPort("wrench"), both.get_input_port(i))
            connect(wrench.GetOutputPort("near_singular"), flags.get_input_port(i))
        outputs = {
            "estimated_torque": observer.GetOutputPort("external_torque"),
            name_of_wrench: both.get_output_port(),
            "residual": observer.GetOutputPort("residual"),
            "reading_ok": observer.GetOutputPort("reading_ok"),
            "near_singular": flags.get_output_port(),
        }
        export_outputs(builder, outputs)
        builder.BuildInto(self)


@dataclass(kw_only=True)
class ForceEstimatorConfig(Config):
    """Scenario part `!ForceEstimator`: momentum observer and wrench estimates.

    It uses the exact dynamics, and `friction_scale` times the friction that the joints have. The threshold (5.3)* is
    given in shares of Coulomb's friction of each joint.
    """

    gain: float = key(25.0, "gain K_R of the momentum observer", unit="1/s", bounds="positive")
    friction_scale: float = key(1.0, "believed friction / true friction", bounds="not negative")
    threshold_move: float = key(0.0, "tau_move / tau_C of moving joints", bounds="not negative")
    threshold_still: float = key(0.0, "tau_still / tau_C of joints at rest", bounds="not negative")
    limit_share: float = key(1.0, "share of the torque limits at which the residual stops", bounds="positive")
    moment: bool = key(True, "false: only forces act at the TCPs")
    expressed_in: str = key(
        "world",
        "axes of the wrenches, which act at the TCPs: world; else they are estimated_local_wrench, in tcp (each in its "
        "own) or in any frame or body of the robot's model",
    )
    smallest_singular_value: float = key(0.02, "below which a direction is damped", unit="1", bounds="positive")
    tare_start: float = key(0.0, "start of the ticks whose mean becomes zero", unit="s", bounds="not negative")
    tare_duration: float = key(0.0, "of these ticks; 0: no taring", unit="s", bounds="not negative")

    def force_lag(self) -> tuple[float, float, float]:
        """Lag of the estimated forces as that of a sensor: bandwidth [rad/s], damping ratio [1] and delay [s].

        The observer lags by 1/K_R; this is the critically damped filter of second order with the same lag.
        """
        return 2 * self.gain, 1.0, 0.0

    def force_response(self, model: PlantModel) -> StateSpace:
        """From a force to its estimate, per tick: mean over the tick, filter of the speeds, observer; no thresholds."""
        period = model.period
        kept, decay = math.exp(-model.velocity_bandwidth * period), math.exp(-self.gain * period)
        # y = kept y_last + (1 - kept)/2 (u + u_last), and r = decay r_last + (1 - decay) y
        half, gain = 0.5 * (1 - kept), 1 - decay
        late = StateSpace([[kept]], [[1.0]], [[half * (1 + kept)]], [[half]], dt=period)
        observed = StateSpace([[decay]], [[1.0]], [[gain * decay]], [[gain]], dt=period)
        mean = StateSpace([[0.0]], [[1.0]], [[0.5]], [[0.5]], dt=period)
        return observed * late * mean

    def add_to(self, builder: DiagramBuilder, model: PlantModel) -> ForceEstimator:
        """Add the estimator."""
        robot, coulomb = model.known_robot(), model.friction.coulomb
        momentum = model.momentum_model()
        # A joint that sticks stands still from one tick to the next, but only from a speed that it can stop from.
        fastest_stop = _STOP * robot.limits.acceleration * model.period
        observer = MomentumObserver(
            momentum,
            model.friction.scaled(self.friction_scale),
            gain=self.gain,
            move=self.threshold_move * coulomb,
            still=self.threshold_still * coulomb,
            limit=self.limit_share * robot.limits.torque,
            period=model.period,
            velocity_bandwidth=model.velocity_bandwidth,
            frozen_speed=np.where(np.isfinite(fastest_stop), fastest_stop, _FROZEN),
            largest_acceleration=_JUMP * robot.limits.acceleration,
        )
        wrenches = {
            name: WrenchEstimator(
                momentum,
                arm.tcp_frame,
                self._axes(robot, arm.tcp_frame),
                joints=arm.joints,
                moment=self.moment,
                smallest=self.smallest_singular_value,
                length=robot.parameters.characteristic_length,
                period=model.period,
            )
            for name, arm in robot.parts.arms.items()
        }
        tare = None
        if self.tare_duration > 0:
            start, end = self.tare_start, self.tare_start + self.tare_duration
            breaks, values = ([0.0], [0.0]) if start > 0 else ([], [])
            held = PiecewisePolynomial.ZeroOrderHold([*breaks, start, end, end + 1.0], [[*values, 1.0, 0.0, 0.0]])
            tare = TrajectorySource(held)
        made = ForceEstimator(observer, wrenches, tare, local=self.expressed_in != "world")
        return builder.AddNamedSystem("estimator", made)

    def _axes(self, robot: RobotModel, tcp: Frame) -> Frame | None:
        """The frame that wrenches at a TCP are expressed in; None for the world."""
        instance = robot.parts.instance
        if self.expressed_in in ("world", "tcp"):
            return tcp if self.expressed_in == "tcp" else None
        if not robot.plant.HasFrameNamed(self.expressed_in, instance):
            bodies = [robot.plant.get_body(index).name() for index in robot.plant.GetBodyIndices(instance)]
            raise unknown("expressed_in", self.expressed_in, ["world", "tcp", *sorted(bodies)])
        return robot.plant.GetFrameByName(self.expressed_in, instance)
