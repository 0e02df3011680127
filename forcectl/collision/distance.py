"""Constraints that keep distances between the links of a robot, its torso and obstacles above a minimum.

The rows have relative degree 2:

    y = minimum - distance <= 0       [m], for the k most urgent balls

With the ball at x on link A, the core on link B (see `forcectl.collision.shapes`), the unit vector n from the nearest
point b of the core's box to x, and w the velocity of x relative to B::

    distance   = |x - b| - radii
    distance'  = n w
    distance'' = n (J_A - J_B) u + n (J_A' - J_B') v - n (w_B x w) + |w across n|^2 / |x - b|

The last term is due to the motion of the nearest point; it is never negative. It is included only in the directions in
which x stays beside the box for a whole tick, so that the distance is not overestimated when a ball passes an edge.
Leaving the term out is conservative, because the core is entirely behind the plane through b fixed on B.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from forcectl.arrays import Array, Indices
from forcectl.collision.pairs import NearBalls, PairTable, speed_left
from forcectl.collision.shapes import RobotShapes
from forcectl.framework.batch import check, check_count
from forcectl.robot.joint_tree import TreeState, cross
from forcectl.robot.robot_motion import RobotMotion

_TINY = 1e-9  # [m]
_LARGEST_FACTOR = 10.0  # largest factor on a row, and largest additional braking over |gamma|
_SPEED_ROWS = 4  # number of rows of `_SlowDown`
_TURN_SHARE = 0.5  # share of the accelerations for turning away, while the joints brake with the rest
_USABLE = 0.5  # usable share of the acceleration limits: in a stretched arm the torque limits bind first
_NO_LIMIT = 1e6  # factor on the speed that stands for no limit
_THREE, _SIX = np.ones(3), np.ones(6)
_LEAST_GAP = 1e-3  # [m] smallest gap used in the last term, which is not reliable below it
_NEAR = 40  # number of pairs of a group and a core whose balls are evaluated


class LinkDistance:
    """Constraint on the distances of pairs of shapes, see `forcectl.tasks.constraints.base.Constraint`.

    ::

        shapes = RobotShapes.load("yumi", "yumi_gripper")
        constraints = [LinkDistance(shapes), LinkDistance(shapes.against([Obstacle(Sphere(0.1), X_WO)]))]

    The rows are those of the k balls with the least `speed_left`, the margin in speed before braking at gamma is too
    late, not of the k nearest: so a ball has a row before one tick of acceleration makes it urgent. Where the joints
    cannot brake at gamma, because they hardly move the two shapes relative to each other, y, y' and the row are
    multiplied by the missing factor, up to 10, and so is the violation that a controller reports. A companion
    constraint slows down joints that could not turn away in time.

    Rows are soft, because joints at full speed cannot always brake at gamma. Constraints demand braking of at most
    2 gamma; a row that needs more than that to stop in time demands it in addition. With gamma = -1 two arms kept the
    minimum in all runs of the tests. Both arms with grippers take 0.3 ms per tick.

    Args:
        shapes: `RobotShapes.load(...)` for self-collision, its `against(obstacles)` for obstacles.
        minimum: distance to keep [m], > 0.
        rows: k; fewer if there are fewer balls.
        gamma: braking [m/s^2], < 0.
        period: tick Ts [s].
        tolerance, box_tolerance: largest error by which distances may be too small, see `cover` [m], > 0.
    """

    relative_degree = 2
    rows_change = True
    slack_weight = 1e6
    margin = 1e-4  # [m] more than the error of holding an acceleration for a tick

    def __init__(
        self,
        shapes: RobotShapes,
        minimum: float = 0.01,
        *,
        rows: int = 24,
        gamma: float = -1.0,
        period: float = 0.004,
        tolerance: float = 2e-3,
        box_tolerance: float = 0.01,
    ):
        self._tree, self._minimum = shapes.tree, check("minimum", minimum, "positive")
        self.gamma, self._period = check("gamma", gamma, "negative and finite"), check("period", period, "positive")
        tolerance = check("tolerance", tolerance, "positive")
        self._table = PairTable(shapes, tolerance, check("box_tolerance", box_tolerance, "positive"))
        self._names = [(shapes.solids[a].name, shapes.solids[b].name) for a, b in shapes.pairs]
        self._pairs, self._near = len(shapes.pairs), min(_NEAR, len(self._table.pair))
        # Any choice of the nearest pairs has at least this many balls.
        fewest = np.sort(self._table.real.sum(axis=1)[self._table.pair_group])[: self._near].sum()
        self.rows = min(check_count("rows", rows), int(fewest))
        limits = np.concatenate([joint.acceleration_upper_limits() for joint in shapes.parts.joints])
        self._acceleration = _USABLE * np.where(np.isfinite(limits), limits, 20.0)
        self.companions = (_SlowDown(self, self._acceleration, self._period),)

    def evaluate(self, motion: RobotMotion) -> tuple[Array, Array, Array, Array]:
        """(y, y', row, bias) of k balls, in the order of the pairs of shapes."""
        y, rate, row, bias = self.second_derivative(motion)
        # Braking at gamma/f, the most that these joints can, is the same as keeping f y <= 0 with gamma.
        least = _TURN_SHARE * (np.abs(row) @ self._acceleration)
        f = self.gamma / np.clip(-least, self.gamma, self.gamma / _LARGEST_FACTOR)
        inside = f * (y + self.margin)
        rate = f * rate
        bounded = np.where(y > 0.0, f * y, np.minimum(inside - self.margin, 0.0))
        return bounded, rate, f[:, None] * row, f * bias + self._late(inside, rate)

    def second_derivative(self, motion: RobotMotion) -> tuple[Array, Array, Array, Array]:
        """(y, y', row, bias) without the factors of `evaluate`: y'' = row u + bias."""
        known: dict[object, Any] = getattr(motion, "known", {})
        if self not in known:  # shared with the companion
            known[self] = self._rows(*self._chosen(motion, known))
        return known[self]

    def rows_at(self, motion: RobotMotion) -> list[str]:
        """The pair of shapes of every row."""
        _, near, chosen = self._chosen(motion, {})
        pairs = self._table.pair.take(near.pair.take(chosen // near.gap.shape[1]))
        return [" and ".join(self._names[pair]) for pair in pairs]

    def _chosen(self, motion: RobotMotion, known: dict[object, Any]) -> tuple[TreeState, NearBalls, Indices]:
        """State of the tree, the near balls, and the indices of those that have a row."""
        if self._tree not in known:  # shared with other distance constraints of the robot
            known[self._tree] = self._tree.at(motion.q, motion.v)
        state = known[self._tree]
        near = self._table.near(state, self._near, self._minimum, self.gamma)
        rate = np.einsum("pbi,pbi->pb", near.normal, near.w)
        least = speed_left(near.distance - self._minimum, rate, self.gamma)
        return state, near, np.sort(np.argpartition(least, self.rows - 1, axis=None)[: self.rows])

    def distances(self, q: Array) -> Array:
        """Distance of each of the pairs of shapes [m], too small by up to the tolerances, in posture q (n,) [rad]."""
        table = self._table
        near = table.near(self._tree.at(q, np.zeros_like(q)), len(table.pair), self._minimum, self.gamma)
        least = np.full(self._pairs, np.inf)
        np.minimum.at(least, table.pair, near.distance.min(axis=1))
        return least

    def nearest(self, q: Array) -> str:
        """The pair of shapes that is nearest in posture q (n,) [rad], in words."""
        distances = self.distances(q)
        nearest = int(np.argmin(distances))
        a, b = self._names[nearest]
        return f"{a} and {b} are {1e3 * distances[nearest]:.3g} mm apart"

    def _rows(self, state: TreeState, near: NearBalls, chosen: Indices) -> tuple[Array, Array, Array, Array]:
        """(y, y', row, bias) of the balls with the indices `chosen`, (k,), counted through the pairs."""
        table, k = self._table, len(chosen)
        which = chosen // near.gap.shape[1]
        pair, R = near.pair.take(which), near.R.take(which, 0)
        x, n, w = (a.reshape(-1, 3).take(chosen, 0) for a in (near.x, near.normal, near.w))
        on_ball, on_core, moves = table.on_ball.take(pair), table.on_core.take(pair), table.moves.take(pair, 0)
        V, A = state.link_velocities, state.link_biases
        V_A, V_B = V.take(on_ball, 0), V.take(on_core, 0)
        turn_A, turn_B = V_A[:, :3], V_B[:, :3]
        crosses = cross(np.concatenate([x, turn_A, n, n]), np.concatenate([n, x, turn_A - turn_B, turn_B]))
        # line V is n times the velocity of the point x of a body with the spatial velocity V.
        line = np.concatenate([crosses[:k], n], axis=1)
        # n (w_AB x v_A) - n (w_B x w)
        turning = crosses[2 * k : 3 * k] * (V_A[:, 3:] + crosses[k : 2 * k]) - crosses[3 * k :] * w
        bias = (line * (A.take(on_ball, 0) - A.take(on_core, 0))) @ _SIX + turning @ _THREE
        rate = (n * w) @ _THREE
        # Whether x stays beside the box for a whole tick; in a direction in which the box is flat it always does.
        along = np.abs((w[:, None] @ R)[:, 0])
        stays = (near.over.reshape(-1, 3).take(chosen, 0) > along * self._period) | table.flat.take(pair, 0)
        across = (along * along * stays) @ _THREE - rate * rate
        bias += np.maximum(across, 0.0) / np.maximum(near.gap.take(chosen), _LEAST_GAP)
        row = (line @ state.screws.T) * moves
        y = self._minimum - near.distance.take(chosen)
        return y, -rate, -row, -bias

    def _late(self, y: Array, rate: Array) -> Array:
        """Braking needed to stop before the minimum, beyond the 2 gamma that a constraint demands at most."""
        closing_speed = np.maximum(rate, 0.0)
        within = np.maximum(-y, closing_speed * self._period)
        needed = 0.5 * closing_speed * closing_speed / np.maximum(within, _TINY)
        return np.clip(needed + 2.0 * self.gamma, 0.0, _LARGEST_FACTOR * -self.gamma)


class _SlowDown:
    """Limits joint speeds so that the joints, braking together along their path, can stop before the minimum.

    They stop after s times their velocities, s = max `|v_i|`/a_i. Meanwhile y grows by y' s + y''(u = 0) s^2/2, minus
    turn s^2/2, by which half of the accelerations a can turn away. At z^(1/2) times the speeds y stays below 0 while

        y + (y' s - turn s^2/2) z + y''(u = 0) s^2/2 z^2 <= 0

    Rows (v/`|v|`) u <= (z^(1/2) - 1) `|v|`/Ts for the joints that move the two shapes, of the most urgent balls. Their
    slack is cheaper than that of the distance, and too high a speed is no violation: y is reported as 0.
    """

    relative_degree = 1
    slack_weight = 1e-2 * LinkDistance.slack_weight

    def __init__(self, distance: LinkDistance, acceleration: Array, period: float):
        self._distance, self._acceleration, self._period = distance, acceleration, period
        self._count = min(_SPEED_ROWS, distance.rows)

    def evaluate(self, motion: RobotMotion) -> tuple[float, float, Array, Array]:
        """(0, 0, row, bias)."""
        direction, limit, worst = self._limits(motion)
        return 0.0, 0.0, direction, -limit[worst]

    def rows_at(self, motion: RobotMotion) -> list[str]:
        """The pair of shapes of every row."""
        pairs = self._distance.rows_at(motion)
        return [pairs[i] for i in self._limits(motion)[2]]

    def _limits(self, motion: RobotMotion) -> tuple[Array, Array, Indices]:
        """Directions of the rows, the limits of all balls of the distance, and the indices of those with a row."""
        y, rate, row, bias = self._distance.second_derivative(motion)
        speeds, acceleration = motion.v, self._acceleration
        ahead = max((np.abs(speeds) / acceleration).max(), _TINY)
        y = np.minimum(y + self._distance.margin, 0.0)
        slope = rate * ahead - (0.5 * _TURN_SHARE * ahead * ahead) * (np.abs(row) @ acceleration)
        bend = bias * (ahead * ahead)
        square = slope * slope - 2.0 * bend * y
        root = np.sqrt(np.maximum(square, 0.0))
        # The first zero, by whichever of two formulas has no cancellation; there is none where the square is below 0.
        rising = slope > 0.0
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            reached = np.where(rising, -2.0 * y / (slope + root), np.where(bend > 0.0, (root - slope) / bend, np.inf))
        share = np.sqrt(np.where(square < 0.0, np.inf, reached))
        own = speeds * (row != 0.0)
        speed = np.maximum(np.sqrt((own * own).sum(axis=1)), _TINY)
        limit = np.clip((np.minimum(share, _NO_LIMIT) - 1.0) * speed / self._period, -speed / ahead, None)
        worst = np.argpartition(limit, self._count - 1)[: self._count]
        return own[worst] / speed[worst, None], limit, worst
