"""Reading the arguments of a command: values of keys, and the diagram of a scenario or of the user's own."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from pydrake.systems.framework import System

from forcectl.diagrams.loop import Loop
from forcectl.doctor.loops import loop_behind
from forcectl.errors import BadInputError, invalid, raised
from forcectl.framework.imports import Imports
from forcectl.framework.wiring import made_by
from forcectl.framework.yaml_tree import nest, parse
from forcectl.inspect.names import type_in_words
from forcectl.runs.chosen import Chosen, choose
from forcectl.scenario.checks.unread import unread
from forcectl.scenario.code import code_in, code_lines
from forcectl.scenario.error_keys import located
from forcectl.scenario.gains import gains_lines
from forcectl.tasks.machine.chart import MachineChart


def parse_settings(settings: Iterable[str] | None) -> dict[str, Any]:
    """`["a.b=1e-3", ...]` as {"a.b": 0.001}; values are YAML.

    Raises:
        BadInputError: no equals sign, no key, or a value that is not YAML.
    """
    found: dict[str, Any] = {}
    for text in settings or ():
        key, equals, value = text.partition("=")
        key = key.strip()
        if not equals or not all(key.split(".")):
            raise BadInputError(f"--set {text!r}: must be key=value, for example station.environment.stiffness=2e5")
        if earlier := next((other for other in found if f"{other}.".startswith(f"{key}.")), ""):
            raise BadInputError(f"--set {text!r}: must not replace what --set {earlier} sets before it")
        found[key] = parse(value, f"--set {key}")
    return found


@dataclass(frozen=True)
class Shown:
    """The object to be drawn or examined that an argument of a command names.

    Attributes:
        name: for the names of files.
        content: the diagram or block, or a state machine.
        code: lines that list the code it names outside of forcectl; see `forcectl.scenario.code`.
        chosen: the scenario; None for an import path.
        signals: names of the signals of the loop, by variant, of every variant that was built.
        loop: of the first variant of the scenario; None for an import path.
    """

    name: str
    content: Any
    code: list[str]
    chosen: Chosen | None = None
    signals: Mapping[str, set[str]] = field(default_factory=dict)
    loop: Loop | None = None


def named_diagram(
    target: str,
    variant: str | None,
    settings: Iterable[str] | None,
    fidelity: str | None,
    allow: Sequence[str] | None,
    *,
    whole: bool = False,
) -> Shown:
    """The diagram or block behind a scenario or an import path.

    Args:
        target: name of a shipped experiment, path of a YAML file, or "package.module:function".
        variant: of the scenario; the first one when None.
        settings: as for `parse_settings`.
        fidelity: replaces the scenario's.
        allow: names of modules that the scenario may name.
        whole: also build the other variants, to find their errors.

    Raises:
        BadInputError: there is no such scenario or function, or it cannot be built.
    """
    if ":" in target and not os.path.exists(target):  # not a file with a colon in its name
        return Shown(target.rpartition(":")[2], _call_for_diagram(target), code_lines({"": target}))
    chosen = choose(target, variant, parse_settings(settings), None, fidelity, allow or (), whole=whole)
    loop, signals = chosen.looked_through()
    return Shown(chosen.file.name, loop.diagram, _code(chosen), chosen, signals, loop)


def named_machine(
    target: str, variant: str | None, settings: Iterable[str] | None, fidelity: str | None, allow: Sequence[str] | None
) -> Shown:
    """The state machine of the controller of a scenario, for a picture.

    Args: as for `named_diagram`, without import paths.

    Raises:
        BadInputError: there is no such scenario, or its controller has no state machine, or one of a wrong type.
    """
    chosen = choose(target, variant, parse_settings(settings), None, fidelity, allow or (), whole=False)
    scenario, name = chosen.first, chosen.file.name
    if not hasattr(scenario.controller, "machine"):
        raise BadInputError(f"--machine: the controller of {name!r} has no state machine")
    try:
        chart = made_by(scenario.controller, "machine", "controller", MachineChart, "a MachineChart")
    except BadInputError as error:
        raise located(scenario, error, chosen.where(next(iter(chosen.scenarios)))) from error.__cause__
    return Shown(f"{name}_machine", replace(chart, name=name), _code(chosen), chosen)


def _code(chosen: Chosen) -> list[str]:
    return code_lines(code_in(chosen.file) | code_in(replace(chosen.file, tree=nest(chosen.changes))))


def info_lines(shown: Shown) -> list[str]:
    """Lines on gains that an experiment finds before each run of the first variant, and on unread keys of all."""
    if shown.chosen is None:
        return []
    scenarios = shown.chosen.scenarios
    lines = [f"info: {line}" for name, found in shown.signals.items() for line in unread(scenarios[name], found)]
    return [*gains_lines(shown.chosen.first), *dict.fromkeys(lines)]


def start_lines(starts: Mapping[str, tuple[float, str]]) -> list[str]:
    """A line for each task on where it starts, see `Loop.task_starts`."""
    coordinates: dict[str, list[str]] = {}
    for name, (value, unit) in starts.items():
        task, _, coordinate = name.rpartition(".")
        coordinates.setdefault(task, []).append(f"{coordinate} {round(value, 4) + 0.0:g} {unit}")
    return [f"task {task} starts at {', '.join(each)}" for task, each in coordinates.items()]


def _call_for_diagram(path: str) -> System:
    """The diagram, or single block, that the function at "package.module:function" returns without arguments."""
    function = Imports(every=True).load(path, "diagram")
    if not callable(function):
        raise invalid("diagram", path, "a function that returns a Drake Diagram")
    wanted = f" = {path!r}: must return a Drake Diagram"
    try:
        diagram = function()
    except KeyboardInterrupt:
        raise
    except BaseException as error:  # the user's function may raise anything
        if (loop := loop_behind(error)) is not None:
            raise BadInputError(f" = {path!r}: {loop.text}", key="diagram") from error
        raise BadInputError(f"{wanted}, but raised {raised(error)}", key="diagram") from error
    if not isinstance(diagram, System):
        raise BadInputError(f"{wanted}, not {type_in_words(diagram)}", key="diagram")
    return diagram
