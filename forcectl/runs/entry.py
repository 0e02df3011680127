"""Functions of the package root that do from Python what `forcectl graph` and `forcectl check` do."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from pydrake.systems.framework import Context, System

from forcectl.diagrams.chain import LoopMargins, loop_margins
from forcectl.doctor import Report, examine
from forcectl.errors import BadInputError
from forcectl.graph.export import Graph, MachineGraph
from forcectl.graph.export import graph as draw
from forcectl.inspect.ports import PortName
from forcectl.runs.chosen import Chosen, choose
from forcectl.scenario.error_keys import located
from forcectl.scenario.scenario import ONE_SCENARIO, Scenario
from forcectl.tasks.machine.chart import MachineChart


def graph(
    scenario: str | Path | Mapping[str, Any] | Scenario | System | MachineChart,
    *,
    depth: int | None = 1,
    hide_unused: bool = True,
    loggers: bool = False,
    context: Context | None = None,
    variant: str | None = None,
    overrides: Mapping[str, Any] | None = None,
    seed: int | None = None,
    fidelity: str | None = None,
    allow_imports: Sequence[str] = (),
) -> Graph | MachineGraph:
    """The block diagram of a scenario or of a Drake diagram, or the picture of a state machine.

    Args:
        scenario: name, path, mapping or `Scenario`; or any Drake diagram or block, or a state machine.
        depth, hide_unused, loggers, context: see `forcectl.graph.export.graph`.
        variant, overrides, seed, fidelity, allow_imports: of a scenario, see `load_scenario`.

    Raises:
        BadInputError: the scenario cannot be built.
    """
    system, title = _system(scenario, variant, overrides, seed, fidelity, allow_imports)
    return draw(system, depth=depth, hide_unused=hide_unused, loggers=loggers, context=context, title=title)


def check(
    scenario: str | Path | Mapping[str, Any] | Scenario | System,
    *,
    variant: str | None = None,
    overrides: Mapping[str, Any] | None = None,
    seed: int | None = None,
    fidelity: str | None = None,
    allow_imports: Sequence[str] = (),
    sensor: PortName | None = None,
    command: PortName | None = None,
    scheme: str | None = None,
) -> Report:
    """Faults, periods and delays of the diagram of a scenario, or of any Drake diagram.

    Of a scenario with variants the first one is examined; all others are built to find their errors.

    Args:
        scenario: name, path, mapping or `Scenario`; or any Drake diagram or block.
        variant, overrides, seed, fidelity, allow_imports: of a scenario, see `load_scenario`.
        sensor, command, scheme: see `forcectl.doctor.examine`.

    Raises:
        BadInputError: the scenario, or another of its variants, cannot be built, or there are no such ports.
    """
    system, _ = _system(scenario, variant, overrides, seed, fidelity, allow_imports, whole=True)
    return examine(system, sensor=sensor, command=command, scheme=scheme)


def margins(
    scenario: str | Path | Mapping[str, Any] | Scenario,
    *,
    variant: str | None = None,
    overrides: Mapping[str, Any] | None = None,
    seed: int | None = None,
    fidelity: str | None = None,
    allow_imports: Sequence[str] = (),
) -> list[LoopMargins]:
    """Stability margins of the force loops of a scenario, from the linear systems of their parts.

    Of a scenario with variants the first one is examined. Friction, limits and the inertia of links behind elastic
    joints are left out; so are laws that are no linear system, or whose gains are found before the run. For a law in
    `!Governed`, `!Passive` or `!Approach` the margins are those of the law alone.

    Args:
        scenario: name, path, mapping or `Scenario`.
        variant, overrides, seed, fidelity, allow_imports: see `load_scenario`.

    Returns:
        One for each law, surface and stiffness that the scenario names.

    Raises:
        BadInputError: the scenario cannot be used.
    """
    return margins_of(choose(scenario, variant, overrides, seed, fidelity, allow_imports, whole=False))


def margins_of(chosen: Chosen) -> list[LoopMargins]:
    """The margins of the first one of some variants, see `margins`."""
    name, one = next(iter(chosen.scenarios.items()))
    try:
        return loop_margins(one.parts, one.setting())
    except BadInputError as error:
        raise located(one, error, chosen.where(name)) from error.__cause__


def _system(
    scenario: Any,
    variant: str | None,
    overrides: Any,
    seed: int | None,
    fidelity: str | None,
    allow_imports: Sequence[str],
    whole: bool = False,
) -> tuple[Any, str]:
    """The diagram of a scenario and its title; any other object as it is, without a title."""
    if isinstance(scenario, ONE_SCENARIO):
        chosen = choose(scenario, variant, overrides, seed, fidelity, allow_imports, whole=whole)
        return chosen.diagram(), ", ".join(filter(None, (chosen.title, variant)))
    given = {"variant": variant, "overrides": overrides, "seed": seed, "fidelity": fidelity}
    given["allow_imports"] = allow_imports or None
    if wrong := [name for name, value in given.items() if value is not None]:
        raise BadInputError(
            f"{wrong[0]} = {given[wrong[0]]!r}: must be left out with a diagram: it goes with a scenario"
        )
    return scenario, ""
