"""What the benchmark programs share: one thread, repeats and medians, a table with required beside measured, JSON.

Import this before anything that imports NumPy: the number of threads is read once.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from typing import Any

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[_name] = "1"


@dataclass(frozen=True)
class Row:
    """One measured number."""

    what: str
    value: float
    unit: str
    required: str = ""  # ">= 150" or "<= 3"; empty: only reported
    goal: str = ""  # wished for, not required
    note: str = ""

    @property
    def met(self) -> bool | None:
        """Whether the requirement is met; None when there is none."""
        if not self.required:
            return None
        sign, limit = self.required.split()
        return self.value >= float(limit) if sign == ">=" else self.value <= float(limit)


Benchmark = Callable[[int], Iterator[Row]]


def seconds(work: Callable[[], Any], clock: Callable[[], float] = time.perf_counter) -> float:
    """How long `work` takes by a clock [s]."""
    started = clock()
    work()
    return clock() - started


def median_seconds(work: Callable[[], Any], repeats: int) -> float:
    """Median time of `work` [s], after one run that does not count."""
    work()
    return statistics.median(seconds(work) for _ in range(repeats))


def interleaved_medians(
    works: Sequence[Callable[[], Any]], repeats: int, clock: Callable[[], float] = time.perf_counter
) -> list[float]:
    """Median time of each of `works` [s], run in turns so that a disturbance of the machine meets all of them."""
    for work in works:
        work()
    times: list[list[float]] = [[] for _ in works]
    for _ in range(repeats):
        for work, found in zip(works, times, strict=True):
            found.append(seconds(work, clock))
    return [statistics.median(found) for found in times]


def main(title: str, benchmark: Benchmark, repeats: int = 5) -> None:
    """Run one benchmark program: `--repeats N`, `--json`; exits 1 when a requirement is missed."""
    parser = argparse.ArgumentParser(description=title)
    parser.add_argument("--repeats", type=int, default=repeats, help=f"runs to take the median of (default {repeats})")
    parser.add_argument("--json", action="store_true", help="print JSON instead of a table")
    arguments = parser.parse_args()
    report(title, list(benchmark(max(1, arguments.repeats))), arguments.json)


def report(title: str, rows: Sequence[Row], as_json: bool) -> None:
    """Print measured rows; exits 1 when a requirement is missed."""
    if as_json:
        print(json.dumps([asdict(row) | {"met": row.met} for row in rows], indent=2))
    else:
        _print_table(title, rows)
    if any(row.met is False for row in rows):
        raise SystemExit(1)


def _print_table(title: str, rows: Sequence[Row]) -> None:
    from rich.console import Console
    from rich.table import Table

    table = Table(title=f"{title} (load {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores)", title_justify="left")
    for name, justify in (("", "left"), ("measured", "right"), ("", "left"), ("required", "right"), ("goal", "right")):
        table.add_column(name, justify=justify)  # type: ignore[arg-type]
    table.add_column("")
    table.add_column("note", style="dim")
    for row in rows:
        verdict = {None: "", True: "[green]met[/]", False: "[red]missed[/]"}[row.met]
        table.add_row(row.what, f"{row.value:.3g}", row.unit, row.required, row.goal, verdict, row.note)
    Console(width=None if os.isatty(1) else 150).print(table)
