"""Robot force control as Drake diagrams: plants, controllers, estimators, experiments and the tools to trust them::

    import forcectl as fc
    result = fc.run("fig_2_7", overrides={"station.environment.stiffness": 2e5})
    result.log["measured_force"], result.metrics, result.diagram

Names are loaded on first use, so that `import forcectl` and `forcectl --help` do not wait for Drake. Each subpackage
has names of its own: `from forcectl.force import IntegralForceLaw`.
"""

from __future__ import annotations

from typing import Any

from forcectl.framework.lazy import lazy_names

_get, __dir__ = lazy_names(__name__, __file__)


def __getattr__(name: str) -> Any:
    if name == "__version__":
        from importlib.metadata import PackageNotFoundError, version

        try:
            return version("forcectl")
        except PackageNotFoundError:  # a plain checkout, not installed
            return "0.0.0+checkout"
    return _get(name)


def _draw(*args: Any, **options: Any) -> Any:
    """The call `forcectl.graph(...)`; the package `forcectl.graph` itself does not import scenarios."""
    from forcectl.runs.entry import graph

    return graph(*args, **options)
