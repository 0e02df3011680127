"""Reproduction: experiments by variants by fidelities in parallel processes, the thesis' numbers beside ours.

Writes, under the output directory, one run directory per experiment and fidelity as soon as it has run, and with it
`summary.json`: {experiment: {target: {published, ours, deviation, tolerance, pass, expected, drift}}}. Targets of an
experiment that runs on several fidelities end in the fidelity, in brackets; `pass` is null for a value that is reported
but not judged there, `drift` for one without an expected number there.
"""

from __future__ import annotations

import multiprocessing
import os
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from forcectl.errors import BadInputError, ForcectlError
from forcectl.runs.directory import SUMMARY, write_json, write_whole
from forcectl.runs.run import StoppedRunError, check_overrides, finish, verdicts_on, with_shortcuts
from forcectl.runs.simulate import VariantOutcome, simulate
from forcectl.scenario.catalog import ScenarioFile, find_scenario
from forcectl.scenario.expectations import Verdict
from forcectl.scenario.scenario import Scenario, build, origins, resolve, select_variants

Progress = Callable[[str, float], None]  # (what, share done)


@dataclass(frozen=True)
class _Part:
    """One experiment on one fidelity: the unit of a run directory."""

    file: ScenarioFile
    fidelity: str
    overrides: dict[str, Any]
    scenarios: dict[str, Scenario]
    several: bool  # whether the experiment runs on several fidelities


@dataclass(frozen=True)
class PartReport:
    """One experiment on one fidelity, judged."""

    experiment: str
    title: str
    fidelity: str
    verdicts: list[Verdict]
    metrics: dict[str, dict[str, float | None]]


@dataclass(frozen=True)
class Reproduction:
    """All experiments, judged."""

    parts: list[PartReport] = field(default_factory=list)

    @property
    def passed(self) -> bool:
        """Whether no target was missed and no value has drifted from its expected number."""
        return not any(v.passed is False or v.drifted for part in self.parts for v in part.verdicts)

    def summary(self) -> dict[str, dict[str, dict[str, object]]]:
        """The content of `summary.json`."""
        result: dict[str, dict[str, dict[str, object]]] = {}
        for part in self.parts:
            result.setdefault(part.experiment, {}).update({v.target: v.as_row() for v in part.verdicts})
        return result


def reproduce(
    experiments: Iterable[str | Path],
    *,
    out: str | Path | None = None,
    fidelity: str | None = None,
    workers: int | None = None,
    force: bool = False,
    progress: Progress | None = None,
) -> Reproduction:
    """Run experiments and compare with their expectations.

    Args:
        experiments: names of shipped experiments or paths of scenario files.
        out: directory to write; None writes nothing.
        fidelity: this one only; otherwise the `fidelities` of each experiment.
        workers: processes; None: one per processor.
        force: replace an earlier reproduction in `out`.
        progress: called with the name of a part and the share of its variants that is done.

    Raises:
        BadInputError: an experiment cannot be used; nothing was run. A run that fails later is a failed row.
    """
    files = [find_scenario(name) for name in experiments]
    for name in (names := [file.name for file in files]):
        if names.count(name) > 1:
            raise BadInputError(
                f"experiments: two are called {name!r}: names must differ, they are folders of the output"
            )
    parts = [part for file in files for part in _parts(file, fidelity)]
    directory = None if out is None else Path(out).expanduser()
    if directory is not None:
        directory = write_whole(directory, lambda folder: write_json(folder / SUMMARY, {}), force)
    reports: dict[int, PartReport] = {}
    result = Reproduction()
    for i, outcomes in _simulate_all(parts, workers or os.cpu_count() or 1, progress):
        reports[i] = _report(parts[i], outcomes, directory)
        result = Reproduction([reports[k] for k in sorted(reports)])
        if directory is not None:
            write_json(directory / SUMMARY, result.summary())
    return result


def _parts(file: ScenarioFile, fidelity: str | None) -> list[_Part]:
    first = resolve(file, select_variants(file)[0])
    own = first.fidelities or [first.fidelity]
    # One that names a single fidelity can be realised in no other.
    fidelities = [fidelity] if fidelity and len(first.fidelities) != 1 else own
    parts = []
    for one in fidelities:
        overrides = with_shortcuts(None, None, one)
        scenarios = {name: resolve(file, name, overrides) for name in select_variants(file)}
        check_overrides(file, list(scenarios), overrides)
        parts.append(_Part(file, one, overrides, scenarios, len(fidelities) > 1))
    return parts


