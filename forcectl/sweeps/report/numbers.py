"""Numbers of a sweep from its table: success rates with intervals, values of keys, groups of trials, sensitivity."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, fields, is_dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import binomtest, rankdata, sobol_indices

from forcectl.arrays import Array
from forcectl.framework.expression import Expression
from forcectl.framework.fields import key_of
from forcectl.sweeps.agenda import wilson
from forcectl.sweeps.axes import Axis
from forcectl.sweeps.study import Study

if TYPE_CHECKING:
    import pandas as pd

FEW_VALUES = 20  # of a key: up to here each value is a group of its own
_FIXED = ("trial", "point", "arm", "seed", "state", "success", "findings", "reason", "time_s")
_DECADES = 100.0  # ratio of the largest to the smallest value, from which an axis is logarithmic
_GROUP = 15  # trials of a group where a key takes many values
_MOST_GROUPS = 12
_LEAST_RANKED = 8  # trials, for a rank correlation
_RESAMPLED = 200  # bootstrap samples for the intervals of sensitivities
_RESAMPLED_LARGE = 40  # the same for many trials
_MANY = 50_000  # trials from which `_RESAMPLED_LARGE` is used
_WITHOUT = 3  # metrics that are shown where the sweep names none


@dataclass(frozen=True)
class Rate:
    """How often an arm succeeds: successes among its finished trials, and the Wilson interval."""

    arm: str
    successes: int
    trials: int
    low: float
    high: float

    @property
    def share(self) -> float:
        """Share of successes; NaN without trials."""
        return self.successes / self.trials if self.trials else float("nan")


def outcome(study: Study, table: pd.DataFrame) -> tuple[str, Array]:
    """The name of a good outcome, and for each row 1 (good), 0 (not good) or NaN (not finished).

    A sweep without a condition for success counts the trials that do not fail.

    Args:
        study: the sweep.
        table: of its trials.
    """
    if study.config.success:
        return "success", table["success"].astype("Float64").to_numpy(float, na_value=np.nan)
    finished = table["state"].isin(["done", "failed"]).to_numpy(bool)
    return "no failure", np.where(finished, (table["state"] == "done").to_numpy(float), np.nan)


def rates(study: Study, table: pd.DataFrame) -> list[Rate]:
    """The rate of every arm, in the order of the sweep."""
    _, good = outcome(study, table)
    found = []
    for arm in study.arms:
        own = good[(table["arm"] == arm).to_numpy(bool)]
        own = own[~np.isnan(own)]
        found.append(Rate(arm, int(own.sum()), len(own), *wilson(int(own.sum()), len(own))))
    return found


@dataclass(frozen=True)
class Comparison:
    """Two arms on the same points and seeds: in how many pairs of trials both, one or none succeeds.

    Attributes:
        first, second: names of the arms.
        both, only_first, only_second, neither: pairs.
    """

    first: str
    second: str
    both: int
    only_first: int
    only_second: int
    neither: int

    @property
    def p(self) -> float:
        """Of McNemar's exact two-sided test: probability of counts at least this unequal if the arms were equal."""
        differing = self.only_first + self.only_second
        return float(binomtest(self.only_first, differing).pvalue) if differing else 1.0


def compared(study: Study, table: pd.DataFrame, first: str, second: str) -> Comparison:
    """Two arms by the pairs of trials that are both finished; a trial that fails is no success.

    Args:
        study: the sweep.
        table: of its trials.
        first, second: names of the arms.
    """
    _, good = outcome(study, table)
    pair = table["trial"].to_numpy(int) // len(study.arms)  # the arm is the fastest index
    one, other = (
        dict(zip(pair[rows], good[rows] > 0, strict=True))
        for arm in (first, second)
        for rows in [np.isfinite(good) & (table["arm"] == arm).to_numpy(bool)]
    )
    found = Counter((one[number], other[number]) for number in one.keys() & other.keys())
    return Comparison(
        first, second, *(found[pair] for pair in ((True, True), (True, False), (False, True), (False, False)))
    )


def share_over(study: Study, table: pd.DataFrame, arm: str) -> tuple[Array, Array, int]:
    """Values of the metric of `share_over` in the trials of an arm that meet its condition, and their shares.

    Args:
        study: the sweep, which has the key `share_over`.
        table: of its finished trials.
        arm: name.

    Returns:
        values, ascending, (n,); share of finished trials that meet the condition with at most that value, (n,); number
        of finished trials.
    """
    asked = study.config.share_over
    assert asked is not None
    own = table[table["arm"] == arm]
    condition, names = Expression(asked.condition), metric_columns(study, table)
    rows = own[own["state"] == "done"][names].to_dict("records")
    given = [{name: None if np.isnan(value) else value for name, value in row.items()} for row in rows]
    met = [row[asked.metric] for row in given if row.get(asked.metric) is not None and condition(row)]
    return np.sort(np.array(met, dtype=float)), np.arange(1, len(met) + 1) / max(len(own), 1), len(own)


