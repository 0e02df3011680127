"""Sweep files: which scenario, which keys, which design, what counts as success."""

from __future__ import annotations

import ast
import math
import os
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from pathlib import Path
from statistics import NormalDist
from typing import Any

from forcectl.errors import BadInputError, check_distinct, invalid, unknown
from forcectl.framework.expression import Expression
from forcectl.framework.fields import Config, key
from forcectl.framework.files.text_file import yaml_text
from forcectl.framework.yaml_tree import Tagged, parse, place, plain
from forcectl.runs.chosen import overlap
from forcectl.scenario.catalog import ScenarioFile, experiments_folder, list_experiments
from forcectl.scenario.layers import check_different, check_names
from forcectl.scenario.scenario import as_file
from forcectl.scenario.schema import ScenarioReader

DESIGNS = ("grid", "random", "latin_hypercube", "sobol", "saltelli")
KEEP = ("none", "failed", "all")
MOST_SEEDS = 1_000_000  # of a point


@dataclass(kw_only=True)
class RepeatConfig(Config):
    """Key `repeat`: every point is run with seeds 0, 1, 2 ... until its success rate has a narrow interval."""

    half_width: float = key(
        0.1,
        "half width of the success rate's Wilson interval at which repetition stops",
        bounds="above 0 and at most 0.5",
    )
    confidence: float = key(0.95, "confidence level of the success rate's Wilson interval", bounds="from 0.5 to 0.9999")
    at_least: int = key(10, "smallest number of trials of each point and arm", bounds="from 1 to 1000000")
    at_most: int = key(200, "largest number of trials of each point and arm", bounds="from 1 to 1000000")

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.at_most < self.at_least:
            raise invalid("at_most", self.at_most, f"at least at_least = {self.at_least}")
        square = NormalDist().inv_cdf(0.5 + 0.5 * self.confidence) ** 2  # of the normal quantile of the interval
        if self.at_most < (least := square * (0.5 / self.half_width - 1)):
            enough = f"at least {math.ceil(least)}: no interval of fewer trials has half_width = {self.half_width:g}"
            raise invalid("at_most", self.at_most, enough)


@dataclass(kw_only=True)
class WorstConfig(Config):
    """Key `worst`: the trials with the largest values of a metric are run again at the end and stored in full."""

    metric: str = key(meaning="name of the metric that ranks the trials")
    smallest: bool = key(False, "true: the smallest values of the metric are the worst; false: the largest")
    count: int = key(1, "number of worst trials that are stored in full", bounds="from 1 to 100")
    replay: bool = key(True, "also write a 3-D replay of the worst trial")


