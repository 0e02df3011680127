"""Running a scenario: simulate its variants, judge them, write the run directory."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import xarray as xr
from pydrake.systems.framework import Diagram

from forcectl.analysis.force_metrics import find_steps, force_distance
from forcectl.errors import BadInputError, RunFailedError
from forcectl.framework.reader import join
from forcectl.framework.yaml_tree import Tagged, Tree, as_json, dump, nest
from forcectl.robot.model import RobotModel
from forcectl.runs.directory import FAILED, check_free, manifest, write_json, write_whole
from forcectl.runs.logs import stack, write_netcdf
from forcectl.runs.simulate import VariantOutcome, simulate
from forcectl.scenario.catalog import ScenarioFile
from forcectl.scenario.expectations import Verdict, judge
from forcectl.scenario.scenario import Scenario, as_file, build, origins, resolve, resolved_tree, select_variants
from forcectl.scenario.trees import part_tree

Progress = Callable[[str, float], None]  # (variant, share done)


@dataclass(frozen=True)
class RunResult:
    """A finished run."""

    name: str
    log: xr.Dataset  # over time, or over (variant, time) when there are several
    metrics: dict[str, dict[str, float | None]]  # variant -> metric -> value
    diagram: Diagram  # of the first variant
    directory: Path | None  # None when nothing was written
    verdicts: list[Verdict] = field(default_factory=list)  # on the scenario's `expect`
    assumed: dict[str, str] = field(default_factory=dict)  # of the robot, by key: the rule

    @property
    def passed(self) -> bool:
        """Whether no expectation was missed."""
        return all(v.passed is not False for v in self.verdicts)


class StoppedRunError(RunFailedError):
    """A run that had to stop. `log` holds the signals up to there, `directory` where they were written (or None)."""

    def __init__(self, message: str, log: xr.Dataset, directory: Path | None):
        super().__init__(message)
        self.log = log
        self.directory = directory


def run(
    scenario: str | Path | Mapping[str, Any] | Scenario | ScenarioFile,
    *,
    variant: str | None = None,
    overrides: Mapping[str, Any] | None = None,
    seed: int | None = None,
    fidelity: str | None = None,
    out: str | Path | None = None,
    force: bool = False,
    replay: bool = False,
    realtime_rate: float = 0.0,
    progress: Progress | None = None,
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
        out: directory to write (see `run_directory`); None writes nothing.
        force: replace an earlier run in `out`.
        replay: also write each variant as an animation in three dimensions, one HTML page each.
        realtime_rate: at most this many simulated seconds per second; 0: as fast as possible.
        progress: called with the variant and the share of it that is done.

    Raises:
        BadInputError: the scenario cannot be used; nothing was written.
        StoppedRunError: a signal became NaN or diverged, or a solver gave up.
    """
    file = as_file(scenario)
    changes = with_shortcuts(overrides, seed, fidelity)
    # Everything is checked before anything is simulated.
    scenarios = {name: resolve(file, name, changes) for name in select_variants(file, variant)}
    check_overrides(file, list(scenarios), changes)
    directory = None if out is None else Path(out).expanduser()
    if replay and directory is None:
        raise BadInputError("replay = True: must be False without an output directory")
    if directory is not None:
        check_free(directory, force)
    loops = {name: build(one, origins(file, name, changes)) for name, one in scenarios.items()}
    outcomes: list[VariantOutcome] = []
    for name, one in scenarios.items():
        outcomes.append(simulate(one, loops.pop(name), name, realtime_rate, progress))
        if outcomes[-1].failure is not None:
            break
    return finish(file, scenarios, outcomes, directory, force=force, replay=replay, overrides=changes)


def with_shortcuts(overrides: Mapping[str, Any] | None, seed: int | None, fidelity: str | None) -> dict[str, Any]:
    """Overrides with the values that have an argument of their own."""
    shortcuts = {"seed": seed, "station.fidelity": fidelity}
    return dict(overrides or {}) | {key: value for key, value in shortcuts.items() if value is not None}


def check_overrides(file: ScenarioFile, names: Sequence[str], overrides: Mapping[str, Any]) -> None:
    """Refuse overrides that would make variants the same under different names.

    Args:
        file: of the variants.
        names: of the ones to be run, each of which can be resolved.
        overrides: dotted key -> value.

    Raises:
        BadInputError: several variants are to be run, and one of them sets an overridden key, a part of it, or what it
            is a part of.
    """
    if len(names) < 2:
        return
    set_by = {name: _keys(nest(file.tree["variants"].get(name) or {})) for name in names}
    for key in _keys(nest({key: part_tree(value) for key, value in overrides.items()})):
        clashing = [name for name, keys in set_by.items() if any(overlap(key, other) for other in keys)]
        if clashing:
            raise BadInputError(
                f"override of {key} for several variants: must be a key that none of them sets, but it is set by "
                f"{', '.join(map(repr, clashing))}: run one of them with --variant, or override another key"
            )


def _keys(tree: Tree, key: str = "") -> list[str]:
    """Dotted keys that a tree replaces when it is merged: a tag or a list replaces the whole part."""
    if isinstance(tree, Tagged) and tree.tag is None:
        return [found for name, part in tree.items() for found in _keys(part, join(key, name))]
    return [key]


