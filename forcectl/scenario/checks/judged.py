"""Checks of `expect`: the metrics must exist in the runs of the scenario, and the fidelities must be known."""

from __future__ import annotations

import math
import re
from typing import TYPE_CHECKING

from forcectl.analysis.tables.metric_tables import (
    GAINS,
    METRICS,
    MOTION_METRICS,
    TUNING_METRICS,
    metric_range,
    metric_unit,
)
from forcectl.analysis.tables.reference import analyses_of
from forcectl.analysis.tables.task_tables import MODE_METRICS
from forcectl.analysis.tracking_metrics import TRACKING_METRICS
from forcectl.errors import check_distinct, invalid, unknown
from forcectl.scenario.catalog import tags_of
from forcectl.scenario.trees import to_tree

if TYPE_CHECKING:
    from forcectl.diagrams.loop import Loop
    from forcectl.scenario.expectations import Expectation
    from forcectl.scenario.scenario import Scenario

_PARTS = re.compile(r"(?:(?!step_\d)(.+?)\.)?(?:step_(\d+)\.)?([^.]+)")


def metric_parts(name: str) -> tuple[str, int | None, str]:
    """Parts of a metric's name: arm, joint, mode or surface ("" for none), number of a step (or None), own name."""
    front, number, last = _PARTS.fullmatch(name).groups()  # type: ignore[union-attr]
    return front or "", None if number is None else int(number), last


def check_judged(scenario: Scenario, loop: Loop) -> None:
    """Refuse expected metrics that no run of the scenario has. A user's own analyses may return any metric.

    Args:
        scenario: the scenario, as read.
        loop: the loop built from it.

    Raises:
        BadInputError: about the metric.
    """
    if any(not type(each).__module__.startswith("forcectl.") for each in scenario.analyses.values()):
        return
    tags = {to_tree(each, "analysis").tag for each in scenario.analyses.values()}
    modes = loop.signals["mode"].meanings if "mode" in loop.signals else ()
    surfaces = [contact.name for contact in loop.workcell.contacts]
    fronts, steps = surfaces if len(surfaces) > 1 else [""], getattr(scenario.reference, "number_of_steps", None)
    for key, name, line in scenario.judged if scenario.as_written else ():
        front, number, last = metric_parts(name)
        makers = analyses_of(name)
        if makers and not tags.intersection(makers):
            raise invalid(key, name, f"left out, or go with an analysis !{' or !'.join(makers)}")
        if last in MODE_METRICS and front not in modes:
            raise unknown("mode", front, modes).at(key)
        if last not in METRICS:
            continue
        if "desired_force" not in loop.signals:
            raise invalid(key, name, "left out: nothing takes a desired force")
        if front not in fronts:
            raise invalid(key, name, f"of one of {', '.join(surfaces)}" if fronts[0] else f"{last}, of the one surface")
        if last in MOTION_METRICS and scenario.motion.interval() is None:
            raise invalid(key, name, "left out without a motion along the surface")
        if last in TUNING_METRICS and not {"mode", *GAINS}.intersection(loop.signals):
            raise invalid(key, name, "left out: no controller is tuned in the run")
        if steps is not None and last in TRACKING_METRICS:
            raise invalid(key, name, "left out: the reference moves in steps only")
        if steps is not None and number is not None and (number > steps or steps == 1):
            counted = f"step_1 to step_{steps}" if steps > 1 else "named without a step: there is one"
            raise invalid(key, name, f"of the reference, {counted}")
        _check_within_reach(scenario, key, name, line)


def _check_within_reach(scenario: Scenario, key: str, name: str, line: Expectation) -> None:
    """Refuse a line of `expect` that needs a time beyond the run, or a force at which the run is stopped."""
    place, _, term = key.removeprefix("expect.").partition(".")
    asked = line.allowed(scenario.fidelity) if term == "metric" else None
    force = scenario.limits()["contact_force"] if metric_unit(name) == "N" else math.inf
    most = min(force, metric_range(name, scenario.duration)[1])
    if asked is not None and asked.low is not None and asked.low > most:
        own = "minimum" if asked.low == line.minimum else "published"
        why = "at which a run is stopped" if most == force else f"as duration = {scenario.duration:g} s"
        raise invalid(f"expect.{place}.{own}", getattr(line, own), f"at most {most:g} {metric_unit(name)}, {why}")


def check_expectations(scenario: Scenario) -> None:
    """Refuse lines of `expect` with equal names, and unknown fidelities."""
    check_distinct("fidelities", scenario.fidelities)
    targets: set[str] = set()
    for i, line in enumerate(scenario.expect):
        if line.target in targets:
            raise invalid(f"expect.{i}.target", line.target, "another one than those before it")
        targets.add(line.target)
        expected = line.expected if isinstance(line.expected, dict) else {}
        for key, names in (("expected", expected), ("fidelities", line.fidelities), ("gaps", line.gaps)):
            for name in names:
                known = (*tags_of("fidelity"), scenario.fidelity)  # the latter may be the path of a user's class
                if name not in known:
                    raise unknown("fidelity", name, tags_of("fidelity")).at(f"expect.{i}.{key}")
