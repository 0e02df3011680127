"""A user's own controller, named in a scenario by its import path.

    controller: !Import
      path: my_package.my_module:MyForceLawConfig
      parameters: {gain: 2.0}

The class is built with the parameters and must offer what the shipped configs offer: `add_to(builder, facts)`, and, if
the closed loop has a nominal model, `reference_model_bandwidth()`.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, field
from typing import Any

from pydrake.systems.framework import DiagramBuilder, System

from forcectl.errors import BadInputError, invalid
from forcectl.framework.imports import import_object
from forcectl.scenario.schema import Reader
from forcectl.scenario.yaml_tree import plain


@dataclass(kw_only=True)
class ImportConfig:
    """Scenario part `!Import`: a class of the user's with the interface of a controller config."""

    path: str = ""  # "package.module:ClassName"
    parameters: dict[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        made = import_object(self.path)
        if not isinstance(made, type) or not callable(getattr(made, "add_to", None)):
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
            raise BadInputError(f"path = {self.path!r}: its add_to raised {reason}") from error
        if not isinstance(system, System):
            raise BadInputError(
                f"path = {self.path!r}: its add_to must return a Drake system, not {type(system).__name__}"
            )
        return system


def call_for_diagram(path: str) -> System:
    """The diagram, or single block, that the function at "package.module:function" returns without arguments.

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
    if not isinstance(diagram, System):
        raise BadInputError(f"diagram = {path!r}: must return a Drake Diagram, not {type(diagram).__name__}")
    return diagram
