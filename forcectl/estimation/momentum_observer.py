"""External joint torques from the generalized momentum, without accelerations and without a force sensor::

    p = B(q) q',   p' = C'q' + tau_g - tau_F + tau + tau_ext                                           (5.4), (5.5)
    r = K_R [p - p(0) - int (tau + C'q' + tau_g - tau_F + r) dt],   so   r' = K_R (tau_ext - r)        (5.6)*, (5.7)

tau_g is gravity as a force on the right-hand side. (5.6) is printed without p(0): its residual would start at K_R p(0).

Sampled, the balance over a tick gives the mean external torque d in it; for a constant d the step of (5.7) is exact::

    d_k = (p_k - p_{k-1} - int tau dt)/T - mean(C'q' + tau_g - tau_F),   r_k = r_{k-1} + (1 - e^{-K_R T})(d_k - r_{k-1})

This is the difference of (5.6)* from tick to tick: p(0) is the first sample, and a lost sample makes T longer. The
motor torque is the mean over each tick; the robot measures it at the rate of its drives.

Differentiated and low-pass filtered speeds lag by T/2 + 1/w_v. Position and torque are then passed through the same
filter, so that all terms of the balance belong to the same, earlier instant.

The encoders show the motors. Where joints are elastic, the links swing on them after every change of acceleration, and
p has their own speeds v_l in place of v: p = B v_l + J_m v, see `forcectl.estimation.link_swing`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike
from pydrake.systems.framework import Context

from forcectl.arrays import Array
from forcectl.errors import BadInputError
from forcectl.estimation.link_swing import swing
from forcectl.framework.batch import BatchParameter, batch_values, check
from forcectl.framework.block import scratch
from forcectl.framework.kernels import all_finite, largest, smallest
from forcectl.framework.sampled_block import Memory, SampledBatch
from forcectl.plant.drives.joint_friction import JointFriction, friction_threshold, mean_features
from forcectl.robot.momentum_model import MomentumModel

_MEMORY = (
    *("external_torque", "residual", "torque_balance", "balance_ok", "frozen"),
    # Of the last good sample; its time is the same for all joints, and negative before the first one.
    *("sample_time", "position", "velocity", "torque", "momentum", "force"),
    # Position and torque after the filter of the speeds; its input torque; the unfiltered speed.
    *("late_position", "late_torque", "mean_torque", "raw_speed"),
    # Integral of the torque since that sample, and the time for which the torque was available.
    *("impulse", "covered"),
)


def residual_step(residual: Array, mean_torque: Array, gain: Array | float, elapsed: float) -> Array:
    """Residual after the time `elapsed` by (5.7), with the mean external torque in it; arguments [Nm, Nm, 1/s, s]."""
    return residual - np.expm1(-gain * elapsed) * (mean_torque - residual)


def dead_band(residual: Array, threshold: Array) -> Array:
    """The part of the residual [Nm] beyond the threshold [Nm]."""
    return np.copysign(np.maximum(np.abs(residual) - threshold, 0.0), residual)


class MomentumObserver(SampledBatch):
    """External joint torques of n joints by the momentum observer (5.6)*, with a dead band for friction (5.3)*.

    ```
    name: MomentumObserver
    input_ports: [joint_position, joint_velocity, motor_torque, reset]
    output_ports: [external_torque, residual, torque_balance, balance_ok]
    parameters: [gain, offset, coulomb, viscous_forward, viscous_backward, move, still, limit]
    ```

    joint_position: shape (n,) [rad]. joint_velocity: shape (n,) [rad/s].
    motor_torque: shape (n,), mean of the torque that drives the joints, over the tick that ends [Nm].
    reset: shape (1,) [1], may be left unconnected; above 0.5 the residual is zero and the observer starts anew.
    external_torque: shape (n,), the part of the residual beyond the friction threshold, else zero [Nm].
    residual: shape (n,), r [Nm].
    torque_balance: shape (n,), mean of tau_ext - tau_F over the tick that ends, or over a gap, not filtered [Nm].
    balance_ok: shape (n,), 1 for a joint whose readings of this tick were used, else 0 [1].
    All outputs are feedthrough of all inputs at the tick, and held.

    Parameters (Context, shape (n,)): gain K_R [1/s] > 0; offset tau_O [Nm], coulomb tau_C [Nm] >= 0, viscous_forward
    and viscous_backward D+, D- [Nms/rad] >= 0 of the friction (5.2); move and still [Nm] >= 0 of the threshold (5.3)*;
    limit [Nm] > 0 of the size of the residual.

    The residual is held while readings are bad. The next good sample then uses the mean over the gap or, if the gap was
    longer than `longest_gap`, starts a new balance without it. Bad readings are

    - a number that is not finite: `balance_ok` is 0 for its joint;
    - a frozen encoder: a position that repeats bit for bit although the joint moves faster than `frozen_speed` (with
      differentiated speeds: moved so in the tick before). It lasts until the position changes, and with differentiated
      speeds 10/w_v longer, because they jump at that change; `balance_ok` is 0 for its joint;
    - a speed that changes faster than `largest_acceleration`: `balance_ok` is 0 for its joint, with differentiated
      speeds 10/w_v longer;
    - a lost sample: positions, speeds and torques all repeat bit for bit, though a joint moves; `balance_ok` is 0 for
      all joints. Beyond `longest_gap` such readings are accepted, once per gap.

    The missing torque of a lost tick is the mean of the torques before and after the gap.

    Sampling: every `period` [s]; no delay from motor_torque to residual, see `SampledBlock`. The first tick
    only starts it.

    Args:
        model: momentum terms of the n joints.
        friction: of (5.2), zero when None.
        velocity_bandwidth: w_v of the first-order filter of speeds that are differentiated from the sampled positions
            [rad/s]; None: the speeds are measured at the tick.
        joint_stiffness: K of elastic joints, by which the speeds of the links differ from those of the motors, shape
            (n,) or a number, > 0 [Nm/rad]; the plant of the model must have no rotors then. None: rigid joints.
    """

    on_arrays = True
    optional_inputs = ("reset",)

    def __init__(
        self,
        model: MomentumModel,
        friction: JointFriction | None = None,
        *,
        gain: ArrayLike = 25.0,
        move: ArrayLike = 0.0,
        still: ArrayLike = 0.0,
        limit: ArrayLike = np.inf,
        period: float = 0.004,
        velocity_bandwidth: float | None = None,
        frozen_speed: ArrayLike = 0.1,
        longest_gap: float = 0.02,
        largest_acceleration: ArrayLike = np.inf,
        joint_stiffness: ArrayLike | None = None,
    ):
        n = model.num_joints
        friction = JointFriction(n) if friction is None else friction
        if friction.size != n:
            raise BadInputError(f"friction has {friction.size} joints: must have {n}, as the model")
        super().__init__(
            n,
            {
                "gain": BatchParameter(gain, "positive and finite", "1/s"),
                "offset": BatchParameter(friction.offset, "finite", "Nm"),
                "coulomb": BatchParameter(friction.coulomb, "not negative", "Nm"),
                "viscous_forward": BatchParameter(friction.viscous_forward, "not negative", "Nms/rad"),
                "viscous_backward": BatchParameter(friction.viscous_backward, "not negative", "Nms/rad"),
                "move": BatchParameter(move, "not negative", "Nm"),
                "still": BatchParameter(still, "not negative", "Nm"),
                "limit": BatchParameter(limit, "positive", "Nm"),
            },
        )
        self._period = check("period", period, "positive")
        self._model = model
        self._lag = None if velocity_bandwidth is None else check("velocity_bandwidth", velocity_bandwidth, "positive")
        self._settle = 0.0 if self._lag is None else 10.0 / self._lag
        self._jump = batch_values("largest_acceleration", largest_acceleration, n, "positive")
        self._stiffness: Array | None = None
        if joint_stiffness is not None:
            self._stiffness = batch_values("joint_stiffness", joint_stiffness, n, "positive and finite")
        self._jumps = bool(np.isfinite(self._jump).any())
        self._good, self._nothing, self._span = np.ones(n), np.zeros(n), np.array(self._period)
        self._frozen_speed = batch_values("frozen_speed", frozen_speed, n, "positive")
        # At least one tick, and half a tick more for rounding of the sample times.
        self._longest = max(check("longest_gap", longest_gap, "not negative"), period) + 0.5 * period
        self.sample_delay = {("motor_torque", "external_torque"): 0.0}
        self.port_units = {
            "reset": "1",
            "residual": "Nm",
            "torque_balance": "Nm",
            "balance_ok": "1",
        }
        self.port_components = dict.fromkeys(("residual", "torque_balance", "balance_ok"), "n")
        inputs = [self.DeclareVectorInputPort(name, n) for name in ("joint_position", "joint_velocity", "motor_torque")]
        inputs.append(self.DeclareVectorInputPort("reset", 1))
        self._scratch = scratch(self, "plant context", model.create_context)
        memory = _MEMORY if self._stiffness is None else (*_MEMORY, "deflection", "link_speed")
        self.declare_memory(dict.fromkeys(memory, 0.0) | {"sample_time": -1.0}, inputs, period)
        self.show("external_torque", "residual", "torque_balance", "balance_ok")

    def check_together(self, values: Mapping[str, Array]) -> None:
        """Friction and thresholds are subtracted, so they must be finite."""
        for name in ("coulomb", "viscous_forward", "viscous_backward", "move", "still"):
            if not np.isfinite(values[name]).all():
                raise BadInputError(f"{name} = {values[name].tolist()}: must be finite")

    def step(self, context: Context, memory: Memory, inputs: Memory) -> dict[str, Array]:
        """One tick of the observer."""
        residual, frozen, since = memory["residual"], memory["frozen"], memory["sample_time"].item(0)
        impulse, covered = memory["impulse"], memory["covered"]
        q_last, v_last, torque_last = memory["position"], memory["velocity"], memory["torque"]
        q, v, torque = inputs["joint_position"], inputs["joint_velocity"], inputs["motor_torque"]
        now = context.get_time()
        external = memory["external_torque"]
        if "reset" in inputs and inputs["reset"].item() > 0.5:
            residual = external = frozen = self._nothing
            since = -1.0
        started, elapsed, moved = since >= 0, now - since, q - q_last

        lost = False
        # Shortcut for good readings, nearly all ticks: a fifth of the time of the full check.
        all_good = started and all_finite(q, v, torque) and not (largest(moved == 0.0) or largest(frozen))
        if all_good and self._jumps:
            all_good = smallest(np.abs(v - v_last) <= self._jump * elapsed)
        if all_good:
            ok, impulse, covered = self._good, impulse + torque * self._span, covered + self._span
        else:
            finite = np.isfinite(q) & np.isfinite(v) & np.isfinite(torque)
            usable = finite
            if started:
                same = (moved == 0.0) | ~np.isfinite(q)
                # Filtered speeds lag: they are not zero yet when a joint has just stuck. The raw speed is used instead.
                speed = np.maximum(np.abs(v), np.abs(v_last)) if self._lag is None else np.abs(memory["raw_speed"])
                moving = speed > self._frozen_speed
                jump = np.abs(v - v_last) > self._jump * elapsed
                standing = same & (moving | (frozen > 0))
                # Time for which the readings of a joint are still rejected.
                frozen = np.where(standing | jump, self._settle + self._period, np.maximum(frozen - self._period, 0.0))
                frozen = np.where(frozen > 0.5 * self._period, frozen, 0.0)
                lost = (
                    bool(same.all() and v.any()) and np.array_equal(v, v_last) and np.array_equal(torque, torque_last)
                )
                usable = finite & (frozen == 0) & (not lost or elapsed > self._longest)
                known = np.isfinite(torque) & (not lost)
                impulse = impulse + np.where(known, torque * self._period, 0.0)
                covered = covered + np.where(known, self._period, 0.0)
            ok = usable.astype(float)
            if not usable.all():
                return {
                    **memory,
                    "external_torque": external,
                    "residual": residual,
                    "balance_ok": ok,
                    "frozen": frozen,
                    "sample_time": since * self._good,
                    "impulse": impulse,
                    "covered": covered,
                }

        gain, offset, coulomb, forward, backward, move, still, limit = self.values(context)
        continues = started and bool(lost or elapsed <= self._longest)
        mean_torque = torque
        # The motor torque of a tick is already its mean; over a gap the mean is formed here.
        if continues and (lost or elapsed > 1.5 * self._period):
            mean_torque = (impulse + (elapsed - covered) * 0.5 * (torque + torque_last)) / elapsed
        if self._lag is None or not continues:
            late_q, late_torque = q, mean_torque
        else:
            pole = math.exp(-self._lag * elapsed)
            share = 0.5 * (1.0 - pole)
            late_q = pole * memory["late_position"] + share * (q + q_last)
            late_torque = pole * memory["late_torque"] + share * (mean_torque + memory["mean_torque"])
        plant, swinging = self._scratch.Eval(context), dict[str, Array]()
        momentum, force = self._model.terms(plant, late_q, v)
        if self._stiffness is not None:
            mass = self._model.mass_matrix(plant)  # at late_q, as `terms` left it
            deflection, link_speed = self._nothing, v
            if continues:
                before = memory["deflection"], memory["link_speed"]
                deflection, link_speed = swing(mass, self._stiffness, *before, v, elapsed)
            momentum = momentum + mass @ (link_speed - v)
            swinging = {"deflection": deflection, "link_speed": link_speed}
        balance = memory["torque_balance"]
        if continues:
            sign, ahead, back = mean_features(v_last, v)
            friction = offset + coulomb * sign + forward * ahead + backward * back
            mean = (momentum - memory["momentum"]) / elapsed - late_torque
            mean = mean - 0.5 * (force + memory["force"])
            stepped = residual_step(residual, mean + friction, gain, elapsed)
            # An overflow from very large readings also holds residual and balance.
            stepped = np.where(np.isfinite(stepped), stepped, residual)
            balance = np.where(np.isfinite(mean), mean, balance)
            residual = np.minimum(np.maximum(stepped, -limit), limit)
        external = dead_band(residual, friction_threshold(v, move, still))
        return {
            "external_torque": external,
            "residual": residual,
            "torque_balance": balance,
            "balance_ok": ok,
            "frozen": frozen,
            "sample_time": now * self._good,
            "position": q,
            "velocity": v,
            "torque": torque,
            "momentum": momentum,
            "force": force,
            "late_position": late_q,
            "late_torque": late_torque,
            "mean_torque": mean_torque,
            "raw_speed": moved / elapsed if started else self._nothing,
            "impulse": self._nothing,
            "covered": self._nothing,
            **swinging,
        }
