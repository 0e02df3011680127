"""The check of a real-time rate. Nothing here loads Drake."""

from __future__ import annotations

from forcectl.errors import invalid

_SLOWEST, _FASTEST = 0.001, 1000.0  # simulated seconds per second


def check_realtime_rate(rate: float, name: str) -> float:
    """The rate, checked.

    Args:
        rate: simulated seconds per second; 0: as fast as possible.
        name: of the option or argument, for the message.

    Raises:
        BadInputError: the rate is neither 0 nor from 0.001 to 1000.
    """
    if rate != 0 and not _SLOWEST <= rate <= _FASTEST:  # true for NaN, too
        raise invalid(name, rate, f"0 for full speed, or from {_SLOWEST:g} to {_FASTEST:g}")
    return rate
