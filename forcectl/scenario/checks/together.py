"""Checks of a scenario across its parts; each part checks its own keys itself."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise
from typing import TYPE_CHECKING, Any

from forcectl.analysis.slot import check_fits
from forcectl.errors import BadInputError, check_distinct, invalid
from forcectl.scenario.checks.effects import check_effects
from forcectl.scenario.checks.forces import check_displacement, check_forces, check_held
from forcectl.scenario.checks.judged import check_expectations
from forcectl.scenario.checks.surfaces import check_directions, check_sides, check_surfaces
from forcectl.scenario.checks.times import check_frequencies, check_times

if TYPE_CHECKING:
    from forcectl.diagrams.loop import Loop
    from forcectl.scenario.scenario import Scenario

_LONGEST = {"title": 200, "source": 200, "description": 5000}  # characters, to fit into figures and tables


def check_together(scenario: Scenario, overrides: Mapping[str, Any]) -> None:
    """Refuse a scenario whose parts do not fit together; no diagram is built.

    Args:
        scenario: the scenario, as read.
        overrides: overrides that it was read with, by dotted key. With an override of `duration` things that the file
            describes may begin after the end of the run.

    Raises:
        BadInputError: about the key that is wrong.
    """
    for key, longest in _LONGEST.items():
        if len(text := getattr(scenario, key)) > longest:
            raise BadInputError(f" has {len(text)} characters: must have at most {longest}", key=key)
    check_times(scenario, overrides)
    check_effects(scenario)
    check_directions(scenario)
    check_expectations(scenario)


def check_built(scenario: Scenario, loop: Loop) -> None:
    """Refuse a scenario that does not fit to the loop built from it.

    Args:
        scenario: the scenario, as read.
        loop: the loop built from it.

    Raises:
        BadInputError: about the key that is wrong.
    """
    if scenario.duration < loop.workcell.period:
        raise invalid("duration", scenario.duration, f"at least a control tick, {loop.workcell.period:g} s")
    if scenario.after_end is not None and "machine_end" not in loop.signals:
        raise invalid("after_end", scenario.after_end, "null: there is no state machine that ends")
    for name, analysis in scenario.analyses.items():
        check_fits(analysis, loop.signals, loop.setting, f"analyses.{name}")
    check_surfaces(scenario, loop)
    check_frequencies(scenario, loop.workcell.period)
    check_held(scenario, loop)
    if "desired_force" in loop.signals:
        times = getattr(scenario.reference, "times", [])
        for i, (one, other) in enumerate(pairwise(times), start=1):
            if other - one < loop.workcell.period:
                apart = f"at least a control tick of {loop.workcell.period:g} s after {one:g}"
                raise invalid(f"reference.times.{i}", other, apart)
        check_forces(scenario, loop.workcell.period)
        check_displacement(scenario, loop.workcell.contacts)
        check_sides(scenario, loop.workcell)
    check_distinct("log", scenario.log)
    for i, name in enumerate(scenario.log):
        if name in loop.signals:
            raise invalid(f"log.{i}", name, "left out: it is logged anyway")
