"""Reproduction: all variants and fidelities of experiments in parallel processes, compared with the thesis' numbers.

Writes, under the output directory, one run directory per experiment and fidelity as soon as it has run, and with it
`summary.json`: {experiment: {target: {published, ours, deviation, tolerance, pass, expected, drift}}}. Targets of an
experiment that runs on several fidelities end in the fidelity, in brackets; `pass` is null for a value that is reported
but not judged there, `drift` for one without an expected number there. A target that is known to be missed has the
reason as `gap`; a gap whose target is met is reported as out of date. At the end `report.html` shows all with figures.
"""

from __future__ import annotations

import contextlib
import os
import shutil
from collections import Counter, defaultdict, deque
from collections.abc import Callable, Generator, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from forcectl.errors import BadInputError, ForcectlError, one_line
from forcectl.interrupts import Interrupts
from forcectl.runs.chosen import Chosen, choose
from forcectl.runs.claims.claim import Claim, Numbered, Place, claimed
from forcectl.runs.claims.kept import kept
from forcectl.runs.claims.lock import StorageError, locked, writing
from forcectl.runs.directory import INTERRUPTED, SUMMARY, is_complete, made_alike, made_of, write_json
from forcectl.runs.pages.reproduction import write_page
from forcectl.runs.result import StoppedRunError
from forcectl.runs.run import finish, keep_variant, verdicts_on
from forcectl.runs.simulate import VariantOutcome, simulate
from forcectl.runs.stored import read_run
from forcectl.runs.workers import EndedTask, Workers, check_can_be_sent
from forcectl.scenario.catalog import ScenarioFile
from forcectl.scenario.expectations import Verdict
from forcectl.scenario.scenario import ONE_SCENARIO, Named, as_file, build, origins, resolve

Progress = Callable[[str, float], None]  # (name of a part, share done)
_DEATHS = 2  # deaths of the process of a variant, after which it is a failed row


@dataclass(frozen=True)
class _Part:
    """One experiment on one fidelity, which has a run directory of its own."""

    chosen: Chosen
    fidelity: str
    several: bool  # whether the experiment runs on several fidelities

    @property
    def name(self) -> str:
        """Name of the experiment."""
        return self.chosen.file.name


@dataclass(frozen=True)
class PartReport:
    """One experiment on one fidelity, judged."""

    experiment: str
    title: str
    fidelity: str
    verdicts: list[Verdict]
    metrics: dict[str, dict[str, float | None]]


@dataclass(frozen=True, repr=False)
class Reproduction:
    """All experiments, judged.

    Attributes:
        directory: of the results; None where they were not written.
        notes: remarks on an earlier reproduction that this one continues.
    """

    parts: list[PartReport] = field(default_factory=list)
    directory: Path | None = None
    notes: list[str] = field(default_factory=list)

    @property
    def passed(self) -> bool:
        """Whether only known gaps are missed, all of them are, and no value has drifted from its expected number."""
        return not any(v.surprising or v.stale or v.drifted for part in self.parts for v in part.verdicts)

    def __repr__(self) -> str:
        judged = [v.passed for part in self.parts for v in part.verdicts if v.passed is not None]
        place = f" in {self.directory}" if self.directory else ""
        return f"<reproduction of {len(self.parts)} runs: {sum(judged)} of {len(judged)} targets met{place}>"

    def summary(self) -> dict[str, dict[str, dict[str, object]]]:
        """The content of `summary.json`."""
        result: dict[str, dict[str, dict[str, object]]] = {}
        for part in self.parts:
            result.setdefault(part.experiment, {}).update({v.target: v.as_row() for v in part.verdicts})
        return result


