"""The wrench at a frame of the robot from its external joint torques.

    mu = (J')^+ (r - r_0)                                                                              (5.8)

The least-squares wrench at the origin of a frame. Where a wrench direction loads no joint, J' loses rank and the
inverse grows without bound. Singular values s of J' (translations divided by `length`) below a limit e are inverted as

    1/s  ->  s/e^2

This is continuous, never larger than 1/e, and goes to zero with s; all other directions stay exact.
r_0 is in joint torques, because what taring removes, above all friction offsets, depends on the joints and not on the
posture.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from pydrake.multibody.tree import Frame
from pydrake.systems.framework import Context
from scipy.linalg.lapack import dgesdd, dposv

from forcectl.arrays import Array
from forcectl.errors import BadInputError
from forcectl.framework.batch import check
from forcectl.framework.block import scratch
from forcectl.framework.kernels import is_definite
from forcectl.framework.sampled_block import Memory, SampledBlock
from forcectl.robot.momentum_model import MomentumModel

_LEAST = 1e-6  # e^2 / sum of s^2 below which J J' is too ill-conditioned for the test of e: then the SVD is used


def wrench_from_torques(jacobian: Array, torque: Array, *, smallest: float, length: float) -> tuple[Array, bool]:
    """Least-squares wrench of joint torques.

    Args:
        jacobian: of the frame, rows [rotation; translation] or translation alone, shape (6, n) or (3, n) [1; m].
        torque: external joint torques, shape (n,) [Nm].
        smallest: e, singular value below which a direction is damped [1].
        length: divisor of translations [m].

    Returns:
        wrench on the robot, [torque; force] or force, shape (6,) or (3,) [Nm, N], and whether it was damped.
    """
    rows = len(jacobian)
    scale = np.ones(rows)
    scale[-3:] = 1.0 / length
    square = np.outer(scale, scale) * (jacobian @ jacobian.T)
    # Usually all singular values are above the limit. To square them squares the condition, too.
    wide = smallest**2 > _LEAST * np.trace(square)
    if wide and is_definite(square - smallest**2 * np.eye(rows)):
        found = dposv(square, scale * (jacobian @ torque))[1]
        return scale * found, False
    # LAPACK itself: half the time of numpy's wrapper for so small a matrix.
    U, s, Vt, _ = dgesdd(scale[:, None] * jacobian, full_matrices=0)
    solution: Array = scale * (U @ (s / np.maximum(s, smallest) ** 2 * (Vt @ torque)))
    # With fewer joints than directions some directions are never observable.
    return solution, bool(s[-1] < smallest) or len(s) < rows


class WrenchEstimator(SampledBlock):
    """Wrench of the environment on the robot from external joint torques.

    ```
    name: WrenchEstimator
    input_ports: [external_torque, joint_position, tare]
    output_ports: [wrench, near_singular]
    ```

    external_torque: shape (n,), from a `MomentumObserver` [Nm]. joint_position: shape (n,) [rad].
    tare: shape (1,) [1], may be left unconnected. Above 0.5 the wrench is zero and r_0 becomes the mean torque of the
    ticks since it rose; below -0.5 r_0 is reset to zero.
    wrench: shape (6,), of the environment on the robot at the origin of `frame`, [torque; force] in `expressed_in`
    [Nm, N]. near_singular: shape (1,), 1 while a direction is damped, else 0 [1].
    All outputs are feedthrough of all inputs at the tick, and held.

    Torques or positions that are not finite hold the wrench of the last tick.

    Sampling: every `period` [s]; no delay, see `SampledBlock`.

    Args:
        model: the n joints.
        frame: where the wrench acts.
        expressed_in: any frame of the same plant; world when None.
        joints: of the n, those that move the frame; all by default. The torques of the others are not used.
        moment: False if only a force acts at the frame: then the torque is zero and the force has less noise.
        smallest: e [1].
        length: of the arm, divisor of translations [m].
    """

    optional_inputs = ("tare",)

    def __init__(
        self,
        model: MomentumModel,
        frame: Frame,
        expressed_in: Frame | None = None,
        *,
        joints: slice = slice(None),
        moment: bool = True,
        smallest: float = 0.02,
        length: float = 0.5,
        period: float = 0.004,
    ):
        super().__init__()
        n = model.num_joints
        for given in (frame, expressed_in):
            if given is not None and not model.owns(given):
                raise BadInputError(f"frame {given.name()!r}: must be of the plant of the momentum model")
        self._model, self._frame, self._joints = model, frame, joints
        self._expressed_in = model.plant.world_frame() if expressed_in is None else expressed_in
        self._first_row = 0 if moment else 3
        self._smallest, self._length = check("smallest", smallest, "positive"), check("length", length, "positive")
        self.port_units = {
            "near_singular": "1",
        }
        sizes = {"external_torque": n, "joint_position": n, "tare": 1}
        inputs = [self.DeclareVectorInputPort(name, size) for name, size in sizes.items()]
        self._scratch = scratch(self, "plant context", model.create_context)
        memory = {"wrench": np.zeros(6), "near_singular": 0.0, "zero": np.zeros(n), "tared": 0.0}
        self.declare_memory(memory, inputs, period)
        self.show("wrench", "near_singular")

    def step(self, context: Context, memory: Memory, inputs: Memory) -> dict[str, Any]:
        """One tick of the estimate."""
        torque, q = inputs["external_torque"], inputs["joint_position"]
        level = inputs["tare"].item() if "tare" in inputs else 0.0
        finite = bool(np.isfinite(torque).all())
        wrench, near, zero, tared = (memory[name] for name in ("wrench", "near_singular", "zero", "tared"))
        if finite and np.isfinite(q).all():
            tared_torque = torque if level < -0.5 else torque - zero
            jacobian = self._model.jacobian(self._scratch.Eval(context), q, self._frame, self._expressed_in)
            first, mine = self._first_row, self._joints
            wrench = np.zeros(6)
            wrench[first:], near = wrench_from_torques(
                jacobian[first:, mine], tared_torque[mine], smallest=self._smallest, length=self._length
            )
            if level > 0.5:
                wrench[:] = 0.0
        if level > 0.5 and finite:
            mean = zero if tared > 0 else np.zeros_like(torque)
            zero, tared = mean + (torque - mean) / (tared + 1), tared + 1
        elif not level > 0.5:
            tared = 0.0
            if level < -0.5:
                zero = np.zeros_like(zero)
        return {"wrench": wrench, "near_singular": float(near), "zero": zero, "tared": tared}
