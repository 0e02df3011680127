"""The wrench at a frame of the robot, felt by the joints that move.

    d = b + diag(sign q') c + J'w + e,    d = (tau_ext - tau_F) + tau_F(q')

d is the torque balance of the momentum observer over a tick, with the friction (5.2) that the joints should have at
their speeds; w the wrench at the frame in its own axes; b and c are what is wrong with model and Coulomb friction of
each joint. w, b and c are random walks, e is white: a Kalman filter finds them.

A joint that stands, or has just begun to move, may keep any friction up to Coulomb's. Its e is then larger, so
that it tells nothing, where the least squares of (5.8) take its friction for a force. A force is felt as long as enough
joints move; a motion that the tasks leave free moves nearly all of them, see `SelfMotion`.

What acts elsewhere, on the elbow say, also moves joints along N, J N = 0, which no wrench at the frame does: N'(d - b)
tells the two apart, as far as the force has a part along that motion.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydrake.multibody.tree import Frame
from pydrake.systems.framework import BasicVector, Context
from scipy.linalg.lapack import dposv

from forcectl.errors import BadInputError, invalid
from forcectl.framework.batch import check
from forcectl.framework.block import scratch
from forcectl.framework.kernels import all_finite, left_free
from forcectl.framework.sampled_block import Memory, SampledBlock
from forcectl.plant.drives.joint_friction import JointFriction, sliding_friction_torque
from forcectl.robot.momentum_model import MomentumModel

Array = NDArray[np.float64]

_DOUBT = 0.05  # below which a joint is believed
_NEEDED = 0.1  # share of a motion that leaves the frame where it is, from which on the joint is needed
_SETTLED = 1.0  # [s] in which b and c are learnt that this torque is beyond
_BRIEF = 0.008  # [s] until a joint is believed again that was slow and goes on in the same direction
_STANDSTILL = 0.06  # [s] after which it has to prove itself as after a reversal
_LAG = 0.02  # [s] of the torque of what acts elsewhere
_PART = 0.1  # [s] of a mean in the window of taring
_UNKNOWN = 8.0  # deviation of the friction of a joint that may stick, in units of Coulomb's


class Tare(NamedTuple):
    """What is subtracted from the wrench, and what it is made of.

    Attributes:
        zero: that, shape (6,) [Nm, N].
        tared: ticks of the mean.
        mean: of the ticks since taring began, with a window of the last 0.1 s, shape (6,) [Nm, N].
        past: means over 0.1 s, the latest first, NaN where there are none yet, shape (6p,) [Nm, N].
    """

    zero: Array
    tared: float
    mean: Array
    past: Array


class WrenchFilter(SampledBlock):
    """Kalman filter of the wrench of the environment on the robot.

    ```
    name: WrenchFilter
    input_ports: [torque_balance, joint_position, joint_velocity, reading_ok, tare]
    output_ports: [wrench, wrench_deviation, joint_bias, moving, torque_elsewhere, wrench_covariance]
    ```

    torque_balance: shape (n,), from a `MomentumObserver` [Nm]. joint_position, joint_velocity: shape (n,) [rad, rad/s].
    reading_ok: shape (n,), 1 for a joint whose balance is of this tick, else 0 [1].
    tare: shape (1,) [1], may be left unconnected. Above 0.5 the wrench is zero, and what is subtracted from then on is
    the mean of the ticks since it rose, in the axes of the frame; below -0.5 that is forgotten. With a `tare_window`
    the wrench goes on above 0.5, and what is subtracted is the mean of that window of the past, as long as it has been
    above; the first ticks, up to the window, are zero. Once the window is full this pauses, with the window, while a
    force differs from its mean by more than `tare_change`: a contact that begins slowly is not subtracted.
    wrench: shape (6,), of the environment on the robot at the origin of `frame`, [torque; force] in `expressed_in`
    [Nm, N].
    wrench_deviation: shape (6,), standard deviations of the wrench in the axes of the frame, as this filter sees it:
    they grow while no joint that moves feels a direction [Nm, N].
    joint_bias: shape (k,), b of the k joints of `joints` [Nm]. moving: shape (k,), 1 for those that are believed [1].
    torque_elsewhere: shape (1,), size of the torque along motions that leave the frame where it is, which no wrench
    at the frame has, beyond what b and c have explained for a second; behind a lag of 20 ms, and held while joints that
    it needs are not believed [Nm].
    wrench_covariance: shape (36,), of the wrench in the axes of the frame, row by row, as this filter sees it: its
    diagonal is the square of wrench_deviation; without a moment the rows of the torque are zero; products of [Nm, N].
    All outputs are feedthrough of all inputs at the tick, and held.

    Numbers that are not finite hold the estimate of the last tick.

    Sampling: every `period` [s]; no delay, see `SampledBlock`.

    Args:
        model: the n joints.
        friction: that the n joints should have.
        frame: where the wrench acts.
        expressed_in: any frame of the same plant; world when None.
        joints: of the n, those that move the frame; all by default.
        moment: False if only a force acts at the frame: then the torque is zero and the force has less noise.
        noise: deviation of the balance of a tick [Nm], > 0; of joints with less than 0.7 Nm of Coulomb's friction it is
            taken to be smaller, (0.3 Nm + tau_C)/1 Nm of it.
        force_walk: deviation that a force gains in a second [N], > 0.
        moment_walk: the same of a torque [Nm], > 0.
        bias: deviation of c at the start, in units of Coulomb's friction; that of b is 0.6 of it [1], > 0.
        bias_walk: what that of b gains in a second, in these units; that of c gains a quarter [1], > 0.
        slow: speed below which a joint may stick [rad/s], > 0.
        hold: time for which a joint that has turned round, or stood for 60 ms, still may [s], >= 0.
        trust: time constant with which it is believed then [s], > 0. One that was slow for less and goes on as before
            is believed after 8 ms.
        tare_window: how long ago it ended and began [s]; empty: none.
        tare_change: of a force from the mean of the window, with which it pauses [N], > 0.
        period: tick [s].

    Raises:
        BadInputError: a value out of range, friction of another number of joints, a frame of another plant.
    """

    optional_inputs = ("tare",)

    def __init__(
        self,
        model: MomentumModel,
        friction: JointFriction,
        frame: Frame,
        expressed_in: Frame | None = None,
        *,
        joints: slice = slice(None),
        moment: bool = True,
        noise: float = 0.25,
        force_walk: float = 1.25,
        moment_walk: float = 0.04,
        bias: float = 0.05,
        bias_walk: float = 0.008,
        slow: float = 0.004,
        hold: float = 0.04,
        trust: float = 0.012,
        tare_window: Sequence[float] = (),
        tare_change: float = 0.5,
        period: float = 0.004,
    ):
        super().__init__()
        n = model.num_joints
        if friction.size != n:
            raise BadInputError(f"friction is of {friction.size} joints: must be of {n}, as the model")
        for given in (frame, expressed_in):
            if given is not None and not model.owns(given):
                raise BadInputError(f"frame {given.name()!r}: must be of the plant of the momentum model")
        self._model, self._frame, self._joints = model, frame, joints
        self._expressed_in = model.plant.world_frame() if expressed_in is None else expressed_in
        self._friction, self._coulomb = friction, friction.coulomb[joints]
        self._slow, self._wait = check("slow", slow, "positive"), check("hold", hold, "not negative")
        self._trust, Ts = check("trust", trust, "positive"), check("period", period, "positive")
        self._window = _window(tare_window)
        self._change = check("tare_change", tare_change, "positive")
        self._again = self._wait + 5.0 * self._trust - _BRIEF
        self._k, self._first = len(self._coulomb), 0 if moment else 3
        share = np.minimum(1.0, 0.3 + self._coulomb)
        self._noise = (check("noise", noise, "positive") * share) ** 2
        self._unknown = (_UNKNOWN * self._coulomb) ** 2
        self._fresh = (check("bias", bias, "positive") * self._coulomb) ** 2
        walks = [check("moment_walk", moment_walk, "positive")] * 3 + [check("force_walk", force_walk, "positive")] * 3
        slowly = check("bias_walk", bias_walk, "positive") * self._coulomb
        walk = np.concatenate([walks[self._first :], slowly, 0.25 * slowly])
        self._walk = Ts * walk**2
        self._size = m = len(walk)
        wrench = 6 - self._first
        self._pick = np.eye(self._k)[:, wrench:]
        # d per wrench, b and c; of the wrench and c to be filled in.
        self._features = np.hstack([np.zeros((self._k, wrench)), np.eye(self._k), np.zeros((self._k, self._k))])
        self.port_units = {
            "torque_balance": "Nm",
            "joint_position": "rad",
            "joint_velocity": "rad/s",
            "reading_ok": "1",
            "tare": "1",
            "wrench": "Nm,N",
            "wrench_deviation": "Nm,N",
            "joint_bias": "Nm",
            "moving": "1",
            "torque_elsewhere": "Nm",
            "wrench_covariance": "",
        }
        sizes = {"torque_balance": n, "joint_position": n, "joint_velocity": n, "reading_ok": n, "tare": 1}
        inputs = [self.DeclareVectorInputPort(name, size) for name, size in sizes.items()]
        self._scratch = scratch(self, "plant context", model.create_context)
        start = np.concatenate([np.zeros(m - 2 * self._k), 0.36 * self._fresh, self._fresh])
        memory = {
            "wrench": np.zeros(6),
            "wrench_deviation": np.zeros(6),
            "joint_bias": np.zeros(self._k),
            "moving": np.zeros(self._k),
            "torque_elsewhere": 0.0,
            "state": np.zeros(m),
            "covariance": np.diag(start).ravel(),
            # Of each joint the direction it last moved in, for how long that has been known and it has been slow.
            "direction": np.zeros(self._k),
            "since": np.zeros(self._k),
            "stood": np.zeros(self._k),
            # b and c behind a lag, for they take up what acts elsewhere; and its torque.
            "settled": np.zeros(2 * self._k),
            "elsewhere": np.zeros(self._k),
            **Tare(np.zeros(6), 0.0, np.zeros(6), np.full(6 * self._window[1], np.nan))._asdict(),
        }
        self.declare_memory(memory, inputs, Ts)
        self.show("wrench", "wrench_deviation", "joint_bias", "moving", "torque_elsewhere")
        self.DeclareVectorOutputPort(
            "wrench_covariance",
            36,
            self._put_covariance,
            prerequisites_of_calc=self._reads,
        )

    def step(self, context: Context, memory: Memory, inputs: Memory) -> dict[str, Any]:
        """One tick of the filter."""
        mine, k = self._joints, self._k
        balance, q, v = inputs["torque_balance"], inputs["joint_position"], inputs["joint_velocity"]
        level = inputs["tare"].item() if "tare" in inputs else 0.0
        tare = Tare(memory["zero"], memory["tared"], memory["mean"], memory["past"])
        if level < -0.5:
            tare = Tare(np.zeros(6), 0.0, np.zeros(6), np.full_like(tare.past, np.nan))
        if not all_finite(balance, q, v):
            return {**memory, **tare._asdict()}
        speed = v[mine]
        slow, direction = np.abs(speed) < self._slow, memory["direction"]
        turned = ~slow & (np.sign(speed) != direction)
        direction = np.where(slow, direction, np.sign(speed))
        since = np.where(turned, 0.0, memory["since"] + self._period)
        stood = np.where(slow, memory["stood"] + self._period, 0.0)
        since = np.where(slow, np.where(stood > _STANDSTILL, 0.0, np.minimum(since, self._again)), since)
        doubt = np.where(slow | (since < self._wait), 1.0, np.exp((self._wait - since) / self._trust))
        doubt = np.where(inputs["reading_ok"][mine] > 0.5, doubt, 1.0)

        plant = self._scratch.Eval(context)
        jacobian = self._model.jacobian(plant, q, self._frame, self._frame)[self._first :, mine]
        m = self._size - 2 * k
        x, P = memory["state"], memory["covariance"].reshape(self._size, self._size).copy()
        P.flat[:: self._size + 1] += self._walk
        # Corrected.
        H = self._features.copy()
        H[:, :m] = jacobian.T
        H.flat[m + k :: self._size + 1] = np.sign(speed)
        gained = H @ P
        S = gained @ H.T
        S.flat[:: k + 1] += self._noise + doubt**2 * self._unknown
        _, solved, failed = dposv(S, gained)
        felt = balance[mine] + sliding_friction_torque(v, self._friction)[mine]
        if not failed:
            x = x + solved.T @ (felt - H @ x)
            P = P - solved.T @ gained
            P = 0.5 * (P + P.T)

        settled = memory["settled"] + self._period / (self._period + _SETTLED) * (x[m:] - memory["settled"])
        free, elsewhere = left_free(jacobian, self._pick) if self._pick.size else None, memory["elsewhere"]
        if free is not None and not ((np.abs(free) > _NEEDED).any(axis=1) & (doubt > _DOUBT)).any():
            left = free @ (free.T @ (felt - H[:, m:] @ settled))
            elsewhere = elsewhere + self._period / (self._period + _LAG) * (left - elsewhere)

        found, deviation = np.zeros(6), np.zeros(6)
        found[self._first :] = x[:m]
        deviation[self._first :] = np.sqrt(np.maximum(np.diag(P)[:m], 0.0))
        shown, tare = self._tare(tare, found, level)
        rotation = self._frame.CalcRotationMatrix(plant, self._expressed_in).matrix()
        return {
            "wrench": np.concatenate([rotation @ shown[:3], rotation @ shown[3:]]),
            "wrench_deviation": deviation,
            "joint_bias": x[m : m + k],
            "moving": (doubt < _DOUBT).astype(float),
            "torque_elsewhere": math.sqrt(elsewhere @ elsewhere),
            "state": x,
            "covariance": P.ravel(),
            "direction": direction,
            "since": since,
            "stood": stood,
            "settled": settled,
            "elsewhere": elsewhere,
            **tare._asdict(),
        }

    def _put_covariance(self, context: Context, output: BasicVector) -> None:
        found = np.zeros((6, 6))
        every = self.memory(context)["covariance"].reshape(self._size, self._size)
        found[self._first :, self._first :] = every[: 6 - self._first, : 6 - self._first]
        output.SetFromVector(found.ravel())

    def _tare(self, tare: Tare, found: Array, level: float) -> tuple[Array, Tare]:
        """The wrench after taring, shape (6,) [Nm, N], and what is known for the next tick."""
        if not level > 0.5:
            return found - tare.zero, tare._replace(tared=0.0)
        if not self._window[1]:
            mean = (tare.mean * tare.tared + found) / (tare.tared + 1.0)
            return np.zeros(6), tare._replace(zero=mean, mean=mean, tared=tare.tared + 1.0)
        past = tare.past.reshape(-1, 6)
        full = np.isfinite(past[-1, 0])
        if full and np.abs(found - tare.zero)[3:].max() > self._change:
            return found - tare.zero, tare
        count = tare.tared + 1.0
        mean = tare.mean + (found - tare.mean) / count
        if count * self._period > _PART - 0.5 * self._period:
            past, count = np.concatenate([mean[None], past[:-1]]), 0.0
        known = past[self._window[0] :]
        known = known[np.isfinite(known[:, 0])]
        zero = known.mean(axis=0) if len(known) else tare.zero
        shown = found - zero if len(known) else np.zeros(6)
        return shown, Tare(zero, count, mean, past.ravel())


def _window(ago: Sequence[float]) -> tuple[int, int]:
    """The first and the number of the means over 0.1 s, of a window of the past [s]."""
    if len(ago) == 0:
        return 0, 0
    if len(ago) != 2 or not 0.0 <= ago[0] <= ago[1] - _PART:
        raise invalid("tare_window", list(ago), f"two times, the second {_PART:g} s later at least")
    first, last = (round(time / _PART) for time in ago)
    return first, last
