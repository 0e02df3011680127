"""Content of the page of a sweep as rows of text: the plan, states, arms, failures, worst trials, costs."""

from __future__ import annotations

import itertools
import math
import re
import shlex
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from forcectl.sweeps.axes import Axis, label_of
from forcectl.sweeps.report.numbers import Rate, compared, key_columns, outcome, rates, short, shown_metrics, unit_of
from forcectl.sweeps.report.worst import REPLAY, WORST, kept, ranked
from forcectl.sweeps.results import Results
from forcectl.sweeps.study import CASE, Study, Trial, versions
from forcectl.sweeps.table import STATES

if TYPE_CHECKING:
    import pandas as pd

MOST_ROWS = 300  # of the table of trials
MOST_REASONS = 40
MOST_NUMBERS = 8  # trials that are listed for a reason
_MOST_VALUES = 12  # of a key that are listed
_NUMBER = re.compile(r"(?<![\w.])[-+]?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?")
_NOTHING = "–"
_DISTRIBUTIONS = {
    "Deterministic": "always {value}",
    "Gaussian": "Gaussian with mean {mean} and standard deviation {stddev}",
    "Uniform": "uniform from {min} to {max}",
    "LogUniform": "log-uniform from {min} to {max}",
}
_DESIGNS = {
    "grid": "grid: every combination of the values",
    "random": "random points",
    "latin_hypercube": "Latin hypercube",
    "sobol": "Sobol points",
    "saltelli": "Saltelli's points, for Sobol indices",
}


@dataclass(frozen=True)
class Link:
    """A link from a cell of a table."""

    text: str
    target: str


@dataclass(frozen=True)
class TextTable:
    """A table of texts.

    Attributes:
        head: names of the columns.
        rows: of cells: texts, numbers or lists of links.
    """

    head: list[str]
    rows: list[list[Any]] = field(default_factory=list)


def shown(value: Any) -> str:
    """A cell of a table as text."""
    if value is None or str(value) in ("<NA>", "nan", "NaT"):
        return _NOTHING
    if isinstance(value, bool) or str(value) in ("True", "False"):
        return "yes" if value else "no"
    return short(float(value)) if isinstance(value, float) else str(value)


def plan(study: Study, identity: Mapping[str, Any]) -> list[tuple[str, str]]:
    """The plan, as pairs of name and text.

    Args:
        study: the sweep.
        identity: content of `sweep.json`; may be empty.
    """
    config = study.config
    points = _count(len(study.points), "point")
    if study.left_out:
        points += f", {study.left_out} more left out by the constraints"
    facts = [("scenario", study.file.name), ("variant", study.variant), ("design", _DESIGNS[config.design])]
    arms = [_count(len(config.arms), "arm")] if config.arms else []
    facts += [("planned", f"{_count(study.size, 'trial')}: {', '.join([points, _seeds(study), *arms])}")]
    if config.overrides:
        facts.append(("in all trials", _settings(config.overrides)))
    if config.constraints:
        facts.append(("constraints", "; ".join(config.constraints)))
    facts += [("success", config.success)] if config.success else []
    facts += [(f"finding {name}", text) for name, text in config.findings.items()]
    if (repeat := config.repeat) is not None:
        narrow = f"until the half width of the {100 * repeat.confidence:g} % interval is at most {repeat.half_width:g}"
        facts.append(("repeated", f"{narrow}: {repeat.at_least} to {repeat.at_most} times"))
    if config.worst is not None:
        kind = "smallest" if config.worst.smallest else "largest"
        facts.append(("worst", f"{config.worst.count} with the {kind} {config.worst.metric}"))
    if (shard := identity.get("shard", [0, 1]))[1] > 1:
        facts.append(("shard", f"{shard[0] + 1} of {shard[1]}"))
    facts.append(("versions", ", ".join(f"{name} {version}" for name, version in versions().items())))
    if git := identity.get("git"):
        facts.append(("commit", git["commit"] + (", with changes" if git["dirty"] else "")))
    facts.append(("hash of the plan", study.digest()))
    return facts


def _count(number: int, what: str) -> str:
    return f"{number} {what}" if number == 1 else f"{number} {what}s"


def _seeds(study: Study) -> str:
    if study.config.repeat is not None:
        return f"at most {study.config.repeat.at_most} seeds"
    if study.seeds is None:
        return "each with its own seed" if study.seeded_by_point else "with the seed of the scenario"
    listed = ", ".join(map(str, study.seeds[:_MOST_VALUES])) + (", …" if len(study.seeds) > _MOST_VALUES else "")
    return f"{_count(len(study.seeds), 'seed')} ({listed})"


def _settings(values: Mapping[str, Any]) -> str:
    return ", ".join(f"{key} = {label_of(value)}" for key, value in values.items())


def keys_table(study: Study) -> TextTable:
    """The varied keys and their values."""
    scenario = study.scenario(study.trial(0)) if study.axes else None
    rows = [[axis.key, unit_of(scenario, axis.key) or _NOTHING, values_of(axis)] for axis in study.axes]
    return TextTable(["key", "unit", "values"], rows)


