"""The wrench between two arms that touch each other, estimated from the joints of both.

    d = J_a'(m_a, -f) + J_b'(m_b, f) + b + diag(sign q') c + e

Arm a pushes arm b with f, and b pushes back with -f. One filter for the joints of both, see `MovingJoints`, estimates
this one force. While all joints of one arm may be in static friction, the joints of the other arm update it. With one
filter per arm, that of the arm at rest would hold its last estimate, and a mean of both would lag.

The contact point is not known, so the torques at the two TCPs, m_a and m_b, are separate unknowns.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from pydrake.multibody.tree import Frame
from pydrake.systems.framework import Context

from forcectl.arrays import Array
from forcectl.estimation.wrench_filter import MovingJointsFilter
from forcectl.plant.drives.joint_friction import JointFriction
from forcectl.robot.momentum_model import MomentumModel
from forcectl.robot.parts import ArmParts


class WrenchBetweenFilter(MovingJointsFilter):
    """Kalman filter of the wrench of arm a on arm b.

    ```
    name: WrenchBetweenFilter
    input_ports: [torque_balance, joint_position, joint_velocity, balance_ok, tare]
    output_ports: [wrench]
    ```

    torque_balance: shape (n,), from a `MomentumObserver` [Nm]. joint_position, joint_velocity: shape (n,) [rad, rad/s].
    balance_ok: shape (n,), 1 for a joint whose balance was updated in this tick, else 0 [1].
    tare: shape (1,) [1], may be left unconnected; see `Taring`, in the axes of the TCP of b.
    wrench: shape (6,), of arm a on arm b at the TCP of b, [torque; force] in `expressed_in` [Nm, N]. The torque is
    m_b, from the joints of b alone. Feedthrough of all inputs at the tick, and held.

    It is the wrench between the arms as long as neither touches anything else. Numbers that are not finite hold the
    estimate of the last tick.

    Sampling: every `period` [s]; no delay, see `SampledBlock`.

    Args:
        model: the n joints.
        friction: assumed friction of the n joints.
        between: arms a and b.
        expressed_in: any frame of the same plant; world when None.
        moment: False if only forces act at the TCPs: then the torque is zero and the force has less noise.
        force_walk: random walk of a force, as the standard deviation of its change in 1 s [N], > 0.
        moment_walk: the same of a torque [Nm], > 0.
        tare_window: end and begin of the window of `Taring`, as times before now [s]; empty: none.
        tare_change: change of a force from the tare value, above which taring pauses [N], > 0.
        short_lever: lever arm of a force over the joints of both arms below which `force_walk` is smaller in its
            direction, by the cube of the ratio; 0: nowhere [m], >= 0.
        period: tick [s].
        **joint_options: `noise`, `jerk_noise`, `outlier`, `bias`, `bias_walk`, `slow`, `hold` and
            `velocity_bandwidth` of `MovingJoints`.

    Raises:
        BadInputError: a value out of range, friction of another number of joints, a frame of another plant.
    """

    port_components = {"wrench": "6"}

    def __init__(
        self,
        model: MomentumModel,
        friction: JointFriction,
        between: tuple[ArmParts, ArmParts],
        expressed_in: Frame | None = None,
        *,
        moment: bool = True,
        force_walk: float = 1.25,
        moment_walk: float = 0.04,
        tare_window: Sequence[float] = (),
        tare_change: float = 0.5,
        short_lever: float = 0.0,
        period: float = 0.004,
        **joint_options: float,
    ):
        self._arms = between
        joints = np.concatenate([np.arange(arm.joints.start, arm.joints.stop) for arm in between])
        walks, tare = (6 if moment else 0, moment_walk, force_walk), (tare_window, tare_change)
        tip = between[1].tcp_frame
        super().__init__(model, friction, joints, tip, expressed_in, walks, tare, short_lever, period, joint_options)
        self.show("wrench")

    def _rows(self, plant: Context, q: Array) -> Array:
        torques = self._torques
        rows = np.zeros((len(self._joints), torques + 3))
        begin = 0
        for arm, sign, place in zip(self._arms, (-1.0, 1.0), (slice(0, 3), slice(3, 6)), strict=True):
            jacobian = self._model.jacobian(plant, q, arm.tcp_frame, self._frame)[:, arm.joints].T
            own = slice(begin, begin + len(jacobian))
            if torques:
                rows[own, place] = jacobian[:, :3]
            rows[own, torques:] = sign * jacobian[:, 3:]
            begin = own.stop
        return rows

    def _wrench(self, unknowns: Array) -> Array:
        found = np.zeros(6)
        on_second = unknowns[self._torques // 2 :]  # without the torque on the first arm
        found[6 - len(on_second) :] = on_second
        return found
