"""Published or required values of the metrics of a run, and the verdict on the values obtained."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

from forcectl.analysis.force_targets import Allowed
from forcectl.analysis.tables.metric_tables import (
    PAIR_METRICS,
    is_metric,
    metric_range,
    metric_unit,
    unknown_metric,
)
from forcectl.errors import BadInputError, check_distinct, invalid, unknown
from forcectl.framework.fields import Config, key
from forcectl.framework.reader import Reader
from forcectl.framework.yaml_tree import plain

Metrics = Mapping[str, float | None]
# (variant, other variant, share of the last step) -> `force_distance_N`
Distance = Callable[[str, str, float], float | None]


@dataclass(kw_only=True)
class Term(Config):
    """A metric of a variant."""

    metric: str = key(meaning="name of the other metric")
    variant: str | None = key(None, "variant that the other metric is taken from; null: that of the expectation")

    def __post_init__(self) -> None:
        super().__post_init__()
        _check_metric(self.metric)


@dataclass(kw_only=True)
class Other(Config):
    """The variant whose measured force is the reference of a comparison, and the range compared."""

    variant: str = key(meaning="variant whose measured force is compared with")
    until_pct: float = key(
        100.0,
        "end of the comparison: when the other force has first covered this share of the last step, in %",
        bounds="above 0 and at most 100",
    )


@dataclass(kw_only=True)
class Tolerance(Config):
    """Allowed distance from a number: the larger of an absolute and a relative one."""

    absolute: float = key(0.0, "absolute tolerance, in the unit of the metric", bounds="not negative")
    relative: float = key(0.0, "tolerance as a share of the number it applies to", bounds="from 0 to 2")

    def width(self, number: float) -> float:
        """Allowed distance from `number`."""
        return max(self.absolute, self.relative * abs(number))

    def holds(self, number: float, ours: float | None) -> bool:
        """Whether the value `ours` is within the allowed distance from `number`; no for None."""
        return ours is not None and abs(ours - number) <= self.width(number)


DRIFT = Tolerance(relative=0.05)  # of a line without `drift`


@dataclass(kw_only=True)
class Expectation(Config):
    """One line of `expect`.

    The judged value is the metric of `variant`, minus that of `minus`, or divided by that of `ratio`. The metric
    `force_distance_N` is the distance of the variant's measured force from that of the variant in `distance_to`.

    The value passes when it lies within `tolerance` of `published` (if there is a tolerance) and between `minimum` and
    `maximum` (with `strict` not on them). A line with a known gap is judged alike. It is shown as missed, with the
    reason, but does not count as a failure. A gap is out of date when the line passes by more than its `drift`; then
    `forcectl reproduce --check` fails.

    Independently, a line has drifted when its value is further than `drift` from `expected`. So a constant deviation
    from the thesis is accepted, but a change of the code that moves a number shows.
    """

    target: str = key(meaning="name of this expectation")
    metric: str = key(meaning="name of the metric that is judged")
    variant: str | None = key(None, "variant that the metric is taken from; null: the first one")
    minus: Term | None = key(None, "metric that is subtracted; null: none")
    ratio: Term | None = key(None, "metric that is divided by; null: none")
    distance_to: Other | None = key(None, "variant from whose force force_distance_N is the distance")
    published: float | str | None = key(None, "number that the thesis gives, or its statement in words")
    expected: float | dict[str, float] | None = key(
        None, "earlier result, the reference of the drift: on the first of the fidelities, or by fidelity"
    )
    drift: Tolerance | None = key(None, "allowed distance from `expected`; null: 5 % of it")
    tolerance: Tolerance | None = key(None, "allowed distance from `published`; null: not judged by it")
    minimum: float | None = key(None, "smallest value that passes; null: no limit")
    maximum: float | None = key(None, "largest value that passes; null: no limit")
    strict: bool = key(False, "true: values equal to minimum or maximum do not pass")
    fidelities: list[str] = key([], "fidelities on which the line is judged, on others it is only reported; empty: all")
    gaps: dict[str, str] = key({}, "reason why the line is missed, by fidelity: a known gap, recorded in KNOWN_GAPS.md")

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.metric not in PAIR_METRICS:
            _check_metric(self.metric)
        if (self.distance_to is not None) != (self.metric in PAIR_METRICS):
            raise BadInputError(f"target {self.target!r}: force_distance_N and distance_to must go together")
        self._check_terms()
        if self.tolerance is not None and not isinstance(self.published, float):
            raise invalid("published", self.published, "a number, because there is a tolerance")
        if self.drift is not None and self.expected is None:
            raise BadInputError(f"target {self.target!r}: drift must go together with expected, from which it counts")
        if self.minimum is not None and self.maximum is not None and self.minimum > self.maximum:
            raise invalid("minimum", self.minimum, f"at most maximum = {self.maximum:g}")
        self._check_limits()
        if self.tolerance is None and self.minimum is None and self.maximum is None:
            raise BadInputError(f"target {self.target!r} has no criterion: must have tolerance, minimum or maximum")

    def _check_terms(self) -> None:
        """Refuse `minus` together with `ratio`, and subtracted metrics of different units."""
        if self.minus is not None and self.ratio is not None:
            raise BadInputError(f"target {self.target!r}: minus and ratio must not go together")
        if self.minus is not None:
            unit, other = metric_unit(self.metric), metric_unit(self.minus.metric)
            if unit and other and unit != other:
                raise invalid("minus.metric", self.minus.metric, f"a metric in {unit}, as {self.metric}")

    def _check_limits(self) -> None:
        """Refuse limits that no value meets, and an expected value that does not pass although there is no gap."""
        if not self.target.strip() or not self.target.isprintable():
            raise invalid("target", self.target, "printable characters")
        low, high = (x if x is not None else side for x, side in ((self.minimum, -math.inf), (self.maximum, math.inf)))
        if self.minus is None and self.ratio is None:
            least, most = metric_range(self.metric)
            for name, limit in (("minimum", self.minimum), ("maximum", self.maximum)):
                if limit is not None and limit < 0 <= least:
                    raise invalid(name, limit, f"not negative, as {self.metric} is")
            if high == 0 <= least and self.strict:
                raise invalid("maximum", high, f"above 0 where strict = true, as {self.metric} is never negative")
            if low > most:
                raise invalid("minimum", low, f"at most {most:g}, as {self.metric} is")
        if self.strict and low == high:
            raise invalid("minimum", low, f"below maximum = {high:g} where strict = true")
        if self.tolerance is not None and isinstance(self.published, float):
            counted = metric_unit(self.metric) in ("", "1")
            if not counted and not (self.tolerance.absolute or self.tolerance.relative):
                raise BadInputError(" is zero: must have absolute or relative above 0", key="tolerance")
            width = self.tolerance.width(self.published)
            nearest = min(max(self.published, low), high)
            if abs(nearest - self.published) > width:
                allowed = f"within {width:g} of the range from {low:g} to {high:g}"
                raise invalid("published", self.published, allowed)
        check_distinct("fidelities", self.fidelities)
        for name, why in self.gaps.items():
            if not why.strip():
                raise invalid(f"gaps.{name}", why, "the reason, in words")
        for name in self.gaps if self.fidelities else ():
            if name not in self.fidelities:
                raise invalid(f"gaps.{name}", self.gaps[name], "left out: the line is not judged there")
        known = self.expected if isinstance(self.expected, dict) else {"": self.expected}
        for name, value in known.items():
            judged = not name or not self.fidelities or name in self.fidelities
            gap = self.gaps if not name else name in self.gaps
            if value is not None and judged and not gap and not low <= value <= high:
                allowed = f"from {low:g} to {high:g}, as minimum and maximum require, or have a gap"
                raise invalid("expected" + (f".{name}" if name else ""), value, allowed)

    @property
    def metrics(self) -> list[str]:
        """Names of the metrics that the value is made of."""
        return [self.metric, *(term.metric for term in (self.minus, self.ratio) if term is not None)]

    def allowed(self, fidelity: str) -> Allowed | None:
        """Allowed range of the metric on a fidelity; None where it is not judged, or combined with another value."""
        if self.minus or self.ratio or self.distance_to or (self.fidelities and fidelity not in self.fidelities):
            return None
        low, high = self.minimum, self.maximum
        number = self.published if isinstance(self.published, float) else None
        if self.tolerance is not None and number is not None:
            width = self.tolerance.width(number)
            low = number - width if low is None else max(low, number - width)
            high = number + width if high is None else min(high, number + width)
        return Allowed(self.metric, self.variant, low, high, number)

    def variants(self, names: Sequence[str]) -> dict[str, str]:
        """The variant of each term, by key: its own, else that of the expectation, else the first one."""
        own = self.variant if self.variant is not None else names[0]
        found = {"variant": own}
        for name in ("minus", "ratio", "distance_to"):
            term = getattr(self, name)
            if term is not None:
                found[f"{name}.variant"] = term.variant if term.variant is not None else own
        return found

    def is_of(self, chosen: Collection[str], names: Sequence[str]) -> bool:
        """Whether each term is of one of the chosen variants."""
        return all(name in chosen for name in self.variants(names).values())


class JudgedMetric(NamedTuple):
    """A metric that a line of `expect` judges, or compares with; `key`: its dotted key in the scenario."""

    key: str
    metric: str
    line: Expectation


def judged_metrics(
    lines: Sequence[Expectation], variant: str, names: Sequence[str], fidelity: str
) -> tuple[JudgedMetric, ...]:
    """The metrics of a variant that are judged on a fidelity.

    Args:
        lines: the expectations of the scenario.
        variant: variant whose metrics are listed.
        names: names of all variants.
        fidelity: fidelity of the run. Lines with a gap there are left out, as they may have no value.

    Raises:
        BadInputError: a line names an unknown variant, compares a metric with itself, or repeats another line.
    """
    found, asked = list[JudgedMetric](), list[dict[str, Any]]()
    for i, line in enumerate(lines):
        asked.append({**vars(line), "target": ""})
        if asked[-1] in asked[:-1]:
            twin = lines[asked.index(asked[-1])].target
            raise invalid(f"expect.{i}.target", line.target, f"an expectation that differs from {twin!r}")
        judged = (not line.fidelities or fidelity in line.fidelities) and fidelity not in line.gaps
        for place, name in (of_terms := line.variants(names)).items():
            if name not in names:
                raise unknown("variant", name, names).at(f"expect.{i}.{place}")
            term = place.removesuffix("variant")  # empty for the line itself
            metric = getattr(getattr(line, term[:-1]) if term else line, "metric", line.metric)
            if term and (metric, name) == (line.metric, of_terms["variant"]):
                if line.distance_to is not None:
                    raise invalid(f"expect.{i}.{place}", name, "another variant")
                raise invalid(f"expect.{i}.{term}metric", metric, "another metric, or that of another variant")
            if judged and name == variant and line.metric not in PAIR_METRICS:
                found.append(JudgedMetric(f"expect.{i}.{term}metric", metric, line))
    return tuple(found)


_ROW = {"passed": "pass", "drifted": "drift"}  # attribute -> its name in `summary.json`, where they differ


@dataclass(frozen=True)
class Verdict:
    """The result of judging one expectation.

    Attributes:
        ours: value of this run, in the unit of the metric; None where it is undefined.
        deviation: ours minus published, where published is a number.
        tolerance: allowed values, as text.
        passed: whether it is met; None for a value that is reported but not judged.
        expected: value of an earlier run; None where there is none on this fidelity.
        drifted: whether ours is too far from expected; None without expected.
        metrics: names of the metrics that ours is made of.
        unit: unit of ours, published and expected.
        gap: reason why it is known to be missed; "" without a known gap.
        stale: whether the gap is out of date: the line is met, and would be met after any drift that is allowed.
    """

    target: str
    published: float | str | None
    ours: float | None
    deviation: float | None
    tolerance: str
    passed: bool | None
    note: str = ""
    expected: float | None = None
    drifted: bool | None = None
    metrics: tuple[str, ...] = ()
    unit: str = ""
    gap: str = ""
    stale: bool = False

    @property
    def surprising(self) -> bool:
        """Whether it is missed without a known gap."""
        return self.passed is False and not self.gap

    def as_row(self) -> dict[str, Any]:
        """The record of `summary.json`."""
        words = {name: text for name, text in (("note", self.note), ("gap", self.gap)) if text}
        left = ("target", "note", "gap", "stale")
        row = {_ROW.get(name, name): value for name, value in vars(self).items() if name not in left}
        return row | {"metrics": list(self.metrics)} | words | ({"stale": True} if self.stale else {})

    @staticmethod
    def from_row(target: str, row: Mapping[str, Any]) -> Verdict:
        """The verdict from a record of `summary.json`; BadInputError for a record of another form."""
        known = {name: row[_ROW.get(name, name)] for name in Verdict.__annotations__ if _ROW.get(name, name) in row}
        return Reader().dataclass(Verdict, plain(known | {"target": target}), f"expectations.{target}")


def judge(
    expectation: Expectation,
    metrics: Mapping[str, Metrics],
    names: Sequence[str],
    fidelity: str,
    distance: Distance = lambda variant, other, share: None,
    fidelities: Sequence[str] = (),
) -> Verdict:
    """The verdict on one expectation.

    Args:
        expectation: the line that is judged.
        metrics: variant -> metric -> value.
        names: all variants of the scenario; a variant that failed has no metrics.
        fidelity: fidelity of the simulated station.
        distance: gives `force_distance_N`.
        fidelities: fidelities of the scenario. A plain number in `expected` belongs to the first fidelity of the line,
            else to the first of these.
    """
    ours, note = _value(expectation, metrics, names, distance)
    judged = not expectation.fidelities or fidelity in expectation.fidelities
    published = expectation.published
    known = expectation.expected
    if not isinstance(known, dict):
        known = {} if known is None else {[*expectation.fidelities, *fidelities, fidelity][0]: known}
    expected = known.get(fidelity)
    drift, gap = expectation.drift or DRIFT, expectation.gaps.get(fidelity, "") if judged else ""
    stale = False
    if gap and ours is not None:
        width = drift.width(ours if expected is None else expected)
        stale = all(_within(expectation, ours + way) for way in (-width, 0.0, width))
    return Verdict(
        target=expectation.target,
        published=published,
        ours=ours,
        deviation=ours - published if ours is not None and isinstance(published, float) else None,
        tolerance=tolerance_text(expectation),
        passed=(ours is not None and _within(expectation, ours)) if judged else None,
        note=note,
        expected=expected,
        drifted=None if expected is None else not drift.holds(expected, ours),
        metrics=tuple(expectation.metrics),
        unit=metric_unit(expectation.metric) if expectation.ratio is None else "",
        gap=gap,
        stale=stale,
    )


def _value(
    expectation: Expectation, metrics: Mapping[str, Metrics], names: Sequence[str], distance: Distance
) -> tuple[float | None, str]:
    where = expectation.variants(names)

    def look_up(metric: str, variant: str) -> float | None:
        return metrics.get(variant, {}).get(metric)

    if (other_one := expectation.distance_to) is not None:
        value = distance(where["variant"], other_one.variant, other_one.until_pct / 100)
    else:
        value = look_up(expectation.metric, where["variant"])
    if value is None:
        return None, f"{expectation.metric} of {where['variant']!r} is undefined"
    for name, term in (("minus", expectation.minus), ("ratio", expectation.ratio)):
        if term is None:
            continue
        other = look_up(term.metric, where[f"{name}.variant"])
        if other is None or (name == "ratio" and other == 0):
            return None, f"{term.metric} of {where[f'{name}.variant']!r} is undefined or zero"
        value = value - other if name == "minus" else value / other
    return value, ""


def _within(expectation: Expectation, ours: float) -> bool:
    published, tolerance, strict = expectation.published, expectation.tolerance, expectation.strict
    low = -math.inf if expectation.minimum is None else expectation.minimum
    high = math.inf if expectation.maximum is None else expectation.maximum
    near = tolerance is None or not isinstance(published, float) or tolerance.holds(published, ours)
    return near and (low < ours < high if strict else low <= ours <= high)


def tolerance_text(expectation: Expectation) -> str:
    """What is allowed, for a table: `± 0.25`, `≤ 2`, `5 … 18`."""
    parts = []
    if expectation.tolerance and isinstance(expectation.published, float):
        parts.append(f"± {expectation.tolerance.width(expectation.published):.3g}")
    low, high = expectation.minimum, expectation.maximum
    if low is not None and high is not None:
        parts.append(f"{low:g} … {high:g}")
    elif low is not None:
        parts.append(f"{'>' if expectation.strict else '≥'} {low:g}")
    elif high is not None:
        parts.append(f"{'<' if expectation.strict else '≤'} {high:g}")
    return ", ".join(parts)


def _check_metric(name: str) -> None:
    if not is_metric(name):
        raise BadInputError(f" = {name!r}: {unknown_metric(name)}", key="metric")
