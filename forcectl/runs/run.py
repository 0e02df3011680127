"""Running a scenario: simulate its variants, judge them, write the run directory."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from pydrake.systems.framework import Diagram

from forcectl.analysis.findings.finding import RunFinding
from forcectl.analysis.force_metrics import find_steps, force_distance
from forcectl.analysis.slot import check_files
from forcectl.errors import BadInputError, RunFailedError, one_line
from forcectl.figures.file_names import file_names
from forcectl.framework.yaml_tree import as_json
from forcectl.interrupts import Interrupts, interrupts_ignored
from forcectl.robot.model import RobotModel
from forcectl.runs.chosen import Chosen, choose
from forcectl.runs.claims.claim import Claim, Place, claimed
from forcectl.runs.claims.kept import keep
from forcectl.runs.directory import DATA, FAILED, INTERRUPTED, keep_only, manifest, write_file, write_json
from forcectl.runs.logs import described, prepare_to_write, stack, write_netcdf
from forcectl.runs.result import InterruptedRunError, RunResult, StoppedRunError
from forcectl.runs.simulate import VariantOutcome, simulate
from forcectl.runs.terminal.realtime import check_realtime_rate
from forcectl.scenario.catalog import ScenarioFile
from forcectl.scenario.expectations import Verdict, judge
from forcectl.scenario.layers import select_variants
from forcectl.scenario.scenario import Scenario, build
from forcectl.scenario.trees import part_tree

Progress = Callable[[str, float], None]  # (variant, share done)


def run(
    scenario: str | Path | Mapping[str, Any] | Scenario | ScenarioFile,
    *,
    variant: str | None = None,
    overrides: Mapping[str, Any] | None = None,
    seed: int | None = None,
    fidelity: str | None = None,
    out: Place | None = None,
    force: bool = False,
    allow_imports: Sequence[str] = (),
    replay: bool = False,
    realtime_rate: float = 0.0,
    progress: Progress | None = None,
    stage: Callable[[str], None] = lambda text: None,
) -> RunResult:
    """Simulate a scenario.

    Args:
        scenario: name of a shipped experiment, path of a YAML file, its content as a mapping, or a `Scenario`.
        variant: run this one only; otherwise all of them, one after the other.
        overrides: dotted key -> value on top of everything, for example {"station.environment.stiffness": 2e5} or
            {"controller": AdaptiveIntegralConfig(integral_gain=2.0)}; where several variants are run, of keys that none
            of them sets.
        seed: short for the override of `seed`.
        fidelity: short for that of `station.fidelity`.
        out: directory to write (see `forcectl.runs.directory`), reserved for this process from now on; None writes
            nothing.
        force: replace an earlier run in `out`.
        allow_imports: names of modules that the scenario may name, see `load_scenario`.
        replay: also write each variant as an animation in three dimensions, one HTML page each.
        realtime_rate: at most this many simulated seconds per second, 0.001 to 1000; 0: as fast as possible.
        progress: called with the variant and the share of it that is done.
        stage: called with the current step: building, simulating, judging or writing.

    Raises:
        BadInputError: the scenario or the directory cannot be used; nothing was written.
        StorageError: the directory cannot be written any more; the message says what is kept.
        StoppedRunError: a signal became NaN or diverged, or a solver gave up.
        InterruptedRunError: Ctrl-C; the log up to there is kept as `<out>.interrupted`.
    """
    check_realtime_rate(realtime_rate, "realtime_rate")
    # Everything is checked before anything is simulated.
    chosen = choose(scenario, variant, overrides, seed, fidelity, allow_imports)
    chosen.check_changes()
    if replay and out is None:
        raise BadInputError("replay = True: must be False without an output directory")
    with contextlib.nullcontext() if out is None else claimed(out, force) as claim:
        if claim is not None:
            prepare_to_write()
        stage("building")
        loops = {name: chosen.build(name) for name in chosen.scenarios}
        stage("simulating")
        outcomes: list[VariantOutcome] = []
        try:
            with Interrupts():
                for number, (name, one) in enumerate(chosen.scenarios.items(), start=1):
                    outcomes.append(simulate(one, loops.pop(name), name, realtime_rate, progress))
                    if outcomes[-1].failure is not None:
                        break
                    if claim is not None and number < len(chosen.scenarios):
                        keep_variant(claim, chosen, outcomes)
                if not outcomes[-1].interrupted:
                    stage("judging" if claim is None else "writing")
                    return finish(chosen, outcomes, claim, replay=replay)
        except KeyboardInterrupt:
            pass  # the frames of the traceback hold the diagram
        with interrupts_ignored():  # further interrupts do not stop the writing
            raise _keep_interrupted(chosen, outcomes, claim)


def finish(
    chosen: Chosen, outcomes: Sequence[VariantOutcome], claim: Claim | None, *, replay: bool = False
) -> RunResult:
    """Judge simulated variants and write their run directory.

    Raises:
        StoppedRunError: one of them had to stop; the results up to there were written to `<directory>.failed`.
        StorageError: the directory cannot be written any more.
    """
    failed = next((outcome for outcome in outcomes if outcome.failure is not None), None)
    first, name = chosen.first, chosen.file.name
    log = _log(chosen, outcomes, f"stopped: {failed.failure}" if failed else "")
    diagram = outcomes[0].diagram or build(first).diagram
    verdicts = [] if failed else verdicts_on(chosen, outcomes)

    def fill(folder: Path) -> None:
        write_netcdf(log, folder / "log.nc")
        status, failure = ("failed", failed.failure) if failed else ("done", None)
        _write_words(folder, chosen, outcomes, status, failure, verdicts)
        try:
            _write_pictures(folder, log, first, diagram, chosen.title, _findings(outcomes))
            parts = file_names(chosen.scenarios)
            for outcome in outcomes:
                mark = f"_{parts[outcome.variant]}" if len(parts) > 1 else ""
                _write_files(folder, mark, outcome, chosen.scenarios[outcome.variant], replay)
        except Exception as error:
            if isinstance(error, OSError):  # pictures may be incomplete, and the disk too full for the note
                keep_only(folder, DATA)
            if failed is None:
                failure = f"pictures cannot be drawn: {one_line(error)}"
                _write_words(folder, chosen, outcomes, "failed", failure, verdicts)
            raise

    if failed is not None:
        kept = None if claim is None else claim.write(fill, FAILED)
        where = f"; the log up to there is in {kept}" if kept else ""
        raise StoppedRunError(f"variant {failed.variant!r}: {failed.failure}{where}", log, kept) from failed.cause
    directory = None if claim is None else _written(claim, fill, log)
    metrics, findings = _metrics(outcomes), _findings(outcomes)
    speeds = {outcome.variant: outcome.realtime_factor for outcome in outcomes}
    gains = {outcome.variant: outcome.gains for outcome in outcomes if outcome.gains}
    return RunResult(
        name, log, metrics, diagram, directory, verdicts, assumed_of(first), first, findings, speeds, gains
    )


def _written(claim: Claim, fill: Callable[[Path], None], log: xr.Dataset) -> Path:
    """The directory of a run that was simulated to its end; StoppedRunError where an analysis fails to draw."""
    try:
        return claim.write(fill)
    except RunFailedError as error:
        text = f"{error}; log and metrics are in {claim.failed}"
        raise StoppedRunError(text, log, claim.failed) from error.__cause__


def _metrics(outcomes: Sequence[VariantOutcome]) -> dict[str, dict[str, float | None]]:
    """The metrics of every variant that was simulated to its end."""
    return {outcome.variant: outcome.metrics for outcome in outcomes if outcome.failure is None}


def _findings(outcomes: Sequence[VariantOutcome]) -> dict[str, list[RunFinding]]:
    """The findings of every variant that was simulated to its end."""
    return {outcome.variant: outcome.findings for outcome in outcomes if outcome.failure is None}


def _gains(outcomes: Sequence[VariantOutcome]) -> dict[str, dict[str, Any]]:
    """The gains that experiments found: variant -> dotted key of the law -> the experiment, and each gain."""
    return {outcome.variant: {one.key: one.as_row() for one in outcome.gains} for outcome in outcomes if outcome.gains}


def _log(chosen: Chosen, outcomes: Sequence[VariantOutcome], how: str) -> xr.Dataset:
    """The log of variants, with the attributes of its file; `how` it ended is "" for a complete run."""
    log = stack([outcome.log for outcome in outcomes])
    return described(log, chosen.file.name, chosen.scenarios[outcomes[0].variant], how, _gains(outcomes))


def keep_variant(claim: Claim, chosen: Chosen, outcomes: Sequence[VariantOutcome]) -> None:
    """Write the last of the finished variants to disk, in case the process is killed before all have finished.

    Raises:
        StorageError: it cannot be written.
    """
    name, names = outcomes[-1].variant, list(chosen.scenarios)
    failure = f"its process ended after {len(outcomes)} of {len(names)} variants"
    with claim.storing():
        outcome = replace(outcomes[-1], log=_log(chosen, outcomes[-1:], failure))
        _write_words(claim.results, chosen, outcomes, "interrupted", failure)
        keep(claim.results, names.index(name), chosen.made_of(name), outcome)


def _write_words(
    folder: Path,
    chosen: Chosen,
    outcomes: Sequence[VariantOutcome],
    status: str,
    failure: str | None,
    verdicts: Sequence[Verdict] = (),
) -> None:
    """Write the text files of a run directory; `status` is done, failed or interrupted, `failure` says why."""
    first, text = chosen.first, chosen.text
    stopped = next((outcome.variant for outcome in outcomes if outcome.failure is not None), None)
    reason = ({"failure": failure} if failure else {}) | ({"failed_variant": stopped} if stopped else {})
    details = {
        "scenario": chosen.file.name,
        "title": first.title,
        "preset": first.preset,
        "fidelity": first.fidelity,
        "seed": first.seed,
        "variants": list(chosen.scenarios),
        "robot_assumed": assumed_of(first),
        "overrides": {key: as_json(part_tree(value)) for key, value in chosen.changes.items()},
        "model_error_window_s": {name: one.model_error_window for name, one in chosen.scenarios.items()},
        "realtime_factor": {outcome.variant: outcome.realtime_factor for outcome in outcomes},
        "gains": _gains(outcomes),
        "status": status,
        **reason,
        "expectations": {v.target: v.as_row() for v in verdicts},
    }
    write_file(folder / "scenario.yaml", f"# {chosen.file.name}, resolved\n{text}".encode())
    rows = {name: {"findings": [one.as_row() for one in found]} for name, found in _findings(outcomes).items()}
    write_json(folder / "metrics.json", {name: each | rows[name] for name, each in _metrics(outcomes).items()})
    write_json(folder / "manifest.json", manifest(text, details))


def _keep_interrupted(chosen: Chosen, outcomes: Sequence[VariantOutcome], claim: Claim | None) -> InterruptedRunError:
    """Write the log of an interrupted run, without pictures; returns the exception to be raised."""
    outcomes = [outcome for outcome in outcomes if outcome.log.sizes["time"] > 1]
    if not outcomes:
        return InterruptedRunError("interrupted before anything was simulated: nothing was kept", None, None)
    last, log = outcomes[-1], _log(chosen, outcomes, "interrupted")
    if last.interrupted:
        failure = f"{last.failure} of {chosen.scenarios[last.variant].duration:g} s"
    else:
        failure = f"interrupted after {len(outcomes)} of {len(chosen.scenarios)} variants, before all was written"
    if claim is None:
        return InterruptedRunError(f"{failure}: nothing was written", log, None)

    def fill(folder: Path) -> None:
        write_netcdf(log, folder / "log.nc")
        _write_words(folder, chosen, outcomes, "interrupted", failure)

    claim.clear()
    kept = claim.write(fill, INTERRUPTED)
    return InterruptedRunError(f"{failure}: the log up to there is in {kept}", log, kept)


def assumed_of(scenario: Scenario) -> dict[str, str]:
    """Keys that the control parameters of a scenario's robot leave out, and the rules that replace them."""
    return RobotModel.load(scenario.station.robot, None).parameters.assumed


