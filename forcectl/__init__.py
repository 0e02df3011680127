"""Robot force control as Drake diagrams: plants, controllers, estimators, experiments and the tools to trust them.

    import forcectl as fc
    result = fc.run("fig_2_7", overrides={"station.environment.stiffness": 2e5})
    result.log["measured_force"], result.metrics, result.diagram

Names are loaded on first use, so that `import forcectl` and `forcectl --help` do not wait for Drake.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from forcectl.errors import BadInputError, ForcectlError, RunFailedError

if TYPE_CHECKING:
    from forcectl.graph.export import graph
    from forcectl.runs.reproduce import reproduce
    from forcectl.runs.run import RunResult, run
    from forcectl.scenario.catalog import list_experiments
    from forcectl.scenario.scenario import Scenario, build, load_scenario

__all__ = [
    "BadInputError",
    "ForcectlError",
    "RunFailedError",
    "RunResult",
    "Scenario",
    "build",
    "graph",
    "list_experiments",
    "load_scenario",
    "reproduce",
    "run",
]

_HOMES = {
    "RunResult": "forcectl.runs.run",
    "Scenario": "forcectl.scenario.scenario",
    "build": "forcectl.scenario.scenario",
    "graph": "forcectl.graph.export",
    "list_experiments": "forcectl.scenario.catalog",
    "load_scenario": "forcectl.scenario.scenario",
    "reproduce": "forcectl.runs.reproduce",
    "run": "forcectl.runs.run",
}


def __getattr__(name: str) -> Any:
    if name == "__version__":
        from importlib.metadata import PackageNotFoundError, version

        try:
            return version("forcectl")
        except PackageNotFoundError:  # a plain checkout, not installed
            return "0.0.0+checkout"
    if name not in _HOMES:
        raise AttributeError(f"module 'forcectl' has no attribute {name!r}")
    return getattr(importlib.import_module(_HOMES[name]), name)


def __dir__() -> list[str]:
    return sorted([*globals(), *__all__])
