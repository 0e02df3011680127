"""Time per tick of the command governor, a batch of one, in a diagram that does nothing else.

The force changes at every tick, as in a loop. The time of the same diagram without a governor is subtracted.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

# Found also when this file is run as a script, from a checkout.
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks._measure import Row, main
from benchmarks._ticks import Case, tick_rows, under_a_decaying_force


def benchmark(repeats: int) -> Iterator[Row]:
    from forcectl.force.governor.governor import CommandGovernor

    governors: dict[str, Case] = {
        "without a governor": (None, ""),
        "closed form, delay of 40 ticks": (lambda: CommandGovernor(1), "<= 20"),
        "closed form with limits": (lambda: CommandGovernor(1, upper_limit=40.0, rate_limit=1e3), ""),
        "closed form, delay of 160 ticks": (lambda: CommandGovernor(1, delay=0.32), ""),
        "quadratic program, horizon of 10 ticks": (lambda: CommandGovernor(1, horizon=10, upper_force=25.0), ""),
    }
    yield from tick_rows(governors, lambda make: under_a_decaying_force(make, "governed_reference", (20.0,)), repeats)


if __name__ == "__main__":
    main("Command governor", benchmark)