def values_of(axis: Axis) -> str:
    """The values that a key takes, in words."""
    if axis.distribution:
        return _DISTRIBUTIONS[axis.distribution].format(**{k: short(v) for k, v in axis.numbers.items()})
    listed = [shown(label) for label in axis.labels[:_MOST_VALUES]]
    more = len(axis.labels) - len(listed)
    return ", ".join(listed) + (f", … ({more} more)" if more else "")


def settings_tables(study: Study) -> list[TextTable]:
    """What each case and each arm sets."""
    named = {CASE: study.config.cases, "arm": study.config.arms}
    return [
        TextTable([what, "sets"], [[name, _settings(values) or "nothing"] for name, values in those.items()])
        for what, those in named.items()
        if those
    ]


def states(table: pd.DataFrame) -> list[tuple[str, int]]:
    """How many trials are in each state that occurs."""
    counts = table["state"].value_counts()
    return [(state, int(counts[state])) for state in STATES if counts.get(state)]


def arms_table(study: Study, table: pd.DataFrame) -> TextTable:
    """Success, findings and medians of metrics of every arm."""
    label, _ = outcome(study, table)
    findings, metrics = list(study.config.findings), shown_metrics(study, table)
    medians = [f"median {name}" for name in metrics]
    head = ["arm", "finished", "failed", label, f"{label} [%]", "95 % interval", *findings, *medians]
    rows: list[list[Any]] = []
    for rate in rates(study, table):
        own = table[(table["arm"] == rate.arm) & table["state"].isin(["done", "failed"])]
        noted = own["findings"].astype(str).str.split(", ").explode().value_counts()
        failed = int((own["state"] == "failed").sum())
        interval = f"{100 * rate.low:.1f} to {100 * rate.high:.1f}" if rate.trials else _NOTHING
        share = f"{100 * rate.share:.1f}" if rate.trials else _NOTHING
        row = [rate.arm or "all trials", len(own), failed, rate.successes, share, interval]
        row += [int(noted.get(name, 0)) for name in findings]
        rows.append([*row, *(_median(own.loc[own["state"] == "done", name]) for name in metrics)])
    return TextTable(head, rows)


def _median(values: pd.Series) -> str:
    """The median, and the number of values where some are missing."""
    there = int(values.count())
    return shown(float(values.median())) + ("" if there in (0, len(values)) else f" (of {there})")


def independence(study: Study) -> str:
    """A caveat on intervals and p where points were run with several seeds each; else ""."""
    if study.config.cases or len(study.points) < 2 or len(study.seeds or [0]) < 2:
        return ""
    return (
        "The trials of a point count as independent ones: intervals and p are those of further seeds on these "
        f"{len(study.points)} points. For further points intervals would be wider and p larger."
    )


def cases_table(study: Study, table: pd.DataFrame) -> TextTable:
    """Successes of every arm in every case, with their intervals."""
    rows: list[list[Any]] = []
    for case in study.config.cases:
        own = table[table[CASE] == case]
        rows.append([case, *(_rate(rate) for rate in rates(study, own))])
    return TextTable([CASE, *(arm or "all trials" for arm in study.arms)], rows)


def _rate(rate: Rate) -> str:
    if not rate.trials:
        return _NOTHING
    return f"{rate.successes}/{rate.trials}, {100 * rate.low:.0f} to {100 * rate.high:.0f} %"


def comparisons(study: Study, table: pd.DataFrame) -> TextTable:
    """Pairs of the arms of `compare`: over all trials, and in the cases where they differ."""
    head = ["arms", "trials", "both", "only the first", "only the second", "none", "p"]
    rows: list[list[Any]] = []
    for first, second in itertools.combinations(study.config.compare, 2):
        parts = {"all": table} | {case: table[table[CASE] == case] for case in study.config.cases}
        for name, part in parts.items():
            one = compared(study, part, first, second)
            if name != "all" and not one.only_first + one.only_second:
                continue
            counts = [one.both, one.only_first, one.only_second, one.neither]
            rows.append([f"{first}, {second}", name, *counts, short(one.p)])
    return TextTable(head, rows)


def failures(study: Study, table: pd.DataFrame) -> TextTable:
    """Reasons of failed trials, the most frequent first; those that differ only in numbers are counted together."""
    failed = table[table["state"] == "failed"]
    pattern = failed["reason"].map(lambda reason: _NUMBER.sub("#", str(reason)))
    rows: list[list[Any]] = []
    for _, name in sorted((-count, name) for name, count in pattern.value_counts().items())[:MOST_REASONS]:
        own = failed[pattern == name]
        trials = [study.trial(int(number)) for number in own["trial"].iloc[:MOST_NUMBERS]]
        rest = f", and {len(own) - len(trials)} more" if len(own) > len(trials) else ""
        again = command(study, trials[0])
        rows.append([len(own), own["reason"].iloc[0], ", ".join(map(_named, trials)) + rest, again])
    return TextTable(["trials", "reason, as of the first one", "numbers", "the first one again"], rows)