def metric_columns(study: Study, table: pd.DataFrame) -> list[str]:
    """The metrics that at least one trial has a value of."""
    known = {*_FIXED, *(axis.key for axis in study.axes)}
    return [str(name) for name in table.columns if name not in known and table[name].notna().any()]


def shown_metrics(study: Study, table: pd.DataFrame) -> list[str]:
    """The metrics that the sweep names; where it names none, the first ones that differ between trials."""
    config, known = study.config, metric_columns(study, table)
    if config.shown:
        return [name for name in config.shown if name in known]
    texts = [config.success, *config.findings.values()]
    named = [name for text in texts if text for name in Expression(text).names]
    if config.worst is not None:
        named.append(config.worst.metric)
    if not named:
        return [name for name in known if table[name].nunique() > 1][:_WITHOUT]
    return [name for name in dict.fromkeys(named) if name in known]


@dataclass(frozen=True)
class KeyColumn:
    """The values of a key in the rows of a table, as positions on an axis.

    Attributes:
        key: dotted key of the scenario.
        unit: of its values; "" for none.
        scale: "linear", "log" or "category".
        positions: of the rows: values of the key, or numbers of the categories from 0.
        labels: of the categories.
    """

    key: str
    unit: str
    scale: str
    positions: Array
    labels: list[str]

    @property
    def distinct(self) -> Array:
        """Positions that occur, in order."""
        return np.unique(self.positions)

    @property
    def listed(self) -> bool:
        """Whether the key takes so few values that each is a group of its own."""
        return len(self.distinct) <= FEW_VALUES

    @property
    def label(self) -> str:
        """Key and unit."""
        return f"{self.key} [{self.unit}]" if self.unit else self.key


def key_columns(study: Study, table: pd.DataFrame) -> list[KeyColumn]:
    """The keys that take more than one value in a table."""
    if table.empty:
        return []
    scenario = study.scenario(study.trial(int(table["trial"].iloc[0])))
    found = [_key_column(axis, table[axis.key], unit_of(scenario, axis.key)) for axis in study.axes]
    return [column for column in found if len(column.distinct) > 1]


def arm_column(study: Study, table: pd.DataFrame) -> KeyColumn:
    """The arms as categories, for sweeps without keys."""
    arms = study.arms
    positions = np.array([arms.index(arm) for arm in table["arm"]], dtype=float)
    return KeyColumn("arm" if any(arms) else "", "", "category", positions, [arm or "all trials" for arm in arms])


def _key_column(axis: Axis, values: pd.Series, unit: str) -> KeyColumn:
    kind = values.dtype.kind
    if kind not in "iuf":  # true, false and texts, in the order of the list
        texts = [str(value) for value in values]
        there = set(texts)
        order = list(dict.fromkeys([text for text in map(str, axis.labels) if text in there] + sorted(there)))
        index = {text: float(i) for i, text in enumerate(order)}
        return KeyColumn(axis.key, unit, "category", np.array([index[text] for text in texts]), order)
    numbers = values.to_numpy(float)
    distinct = np.unique(numbers)
    positive = distinct[distinct > 0]
    wide = not axis.distribution and len(positive) > 1 and positive[-1] >= _DECADES * positive[0]
    if wide and len(positive) < len(distinct) <= FEW_VALUES:  # zero, and values over decades
        labels = [short(value) for value in distinct]
        return KeyColumn(axis.key, unit, "category", np.searchsorted(distinct, numbers).astype(float), labels)
    logarithmic = len(positive) == len(distinct) and (wide or axis.distribution == "LogUniform")
    return KeyColumn(axis.key, unit, "log" if logarithmic else "linear", numbers, [])


def unit_of(scenario: Any, key: str) -> str:
    """Unit of a key of a scenario, as its field declares it; "" where it declares none.

    Args:
        scenario: the object that the key is of.
        key: with dots.
    """
    part, unit = scenario, ""
    for name in key.split("."):
        if isinstance(part, Mapping) and name in part:
            part, unit = part[name], ""
            continue
        declared = [field for field in fields(part) if field.name == name] if is_dataclass(part) else []
        if not declared:
            return ""
        part, unit = getattr(part, name), key_of(declared[0]).unit
    return unit


def short(value: float) -> str:
    """A number in few characters: 1e5 rather than 100000 or 1e+05."""
    plain = f"{value:.4g}"
    mantissa, _, exponent = f"{value:.3e}".partition("e")
    scientific = f"{mantissa.rstrip('0').rstrip('.')}e{int(exponent)}"
    return scientific if "e" in plain or len(scientific) < len(plain) else plain


