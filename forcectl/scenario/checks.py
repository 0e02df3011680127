"""Checks that scenarios of every loop share."""

from __future__ import annotations

from forcectl.errors import invalid
from forcectl.framework.batch import check

LONGEST_DURATION = 86_400.0  # [s]


def check_run(duration: float, seed: int) -> None:
    """Whether a run of `duration` [s] with this seed can be made.

    Raises:
        BadInputError: it cannot.
    """
    if check("duration", duration, "positive") > LONGEST_DURATION:
        raise invalid("duration", duration, f"at most {LONGEST_DURATION:g} s")
    if not 0 <= seed < 2**63:
        raise invalid("seed", seed, "a whole number from 0 to 2^63 - 1")
