"""The plan of a sweep: points, seeds and arms, numbered, before anything runs.

Trial numbers count arms fastest, then seeds, then points. Everything follows from the sweep, so a number
determines its trial completely.
"""

from __future__ import annotations

import difflib
import hashlib
import itertools
import json
import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np

import forcectl
from forcectl.analysis.tables.metric_tables import METRICS, compared_unit, is_metric, metric_range, unknown_metric
from forcectl.analysis.tables.reference import analyses_of
from forcectl.analysis.tables.task_tables import MODE_METRICS
from forcectl.arrays import Array
from forcectl.errors import BadInputError, invalid, unknown
from forcectl.framework.expression import Expression
from forcectl.framework.expression_units import check_units
from forcectl.framework.fields import PHYSICAL, key_of
from forcectl.framework.yaml_tree import Tagged, dump, equal
from forcectl.runs.chosen import overlap
from forcectl.scenario.catalog import ScenarioFile
from forcectl.scenario.checks.judged import metric_parts
from forcectl.scenario.checks.values import values
from forcectl.scenario.layers import select_variants
from forcectl.scenario.scenario import Scenario, as_file, build, origins, resolve
from forcectl.scenario.trees import part_tree, to_tree
from forcectl.sweeps.axes import MOST_TRIALS, Axis, axis_of, draw, is_plain
from forcectl.sweeps.sweep_config import SweepConfig, SweepFile, with_scenario

CASE = "case"  # the axis of the cases
_PACKAGES = ("drake", "numpy", "scipy")
_TRIED = 200  # largest number of values of a list that are read before anything runs


@dataclass(frozen=True)
class Trial:
    """One simulation of a sweep: its number, point, seed (None: the scenario's own) and arm ("" for none)."""

    number: int
    point: int
    seed: int | None
    arm: str


@dataclass(frozen=True)
class Study:
    """A sweep with its points.

    Attributes:
        name: of the sweep.
        config: as given.
        file: the scenario.
        variant: of the scenario.
        axes: the varied keys.
        points: coordinates, shape (points, axes), see `Axis.draw`.
        left_out: points that did not meet the conditions.
        text: the sweep as YAML, with the content of the scenario.
    """

    name: str
    config: SweepConfig
    file: ScenarioFile
    variant: str
    axes: list[Axis]
    points: Array
    left_out: int
    text: str

    @property
    def arms(self) -> list[str]:
        """Names of the arms; one without a name where there are none."""
        return list(self.config.arms) or [""]

    @property
    def seeds(self) -> list[int] | None:
        """Seeds of each point; None where each point has one seed, see `seeded_by_point`."""
        if self.config.repeat is not None:
            return list(range(self.config.repeat.at_most))
        return self.config.seed_list()

    @property
    def seeded_by_point(self) -> bool:
        """Whether the number of a point is its seed where `seeds` is not given: for drawn points."""
        return self.config.design not in ("grid", "saltelli")

    @property
    def size(self) -> int:
        """Number of planned trials."""
        return len(self.points) * len(self.seeds or [0]) * len(self.arms)

    def trial(self, number: int) -> Trial:
        """The trial of a number."""
        point, repetition, arm = self.split(number)
        seeds = self.seeds
        seed = seeds[repetition] if seeds is not None else point if self.seeded_by_point else None
        return Trial(number, point, seed, self.arms[arm])

    def split(self, number: Any) -> tuple[Any, Any, Any]:
        """Point, repetition and index of the arm of a trial number, or of each in an array."""
        rest, arm = divmod(number, len(self.arms))
        return *divmod(rest, len(self.seeds or [0])), arm

    def group(self, number: int) -> tuple[int, int]:
        """The group of a trial: its point and arm. Trials of one group differ in their seeds only."""
        point, _, arm = self.split(number)
        return point, arm

    def number(self, group: tuple[int, int], repetition: int) -> int:
        """The number of a repetition, counted from 0, in a group."""
        point, arm = group
        return (point * len(self.seeds or [0]) + repetition) * len(self.arms) + arm

    def overrides(self, trial: Trial) -> dict[str, Any]:
        """The changes of a trial to the scenario, dotted key -> value."""
        values = {axis.key: axis.value(x) for axis, x in zip(self.axes, self.points[trial.point].tolist(), strict=True)}
        case = values.pop(CASE, {})
        changes = {**self.config.overrides, **values, **case, **self.config.arms.get(trial.arm, {})}
        return changes | ({} if trial.seed is None else {"seed": trial.seed})

    def labels(self, trial: Trial) -> dict[str, Any]:
        """The values of the varied keys in a trial, as a table shows them."""
        coordinates = self.points[trial.point].tolist()
        return {axis.key: axis.label(x) for axis, x in zip(self.axes, coordinates, strict=True)}

    def scenario(self, trial: Trial) -> Scenario:
        """The scenario of a trial."""
        return resolve(self.file, self.variant, self.overrides(trial))

    @property
    def writable(self) -> bool:
        """Whether the sweep can be read back from its text: no value is an object from Python."""
        return is_plain([self.file.tree, self.config.overrides, self.config.arms, [axis.values for axis in self.axes]])

    def digest(self) -> str:
        """Hash of the sweep, its points and the versions."""
        found = hashlib.sha256(self.text.encode())
        found.update(json.dumps(versions(), sort_keys=True).encode())
        found.update(np.ascontiguousarray(self.points).tobytes())
        return found.hexdigest()


