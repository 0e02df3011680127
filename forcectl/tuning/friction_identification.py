"""Joint friction from a recorded excitation run, by least squares without negative coefficients.

    tau_F = tau_O + tau_C tanh(130 q') + D+ max(q', 0) + D- min(q', 0),   tau_C, D+, D- >= 0           (5.2)

The friction torque of a tick is the residual of the momentum balance::

    mean(tau_F) = mean(tau) + mean(C'q' + tau_g) - (p_k - p_{k-1})/T

so no acceleration is needed. The regressors are the means of (5.2) over the tick, so that noise of the speed and a
reversal inside a tick do no harm. Slow ticks are left out of the fit, because static friction follows the load and not
the speed. The two levels of the threshold (5.3)* follow from the residuals.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import nnls

from forcectl.arrays import Array, Mask
from forcectl.errors import BadInputError, invalid
from forcectl.framework.batch import check
from forcectl.plant.drives.joint_friction import JointFriction, friction_threshold, mean_features
from forcectl.robot.momentum_model import MomentumModel
from forcectl.tuning.identifiability import BLOCKS, robust_errors

_LEAST_SAMPLES = 20
_WORST_CONDITION = 1e4
_OUTLIERS = 0.99  # share of the ticks that the threshold covers
_BRAKES = 0.5  # a correlation of torque and speed below minus this means that the torque has the wrong sign
_NEAR_REST = 0.1  # [rad/s] slower ticks are near rest: sech(30 q') is 0.1 at this speed


@dataclass(frozen=True, eq=False)
class FrictionFit:
    """Result of `identify_friction` for n joints.

    Attributes:
        friction: the parameters.
        deviation: standard error of tau_O, tau_C, D+ and D-, shape (4, n) [Nm, Nm, Nms/rad, Nms/rad], robust against
            correlated residuals; that of a coefficient at its bound of zero is zero. It does not contain errors of the
            dynamic model, such as elastic joints.
        rms: of the residuals of the fit, shape (n,) [Nm].
        explained: share of the variance of the torque, shape (n,).
        move, still: levels of the threshold that cover 99 % of the ticks, shape (n,) [Nm].
        used: number of ticks in the fit, shape (n,).
        speed, torque: mean joint speed and friction torque of all ticks, shape (N, n) [rad/s, Nm].
    """

    friction: JointFriction
    deviation: Array
    rms: Array
    explained: Array
    move: Array
    still: Array
    used: NDArray[np.int64]
    speed: Array
    torque: Array


def friction_samples(
    model: MomentumModel,
    time: ArrayLike,
    position: ArrayLike,
    velocity: ArrayLike,
    motor_torque: ArrayLike,
    *,
    velocity_bandwidth: float | None = None,
) -> tuple[Array, Array, Array]:
    """Friction torque of every tick of a recorded run in free motion.

    Args:
        model: momentum terms of the n joints.
        time: shape (N+1,) [s], increasing.
        position, velocity: shape (N+1, n) [rad, rad/s].
        motor_torque: mean over the tick that ends, (N+1, n) [Nm].
        velocity_bandwidth: of the filter behind speeds that were differentiated from the positions [rad/s], see
            `MomentumObserver`; None: the speeds are those of the tick.

    Returns:
        speeds before and after each tick and mean friction torque in it, each of shape (N, n) [rad/s, rad/s, Nm];
        ticks next to a reading that is not finite are left out.

    Raises:
        BadInputError: wrong shapes or times that do not increase.
    """
    t = np.asarray(time, dtype=float)
    rows = {"position": position, "velocity": velocity, "motor_torque": motor_torque}
    arrays = {name: np.asarray(values, dtype=float) for name, values in rows.items()}
    if t.ndim != 1 or len(t) < 2 or not np.all(np.diff(t) > 0):
        raise BadInputError("time: must be at least two increasing times")
    for name, array in arrays.items():
        if array.shape != (len(t), model.num_joints):
            raise BadInputError(f"{name} has shape {array.shape}: must be ({len(t)}, {model.num_joints})")
    q, v, torque = arrays.values()
    good = np.isfinite(np.hstack([q, v, torque])).all(axis=1)
    if velocity_bandwidth is not None:
        bandwidth = check("velocity_bandwidth", velocity_bandwidth, "positive")
        q, torque = (_late(t, values, good, bandwidth) for values in (q, torque))
    momentum, force = np.full_like(q, np.nan), np.full_like(q, np.nan)
    context = model.create_context()
    for k in np.flatnonzero(good):
        momentum[k], force[k] = model.terms(context, q[k], v[k])
    both = good[1:] & good[:-1]
    friction = torque[1:] - np.diff(momentum, axis=0) / np.diff(t)[:, None] + 0.5 * (force[1:] + force[:-1])
    return v[:-1][both], v[1:][both], friction[both]


def _late(time: Array, values: Array, good: Mask, bandwidth: float) -> Array:
    """Values after the filter of the speeds; the filter is restarted after readings that are not finite."""
    late = values.copy()
    for k in np.flatnonzero(good[1:] & good[:-1]) + 1:
        pole = np.exp(-bandwidth * (time[k] - time[k - 1]))
        late[k] = pole * late[k - 1] + (1 - pole) * 0.5 * (values[k] + values[k - 1])
    return late


def identify_friction(
    before: ArrayLike, after: ArrayLike, torque: ArrayLike, *, slowest: float = 0.02, joints: Sequence[str] = ()
) -> FrictionFit:
    """Fit (5.2) to ticks, by non-negative least squares.

    Args:
        before, after: joint speeds at the ends of each tick, shape (N, n) [rad/s].
        torque: mean friction torque in it, shape (N, n) [Nm]; see `friction_samples`.
        slowest: a tick is left out if it is slower than this at either end, or if the motion reverses in it [rad/s].
        joints: names for messages, one per joint; empty: joint 1, joint 2 and so on.

    Raises:
        BadInputError: shapes that do not fit, torque of the wrong sign, or a run that does not excite a joint: it has
            to move in both directions, each at more than one speed.
    """
    start, end, load = (np.asarray(values, dtype=float) for values in (before, after, torque))
    slow = check("slowest", slowest, "not negative")
    if load.ndim != 2 or not load.shape[1] or start.shape != load.shape or end.shape != load.shape:
        raise BadInputError(f"torque has shape {load.shape}: must be (N, n), as the speeds {start.shape}, {end.shape}")
    names = list(joints) or [f"joint {j + 1}" for j in range(load.shape[1])]
    if len(names) != load.shape[1]:
        raise invalid("joints", names, f"{load.shape[1]} names, as many as there are columns")
    for name, values in (("before", start), ("after", end), ("torque", load)):
        if not (finite := np.isfinite(values)).all():
            k, j = (int(i) for i in np.argwhere(~finite)[0])
            raise invalid(f"{name}[{k}] of {names[j]}", float(values[k, j]), "finite; leave out lost samples")
    fits = [_fit_joint(names[j], start[:, j], end[:, j], load[:, j], slow) for j in range(load.shape[1])]
    coefficients, deviation, rms, explained, move, still, used = (np.array(part).T for part in zip(*fits, strict=True))
    keys = ("offset", "coulomb", "viscous_forward", "viscous_backward")
    friction = JointFriction(len(names), **dict(zip(keys, coefficients, strict=True)))
    return FrictionFit(friction, deviation, rms, explained, move, still, used, 0.5 * (start + end), load)


def _fit_joint(joint: str, before: Array, after: Array, torque: Array, slowest: float) -> tuple[Any, ...]:
    """Coefficients and the other results in `FrictionFit` for one joint, in its order."""
    moving = (np.minimum(np.abs(before), np.abs(after)) >= slowest) & (before * after >= 0)
    count = int(moving.sum())
    if count < _LEAST_SAMPLES:
        raise BadInputError(f"{joint}: has {count} ticks in motion: must have at least {_LEAST_SAMPLES}")
    features, speed = _features(before[moving], after[moving]), (before + after)[moving]
    scale = np.linalg.norm(features, axis=0)
    if speed.min() >= 0 or speed.max() <= 0 or np.linalg.cond(features / scale) > _WORST_CONDITION:
        raise BadInputError(f"{joint}: is not excited: must move both ways, each at more than one speed")
    wanted = torque[moving]
    if _alike(wanted, speed) < -_BRAKES:
        raise BadInputError(f"{joint}: torque drives the motion: must brake it, and be positive with a positive speed")
    # The offset may have either sign: it is the difference of two unknowns that are not negative.
    solution = nnls(np.column_stack([features / scale, -features[:, 0] / scale[0]]), wanted)[0]
    coefficients = solution[:4] / scale
    coefficients[0] -= solution[4] / scale[0]
    left = wanted - features @ coefficients
    free = np.concatenate([[True], coefficients[1:] > 0])
    used, deviation = features[:, free], np.zeros(4)
    blocks = np.array_split(np.arange(count), min(BLOCKS, count // 10))
    scores = np.array([used[block].T @ left[block] for block in blocks])
    inverse = np.asarray(np.linalg.inv(used.T @ used), dtype=float)
    deviation[free] = robust_errors(inverse, scores)
    spread = float(np.var(wanted))
    explained = 1.0 - float(np.mean(left**2)) / spread if spread > 0 else 0.0
    move, still = _threshold_levels(before, after, torque, coefficients)
    return coefficients, deviation, float(np.sqrt(np.mean(left**2))), explained, move, still, count


def _alike(one: Array, other: Array) -> float:
    """Correlation of two signals, from -1 to 1; 0 where one is constant."""
    a, b = one - one.mean(), other - other.mean()
    size = float(np.linalg.norm(a) * np.linalg.norm(b))
    return float(a @ b) / size if size > 0 else 0.0


def _features(before: Array, after: Array) -> Array:
    return np.column_stack([np.ones(len(before)), *mean_features(before, after)])


def _threshold_levels(before: Array, after: Array, torque: Array, coefficients: Array) -> tuple[float, float]:
    """Levels of (5.3)* that cover 99 % of the ticks, at speed and, added to that, near rest."""
    error, speed = np.abs(torque - _features(before, after) @ coefficients), 0.5 * np.abs(before + after)
    slow = speed < _NEAR_REST
    move = float(np.quantile(error if slow.all() else error[~slow], _OUTLIERS))
    if not slow.any():
        return move, 0.0
    # Errors above the level at speed, scaled to rest.
    excess = np.maximum(error[slow] - move, 0.0) / friction_threshold(speed[slow], 0.0, 1.0)
    return move, float(np.quantile(excess, _OUTLIERS))