def _job(file: ScenarioFile, variant: str, overrides: Mapping[str, Any]) -> VariantOutcome | str:
    """One simulation in a worker process; a text when there is not even a log."""
    try:
        scenario = resolve(file, variant, overrides)
        # Diagrams and exceptions do not travel between processes.
        loop = build(scenario, origins(file, variant, overrides))
        return replace(simulate(scenario, loop, variant), diagram=None, cause=None)
    except ForcectlError as error:
        return str(error)
    except (Exception, SystemExit) as error:  # a row of the table, with the name of what went wrong
        return " ".join(f"{type(error).__name__}: {error}".split())


def _one_thread() -> None:
    # Many processes with many threads each are slower than with one.
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(name, "1")


def _pool(workers: int) -> ProcessPoolExecutor:
    return ProcessPoolExecutor(workers, mp_context=multiprocessing.get_context("spawn"), initializer=_one_thread)


def _simulate_all(
    parts: Sequence[_Part], workers: int, progress: Progress | None
) -> Iterator[tuple[int, dict[str, VariantOutcome | str]]]:
    """The number of every part and its outcomes by variant, as soon as the last of them is there."""
    results: defaultdict[int, dict[str, VariantOutcome | str]] = defaultdict(dict)
    jobs = [(i, variant) for i, part in enumerate(parts) for variant in part.scenarios]

    def submit(pool: ProcessPoolExecutor, i: int, variant: str) -> Future[VariantOutcome | str]:
        return pool.submit(_job, parts[i].file, variant, parts[i].overrides)

    def complete(i: int, variant: str, outcome: VariantOutcome | str) -> bool:
        results[i][variant] = outcome
        done, wanted = len(results[i]), len(parts[i].scenarios)
        if progress:
            progress(f"{parts[i].file.name} [{parts[i].fidelity}]", done / wanted)
        return done == wanted

    lost = []
    with _pool(max(1, min(workers, len(jobs)))) as pool:
        running = {submit(pool, *job): job for job in jobs}
        for future in as_completed(running):
            i, variant = running.pop(future)
            if isinstance(future.exception(), BrokenProcessPool):
                lost.append((i, variant))
            elif complete(i, variant, future.result()):
                yield i, results.pop(i)
    # One process that dies takes the others' work with it: repeat what was lost, each in a process of its own.
    for i, variant in lost:
        with _pool(1) as pool:
            try:
                outcome = submit(pool, i, variant).result()
            except BrokenProcessPool:
                outcome = "the process ended unexpectedly"
        if complete(i, variant, outcome):
            yield i, results.pop(i)


def _report(part: _Part, outcomes: Mapping[str, VariantOutcome | str], out: Path | None) -> PartReport:
    """A part judged, and written to its directory under `out`."""
    rows = []
    for name in part.scenarios:
        outcome = outcomes[name]
        failure = outcome if isinstance(outcome, str) else outcome.failure
        if failure is not None:
            rows.append(Verdict(f"run of {name!r}", None, None, None, "must complete", False, failure))
    simulated = [outcome for name in part.scenarios if isinstance(outcome := outcomes[name], VariantOutcome)]
    done = [outcome for outcome in simulated if outcome.failure is None]
    rows += verdicts_on(part.file, part.scenarios, done)
    if simulated and out is not None:
        try:
            directory = out / part.file.name / part.fidelity
            finish(part.file, part.scenarios, simulated, directory, overrides=part.overrides)
        except StoppedRunError:
            pass  # it is written beside, and a row already
        except Exception as error:  # what cannot be drawn is a row, and costs no other result
            why = " ".join(f"{type(error).__name__}: {error}".split())
            rows.append(Verdict("results", None, None, None, "must be written", False, why))
    if part.several:
        rows = [replace(row, target=f"{row.target} [{part.fidelity}]") for row in rows]
    title = next(iter(part.scenarios.values())).title
    metrics = {outcome.variant: outcome.metrics for outcome in done}
    return PartReport(part.file.name, title, part.fidelity, rows, metrics)
