"""Start-up: importing forcectl, the command line's help, building the loops.

Each import is timed in a process of its own. What forcectl adds to Drake is the difference of two medians: importing
the modules a run needs, and importing those parts of Drake and NumPy alone that they import.
"""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from functools import partial
from pathlib import Path

# Found also when this file is run as a script, from a checkout.
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks._measure import Row, interleaved_medians, main, median_seconds

# The modules of others that `forcectl.runs.run` ends up with, asked of the interpreter and not written down.
_OTHERS = (
    "import sys, forcectl.runs.run; "
    "print(','.join(sorted(m for m in sys.modules if m.startswith('pydrake.') and '_' not in m)))"
)


def _process(code: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True)


def benchmark(repeats: int) -> Iterator[Row]:
    drake = ",".join(_process(_OTHERS).stdout.strip().split(","))
    nothing, bare, package, alone, whole = interleaved_medians(
        [
            lambda: _process("pass"),
            lambda: _process("import forcectl, forcectl.cli"),
            lambda: _process("import forcectl"),
            lambda: _process(f"import numpy, scipy.linalg, {drake}"),
            lambda: _process("import forcectl.runs.run"),
        ],
        repeats,
    )
    yield Row("import forcectl", package - nothing, "s", note="no Drake yet")
    yield Row("import forcectl.cli", bare - nothing, "s", note="no Drake yet")
    yield Row("import Drake and NumPy alone", alone - nothing, "s")
    yield Row("import all a run needs, beyond Drake", whole - alone, "s")
    run_help = "import sys; sys.argv = ['forcectl', '--help']; from forcectl.cli import main; main()"
    yield Row("forcectl --help", median_seconds(lambda: _process(run_help), repeats), "s", "<= 0.5")

    from benchmarks._loops import SHIPPED_FIDELITIES, build, build_scalar

    yield Row("build the 1-D loop", 1e3 * median_seconds(build_scalar, repeats), "ms")
    for fidelity in SHIPPED_FIDELITIES:
        yield Row(f"build {fidelity}", 1e3 * median_seconds(partial(build, fidelity), repeats), "ms")


if __name__ == "__main__":
    main("Start-up", benchmark)
