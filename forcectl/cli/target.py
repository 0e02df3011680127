"""What the arguments of a command name: values of keys, and the diagram of a scenario or of one's own."""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Any

from pydrake.systems.framework import System

from forcectl.diagrams.chain import LoopMargins
from forcectl.doctor.loops import loop_behind
from forcectl.errors import BadInputError, invalid, one_line
from forcectl.framework.imports import Imports
from forcectl.framework.wiring import made_by
from forcectl.framework.yaml_tree import nest, parse
from forcectl.inspect.names import said_type
from forcectl.runs.entry import first_built, margins
from forcectl.scenario.code import code_in, said
from forcectl.scenario.effects import unread
from forcectl.scenario.error_keys import located
from forcectl.scenario.gains import gains_lines
from forcectl.scenario.layers import select_variants
from forcectl.scenario.scenario import Scenario, as_file, origins, resolve, with_shortcuts
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


def named_diagram(
    target: str,
    variant: str | None,
    settings: Iterable[str] | None,
    fidelity: str | None,
    allow: Sequence[str] | None,
    *,
    whole: bool = False,
) -> tuple[str, System]:
    """A file name and the diagram or block behind a scenario or an import path.

    Args:
        target: name of a shipped experiment, path of a YAML file, or "package.module:function".
        variant: of the scenario; the first one when None.
        settings: as for `parse_settings`.
        fidelity: instead of the scenario's.
        allow: names of modules that it may name.
        whole: build the other variants, too, to find what is wrong with them.

    Raises:
        BadInputError: there is no such scenario or function, or it cannot be built.
    """
    if _is_import_path(target):
        return target.rpartition(":")[2], _call_for_diagram(target)
    file = as_file(target, allow or ())
    overrides = with_shortcuts(parse_settings(settings), None, fidelity)
    return file.name, first_built(file, select_variants(file, variant), overrides, whole=whole)[1]


def named_machine(
    target: str, variant: str | None, settings: Iterable[str] | None, fidelity: str | None, allow: Sequence[str] | None
) -> tuple[str, MachineChart]:
    """A file name and the state machine of the controller of a scenario, for a picture.

    Args: as for `named_diagram`, without import paths.

    Raises:
        BadInputError: there is no such scenario, or its controller has no state machine, or one that is none.
    """
    file = as_file(target, allow or ())
    overrides = with_shortcuts(parse_settings(settings), None, fidelity)
    name = select_variants(file, variant)[0]
    scenario, where = resolve(file, name, overrides), origins(file, name, overrides)
    if not hasattr(scenario.controller, "machine"):
        raise BadInputError(f"--machine: the controller of {file.name!r} has no state machine")
    try:
        chart = made_by(scenario.controller, "machine", "controller", MachineChart, "a MachineChart")
    except BadInputError as error:
        raise located(scenario, error, where) from error.__cause__
    return f"{file.name}_machine", replace(chart, name=file.name)


def _is_import_path(target: str) -> bool:
    """Whether it is `package.module:function`, and no file that has a colon in its name."""
    return ":" in target and not os.path.exists(target)


def named_scenarios(
    target: str, variant: str | None, settings: Iterable[str] | None, fidelity: str | None, allow: Sequence[str] | None
) -> list[Scenario]:
    """The variants of a scenario, as read; none of an import path.

    Args: as for `named_diagram`.
    """
    if _is_import_path(target):
        return []
    file = as_file(target, allow or ())
    overrides = with_shortcuts(parse_settings(settings), None, fidelity)
    return [resolve(file, name, overrides) for name in select_variants(file, variant)]


def said_of(scenarios: Sequence[Scenario]) -> list[str]:
    """Lines on the gains that an experiment finds before each run of the first one, and on unread keys of any."""
    gains = [line for scenario in scenarios[:1] for line in gains_lines(scenario)]
    return [*gains, *dict.fromkeys(f"info: {line}" for scenario in scenarios for line in unread(scenario))]


def named_margins(
    target: str, variant: str | None, settings: Iterable[str] | None, fidelity: str | None, allow: Sequence[str] | None
) -> list[LoopMargins]:
    """Stability margins of a scenario; none of an import path.

    Args: as for `named_diagram`.
    """
    if _is_import_path(target):
        return []
    overrides = parse_settings(settings)
    return margins(target, variant=variant, overrides=overrides, fidelity=fidelity, allow_imports=allow or ())


def named_code(target: str, settings: Iterable[str] | None) -> list[str]:
    """Lines that say which code beside forcectl's own a target names; see `forcectl.scenario.code`."""
    if _is_import_path(target):
        return said({"": target})
    file = as_file(target)
    return said(code_in(file) | code_in(replace(file, tree=nest(parse_settings(settings)))))


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
    except BaseException as error:  # whatever the user's function does
        if (loop := loop_behind(error)) is not None:
            raise BadInputError(f" = {path!r}: {loop.text}", key="diagram") from error
        raise BadInputError(f"{wanted}, but raised {one_line(error)}", key="diagram") from error
    if not isinstance(diagram, System):
        raise BadInputError(f"{wanted}, not {said_type(diagram)}", key="diagram")
    return diagram