def _named(trial: Trial) -> str:
    return f"{trial.number}" if trial.seed is None else f"{trial.number} (seed {trial.seed})"


def command(study: Study, trial: Trial) -> str:
    """The command that runs one trial again; "" where its options cannot express the changes."""
    changes = study.overrides(trial)
    seed = changes.pop("seed", None)
    simple = all(isinstance(value, bool | int | float | str) for value in changes.values())
    if not (simple and isinstance(study.config.scenario, str)):
        return ""
    texts = [str(value).lower() if isinstance(value, bool) else str(value) for value in changes.values()]
    settings = [word for key, text in zip(changes, texts, strict=True) for word in ("--set", f"{key}={text}")]
    seeded = [] if seed is None else ["--seed", str(seed)]
    return shlex.join(["forcectl", "run", study.config.scenario, "--variant", study.variant, *settings, *seeded])


def worst_table(study: Study, results: Results, table: pd.DataFrame) -> TextTable:
    """The worst trials with links to their stored files."""
    worst = study.config.worst
    numbers = ranked(study, table)
    if worst is None or not numbers:
        return TextTable([])
    rows, there = [], kept(results)
    found = table.set_index("trial")
    keys = [axis.key for axis in study.axes]
    for number in numbers:
        row = found.loc[number]
        folder = there.get(number)
        names = ("figures/force.svg", "diagram.html", REPLAY, "log.nc")
        links = [] if folder is None else [Link("folder", f"{WORST}/{folder.name}/")]
        links += [Link(name.rpartition("/")[2], f"{WORST}/{folder.name}/{name}")
                  for name in names if folder is not None and (folder / name).is_file()]  # fmt: skip
        values = [shown(row[name]) for name in ["arm", "seed", *keys]]
        rows.append([number, shown(float(row[worst.metric])), *values, shown(row["success"]), links])
    return TextTable(["trial", worst.metric, "arm", "seed", *keys, "success", "kept"], rows)


def trials_table(study: Study, table: pd.DataFrame) -> TextTable:
    """The first rows of the table of trials."""
    keys, metrics = [column.key for column in key_columns(study, table)], shown_metrics(study, table)
    columns = ["trial", *(["arm"] if any(study.arms) else []), "seed", *keys, "state"]
    columns += (["success"] if study.config.success else []) + (["findings"] if study.config.findings else []) + metrics
    first = table.iloc[:MOST_ROWS]
    texts = [[shown(value) for value in _values(first[name])] for name in columns]
    return TextTable(columns, [list(row) for row in zip(*texts, strict=True)])


def _values(column: pd.Series) -> Iterable[Any]:
    return column.astype(object).tolist()


def costs_of_arms(study: Study, table: pd.DataFrame, costs: pd.DataFrame) -> TextTable:
    """Computing time of a trial of each arm."""
    rows: list[list[Any]] = []
    if len(study.arms) > 1 and not costs.empty and "cpu_s" in costs:
        arms = costs["trial"].map(dict(zip(table["trial"], table["arm"], strict=True)))
        for arm in study.arms:
            cpu = costs["cpu_s"][arms == arm].dropna()
            if len(cpu):
                rows.append([arm, len(cpu), short(float(cpu.median())), short(float(cpu.mean()))])
    return TextTable(["arm", "trials", "median [s]", "mean [s]"], rows)


def costs_summary(costs: pd.DataFrame) -> list[tuple[str, str]]:
    """Computing and elapsed times, as pairs of name and text."""
    if costs.empty or "cpu_s" not in costs:
        return []
    cpu, wall = costs["cpu_s"].dropna(), costs["wall_s"].dropna()
    if cpu.empty:
        return []
    longest = costs.loc[cpu.idxmax()]
    facts = [
        ("finished trials", str(len(costs))),
        ("side by side in batches", str(int((costs["batch"] > 1).sum()))),
        ("computing time of a trial, median", duration(float(cpu.median()))),
        ("longest computing time", f"{duration(float(cpu.max()))} (trial {int(longest['trial'])})"),
        ("computing time in all", duration(float(cpu.sum()))),
        ("elapsed time of the trials in all", duration(float(wall.sum()))),
    ]
    if "host" in costs:
        facts.append(("machines", str(costs["host"].nunique())))
    return facts


def duration(seconds: float) -> str:
    """A time in words."""
    if seconds < 120:
        return f"{seconds:.3g} s"
    minutes, _ = divmod(round(seconds), 60)
    return f"{minutes // 60} h {minutes % 60} min" if minutes >= 60 else f"{minutes} min {math.floor(seconds % 60)} s"


def resume_command(study: Study, results: Results) -> str:
    """The command, or the Python call, that resumes a sweep."""
    if not study.writable:
        return f"forcectl.sweeps.sweep(sweep, out={str(results.folder)!r}, resume=True)"
    return shlex.join(["forcectl", "sweep", str(results.folder), "--resume"])
