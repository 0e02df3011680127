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
    from forcectl.simulation.catalog import list_experiments
    from forcectl.simulation.reproduce import reproduce
    from forcectl.simulation.run import RunResult, run
    from forcectl.simulation.scenario import Scenario, build, load_scenario
    from forcectl.viz.graph import graph

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
    "RunResult": "forcectl.simulation.run",
    "Scenario": "forcectl.simulation.scenario",
    "build": "forcectl.simulation.scenario",
    "graph": "forcectl.viz.graph",
    "list_experiments": "forcectl.simulation.catalog",
    "load_scenario": "forcectl.simulation.scenario",
    "reproduce": "forcectl.simulation.reproduce",
    "run": "forcectl.simulation.run",
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