def reproduce(
    experiments: Named | Iterable[Named],
    *,
    variant: str | None = None,
    overrides: Mapping[str, Any] | None = None,
    seed: int | None = None,
    fidelity: str | None = None,
    allow_imports: Sequence[str] = (),
    out: Place | None = None,
    workers: int | None = None,
    force: bool = False,
    resume: bool = False,
    progress: Progress | None = None,
) -> Reproduction:
    """Run experiments and compare with their expectations.

    Args:
        experiments: one, or several: names, paths, mappings or `Scenario`s, see `load_scenario`.
        variant: this one only, with the expectations that are about it alone.
        overrides, seed, allow_imports: of every experiment, see `load_scenario`.
        fidelity: this one only; otherwise the `fidelities` of each experiment.
        out: directory to write, reserved for this process from now on. None writes nothing.
        workers: processes; None: one per processor.
        force: replace an earlier reproduction in `out`.
        resume: continue the one in `out`: finished experiments are not run again, failed ones are.
        progress: called with the name of a part and the share of its variants that is done.

    Raises:
        BadInputError: an experiment or the directory cannot be used; nothing was run. A run that fails later is a
            failed row.
        StorageError: the directory cannot be written any more; finished experiments are kept.
        InterruptedReproductionError: Ctrl-C; finished experiments are kept.
    """
    several = [experiments] if isinstance(experiments, ONE_SCENARIO) else experiments
    files = [as_file(one, allow_imports) for one in several]
    for name in (names := [file.name for file in files]):
        if names.count(name) > 1:
            raise BadInputError(
                f"experiments: two are called {name!r}: names must differ, they are folders of the output"
            )
    parts = [part for file in files for part in _parts(file, variant, overrides, seed, fidelity)]
    if resume and (out is None or isinstance(out, Numbered)):
        raise BadInputError("resume: goes with the directory of a reproduction that was stopped")
    check_can_be_sent([(part.chosen.file, part.chosen.changes) for part in parts], "or run it with fc.run")
    work = None
    with contextlib.ExitStack() as stack:
        try:
            with Interrupts() as interrupts:
                directory = None if out is None else _opened(out, force, resume, stack)
                work = _Work(parts, directory, progress)
                stack.callback(work.close)
                if resume:
                    work.take_up()
                done = stack.enter_context(
                    contextlib.closing(_simulate_all(parts, work.jobs(), workers or os.cpu_count() or 1))
                )
                for i, variant, outcome in done:
                    interrupts.check()
                    work.take(i, variant, outcome)
                if directory is not None:
                    write_page(directory, work.result())
        except KeyboardInterrupt:
            stack.close()
            raise _interrupted(work, len(parts)) from None
        except StorageError as error:
            stack.close()
            kept = f"{len(work.reports)} of {len(parts)} had finished" if work else "nothing was kept"
            raise StorageError(f"{error}; {kept}") from error
        return work.result()


def _opened(out: Place, force: bool, resume: bool, stack: contextlib.ExitStack) -> Path:
    """The directory of a reproduction, reserved for this process."""
    if resume:
        directory = Path(os.path.expanduser(str(out)))
        if not (directory / SUMMARY).is_file():
            raise BadInputError(f"{str(directory)!r} is not the directory of a reproduction: run it without resume")
        stack.enter_context(locked(directory))
        return directory
    with claimed(out, force) as claim:
        directory = claim.write(lambda folder: write_json(folder / SUMMARY, {}))
        stack.enter_context(locked(directory))
    return directory