def groups(positions: Array) -> list[tuple[float, NDArray[np.bool_]]]:
    """Groups of rows whose values of a key are equal, or close where it takes many; each with its middle value.

    Args:
        positions: of the rows, as those of `KeyColumn`.
    """
    distinct = np.unique(positions)
    if len(distinct) <= FEW_VALUES:
        return [(float(value), positions == value) for value in distinct]
    count = int(np.clip(len(positions) // _GROUP, 3, _MOST_GROUPS))
    parts = np.array_split(np.argsort(positions, kind="stable"), count)
    return [(float(np.median(positions[part])), np.isin(np.arange(len(positions)), part)) for part in parts]


def association(column: KeyColumn, values: Array) -> float:
    """Strength of association of values with a key, from 0 to 1: magnitude of Spearman's rank correlation.

    For a key without order it is the correlation ratio of the ranks: the root of the share of their variance
    between categories.

    Args:
        column: of the key.
        values: by row; values that are not finite are left out.
    """
    there = np.isfinite(values)
    positions, ranks = column.positions[there], rankdata(values[there])
    if len(ranks) < 3 or np.ptp(ranks) == 0 or np.ptp(positions) == 0:
        return float("nan")
    if column.scale == "category" and not _numbers(column.labels):
        means = np.zeros(len(ranks))
        for position in np.unique(positions):
            means[positions == position] = ranks[positions == position].mean()
        return float(np.sqrt(means.var() / ranks.var()))
    return float(abs(np.corrcoef(rankdata(positions), ranks)[0, 1]))


def _numbers(labels: list[str]) -> bool:
    try:
        return bool([float(label) for label in labels])
    except ValueError:
        return False


def by_influence(columns: list[KeyColumn], values: Array) -> list[KeyColumn]:
    """Keys, the one with which values are associated most first.

    Args:
        columns: of the keys.
        values: by row.
    """
    strength = {column.key: association(column, values) for column in columns}
    return sorted(columns, key=lambda column: -np.nan_to_num(strength[column.key], nan=-1.0))


@dataclass(frozen=True)
class Sensitivity:
    """Sensitivity of a metric to each key.

    Attributes:
        keys: of the scenario.
        first: first-order Sobol indices, or magnitudes of rank correlations.
        total: total Sobol indices; None for rank correlations.
        first_range: 95 % intervals of `first`, shape (2, keys); None for rank correlations.
        total_range: those of `total`.
        chance: rank correlation that a key without influence exceeds in 5 % of sweeps; None for Sobol indices.
        trials: number of trials that it is computed from.
    """

    keys: list[str]
    first: Array
    total: Array | None
    first_range: Array | None
    total_range: Array | None
    chance: float | None
    trials: int


def sensitivity(study: Study, columns: list[KeyColumn], points: NDArray[np.int64], values: Array) -> Sensitivity | str:
    """Sensitivity of a metric to each key, or a text that says why it cannot be computed.

    For the design `saltelli` these are Sobol indices, for every other one rank correlations.

    Args:
        study: the sweep.
        columns: of the keys, with rows of one arm.
        points: numbers of the points of these rows.
        values: by row.
    """
    finite = np.isfinite(values)
    if study.config.design == "saltelli" and len(study.axes) > 1:
        missing = len(study.points) - int(finite.sum())
        if missing > 0:
            return f"{missing} of {len(study.points)} points have no value, and Sobol indices need all"
        if np.ptp(values) == 0:
            return "it is the same in all trials"
        return _sobol(study, values[np.argsort(points, kind="stable")])
    if len(columns) < 2:
        return "there are no two keys to compare"
    if finite.sum() < _LEAST_RANKED:
        return f"{finite.sum()} trials have a value: at least {_LEAST_RANKED} are needed"
    if np.ptp(values[finite]) == 0:
        return "it is the same in all trials"
    found = np.nan_to_num([association(column, values) for column in columns])
    chance = 1.96 / np.sqrt(finite.sum() - 1)
    return Sensitivity([c.key for c in columns], found, None, None, None, float(chance), int(finite.sum()))


def _sobol(study: Study, values: Array) -> Sensitivity:
    """Indices from values at the points A, B and, for each key, A with that column of B."""
    count, size = study.config.trials or 1, len(study.axes)
    parts = values.reshape(size + 2, count)

    def indices(rows: NDArray[np.int64]) -> tuple[Array, Array]:
        drawn = parts[:, rows]
        func = {"f_A": drawn[:1], "f_B": drawn[1:2], "f_AB": drawn[2:, None, :]}
        found = sobol_indices(func=func, n=count)
        return found.first_order, found.total_order

    first, total = indices(np.arange(count))
    generator = np.random.default_rng(0)
    resampled = _RESAMPLED if len(values) < _MANY else _RESAMPLED_LARGE
    again = np.array([indices(generator.integers(count, size=count)) for _ in range(resampled)])
    ranges = np.percentile(again, [2.5, 97.5], axis=0)
    keys = [axis.key for axis in study.axes]
    return Sensitivity(keys, first, total, ranges[:, 0], ranges[:, 1], None, len(values))
