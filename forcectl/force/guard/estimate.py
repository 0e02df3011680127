"""Bandwidth of the estimate of the true force behind its sensor's lag, and what the sensor's readings can show."""

from __future__ import annotations

import math

_AHEAD = 32.0  # largest bandwidth of the estimate, in bandwidths of the sensor
_FASTEST = 0.8  # largest bandwidth of the estimate, times a tick
_COMPENSATED = 0.8  # compensated share of the sensor's lag: with 1, a rise that the law ends itself is overestimated
_NEVER = 1e-9  # probability of equal readings in a row below which a live sensor does not show them
_QUIET = 0.04  # standard deviation of a predicted force, as a share of the largest force


def estimate_of(
    bandwidth: float, damping_ratio: float, period: float, most: float = math.inf
) -> tuple[float, float, float]:
    """The coefficients (lag, square, share) of `GuardLimits` for a sensor.

    Args:
        bandwidth: w [rad/s].
        damping_ratio: z [1].
        period: Ts [s].
        most: largest bandwidth a of the estimate, see `quiet_bandwidth` [rad/s].
    """
    ahead = min(_AHEAD, _FASTEST / (bandwidth * period), most / bandwidth)
    if ahead < 1.0:
        return 0.0, 0.0, 1.0
    ticks = ahead * bandwidth * period
    lead = _COMPENSATED * ahead
    return 2 * damping_ratio * lead, lead**2, ticks / (1.0 + ticks)  # of a filter with the lag 1/a on a ramp


def quiet_bandwidth(noise: float, force: float, ahead: float, period: float) -> float:
    """Bandwidth a of the estimate [rad/s] at which the noise of a predicted force stays small.

    White noise of the readings behind T_r s/(s/a + 1)^3 has the standard deviation sigma T_r sqrt(a^3 Ts)/4.

    Args:
        noise: sigma, standard deviation per tick [N].
        force: largest true force [N].
        ahead: T_r [s].
        period: Ts [s].
    """
    if noise * ahead == 0.0:
        return math.inf
    return float((4 * _QUIET * force / (noise * ahead * math.sqrt(period))) ** (2 / 3))


def largest_jump(bandwidth: float, period: float, force: float) -> float:
    """Largest second difference of readings [N] that the filter of a sensor can show.

    Args:
        bandwidth: w [rad/s].
        period: Ts [s].
        force: R [N].
    """
    return 4.0 * force * (bandwidth * period) ** 2 if bandwidth * period < 0.5 else math.inf


def live_repeats(noise: float, quantum: float, bandwidth: float, period: float) -> float:
    """Equal readings in a row that a live sensor does not show; infinite without noise [ticks].

    With noise in front of a filter every reading differs from the last one. Without a filter, readings of a force in
    the middle of a quantisation step stay the same with the probability that the noise does not leave the step.

    Args:
        noise: standard deviation per tick [N].
        quantum: step of the readings [N].
        bandwidth: w of the filter [rad/s].
        period: Ts [s].
    """
    if noise > quantum / 4 and bandwidth * period < 1.0:
        return 0.0
    stays = math.erf(quantum / (math.sqrt(8) * noise)) if noise > 0.0 else 1.0
    return math.inf if stays == 1.0 else math.log(_NEVER) / math.log(stays) if stays > 0.0 else 0.0
