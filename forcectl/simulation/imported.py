"""A user's own controller, named in a scenario by its import path.

    controller: !Import
      path: my_package.my_module:MyForceLawConfig
      parameters: {gain: 2.0}

The class is built with the parameters and must offer what the shipped configs offer: `add_to(builder, facts)`, and, if
the closed loop has a nominal model, `reference_model_bandwidth()`.
"""

from __future__ import annotations

import dataclasses
import importlib
import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from pydrake.systems.framework import Diagram, DiagramBuilder, System

from forcectl.errors import BadInputError, invalid, unknown
from forcectl.simulation.schema import Reader
from forcectl.simulation.yaml_tree import plain


def import_object(path: str, field_name: str = "path") -> Any:
    """The object behind "package.module:name"; modules in the working directory are found too.

    Raises:
        BadInputError: the path has another form, or the module or the name in it does not exist.
    """
    module_name, colon, name = path.partition(":")
    if not (colon and name.isidentifier() and all(part.isidentifier() for part in module_name.split("."))):
        raise invalid(field_name, path, 'an import path such as "package.module:Name"')
    here = str(Path.cwd())
    added = here not in sys.path
    if added:  # an installed command does not look into the working directory by itself
        sys.path.append(here)
    try:
        module = importlib.import_module(module_name)
    except Exception as error:  # whatever the user's module does while it is imported
        reason = " ".join(f"{type(error).__name__}: {error}".split())
        raise BadInputError(f"{field_name} = {path!r}: must be importable, but: {reason}") from error
    finally:
        if added:
            sys.path.remove(here)
    if not hasattr(module, name):
        raise BadInputError(
            f"{field_name} = {path!r}: " + str(unknown(f"name in {module_name}", name, _public(module)))
        )
    return getattr(module, name)


def _public(module: object) -> list[str]:
    return [name for name in vars(module) if not name.startswith("_")]


@dataclass(kw_only=True)
class ImportConfig:
    """Scenario part `!Import`: a class of the user's with the interface of a controller config."""

    path: str = ""  # "package.module:ClassName"
    parameters: dict[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        made = import_object(self.path)
        if not isinstance(made, type) or not hasattr(made, "add_to"):
            raise invalid("path", self.path, "a class with a method add_to(builder, facts)")
        reader = Reader()
        if dataclasses.is_dataclass(made):
            self._made = reader.dataclass(made, plain(self.parameters), "parameters")
        else:
            self._made = reader.construct(made, self.parameters, "parameters")

    def reference_model_bandwidth(self) -> float | None:
        """What the user's class says [rad/s]; None when it has no such method."""
        bandwidth = getattr(self._made, "reference_model_bandwidth", None)
        return bandwidth() if bandwidth else None

    def add_to(self, builder: DiagramBuilder, facts: Any) -> System:
        """Let the user's class add its blocks."""
        try:
            system: System = self._made.add_to(builder, facts)
        except BadInputError:
            raise
        except Exception as error:  # whatever the user's class does
            reason = " ".join(f"{type(error).__name__}: {error}".split())
            raise BadInputError(f"controller.path = {self.path!r}: its add_to raised {reason}") from error
        if not isinstance(system, System):
            raise BadInputError(
                f"controller.path = {self.path!r}: its add_to must return a Drake system, not {type(system).__name__}"
            )
        return system


def call_for_diagram(path: str) -> Diagram:
    """The diagram that the function at "package.module:function" returns when called without arguments.

    Raises:
        BadInputError: there is no such function, it raises, or it returns something else.
    """
    function = import_object(path, "diagram")
    if not callable(function):
        raise invalid("diagram", path, "a function that returns a Drake Diagram")
    try:
        diagram = function()
    except Exception as error:  # whatever the user's function does
        reason = " ".join(f"{type(error).__name__}: {error}".split())
        raise BadInputError(f"diagram = {path!r}: must return a Drake Diagram, but raised {reason}") from error
    if not isinstance(diagram, Diagram):
        raise BadInputError(f"diagram = {path!r}: must return a Drake Diagram, not {type(diagram).__name__}")
    return diagram