def overlap(one: str, other: str) -> bool:
    """Whether one of two dotted keys is the other, or a part of it."""
    return f"{one}.".startswith(f"{other}.") or f"{other}.".startswith(f"{one}.")


def finish(
    file: ScenarioFile,
    scenarios: Mapping[str, Scenario],
    outcomes: Sequence[VariantOutcome],
    directory: Path | None,
    *,
    overrides: Mapping[str, Any],
    force: bool = False,
    replay: bool = False,
) -> RunResult:
    """Judge simulated variants and write their run directory.

    Raises:
        StoppedRunError: one of them had to stop; what there is was written to `<directory>.failed`.
    """
    log = stack([outcome.log for outcome in outcomes])
    metrics = {outcome.variant: outcome.metrics for outcome in outcomes if outcome.failure is None}
    failed = next((outcome for outcome in outcomes if outcome.failure is not None), None)
    first = next(iter(scenarios.values()))
    diagram = outcomes[0].diagram or build(first).diagram
    verdicts = [] if failed else verdicts_on(file, scenarios, outcomes)
    assumed = assumed_of(first)

    def fill(folder: Path) -> None:
        text = dump(resolved_tree(scenarios))
        reason = {"failure": failed.failure, "failed_variant": failed.variant} if failed else {}
        details = {
            "scenario": file.name,
            "title": first.title,
            "preset": first.preset,
            "fidelity": first.fidelity,
            "seed": first.seed,
            "variants": list(scenarios),
            "robot_assumed": assumed,
            "overrides": {key: as_json(part_tree(value)) for key, value in overrides.items()},
            "status": "failed" if failed else "done",
            **reason,
            "expectations": {v.target: v.as_row() for v in verdicts},
        }
        (folder / "scenario.yaml").write_text(f"# {file.name}, resolved\n{text}", encoding="utf-8")
        write_json(folder / "manifest.json", manifest(text, details))
        write_netcdf(log, folder / "log.nc")
        write_json(folder / "metrics.json", metrics)
        _write_pictures(folder, log, first, diagram, first.title or file.name)
        for number, outcome in enumerate(outcomes, start=1):
            mark = f"_{number}" if len(scenarios) > 1 else ""
            _write_files(folder, mark, outcome, scenarios[outcome.variant], replay)

    if failed is not None:
        # An earlier failure at the same place is out of date.
        kept = directory and write_whole(directory.with_name(directory.name + FAILED), fill, force=True)
        where = f"; the log up to there is in {kept}" if kept else ""
        raise StoppedRunError(f"variant {failed.variant!r}: {failed.failure}{where}", log, kept) from failed.cause
    if directory is not None:
        directory = write_whole(directory, fill, force)
    return RunResult(file.name, log, metrics, diagram, directory, verdicts, assumed)


def assumed_of(scenario: Scenario) -> dict[str, str]:
    """Keys that the control parameters of a scenario's robot leave out, and the rules that stand for them."""
    return RobotModel.load(scenario.station.robot, None).parameters.assumed


def verdicts_on(
    file: ScenarioFile, scenarios: Mapping[str, Scenario], outcomes: Sequence[VariantOutcome]
) -> list[Verdict]:
    """The verdicts on every expectation whose variants were all run."""
    first = next(iter(scenarios.values()))
    names = select_variants(file)
    done = [outcome for outcome in outcomes if outcome.failure is None]
    metrics = {outcome.variant: outcome.metrics for outcome in done}
    logs = {outcome.variant: outcome.log for outcome in done}

    def distance(variant: str, other: str, share: float) -> float | None:
        if variant not in logs or other not in logs:
            return None
        one, two = logs[variant], logs[other]
        time, desired = two["time"].values, two["desired_force"].values
        steps = find_steps(time, desired, two["contact_force"].values[0].item())
        forces = one["measured_force"].values, two["measured_force"].values
        return force_distance(time, *forces, steps[-1], share) if steps else None

    return [
        judge(expectation, metrics, names, first.fidelity, distance, first.fidelities)
        for expectation in first.expect
        if set(expectation.variants(names).values()) <= set(scenarios)
    ]


def _write_files(folder: Path, mark: str, outcome: VariantOutcome, scenario: Scenario, replay: bool) -> None:
    """What analyses have to say of a variant in files of their own, and its replay; `mark` ends the files' names."""
    setting = scenario.setting()
    for analysis in scenario.analyses.values():
        if hasattr(analysis, "files") and outcome.failure is None:
            for name, text in analysis.files(outcome.log, setting).items():
                path = Path(name)
                (folder / f"{path.stem}{mark}{path.suffix}").write_text(text, encoding="utf-8")
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


def _write_pictures(folder: Path, log: xr.Dataset, scenario: Scenario, diagram: Diagram, title: str) -> None:
    # Matplotlib takes half a second to import, and a run from Python without a directory needs none of it.
    from forcectl.figures.force import write_figures
    from forcectl.graph.export import graph

    if log.sizes["time"] > 1:  # a run may stop before its first step
        write_figures(scenario.figures(log, title), folder / "figures")
    picture = graph(diagram)
    for format_ in ("dot", "svg", "html"):
        picture.save(folder / f"diagram.{format_}")