def versions() -> dict[str, str]:
    """The versions that the results of a sweep depend on."""
    return {"forcectl": forcectl.__version__, **{name: metadata.version(name) for name in _PACKAGES}}


def study_of(sweep: SweepFile, allow_imports: Sequence[str] = ()) -> Study:
    """The study that a sweep describes; all that can be checked before a run is checked.

    Args:
        sweep: as read.
        allow_imports: names of modules that the scenario may name, see `load_scenario`.

    Raises:
        BadInputError: no scenario of that name, a key that does not exist, a design without points, ...
    """
    with at_lines(sweep):
        return _study_of(sweep, allow_imports)


@contextmanager
def at_lines(sweep: SweepFile) -> Iterator[None]:
    """Context that adds file and line to errors about a key of the sweep."""
    try:
        yield
    except BadInputError as error:
        if error.key and not error.where:
            raise error.at(error.key, sweep.where(error.key)) from error.__cause__
        raise


def _study_of(sweep: SweepFile, allow_imports: Sequence[str]) -> Study:
    config = sweep.config
    # Modules beside the sweep file may be named, not those beside the scenario that it names.
    modules = sweep.modules if isinstance(config.scenario, str | Path) else None
    file = as_file(config.scenario, allow_imports, modules)
    try:
        names = select_variants(file, config.variant)
    except BadInputError as error:
        raise error.at("variant") from error.__cause__
    if len(names) > 1:
        raise BadInputError(f" is missing: must be one of {', '.join(names)}", key="variant")
    axes = [Axis(CASE, list(config.cases.values()), labels=list(config.cases))] if config.cases else []
    axes += [axis_of(key, tree) for key, tree in config.keys.items()]
    conditions = [Expression(text, f"constraints.{i}") for i, text in enumerate(config.constraints)]
    for condition in conditions:
        condition.check_names([axis.key for axis in axes], "varied key")
    points, left_out = draw(config, axes, conditions)
    text = dump(part_tree(with_scenario(config, file)))
    study = Study(sweep.name, config, file, names[0], axes, points, left_out, text)
    if study.size > MOST_TRIALS:
        raise BadInputError(f"the sweep has {study.size} trials: must be at most {MOST_TRIALS}")
    if config.worst is not None and config.worst.count > study.size:
        raise invalid("worst.count", config.worst.count, f"at most the number of trials, {study.size}")
    _try_values(study, sweep)
    return study


