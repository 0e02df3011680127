"""Tests for any Drake system or diagram: assertions that say what is wrong, and a pytest plugin with fixtures.

The names are imported when they are used, so that starting pytest with the plugin installed does not import Drake.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from forcectl.testing.contract import assert_feedthrough, assert_ports
    from forcectl.testing.docstring import assert_docstring_matches
    from forcectl.testing.memory import MemoryRecord, assert_memory_released
    from forcectl.testing.model import assert_matches_model
    from forcectl.testing.nan import assert_passes_no_nan
    from forcectl.testing.repeat import assert_deterministic, assert_same_after_reset_and_clone
    from forcectl.testing.response import StepResponse, assert_no_overshoot, assert_settles_within, step_response
    from forcectl.testing.runs import Log, run_diagram

_HOME = {
    "assert_ports": "contract",
    "assert_feedthrough": "contract",
    "assert_docstring_matches": "docstring",
    "assert_memory_released": "memory",
    "MemoryRecord": "memory",
    "assert_matches_model": "model",
    "assert_passes_no_nan": "nan",
    "assert_deterministic": "repeat",
    "assert_same_after_reset_and_clone": "repeat",
    "StepResponse": "response",
    "step_response": "response",
    "assert_no_overshoot": "response",
    "assert_settles_within": "response",
    "Log": "runs",
    "run_diagram": "runs",
}

__all__ = [
    "assert_ports", "assert_feedthrough", "assert_docstring_matches",
    "step_response", "StepResponse", "assert_matches_model", "assert_no_overshoot", "assert_settles_within",
    "assert_passes_no_nan", "assert_deterministic", "assert_same_after_reset_and_clone",
    "assert_memory_released", "MemoryRecord", "run_diagram", "Log",
]  # fmt: skip


def __getattr__(name: str) -> object:
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_HOME[name]}"), name)


def __dir__() -> list[str]:
    return __all__
