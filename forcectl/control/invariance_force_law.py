"""Force control by set invariance without a nominal controller: relative degree 2, one step ahead (Sec. 3.2.2, 3.4)."""

from __future__ import annotations

from typing import Any

import numpy as np

from forcectl.lanes import Lane


def one_step_acceleration(y: Lane, rate: Lane, gamma: Lane, upper: Lane, period: float, m: Any = np) -> Lane:
    """The fastest acceleration y'' of a double integrator after which the constraint y <= 0 can still be kept.

    For y <= 0 it is the largest a in [gamma, upper] whose next state (y1, y1') = (y + Ts y' + Ts^2 a/2, y' + Ts a) can
    be brought to rest at 0 with decelerations within gamma that change at the ticks only; gamma if there is none. For
    y > 0 the same is done for (-y, -y'), with the opposite sign. (3.31)*, (3.33)*, (3.57), sampled

    The set of such states is a polygon: its corners lie on the parabola Phi = y - y'^2/(2 gamma) = 0 at speeds of whole
    multiples of -gamma Ts, and it is at most -gamma Ts^2/8 smaller. So Phi(y1, y1') <= 0 holds as well, and unlike on
    the parabola itself every braking ends exactly at rest: no chatter at the end.

    Args:
        y: constraint output, violated when positive. rate: y'. gamma: lower bound of y'' when braking, < 0.
        upper: largest y'' when accelerating, > 0. period: tick Ts [s]. m: numpy, or `SCALAR_MATH` for floats.
    """
    side = m.where(y > 0.0, -1.0, 1.0)
    speed_step = -gamma * period
    speed = side * rate / speed_step
    # In units of speed_step and speed_step * Ts: the corner of speed n is n (n + 1)/2 half steps ahead.
    ahead = -side * y / (speed_step * period) - 0.5 * speed
    n = m.floor(((1.0 + 8.0 * m.maximum(ahead, 0.0)) ** 0.5 - 1.0) * 0.5)
    next_speed = m.where(ahead < 0.0, 2.0 * ahead, n + (ahead - 0.5 * n * (n + 1.0)) / (n + 1.0))
    return side * m.minimum(m.maximum(-gamma * (next_speed - speed), gamma), upper)
