"""Batch VRFT of a million samples: time, and memory of the process while it runs.

The memory is the peak of a process of its own that imports, makes the record and fits once.
"""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

# Found also when this file is run as a script, from a checkout.
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks._measure import Row, main, median_seconds

SAMPLES = 1_000_000
PERIOD = 0.002

_ONE_FIT = """
import resource
from benchmarks.vrft import SAMPLES, fit, record
fit(*record(SAMPLES))
print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3)
"""


def record(samples: int) -> tuple[Any, Any]:
    """Displacement and force of moves up to 4 mm on springs behind lags, with 0.02 N of noise."""
    import numpy as np
    from scipy.signal import lfilter

    rng = np.random.default_rng(0)
    targets = np.repeat(-1e-3 * rng.integers(0, 5, size=samples // 1000 + 1), 1000)[:samples]
    u = lfilter([0.02], [1.0, -0.98], targets)
    y = -5.9e3 * lfilter([0.025], [1.0, -0.975], lfilter([0.025], [1.0, -0.975], u))
    return u, y + 0.02 * rng.normal(size=samples)


def fit(u: Any, y: Any, *, prefilter: bool = True) -> Any:
    """A PID fit of the first-order model with 1.5 rad/s."""
    from forcectl.tuning.controller_basis import discrete_pid
    from forcectl.tuning.reference_model import first_order
    from forcectl.tuning.vrft import fit_vrft

    return fit_vrft(u, y, first_order(1.5, PERIOD), discrete_pid(PERIOD), prefilter=prefilter)


def benchmark(repeats: int) -> Iterator[Row]:
    u, y = record(SAMPLES)
    limit = "<= 1.5"
    yield Row("batch VRFT, PID, 1e6 samples", median_seconds(lambda: fit(u, y), repeats), "s", limit)
    plain = median_seconds(lambda: fit(u, y, prefilter=False), repeats)
    yield Row("the same without prefilter", plain, "s", limit)
    root = Path(__file__).resolve().parents[1]
    done = subprocess.run([sys.executable, "-c", _ONE_FIT], cwd=root, capture_output=True, text=True, check=True)
    yield Row("peak memory of a process that fits once", float(done.stdout), "MB", "<= 400")


if __name__ == "__main__":
    main("Batch VRFT", benchmark)
