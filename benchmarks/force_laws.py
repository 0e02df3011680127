"""Time per tick of the scalar force laws, a batch of one each, in a diagram that does nothing else.

The force changes at every tick, as in a loop. The time of the same diagram without a law is subtracted.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

# Found also when this file is run as a script, from a checkout.
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks._measure import Row, main
from benchmarks._ticks import Case, tick_rows, under_a_decaying_force

COMPLIANCE = 2e-4


def benchmark(repeats: int) -> Iterator[Row]:
    from forcectl.force.integral import IntegralForceLaw
    from forcectl.force.invariance.correction import InvarianceControl, InvarianceCorrection
    from forcectl.force.invariance.force_law import InvarianceForceLaw
    from forcectl.force.invariance.fourth_degree import FourthDegreeForceLaw

    def integral() -> IntegralForceLaw:
        return IntegralForceLaw(1, integral_gain=3.0, compliance=COMPLIANCE)

    laws: dict[str, Case] = {
        "without a law": (None, ""),
        "integral": (integral, ""),
        "invariance [57]": (lambda: InvarianceForceLaw(1, compliance=COMPLIANCE), "<= 20"),
        "invariance control [56], with its integral law": (
            lambda: InvarianceControl(integral(), InvarianceCorrection(1, compliance=COMPLIANCE)),
            "",
        ),
        "invariance of degree 4": (
            lambda: FourthDegreeForceLaw(1, gamma=-1e5, alpha=3.0, bandwidth=12.6, compliance=COMPLIANCE),
            "",
        ),
    }
    yield from tick_rows(laws, lambda make: under_a_decaying_force(make, "displacement_command"), repeats)


if __name__ == "__main__":
    main("Force laws", benchmark)
