"""Assertions that the same run gives the same bits on every vector output, each time."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np
from pydrake.systems.framework import System

from forcectl.inspect.names import own_name
from forcectl.testing.runs import Input, Log, fix_inputs, run_diagram


def assert_deterministic(
    build: Callable[[], System],
    *,
    duration: float,
    period: float,
    inputs: Mapping[str, Input] | None = None,
    outputs: Sequence[str] | None = None,
) -> Log:
    """Two systems from the same `build` show bit-identical outputs in the same run.

    Args:
        build: makes the system, seeds included.
        duration: [s].
        period: distance of the samples [s].
        inputs: see `run_diagram`.
        outputs: names of the vector outputs to compare, see `run_diagram`.

    Returns:
        The log of the run.

    Raises:
        AssertionError: with the first difference.
    """
    __tracebackhide__ = True
    first, second = (run_diagram(build(), duration, period=period, inputs=inputs, outputs=outputs) for _ in range(2))
    if difference := _first_difference(first, second):
        raise AssertionError(f"two builds give different runs, first in {difference}; seed every random source")
    return first


def assert_same_after_reset_and_clone(
    system: System,
    *,
    duration: float,
    period: float,
    inputs: Mapping[str, Input] | None = None,
    outputs: Sequence[str] | None = None,
) -> Log:
    """All state of the system is in its Context.

    Compares, bit by bit, a run with the same run after the Context was set back to defaults; then, from half of the
    run on, the system with a clone of its Context, run one after the other. A block that keeps state in a Python
    attribute fails at least one of the two.

    Args:
        system: any diagram or block.
        duration: [s]; at least two periods.
        period: distance of the samples [s].
        inputs: see `run_diagram`.
        outputs: names of the vector outputs to compare, see `run_diagram`.

    Returns:
        The log of the first run.

    Raises:
        AssertionError: with the first difference.
    """
    __tracebackhide__ = True
    hint = "; some state is kept outside of the Context"
    context = system.CreateDefaultContext()

    def run(seconds: float, start: object) -> Log:
        return run_diagram(system, seconds, period=period, inputs=inputs, outputs=outputs, context=start)

    first = run(duration, context)
    context.SetTime(0.0)
    system.SetDefaultContext(context)
    fix_inputs(system, context, inputs or {})
    if difference := _first_difference(first, run(duration, context)):
        raise AssertionError(f"{own_name(system)} runs differently after a reset, first in {difference}{hint}")

    context = system.CreateDefaultContext()
    half = period * max(1, round(duration / period / 2))
    run(half, context)
    clone = context.Clone()
    rest = max(period, duration - half)
    if difference := _first_difference(run(rest, context), run(rest, clone)):
        raise AssertionError(f"{own_name(system)} and its clone run differently, first in {difference}{hint}")
    return first


def _first_difference(a: Log, b: Log) -> str | None:
    """Where two logs first differ by a single bit, as text; None when they do not."""
    found: list[tuple[int, str, int]] = []
    for name in a.values:
        # Bit patterns, so that NaN equals NaN and 0.0 is not -0.0.
        differs = a.values[name].view(np.uint64) != b.values[name].view(np.uint64)
        found += [(int(k), name, int(i)) for k, i in np.argwhere(differs)[:1]]
    if not found:
        return None
    k, name, i = min(found, key=lambda where: where[0])
    return f"{name}[{i}] at t = {a.time[k]:g} s: {float(a.values[name][k, i])} and {float(b.values[name][k, i])}"
