"""The wrench at a frame of the robot, estimated from the torques of the joints that move.

`MovingJoints` estimates the wrench w at the frame, in the axes of the frame, with A = J'. A force is observable as long
as enough joints move. `JointDither` moves all of them, `SelfMotion` nearly all.

A wrench at the frame has no torque along the null space N, J N = 0. A force elsewhere, for example on the elbow, has
one if it does work in that motion: N'(d - b) distinguishes the two.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from pydrake.multibody.tree import Frame
from pydrake.systems.framework import Context

from forcectl.arrays import Array
from forcectl.errors import BadInputError
from forcectl.estimation.moving_joints import MovingJoints, MovingJointsEstimate
from forcectl.estimation.taring import Taring
from forcectl.framework.batch import check
from forcectl.framework.block import scratch
from forcectl.framework.kernels import all_finite, left_free
from forcectl.framework.sampled_block import Memory, SampledBlock
from forcectl.plant.drives.joint_friction import JointFriction, viscous_friction_torque
from forcectl.robot.momentum_model import MomentumModel

_USED = 0.05  # ignored share below which the balance of a joint counts as used
_NEEDED = 0.1  # component of a unit null-space motion above which its joint must be used
_SETTLED = 1.0  # [s] time constant of the filtered b and c that `torque_elsewhere` is measured from
_LAG = 0.02  # [s] time constant of `torque_elsewhere`


class MovingJointsFilter(SampledBlock):
    """Base of the filters that estimate a wrench at a frame from the joints that move.

    A subclass maps the unknowns, torques before one force, to joint torques in `_rows` and to the wrench in `_wrench`,
    and may keep further state in `_further`. It has the input ports [torque_balance, joint_position, joint_velocity,
    balance_ok, tare] and the output `wrench` of `WrenchFilter`.

    Args:
        model: the n joints.
        friction: assumed friction of the n joints.
        joints: of the n, those that the wrench acts on.
        frame: where the wrench acts.
        expressed_in: any frame of the same plant; world when None.
        walks: number of unknown torque components; random walks of a torque and of a force, as the standard deviation
            of their change in 1 s [1, Nm, N].
        tare: window and change of `Taring`.
        short_lever: lever arm of a force over the joints, the root of the sum of their squares, below which the random
            walk of the force is smaller by the cube of the ratio [m], >= 0.
        period: tick [s].
        joint_options: keyword arguments of `MovingJoints`.
        further: further state by name.

    Raises:
        BadInputError: a value out of range, friction of another number of joints, a frame of another plant.
    """

    optional_inputs = ("tare",)
    port_units = {
        "torque_balance": "Nm",
        "balance_ok": "1",
    }

    def __init__(
        self,
        model: MomentumModel,
        friction: JointFriction,
        joints: Any,
        frame: Frame,
        expressed_in: Frame | None,
        walks: tuple[int, float, float],
        tare: tuple[Sequence[float], float],
        short_lever: float,
        period: float,
        joint_options: Mapping[str, float],
        further: Mapping[str, Any] | None = None,
    ):
        super().__init__()
        n = model.num_joints
        if friction.size != n:
            raise BadInputError(f"friction has {friction.size} joints: must have {n}, as the model")
        for given in (frame, expressed_in):
            if given is not None and not model.owns(given):
                raise BadInputError(f"frame {given.name()!r}: must be of the plant of the momentum model")
        self._model, self._friction, self._joints, self._frame = model, friction, joints, frame
        self._expressed_in = model.plant.world_frame() if expressed_in is None else expressed_in
        torques, moment_walk, force_walk = walks
        gained = np.repeat(
            [check("moment_walk", moment_walk, "positive"), check("force_walk", force_walk, "positive")], [torques, 3]
        )
        self._torques = torques
        self._short = check("short_lever", short_lever, "not negative") ** 2
        self._grows = period * force_walk**2  # variance by which a force grows in a tick
        self._filter = MovingJoints(friction.coulomb[joints], gained, period=period, **joint_options)
        self._taring = Taring(*tare, period)
        sizes = {"torque_balance": n, "joint_position": n, "joint_velocity": n, "balance_ok": n, "tare": 1}
        inputs = [self.DeclareVectorInputPort(name, size) for name, size in sizes.items()]
        self._scratch = scratch(self, "plant context", model.create_context)
        own = {"wrench": np.zeros(6), **(further or {})}
        self.declare_memory({**own, **self._filter.start(), **self._taring.start()}, inputs, period)

    @abstractmethod
    def _rows(self, plant: Context, q: Array) -> Array:
        """Torque of each joint per unit of each unknown, shape (k, w), at the joint positions q."""

    @abstractmethod
    def _wrench(self, unknowns: Array) -> Array:
        """The wrench of w torques and forces, shape (6,), in the axes of the frame [Nm, N]."""

    def _further(self, memory: Memory, rows: Array, estimate: MovingJointsEstimate) -> dict[str, Any]:
        """Further state after the tick."""
        return {}

    def _less(self, rows: Array) -> Array | None:
        """By how much the force's covariance grows less in directions with a short lever, see `MovingJoints.tick`."""
        forces = rows[:, self._torques :]
        squares, axes = np.linalg.eigh(forces.T @ forces)
        if squares[0] >= self._short:
            return None
        less = np.zeros((self._torques + 3, self._torques + 3))
        missing = 1.0 - np.minimum(np.maximum(squares, 0.0) / self._short, 1.0) ** 3
        less[self._torques :, self._torques :] = (axes * (self._grows * missing)) @ axes.T
        return less

    def step(self, context: Context, memory: Memory, inputs: Memory) -> dict[str, Any]:
        """One tick of the filter."""
        mine, balance = self._joints, inputs["torque_balance"]
        q, v = inputs["joint_position"], inputs["joint_velocity"]
        level = inputs["tare"].item() if "tare" in inputs else 0.0
        tare = self._taring.own_memory(memory, level)
        if not all_finite(balance, q, v):
            return {**memory, **tare, "seen": 0.0}
        plant = self._scratch.Eval(context)
        rows, balance = self._rows(plant, q), (balance + viscous_friction_torque(v, self._friction))[mine]
        ok, less = inputs["balance_ok"][mine] > 0.5, self._less(rows) if self._short else None
        estimate = self._filter.tick(memory, rows, balance, q[mine], v[mine], ok, less)
        shown, tare = self._taring.step(tare, self._wrench(estimate.x[: self._torques + 3]), level)
        rotation = self._frame.CalcRotationMatrix(plant, self._expressed_in).matrix()
        return {
            "wrench": np.concatenate([rotation @ shown[:3], rotation @ shown[3:]]),
            **self._further(memory, rows, estimate),
            **estimate.memory,
            **tare,
        }