class _Work:
    """A running reproduction.

    Args:
        parts: to be run.
        directory: of the results; None: they are not written.
        progress: see `reproduce`.

    Attributes:
        reports: of the parts that have finished, by number.
        kept: whether variants of unfinished parts are kept; set by `close`.
    """

    def __init__(self, parts: Sequence[_Part], directory: Path | None, progress: Progress | None):
        self.directory, self.reports, self.kept = directory, dict[int, PartReport](), False
        self._parts, self._progress, self._notes = parts, progress, list[str]()
        self._outcomes: defaultdict[int, dict[str, VariantOutcome | str]] = defaultdict(dict)
        self._claims: dict[int, Claim] = {}

    def jobs(self) -> list[tuple[int, str]]:
        """The simulations that are left: number of the part, and variant."""
        return [
            (i, variant)
            for i, part in enumerate(self._parts)
            if i not in self.reports
            for variant in part.chosen.scenarios
            if variant not in self._outcomes[i]
        ]

    def result(self) -> Reproduction:
        """The result up to now."""
        reports = [self.reports[i] for i in sorted(self.reports)]
        return Reproduction(reports, self.directory, self._notes)

    def take_up(self) -> None:
        """Take over what an earlier reproduction of the same experiments and versions had finished."""
        for i, part in enumerate(self._parts):
            folder = self._folder(i)
            if is_complete(folder) and made_alike((stored := read_run(folder)).manifest, made_of(part.chosen.text)):
                self.reports[i] = _part_report(part, stored.verdicts, stored.metrics)
                continue
            claim = self._claim(i)
            for one in kept(folder.with_name(folder.name + INTERRUPTED)):
                name = one.outcome.variant
                if name in part.chosen.scenarios and one.made_of == part.chosen.made_of(name):
                    self._outcomes[i][name] = one.outcome
                    self._keep(i, claim, name)
        variants = sum(map(len, self._outcomes.values()))
        more = f", and {variants} variants of others" if variants else ""
        self._notes.append(f"{len(self.reports)} of {len(self._parts)} had finished before{more}: not run again")
        self._write()

    def take(self, i: int, variant: str, outcome: VariantOutcome | str) -> None:
        """Keep a simulated variant; after the last one of a part, judge and write the part."""
        part, outcomes = self._parts[i], self._outcomes[i]
        outcomes[variant], count = outcome, len(part.chosen.scenarios)
        if self._progress:
            self._progress(f"{part.name} [{part.fidelity}]", len(outcomes) / count)
        claim = None if self.directory is None else self._claim(i)
        if len(outcomes) < count:
            if claim is not None:
                self._keep(i, claim, variant)
            return
        self.reports[i] = _report(part, self._outcomes.pop(i), claim)
        if claim is not None:
            self._claims.pop(i).release()
            shutil.rmtree(claim.directory.with_name(claim.directory.name + INTERRUPTED), ignore_errors=True)
            self._write()

    def close(self) -> None:
        """Keep the finished variants of unfinished parts."""
        for claim in self._claims.values():
            self.kept = claim.interrupt() is not None or self.kept
            claim.release()

    def _keep(self, i: int, claim: Claim, variant: str) -> None:
        done = [one for one in self._outcomes[i].values() if isinstance(one, VariantOutcome) and one.failure is None]
        if any(one.variant == variant for one in done):
            done.sort(key=lambda one: one.variant == variant)
            keep_variant(claim, self._parts[i].chosen, done)

    def _folder(self, i: int) -> Path:
        assert self.directory is not None
        return self.directory / self._parts[i].name / self._parts[i].fidelity

    def _claim(self, i: int) -> Claim:
        if i not in self._claims:
            self._claims[i] = Claim(self._folder(i), force=True)
        return self._claims[i]

    def _write(self) -> None:
        if self.directory is not None:
            with writing(self.directory):
                write_json(self.directory / SUMMARY, self.result().summary())


class InterruptedReproductionError(KeyboardInterrupt):
    """A reproduction that was interrupted; `result` holds the experiments that had finished."""

    def __init__(self, message: str, result: Reproduction):
        super().__init__(message)
        self.result = result


def _interrupted(work: _Work | None, count: int) -> InterruptedReproductionError:
    """The error of an interrupted reproduction of `count` parts; a directory without results is removed."""
    result = work.result() if work else Reproduction()
    done = f"interrupted: {len(result.parts)} of {count} finished"
    if work is None or work.directory is None:
        return InterruptedReproductionError(done, result)
    if result.parts or work.kept:
        return InterruptedReproductionError(f"{done}, kept in {work.directory}; go on with --resume", result)
    shutil.rmtree(work.directory, ignore_errors=True)
    return InterruptedReproductionError(f"{done}, nothing was kept", result)


