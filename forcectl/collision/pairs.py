"""Distances and approach speeds of balls and cores: the pairs of a robot's shapes as arrays.

See `forcectl.collision.shapes` for balls and cores. The balls of a solid are divided into rows, called groups; a pair
is a group and a core. Which pairs are evaluated is decided by the distance of the middle of the row from the core, its
velocity, and the slope of the distance along the row.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from forcectl.arrays import Array, Indices
from forcectl.collision.shapes import RobotShapes, Solid, cover
from forcectl.errors import BadInputError
from forcectl.robot.joint_tree import TreeState

_TINY = 1e-9  # [m]
# V -> the matrix M with x M = w x x, for row vectors x.
_TURN = np.zeros((6, 9))
for _i, _j, _k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
    _TURN[_i, 3 * _j + _k], _TURN[_i, 3 * _k + _j] = 1.0, -1.0
# V -> the matrix that maps points of a body, in homogeneous coordinates, to their velocities.
_MOVING = np.zeros((6, 16))
_MOVING.reshape(6, 4, 4)[:, :3, :3] = _TURN.reshape(6, 3, 3).swapaxes(1, 2)
_MOVING.reshape(6, 4, 4)[3:, :3, 3] = np.eye(3)


class NearBalls(NamedTuple):
    """The balls of p pairs of a group and a core; vectors in W unless said otherwise.

    Attributes:
        pair: indices of the pairs in the `PairTable`, (p,).
        R: axes of the core in W, (p, 3, 3).
        x: centres of the balls, (p, b, 3) [m].
        over: distance of x beyond the box along each of its axes, negative within, (p, b, 3) [m].
        gap: distance from the box to x, negative inside, (p, b) [m].
        normal: unit vector from the box to x, (p, b, 3).
        w: velocity of x relative to the core's link, (p, b, 3) [m/s].
        distance: between ball and core, infinite for a copy of a ball, (p, b) [m].
    """

    pair: Indices
    R: Array
    x: Array
    over: Array
    gap: Array
    normal: Array
    w: Array
    distance: Array


class PairTable:
    """Arrays of g groups of b balls each, filled up with copies, of c cores, and of p pairs of a group and a core.

    Args:
        shapes: shapes and their pairs.
        tolerance, box_tolerance: see `cover` [m].

    Attributes:
        group_link: link of each group, (g,).
        balls: centres on the link, (g, b, 3) [m].
        real: whether a ball is not a copy, (g, b).
        core_link: link of each core, (c,).
        X_LC: pose of each core on its link, (c, 4, 4).
        half: half the size of each core's box, (c, 3) [m].
        core_radius: radius of each core around its box, (c,) [m].
        pair_group, pair_core: group and core of each pair, (p,).
        pair: index of each pair in `shapes.pairs`, (p,).
        on_ball, on_core: links of group and core of each pair, (p,).
        moves: 1 for the joints that move the ball and not the core, -1 for those that move the core alone, else 0, (p,
            n).
        flat: whether the core's box has no extent, in each direction, (p, 3).

    Raises:
        BadInputError: there are no pairs.
    """

    def __init__(self, shapes: RobotShapes, tolerance: float, box_tolerance: float):
        if not shapes.pairs:
            raise BadInputError("collision shapes: there is no pair of shapes that move against each other")
        solids = shapes.solids
        balls = [cover(solid, tolerance, box_tolerance) for solid in solids]
        # A box is the core of its pair; otherwise the solid with more balls is.
        ranks = [(solid.is_box, sum(map(len, each.rows))) for solid, each in zip(solids, balls, strict=True)]
        as_balls = [(a, b) if ranks[a] <= ranks[b] else (b, a) for a, b in shapes.pairs]
        groups: dict[int, list[int]] = {}
        self._groups: list[tuple[Solid, Array, float]] = []
        for i in sorted({covered for covered, _ in as_balls}):
            rows = balls[i].rows
            groups[i] = list(range(len(self._groups), len(self._groups) + len(rows)))
            self._groups += [(solids[i], row, balls[i].radius) for row in rows]
        cores = sorted({core for _, core in as_balls})
        entries = [
            (group, cores.index(core), k) for k, (covered, core) in enumerate(as_balls) for group in groups[covered]
        ]
        self.pair_group, self.pair_core, self.pair = np.array(entries, dtype=np.intp).T.copy()
        self.core_link = np.array([solids[i].link for i in cores], dtype=np.intp)
        self.X_LC = np.array([solids[i].X_LC for i in cores])
        self.half = np.array([solids[i].half for i in cores])
        self.core_radius = np.array([solids[i].radius for i in cores])
        self._fill_groups()
        self._all = np.arange(len(self.pair))
        self.on_ball, self.on_core = self.group_link[self.pair_group], self.core_link[self.pair_core]
        # Index of the velocity of a pair's row, if it moved with the link of the ball, and with that of the core.
        self._by_ball = self.on_ball * len(self.group_link) + self.pair_group
        self._by_core = self.on_core * len(self.group_link) + self.pair_group
        self.moves = shapes.tree.moves[self.on_ball] - shapes.tree.moves[self.on_core]
        self.flat = (self.half == 0.0)[self.pair_core]
        self._pair_radii = self._ball_radius[self.pair_group] + self.core_radius[self.pair_core]
        self._radii = np.where(self.real[self.pair_group], self._pair_radii[:, None], -np.inf)
        self._pair_half = self.half[self.pair_core]

    def _fill_groups(self) -> None:
        size = max(len(centres) for _, centres, _ in self._groups)
        self.group_link = np.array([solid.link for solid, _, _ in self._groups], dtype=np.intp)
        self._ball_radius = np.array([radius for _, _, radius in self._groups])
        self.balls = np.empty((len(self._groups), size, 3))
        self.real = np.zeros((len(self._groups), size), dtype=bool)
        for i, (solid, centres, _) in enumerate(self._groups):
            on_link = centres @ solid.X_LC[:3, :3].T + solid.X_LC[:3, 3]
            self.balls[i] = on_link[np.minimum(np.arange(size), len(centres) - 1)]
            self.real[i, : len(centres)] = True
        # Each row as a segment: the columns [half of it, its middle], which X_WL maps to W.
        first, last = self.balls[:, 0], self.balls[:, -1]
        self._segment = np.zeros((len(first), 4, 2))
        self._segment[:, :3, 0], self._segment[:, :3, 1] = 0.5 * (last - first), 0.5 * (last + first)
        self._segment[:, 3, 1] = 1.0

    def near(self, state: TreeState, count: int, minimum: float, gamma: float) -> NearBalls:
        """The balls of the `count` pairs with the least `speed_left`, in ascending order of the pairs."""
        X_WL, V = state.X_WL, state.link_velocities
        X_WC = X_WL.take(self.core_link, 0) @ self.X_LC
        pair = self._all
        if count < len(self.pair):
            pair = np.sort(np.argpartition(self._speed_left(X_WL, X_WC, V, minimum, gamma), count)[:count])
        group, core, on_ball = self.pair_group.take(pair), self.pair_core.take(pair), self.on_ball.take(pair)
        X_WB, X = X_WL.take(on_ball, 0), X_WC.take(core, 0)
        R = X[:, :3, :3]
        x = self.balls.take(group, 0) @ X_WB[:, :3, :3].swapaxes(1, 2) + X_WB[:, None, :3, 3]
        local = (x - X[:, None, :3, 3]) @ R
        over = np.abs(local) - self.half.take(core, 0)[:, None]
        beside = np.maximum(over, 0.0)
        gap = np.sqrt(np.einsum("pbi,pbi->pb", beside, beside))
        unit = gap[:, :, None]
        if not gap.all():  # a centre is inside the box: the normal is that of the nearest face
            inside = gap == 0.0
            beside[inside] = np.eye(3)[over[inside].argmax(axis=1)]
            unit = np.where(inside, 1.0, gap)[:, :, None]
            gap = np.where(inside, over.max(axis=2), gap)
        normal = np.copysign(beside / unit, local) @ R.swapaxes(1, 2)
        relative = V.take(on_ball, 0) - V.take(self.on_core.take(pair), 0)
        w = x @ (relative @ _TURN).reshape(-1, 3, 3) + relative[:, None, 3:]
        return NearBalls(pair, R, x, over, gap, normal, w, gap - self._radii.take(pair, 0))

    def _speed_left(self, X_WL: Array, X_WC: Array, V: Array, minimum: float, gamma: float) -> Array:
        """Estimate of the least `speed_left` of the balls of each pair, (p,) [m/s]."""
        rows = X_WL.take(self.group_link, 0) @ self._segment
        # Velocity of the middle of every row, if it moved with each of the links, (links, g, 4).
        moving = ((V @ _MOVING).reshape(-1, 4) @ rows[:, :, 1].T).reshape(len(V), 4, -1).swapaxes(1, 2).reshape(-1, 4)
        # Of each pair, relative to the core and in its axes: half of the row, its middle, and the middle's velocity.
        X, local = X_WC.take(self.pair_core, 0), np.empty((len(self.pair), 3, 3))
        local[:, :, :2] = rows.take(self.pair_group, 0)[:, :3]
        local[:, :, 1] -= X[:, :3, 3]
        local[:, :, 2] = (moving.take(self._by_ball, 0) - moving.take(self._by_core, 0))[:, :3]
        local = X[:, :3, :3].swapaxes(1, 2) @ local
        beside = np.maximum(np.abs(local[:, :, 1]) - self._pair_half, 0.0)
        gap = np.sqrt(np.einsum("pi,pi->p", beside, beside))
        normal = np.copysign(beside, local[:, :, 1])
        slope, rate = np.einsum("pi,pij->jp", normal, local[:, :, ::2]) / np.maximum(gap, _TINY)
        # The distance is convex along the row: the tangent at its middle is a lower bound at its ends.
        return speed_left(gap - np.abs(slope) - self._pair_radii - minimum, rate, gamma)


def speed_left(spare: Array, rate: Array, gamma: float) -> Array:
    """By how much faster a distance may shrink before braking at gamma would be too late [m/s].

    Args:
        spare: distance above the minimum [m].
        rate: rate of the distance [m/s].
        gamma: braking, < 0 [m/s^2].
    """
    return np.copysign(np.sqrt(np.abs(spare) * (-2.0 * gamma)), spare) + rate
