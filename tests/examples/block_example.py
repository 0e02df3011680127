"""What an example of a block is."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from pydrake.systems.framework import System

from forcectl.testing.runs import Input


@dataclass(frozen=True)
class Example:
    """One way to build a block.

    Attributes:
        feedthrough: (output, input) of each.
        inputs: name -> value, or function of time [s].
        runnable: what is simulated when the block cannot run alone.
        periods: name -> value [s] of the periods in the docstring that are not the defaults of the class's arguments;
            None: no updates with this period in this configuration.
    """

    build: Callable[[], System]
    feedthrough: set[tuple[str, str]] = field(default_factory=set)
    inputs: Mapping[str, Input] = field(default_factory=dict)
    runnable: Callable[[], System] | None = None
    periods: Mapping[str, float | None] = field(default_factory=dict)

    @cached_property
    def block(self) -> System:
        """The block, built once; what is simulated has a context of its own."""
        return self.build()


def force(t: float) -> np.ndarray:
    """Of two batch elements [N]."""
    return np.array([12.0, 7.0]) * (1 + math.sin(50 * t))


def push(t: float) -> np.ndarray:
    """A displacement of two batch elements that goes into the surface and leaves it again [m]."""
    return np.array([-2e-3, -1e-3]) * math.sin(60 * t)


def each(output: str, *inputs: str) -> set[tuple[str, str]]:
    return {(output, name) for name in inputs}