def _parts(
    file: ScenarioFile,
    variant: str | None,
    overrides: Mapping[str, Any] | None,
    seed: int | None,
    fidelity: str | None,
) -> list[_Part]:
    first = choose(file, variant, overrides, seed, whole=False).first
    own = first.fidelities or [first.fidelity]
    # An experiment that names a single fidelity runs on no other.
    fidelities = [fidelity] if fidelity is not None and len(first.fidelities) != 1 else own
    parts = [_Part(choose(file, variant, overrides, seed, one), one, len(fidelities) > 1) for one in fidelities]
    for part in parts:
        part.chosen.check_changes()
    return parts


def _job(task: tuple[int, str, ScenarioFile, Mapping[str, Any]]) -> VariantOutcome | str:
    """One simulation in a worker process; the text of the error if there is no log."""
    _, variant, file, overrides = task
    try:
        scenario = resolve(file, variant, overrides)
        # Diagrams and exceptions cannot be sent between processes.
        loop = build(scenario, origins(file, variant, overrides))
        return replace(simulate(scenario, loop, variant), diagram=None, cause=None)
    except ForcectlError as error:
        return str(error)
    except (Exception, SystemExit) as error:  # a row of the table that names the error
        return one_line(error)


def _simulate_all(
    parts: Sequence[_Part], jobs: Iterable[tuple[int, str]], workers: int
) -> Generator[tuple[int, str, VariantOutcome | str], None, None]:
    """The outcome of every variant, with the number of its part, as soon as it is available."""
    waiting, deaths, found = deque(jobs), Counter[tuple[int, str]](), list[EndedTask]()
    with contextlib.closing(Workers(_job, (), max(1, min(workers, len(waiting))))) as pool:
        while True:
            done = []
            for ended in found:
                i, variant, *_ = ended.task
                deaths[i, variant] += bool(ended.death)
                if ended.death and deaths[i, variant] < _DEATHS:
                    waiting.append((i, variant))
                else:
                    done.append((i, variant, f"{ended.death}, {_DEATHS} times" if ended.death else ended.result))
            while waiting and pool.free:
                i, variant = waiting.popleft()
                pool.submit((i, variant, parts[i].chosen.file, parts[i].chosen.changes))
            yield from done
            if not pool.busy:
                return
            found = pool.wait()


def _report(part: _Part, outcomes: Mapping[str, VariantOutcome | str], claim: Claim | None) -> PartReport:
    """Judge a part, and write it to its directory."""
    rows, chosen = [], part.chosen
    for name in chosen.scenarios:
        outcome = outcomes[name]
        failure = outcome if isinstance(outcome, str) else outcome.failure
        if failure is not None:
            rows.append(Verdict(f"run of {name!r}", None, None, None, "must complete", False, failure))
    simulated = [outcome for name in chosen.scenarios if isinstance(outcome := outcomes[name], VariantOutcome)]
    done = [outcome for outcome in simulated if outcome.failure is None]
    rows += verdicts_on(chosen, done)
    if simulated and claim is not None:
        try:
            finish(chosen, simulated, claim)
        except StoppedRunError:
            pass  # it is written as `.failed`, and has a row already
        except StorageError:
            raise
        except Exception as error:  # what cannot be drawn is a row; no other result is lost
            rows.append(Verdict("results", None, None, None, "must be written", False, one_line(error)))
    return _part_report(part, rows, {outcome.variant: outcome.metrics for outcome in done})


def _part_report(part: _Part, rows: Iterable[Verdict], metrics: dict[str, dict[str, float | None]]) -> PartReport:
    if part.several:
        rows = [replace(row, target=f"{row.target} [{part.fidelity}]") for row in rows]
    return PartReport(part.name, part.chosen.first.title, part.fidelity, list(rows), metrics)