def verdicts_on(chosen: Chosen, outcomes: Sequence[VariantOutcome]) -> list[Verdict]:
    """The verdicts on every expectation whose variants were all run."""
    first, names, metrics = chosen.first, select_variants(chosen.file), _metrics(outcomes)
    logs = {outcome.variant: outcome.log for outcome in outcomes if outcome.failure is None}

    def distance(variant: str, other: str, share: float) -> float | None:
        if variant not in logs or other not in logs:
            return None
        one, two = logs[variant], logs[other]
        time, desired = two["time"].values, two["desired_force"].values
        steps = find_steps(time, desired, two["contact_force"].values[0].item())
        # At the ticks of the other one, which may have another period and end later.
        force = np.interp(time, one["time"].values, one["measured_force"].values, right=np.nan)
        return force_distance(time, force, two["measured_force"].values, steps[-1], share) if steps else None

    return [
        judge(expectation, metrics, names, first.fidelity, distance, first.fidelities)
        for expectation in first.expect
        if expectation.is_of(chosen.scenarios, names)
    ]


def _write_files(folder: Path, mark: str, outcome: VariantOutcome, scenario: Scenario, replay: bool) -> None:
    """Write the files of a variant's analyses, and its replay; `mark` is a suffix of the file names."""
    setting = scenario.setting()
    if replay and outcome.log.sizes["time"]:
        from forcectl.runs.replay.write import write_replay
        from forcectl.tasks.controllers.base import TaskControllerConfig
        from forcectl.tasks.task_parts import start_motion

        controller, tasks = scenario.controller, {}
        if "task_wrench" in outcome.log and isinstance(controller, TaskControllerConfig):
            tasks = controller.made_tasks(start_motion(setting.model))
        write_replay(
            outcome.log,
            setting.workcell,
            folder / f"replay{mark}.html",
            title=f"{scenario.title}{f': {outcome.variant}' if mark else ''}",
            tasks=tasks,
        )
    for name, analysis in scenario.analyses.items():
        if hasattr(analysis, "files") and outcome.failure is None:
            files = scenario.asked(name, "files", outcome.log, setting)
            ours = [f"{path.stem.removesuffix(mark)}{path.suffix}" for path in folder.iterdir()]
            for file_name, text in check_files(files, ours, name).items():
                path = Path(file_name)
                (folder / f"{path.stem}{mark}{path.suffix}").write_text(text, encoding="utf-8")


def _write_pictures(
    folder: Path,
    log: xr.Dataset,
    scenario: Scenario,
    diagram: Diagram,
    title: str,
    findings: Mapping[str, Sequence[RunFinding]],
) -> None:
    # Matplotlib takes half a second to import, and a run from Python without a directory needs none of it.
    from forcectl.figures.force import write_figures
    from forcectl.graph.export import graph

    if log.sizes["time"] > 1:  # a run may stop before its first step
        write_figures(scenario.figures(log, title, findings), folder / "figures")
    picture = graph(diagram, title=title)
    for format_ in ("dot", "svg", "html"):
        picture.save(folder / f"diagram.{format_}")
