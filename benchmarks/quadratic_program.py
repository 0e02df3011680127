"""Solving one quadratic program, by solver: what decides which one `forcectl.qp.solvers` takes.

Programs of the size of a robot controller (6 variables) and of a dual arm (14), with other coefficients at every tick,
through the same layer, checks included.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

# Found also when this file is run as a script, from a checkout.
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks._measure import Row, main

PROGRAMS = 300
SIZES = ((6, 20), (14, 30))


def benchmark(repeats: int) -> Iterator[Row]:
    import numpy as np
    from pydrake import solvers

    from forcectl.qp.quadratic_program import QuadraticProgram, Status
    from forcectl.qp.solvers import DaqpPackage, Solver, drake_daqp, make_solver

    in_use = "Drake's DAQP" if hasattr(solvers, "DaqpSolver") else "daqp package"
    kinds: dict[str, Solver] = {"daqp package": DaqpPackage(), "Drake's Clarabel": make_solver("clarabel")}
    if hasattr(solvers, "DaqpSolver"):
        kinds = {"Drake's DAQP": drake_daqp()} | kinds
    for n, m in SIZES:
        rng = np.random.default_rng(1)
        root, rows, cost = rng.normal(size=(n, n)), rng.normal(size=(m, n)), rng.normal(size=n)
        # A slow change from tick to tick, a few active rows.
        programs: list[Any] = [
            (root @ root.T + (0.1 + 1e-3 * k) * np.eye(n), cost + 0.05 * rng.normal(size=n), rows, rng.random(m) + 0.1)
            for k in range(PROGRAMS)
        ]
        exact = _solutions(QuadraticProgram(n, m), programs)
        for name, kind in kinds.items():
            program = QuadraticProgram(n, m, solver=kind)
            error = float(np.abs(_solutions(program, programs) - exact).max())
            spent = np.empty((repeats, PROGRAMS))
            for row in spent:
                for k, (hessian, gradient, matrix, upper) in enumerate(programs):
                    started = time.perf_counter()
                    solution = program.solve(hessian, gradient, matrix, upper, fallback=np.zeros(n))
                    row[k] = time.perf_counter() - started
                    assert solution.status is Status.OPTIMAL
            p50, p99 = (float(np.median(np.percentile(spent, share, axis=1))) for share in (50, 99))
            note = "in use with this Drake" if name == in_use else f"differs from the one in use by {error:.0e}"
            yield Row(f"{n} variables, {m} rows, {name}, p50", 1e6 * p50, "us", note=note)
            yield Row(f"{n} variables, {m} rows, {name}, p99", 1e6 * p99, "us")


def _solutions(program: Any, programs: list[Any]) -> Any:
    import numpy as np

    return np.array([program.solve(*numbers, fallback=np.full(len(numbers[1]), np.nan)).u for numbers in programs])


if __name__ == "__main__":
    main("Quadratic programs", benchmark)
