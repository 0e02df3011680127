"""What an example of a block is."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from pydrake.systems.framework import System

from forcectl.testing.runs import Input


@dataclass(frozen=True)
class Example:
    """One way to build a block; `runnable` is what is simulated when the block cannot run alone."""

    build: Callable[[], System]
    feedthrough: set[tuple[str, str]] = field(default_factory=set)
    inputs: Mapping[str, Input] = field(default_factory=dict)
    runnable: Callable[[], System] | None = None


def each(output: str, *inputs: str) -> set[tuple[str, str]]:
    return {(output, name) for name in inputs}