def _try_values(study: Study, sweep: SweepFile) -> None:
    """Read each arm, listed value, smallest and largest drawn value once, and build each arm, before anything runs."""
    numbers = dict.fromkeys(range(len(study.arms)))
    units: dict[str, str] = {}  # of the keys of all arms
    for i, axis in enumerate(study.axes):
        _, first = np.unique(study.points[:, i], return_index=True)
        points = first[[0, -1]] if axis.distribution else first[:_TRIED]
        numbers |= dict.fromkeys(study.number((int(point), 0), 0) for point in points)
    own_metrics, longest = False, 0.0
    modes: dict[str, None] = {}  # of all arms, in order
    surfaces: dict[str, None] = {}  # the same; "" of one alone
    analyses = set[str]()  # tags of those of all trials that are read
    arms: dict[str, Tagged] = {}
    for number in numbers:
        trial = study.trial(number)
        changes = study.overrides(trial)
        try:
            scenario = resolve(study.file, study.variant, changes)
            # With another duration, such as a shorter trial, conditions on times are not refused.
            longest = max(longest, math.inf if "duration" in changes else scenario.duration)
            analyses |= {to_tree(each, "analysis").tag or "" for each in scenario.analyses.values()}
            if number < len(study.arms):
                units |= {at: key_of(one).unit for at, one, _ in values(scenario, "", *PHYSICAL)}
                arms[trial.arm] = tree = to_tree(scenario)
                twin = next(name for name, other in arms.items() if equal(tree, other))
                if twin != trial.arm:
                    text = f" makes the same scenario as arm {twin!r}: must change something else"
                    raise BadInputError(text, key=f"arms.{trial.arm}")
                loop = build(scenario, origins(study.file, study.variant, changes))
                # Metrics of a user's analysis are known only once there is a log.
                rooms = [type(each).__module__ for each in scenario.analyses.values()]
                own_metrics = own_metrics or not all(room.startswith("forcectl.") for room in rooms)
                fronts = [contact.name for contact in loop.workcell.contacts]
                surfaces |= dict.fromkeys(fronts if len(fronts) > 1 else [""])
                if hasattr(scenario.controller, "machine"):
                    modes |= dict.fromkeys(mode.name for mode in scenario.controller.machine().modes)
                for name in study.config.envelope:
                    if name not in loop.signals:
                        raise unknown("signal", name, loop.signals).at("envelope")
        except BadInputError as error:
            raise _placed(error, study, trial, sweep) from error.__cause__
    for i, text in enumerate(study.config.constraints):
        check_units(Expression(text), lambda name: units.get(name, ""), f"constraints.{i}")
    _check_metrics(study.config, own_metrics, list(modes), analyses, longest)
    if not own_metrics:
        _check_surfaces(study.config, list(surfaces))


def unknown_metrics(config: SweepConfig) -> dict[str, str]:
    """Requested metrics, by key, that no run has by itself: they must come from a user's analysis."""
    return {key: name for key, name in reversed(_asked(config)) if not is_metric(name)}


def _asked(config: SweepConfig) -> list[tuple[str, str]]:
    """The metrics that the sweep requests, with their keys."""
    asked = [(key, name) for key, condition in _conditions(config) for name in condition.names]
    if config.worst is not None:
        asked.append(("worst.metric", config.worst.metric))
    if config.share_over is not None:
        asked.append(("share_over.metric", config.share_over.metric))
    return asked + [(f"shown.{i}", name) for i, name in enumerate(config.shown)]


def _conditions(config: SweepConfig) -> list[tuple[str, Expression]]:
    """The conditions on metrics, with their keys."""
    asked = {"success": config.success} | {f"findings.{name}": text for name, text in config.findings.items()}
    asked |= {"share_over.condition": config.share_over.condition} if config.share_over is not None else {}
    return [(key, Expression(text, key)) for key, text in asked.items() if text]


