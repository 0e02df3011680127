"""Block-diagram graphs of any Drake diagram; called, `forcectl.graph(scenario)`, it is `forcectl.runs.entry.graph`."""

from __future__ import annotations

import sys
from types import ModuleType
from typing import TYPE_CHECKING, Any

from forcectl.framework.lazy import lazy_names

if TYPE_CHECKING:
    from forcectl.graph.export import Graph

__getattr__, __dir__ = lazy_names(__name__, __file__)


class _Room(ModuleType):
    """The room `graph` is an attribute of the package, and so is the function."""

    def __call__(self, *args: Any, **options: Any) -> Graph:
        """The picture of a scenario or of a diagram, see `forcectl.runs.entry.graph`."""
        # The package asks for it: this room knows nothing of scenarios.
        return sys.modules["forcectl"]._draw(*args, **options)


sys.modules[__name__].__class__ = _Room