@dataclass(kw_only=True)
class ShareOverConfig(Config):
    """Key `share_over`: share of trials that meet a condition with at most some value of a metric, over this value."""

    metric: str = key(meaning="name of the metric over which the share is drawn, best if small, such as a force")
    condition: str = key(
        meaning="condition on the metrics for a trial to count, without a limit on the metric of the share"
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        Expression(self.condition, "condition").check_condition()


@dataclass(kw_only=True)
class SweepConfig(Config):
    """A sweep file."""

    title: str = key("", "heading of the report")
    description: str = key("", "text below the heading of the report")
    scenario: Any = key(meaning="scenario that is varied: name of an experiment, path of a file, or its content")
    variant: str | None = key(None, "variant of the scenario; null: its only one; required where it has several")
    overrides: dict[str, Any] = key({}, "values of scenario keys that are the same in all trials")
    keys: dict[str, Any] = key({}, "scenario keys that are varied: each a list of values or a distribution")
    constraints: list[str] = key([], "conditions on the varied keys; points that do not meet all of them are left out")
    design: str = key("grid", "how the values of the keys are combined", choices=DESIGNS)
    trials: int | None = key(
        None, "number of points to draw, for saltelli the base number; null for a grid", bounds="from 1 to 1000000"
    )
    seed: int = key(0, "seed of the random draws of points", bounds="not negative")
    seeds: Any = key(None, "seeds that each point is run with: how many, or a list; null: one")
    cases: dict[str, Any] = key({}, "named sets of values of scenario keys that are varied together, as one key `case`")
    arms: dict[str, Any] = key(
        {}, "named sets of values of scenario keys to compare; every arm runs on the same points and seeds"
    )
    success: str = key("", "condition on the metrics for a trial to be a success; empty: none")
    findings: dict[str, str] = key(
        {}, "named conditions on the metrics; the table lists the names of those that a trial meets"
    )
    compare: list[str] = key([], "arms whose successes are compared in pairs by McNemar's exact test")
    share_over: ShareOverConfig | None = key(
        None, "figure of the share of successes over the allowed value of a metric; null: none"
    )
    shown: list[str] = key([], "metrics shown in tables and figures; empty: those of success, findings and worst")
    repeat: RepeatConfig | None = key(
        None, "further seeds for each point until its success rate is known; null: fixed seeds"
    )
    batches: bool = key(
        True, "run similar one-dimensional trials side by side; false: each alone; see Batches in docs/sweeps.md"
    )
    keep: str = key("failed", "trials whose logs are kept", choices=KEEP)
    worst: WorstConfig | None = key(None, "worst trials by a metric, run again and stored in full; null: none")
    envelope: list[str] = key([], "signals recorded in all trials, to show their range over time")

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.design != "grid" and self.trials is None:
            raise BadInputError(f" is missing: the design {self.design} draws as many points", key="trials")
        if self.design == "grid" and self.trials is not None:
            raise invalid("trials", self.trials, "left out: a grid has as many points as its lists give")
        if not (self.keys or self.cases) and self.design != "grid":
            raise invalid("keys", {}, f"at least one key for the design {self.design}")
        for name in self.keys:
            if (first := name.partition(".")[0]) in _INSTEAD:
                raise BadInputError(f" cannot be varied: {_INSTEAD[first]}", key=f"keys.{name}")
        if self.repeat is not None and not self.success:
            raise BadInputError(" is missing: `repeat` needs a condition to count", key="success")
        if self.repeat is not None and self.seeds is not None:
            raise invalid("seeds", self.seeds, "left out: `repeat` chooses them")
        for kind, named in (("arms", self.arms), ("cases", self.cases), ("findings", self.findings)):
            check_names(kind, named)
        for kind, named in (("arms", self.arms), ("cases", self.cases)):
            for name, values in named.items():
                if not isinstance(values, Mapping):
                    raise invalid(f"{kind}.{name}", values, "a mapping of scenario keys to values")
            check_different(kind, {name: plain(values) for name, values in named.items()})
        for kind, names in (("compare", self.compare), ("shown", self.shown), ("envelope", self.envelope)):
            check_distinct(kind, names)
        if len(self.compare) == 1:
            raise invalid("compare", self.compare, "at least two arms")
        for i, name in enumerate(self.compare):
            if name not in self.arms:
                raise unknown("arm", name, self.arms).at(f"compare.{i}")
        if self.compare and not self.success:
            raise BadInputError(" is missing: `compare` needs a condition to count", key="success")
        self._check_overlaps()
        self.seed_list()
        findings = {f"findings.{name}": text for name, text in self.findings.items()}
        constraints = {f"constraints.{i}": text for i, text in enumerate(self.constraints)}
        for conditions in (findings, constraints, {"success": self.success} if self.success else {}):
            seen: dict[frozenset[str], str] = {}
            for name, text in conditions.items():
                Expression(text, name).check_condition()
                parts = _joined(text)
                if len(set(parts)) < len(parts) or seen.setdefault(frozenset(parts), name) != name:
                    where = seen.get(frozenset(parts), name)
                    raise invalid(name, text, f"a condition that does not repeat one, as in {where}")

    def _check_overlaps(self) -> None:
        """One key set in two places would make trials that differ in name only."""
        places = {"overrides": list(self.overrides), "keys": list(self.keys)}
        places |= {f"arms.{name}": list(arm) for name, arm in self.arms.items()}
        for name, own in places.items():
            for one in own:
                if not all(one.split(".")):
                    raise invalid(name, one, "a scenario key, such as station.environment.stiffness")
                for other in self.keys:
                    if overlap(one, other) and (name, one) != ("keys", other):
                        raise BadInputError(f" is also set by keys.{other}: must be set once", key=f"{name}.{one}")
                for case, values in self.cases.items():
                    for other in values if name != "overrides" else ():
                        if overlap(one, other):
                            text = f" is also set by cases.{case}.{other}: must be set once"
                            raise BadInputError(text, key=f"{name}.{one}")

    def seed_list(self) -> list[int] | None:
        """The seeds that each point is run with; None: one, chosen by the design."""
        if self.seeds is None:
            return None
        if isinstance(self.seeds, int) and self.seeds > MOST_SEEDS:
            raise invalid("seeds", self.seeds, f"at most {MOST_SEEDS}")
        found = list(range(self.seeds)) if isinstance(self.seeds, int) else self.seeds
        whole = isinstance(found, list) and all(type(seed) is int and 0 <= seed < 2**63 for seed in found)
        if not whole or not found or len(set(found)) != len(found) or isinstance(self.seeds, bool):
            raise invalid("seeds", self.seeds, "how many, or a list of different whole numbers from 0")
        return found


def _joined(condition: str) -> list[str]:
    """The parts that `and` joins in a condition, each in a normal form, to compare them."""
    tree = ast.parse(condition.strip(), mode="eval").body
    both = isinstance(tree, ast.BoolOp) and isinstance(tree.op, ast.And)
    return [ast.unparse(part) for part in (tree.values if both else [tree])]  # type: ignore[attr-defined]


_INSTEAD = {"seed": "use `seeds`", "variants": "use `arms`", "case": "use `cases`"} | dict.fromkeys(
    ("title", "source", "description", "fidelities", "expect", "log"), "it does not affect the simulation"
)


@dataclass(frozen=True)
class SweepFile:
    """A sweep as given: its configuration, the scenario as a file, and how messages name its places.

    Attributes:
        modules: folder of Python modules that the scenario may name; None: the folder of the scenario.
    """

    name: str
    config: SweepConfig
    origin: str
    lines: dict[str, int]
    modules: Path | None = None

    def where(self, dotted: str) -> str:
        """File and line of a dotted key, for messages."""
        return place(self.origin, self.lines, dotted)


def read_sweep(sweep: str | Path | Mapping[str, Any] | SweepConfig) -> SweepFile:
    """A sweep from a file, a mapping or a configuration.

    Args:
        sweep: path of a YAML file, name of a shipped sweep, the same as a mapping, or a `SweepConfig`.

    Raises:
        BadInputError: anything in it that cannot be used, with file and line.
    """
    if isinstance(sweep, SweepConfig):
        return SweepFile("sweep", sweep, "", {})
    if isinstance(sweep, Mapping):
        tree, name, folder, origin, modules = plain(sweep), "sweep", Path.cwd(), "sweep", None
    else:
        path = _find(Path(os.path.expanduser(sweep)))
        name, folder, origin = path.stem, path.parent, path.name
        modules = folder.resolve()
        try:
            tree = parse(yaml_text(path), path.name)
        except (OSError, UnicodeDecodeError) as error:
            reason = error.strerror if isinstance(error, OSError) else "it is not UTF-8 text"
            raise BadInputError(f"cannot read sweep file {str(path)!r}: {reason}") from None
    if not isinstance(tree, Tagged) or tree.tag is not None:
        known = ", ".join(f.name for f in fields(SweepConfig))
        raise BadInputError(f"{origin}: must be a mapping with keys out of: {known}")
    lines = tree.lines
    reader = ScenarioReader(lambda dotted: place(origin, lines, dotted))
    config: SweepConfig = reader.dataclass(SweepConfig, tree, "")
    beside = folder / config.scenario if isinstance(config.scenario, str) else None
    if beside is not None and config.scenario not in list_experiments() and os.path.isfile(beside):
        config.scenario = str(beside.resolve())
    elif isinstance(config.scenario, Mapping):  # its paths are relative to the folder of the sweep
        if getattr(config.scenario, "tag", None) is not None:
            wrong = invalid("scenario", config.scenario, "a name, a path, or a mapping of scenario keys without a tag")
            raise wrong.at("scenario", place(origin, lines, "scenario"))
        config.scenario = replace(as_file(config.scenario), folder=folder)
    return SweepFile(name, config, origin, lines, modules)


def _find(path: Path) -> Path:
    shipped = experiments_folder() / "sweeps" / f"{path}.yaml"
    if os.path.isfile(path):
        return path
    if path.name == str(path) and os.path.isfile(shipped):
        return shipped
    names = ", ".join(list_sweeps())
    kind = "is a folder" if os.path.isdir(path) else "does not exist"
    raise BadInputError(f"sweep file {str(path)!r} {kind}: must be a YAML file or one of: {names}")


def list_sweeps() -> list[str]:
    """Names of the shipped sweeps, sorted."""
    return sorted(file.stem for file in (experiments_folder() / "sweeps").glob("*.yaml"))


def with_scenario(config: SweepConfig, scenario: ScenarioFile) -> dict[str, Any]:
    """The fields of a sweep with the content of its scenario in place of its name."""
    return {f.name: getattr(config, f.name) for f in fields(config)} | {"scenario": scenario.tree}