def _check_metrics(config: SweepConfig, own: bool, modes: Sequence[str], analyses: set[str], longest: float) -> None:
    """Raise BadInputError for conditions that are always true or false, and for metrics that no run has.

    A condition that a metric is not negative is allowed: it is true only where the metric has a value.

    Args:
        config: of the sweep.
        own: whether there is a user's analysis; names are then checked after the first trials, see `SweepRun`.
        modes: of the state machines of all arms; a metric of an unknown mode with a similar name is refused.
        analyses: tags of the analyses of the trials; a metric of a shipped analysis needs one of them.
        longest: duration of the longest trial [s], which bounds all times.
    """
    for key, condition in _conditions(config):
        check_units(condition, compared_unit, key)
        settled = {name: each for name in condition.names if (each := metric_range(name))[1] < math.inf}
        condition.check_open(settled, {name: metric_range(name, longest) for name in condition.names})
    if not own:
        for key, name in reversed(unknown_metrics(config).items()):
            raise unknown_metric(name).at(key)
        for key, name in _asked(config):
            if (makers := analyses_of(name)) and not analyses.intersection(makers):
                raise BadInputError(f" uses {name}: must go with an analysis !{' or !'.join(makers)}", key=key)
    for key, name in _asked(config):
        mode, _, last = name.rpartition(".")
        # An unknown mode without a similar name may be that of an arm that is not examined here.
        if last in MODE_METRICS and mode not in modes and difflib.get_close_matches(mode, modes):
            raise unknown("mode", mode, modes).at(key)


def _check_surfaces(config: SweepConfig, surfaces: Sequence[str]) -> None:
    """Raise BadInputError for a metric of a surface that no arm has, unless trials may have other surfaces."""
    varied = [*config.keys, *itertools.chain(*config.cases.values())]
    if any(overlap(key, "station.environment") for key in varied):
        return
    for key, name in _asked(config):
        front, _, last = metric_parts(name)
        if last in METRICS and front not in surfaces:
            own = ", ".join(each for each in surfaces if each)
            raise BadInputError(
                f" uses {name}: must be {f'of one of {own}' if own else f'{last}, of the one surface'}", key=key
            )


def _placed(error: BadInputError, study: Study, trial: Trial, sweep: SweepFile) -> BadInputError:
    """An error about an override, with file, line and key of the sweep that set it."""
    if error.where != "override":
        return error
    places: list[tuple[str, Mapping[str, Any]]] = [
        (f"arms.{trial.arm}", study.config.arms.get(trial.arm, {})),
        (f"cases.{study.labels(trial).get(CASE)}", study.config.cases.get(study.labels(trial).get(CASE, ""), {})),
        ("keys", study.config.keys),
        ("overrides", study.config.overrides),
    ]
    for place, keys in places:
        for key in keys:
            # For a key that does not exist, the error names its first wrong part.
            if overlap(error.key, key):
                return error.at(error.key, sweep.where(f"{place}.{key}") or f"{place}.{key}")
    # A key is missing in a part that exists only because the sweep sets another key of it.
    depth, at, key = max((_shared(error.key, key), f"{place}.{key}", key) for place, keys in places for key in keys)
    made = BadInputError(f"{error.at(error.key)}{_meant(study.file.tree, key.split('.')[:depth])}")
    return made.at(at, sweep.where(at))


def _shared(one: str, other: str) -> int:
    """Number of leading parts that two dotted keys have in common."""
    same = (a == b for a, b in zip(one.split("."), other.split("."), strict=False))
    return sum(itertools.takewhile(bool, same))


def _meant(tree: Any, parts: Sequence[str]) -> str:
    """The name in the scenario that looks like the last part, for a message; "" where it has none."""
    for part in parts[:-1]:
        tree = tree.get(part) if isinstance(tree, Mapping) else None
    near = difflib.get_close_matches(parts[-1], tree, n=1) if isinstance(tree, Mapping) and parts else []
    return f"; did you mean {near[0]!r} by {parts[-1]!r}?" if near and near[0] != parts[-1] else ""
