"""Block diagrams of any Drake diagram. The call `forcectl.graph(scenario)` is that of `forcectl.runs.entry.graph`."""

from __future__ import annotations

import sys
from types import ModuleType
from typing import TYPE_CHECKING, Any

from forcectl.framework.lazy import lazy_names

if TYPE_CHECKING:
    from forcectl.graph.export import Graph

__getattr__, __dir__ = lazy_names(__name__, __file__)


class _Room(ModuleType):
    """Type of this module that makes it callable, as `forcectl.graph` is both this package and a function."""

    def __call__(self, *args: Any, **options: Any) -> Graph:
        """The picture of a scenario or of a diagram, see `forcectl.runs.entry.graph`."""
        # By way of the top-level package, as this one does not import scenarios.
        return sys.modules["forcectl"]._draw(*args, **options)


sys.modules[__name__].__class__ = _Room
