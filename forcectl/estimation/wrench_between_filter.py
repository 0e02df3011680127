"""The wrench between two arms that touch each other, of the joints of both.

    d = J_a'(m_a, -f) + J_b'(m_b, f) + b + diag(sign q') c + e

Arm a pushes arm b with f, and is pushed back by as much: one filter for the joints of both, see `MovingJoints`, finds
one force. While no joint of one arm can be believed, those of the other one lead it on. Were there a filter for each,
the blind one would keep what it knew, and hold a mean of both back.

Where they touch is not known, so the torques at both hands, m_a and m_b, are unknowns of their own.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from pydrake.multibody.tree import Frame
from pydrake.systems.framework import Context

from forcectl.errors import BadInputError
from forcectl.estimation.moving_joints import MovingJoints
from forcectl.estimation.taring import Taring
from forcectl.estimation.wrench_filter import walks_of
from forcectl.framework.block import scratch
from forcectl.framework.kernels import all_finite
from forcectl.framework.sampled_block import Memory, SampledBlock
from forcectl.plant.drives.joint_friction import JointFriction, sliding_friction_torque
from forcectl.robot.momentum_model import MomentumModel
from forcectl.robot.parts import ArmParts


class WrenchBetweenFilter(SampledBlock):
    """Kalman filter of the wrench of arm a on arm b.

    ```
    name: WrenchBetweenFilter
    input_ports: [torque_balance, joint_position, joint_velocity, reading_ok, tare]
    output_ports: [wrench]
    ```

    torque_balance: shape (n,), from a `MomentumObserver` [Nm]. joint_position, joint_velocity: shape (n,) [rad, rad/s].
    reading_ok: shape (n,), 1 for a joint whose balance is of this tick, else 0 [1].
    tare: shape (1,) [1], may be left unconnected; see `Taring`, in the axes of the TCP of b.
    wrench: shape (6,), of arm a on arm b at the TCP of b, [torque; force] in `expressed_in` [Nm, N]. The torque is what
    b alone feels. Feedthrough of all inputs at the tick, and held.

    It is the wrench between the arms as long as neither touches anything else. Numbers that are not finite hold the
    estimate of the last tick.

    Sampling: every `period` [s]; no delay, see `SampledBlock`.

    Args:
        model: the n joints.
        friction: that the n joints should have.
        between: arms a and b.
        expressed_in: any frame of the same plant; world when None.
        moment: False if only forces act at the TCPs: then the torque is zero and the force has less noise.
        force_walk: deviation that a force gains in a second [N], > 0.
        moment_walk: the same of a torque [Nm], > 0.
        tare_window: how long ago it ended and began [s]; empty: none.
        tare_change: of a force from the mean of the window, with which it pauses [N], > 0.
        period: tick [s].
        **trust: `noise`, `bias`, `bias_walk`, `slow`, `hold` and `trust` of `MovingJoints`.

    Raises:
        BadInputError: a value out of range, friction of another number of joints.
    """

    optional_inputs = ("tare",)
    port_units = {
        "torque_balance": "Nm",
        "joint_position": "rad",
        "joint_velocity": "rad/s",
        "reading_ok": "1",
        "tare": "1",
        "wrench": "Nm,N",
    }
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
        period: float = 0.004,
        **trust: float,
    ):
        super().__init__()
        n = model.num_joints
        if friction.size != n:
            raise BadInputError(f"friction is of {friction.size} joints: must be of {n}, as the model")
        self._model, self._friction, self._arms = model, friction, between
        self._tip = between[1].tcp_frame
        self._expressed_in = model.plant.world_frame() if expressed_in is None else expressed_in
        self._joints = np.concatenate([np.arange(arm.joints.start, arm.joints.stop) for arm in between])
        self._moments = 6 if moment else 0
        walks = walks_of(force_walk, moment_walk, (self._moments, 3))
        self._filter = MovingJoints(friction.coulomb[self._joints], walks, period=period, **trust)
        self._taring = Taring(tare_window, tare_change, period)
        sizes = {"torque_balance": n, "joint_position": n, "joint_velocity": n, "reading_ok": n, "tare": 1}
        inputs = [self.DeclareVectorInputPort(name, size) for name, size in sizes.items()]
        self._scratch = scratch(self, "plant context", model.create_context)
        self.declare_memory({"wrench": np.zeros(6), **self._filter.start(), **self._taring.start()}, inputs, period)
        self.show("wrench")

    def step(self, context: Context, memory: Memory, inputs: Memory) -> dict[str, Any]:
        """One tick of the filter."""
        mine, moments = self._joints, self._moments
        balance, q, v = inputs["torque_balance"], inputs["joint_position"], inputs["joint_velocity"]
        level = inputs["tare"].item() if "tare" in inputs else 0.0
        tare = self._taring.known(memory, level)
        if not all_finite(balance, q, v):
            return {**memory, **tare}
        plant = self._scratch.Eval(context)
        rows = np.zeros((len(mine), moments + 3))
        begin = 0
        for arm, sign, place in zip(self._arms, (-1.0, 1.0), (slice(0, 3), slice(3, 6)), strict=True):
            jacobian = self._model.jacobian(plant, q, arm.tcp_frame, self._tip)[:, arm.joints].T
            own = slice(begin, begin + len(jacobian))
            if moments:
                rows[own, place] = jacobian[:, :3]
            rows[own, moments:] = sign * jacobian[:, 3:]
            begin = own.stop
        balance = (balance + sliding_friction_torque(v, self._friction))[mine]
        felt = self._filter.tick(memory, rows, balance, v[mine], inputs["reading_ok"][mine] > 0.5)
        found = np.zeros(6)
        found[: moments // 2] = felt.x[moments // 2 : moments]
        found[3:] = felt.x[moments : moments + 3]
        shown, tare = self._taring.step(tare, found, level)
        rotation = self._tip.CalcRotationMatrix(plant, self._expressed_in).matrix()
        return {
            "wrench": np.concatenate([rotation @ shown[:3], rotation @ shown[3:]]),
            **felt.memory,
            **tare,
        }