class WrenchFilter(MovingJointsFilter):
    """Kalman filter of the wrench of the environment on the robot.

    ```
    name: WrenchFilter
    input_ports: [torque_balance, joint_position, joint_velocity, balance_ok, tare]
    output_ports: [wrench, wrench_deviation, joint_bias, moving, torque_elsewhere]
    ```

    torque_balance: shape (n,), from a `MomentumObserver` [Nm]. joint_position, joint_velocity: shape (n,) [rad, rad/s].
    balance_ok: shape (n,), 1 for a joint whose balance was updated in this tick, else 0 [1].
    tare: shape (1,) [1], may be left unconnected; see `Taring`, in the axes of the frame.
    wrench: shape (6,), of the environment on the robot at the origin of `frame`, [torque; force] in `expressed_in`
    [Nm, N].
    wrench_deviation: shape (6,), standard deviations of the wrench in the axes of the frame, from the covariance of the
    filter: those of a direction grow while it loads no moving joint [Nm, N].
    joint_bias: shape (k,), b of the k joints of `joints` [Nm]. moving: shape (k,), 1 for those whose balance is used, 0
    for those that may be in static friction or have no reading [1].
    torque_elsewhere: shape (1,), norm of the torque along null-space motions, which no wrench at the frame has, minus
    the part of b and c filtered over 1 s; filtered over 20 ms, and held while a joint of these motions is not used
    [Nm].
    All outputs are feedthrough of all inputs at the tick, and held.

    Numbers that are not finite hold the estimate of the last tick.

    Sampling: every `period` [s]; no delay, see `SampledBlock`.

    Args:
        model: the n joints.
        friction: assumed friction of the n joints.
        frame: where the wrench acts.
        expressed_in: any frame of the same plant; world when None.
        joints: of the n, those that move the frame; all by default.
        moment: False if only a force acts at the frame: then the torque is zero and the force has less noise.
        force_walk: random walk of a force, as the standard deviation of its change in 1 s [N], > 0.
        moment_walk: the same of a torque [Nm], > 0.
        tare_window: end and begin of the window of `Taring`, as times before now [s]; empty: none.
        tare_change: change of a force from the tare value, above which taring pauses [N], > 0.
        short_lever: lever arm of a force over the joints below which `force_walk` is smaller in its direction, by the
            cube of the ratio; 0: nowhere [m], >= 0.
        period: tick [s].
        **joint_options: `noise`, `jerk_noise`, `outlier`, `bias`, `bias_walk`, `slow`, `hold` and
            `velocity_bandwidth` of `MovingJoints`.

    Raises:
        BadInputError: a value out of range, friction of another number of joints, a frame of another plant.
    """

    port_units = MovingJointsFilter.port_units | {
        "wrench_deviation": "Nm,N",
        "joint_bias": "Nm",
        "moving": "1",
        "torque_elsewhere": "Nm",
    }

    def __init__(
        self,
        model: MomentumModel,
        friction: JointFriction,
        frame: Frame,
        expressed_in: Frame | None = None,
        *,
        joints: slice = slice(None),
        moment: bool = True,
        force_walk: float = 1.25,
        moment_walk: float = 0.04,
        tare_window: Sequence[float] = (),
        tare_change: float = 0.5,
        short_lever: float = 0.0,
        period: float = 0.004,
        **joint_options: float,
    ):
        torques, k = 3 if moment else 0, len(friction.coulomb[joints])
        further = {
            "wrench_deviation": np.zeros(6),
            "joint_bias": np.zeros(k),
            "moving": np.zeros(k),
            "torque_elsewhere": 0.0,
            # Low-pass filtered b and c, because they absorb a force elsewhere with time; null-space torque, filtered.
            "settled": np.zeros(2 * k),
            "elsewhere": np.zeros(k),
        }
        walks, tare = (torques, moment_walk, force_walk), (tare_window, tare_change)
        super().__init__(
            model, friction, joints, frame, expressed_in, walks, tare, short_lever, period, joint_options, further
        )
        self._pick = np.eye(k)[:, torques + 3 :]
        self.show("wrench", "wrench_deviation", "joint_bias", "moving", "torque_elsewhere")

    def _rows(self, plant: Context, q: Array) -> Array:
        jacobian = self._model.jacobian(plant, q, self._frame, self._frame)
        return jacobian[3 - self._torques :, self._joints].T

    def _wrench(self, unknowns: Array) -> Array:
        found = np.zeros(6)
        found[3 - self._torques :] = unknowns
        return found

    def _further(self, memory: Memory, rows: Array, estimate: MovingJointsEstimate) -> dict[str, Any]:
        x, k, m = estimate.x, self._filter.k, self._torques + 3
        settled = memory["settled"] + self._period / (self._period + _SETTLED) * (x[m:] - memory["settled"])
        free, elsewhere = left_free(rows.T, self._pick) if self._pick.size else None, memory["elsewhere"]
        if free is not None and not ((np.abs(free) > _NEEDED).any(axis=1) & (estimate.ignored > _USED)).any():
            left = free @ (free.T @ (estimate.d - estimate.H[:, m:] @ settled))
            elsewhere = elsewhere + self._period / (self._period + _LAG) * (left - elsewhere)
        return {
            "wrench_deviation": self._wrench(np.sqrt(np.maximum(np.diag(estimate.P)[:m], 0.0))),
            "joint_bias": x[m : m + k],
            "moving": (estimate.ignored < _USED).astype(float),
            "torque_elsewhere": math.sqrt(elsewhere @ elsewhere),
            "settled": settled,
            "elsewhere": elsewhere,
        }
