"""An assertion that NaN at an input does not silently reach an output."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike
from pydrake.systems.framework import System

from forcectl.errors import BadInputError
from forcectl.inspect.names import own_name
from forcectl.testing.runs import Input, Log, run_diagram, vector_inputs


def assert_passes_no_nan(
    system: System,
    *,
    duration: float,
    period: float,
    inputs: Mapping[str, Input] | None = None,
    outputs: Sequence[str] | None = None,
) -> None:
    """With NaN on any one vector input, no vector output becomes NaN or infinite: outputs stay finite, or it raises.

    Each input in turn is NaN from half of the run on, while the others keep their values.

    Args:
        system: any diagram or block.
        duration: of each run [s]; long enough for a value to come through.
        period: distance of the samples [s].
        inputs: values of the inputs in normal operation, see `run_diagram`; default zero.
        outputs: names of the vector outputs to look at, see `run_diagram`.

    Raises:
        AssertionError: NaN reached an output (inputs, outputs and times are named), or an output is not finite even
            without NaN at an input.
        BadInputError: the system has no vector input.
    """
    __tracebackhide__ = True
    names = vector_inputs(system)
    if not names:
        raise BadInputError(f"{own_name(system)} has no vector input to put a NaN on")
    normal = dict(inputs or {})
    before = _non_finite(run_diagram(system, duration, period=period, inputs=normal, outputs=outputs))
    if before:
        raise AssertionError(
            f"{own_name(system)} is not finite even without a NaN: {', '.join(before)}; give it `inputs`"
        )
    lines = []
    for name in names:
        poisoned = {**normal, name: _from(duration / 2, normal.get(name, 0.0))}
        try:
            log = run_diagram(system, duration, period=period, inputs=poisoned, outputs=outputs)
        except Exception:
            continue  # loud is fine
        if reached := _non_finite(log):
            lines.append(f"  NaN on {name!r} from t = {duration / 2:g} s comes out of {', '.join(reached)}")
    if lines:
        raise AssertionError("\n".join([f"{own_name(system)} passes NaN on silently:", *lines]))


def _from(start: float, value: Input) -> Input:
    def poisoned(time: float) -> ArrayLike:
        usual: ArrayLike = value(time) if callable(value) else value
        return usual if time < start else np.full(np.shape(usual), np.nan)

    return poisoned


def _non_finite(log: Log) -> list[str]:
    """'output from t = ...' for every output that is not finite at some time."""
    found = []
    for name, values in log.values.items():
        rows = np.flatnonzero(~np.all(np.isfinite(values), axis=1))
        if rows.size:
            found.append(f"{name!r} at t = {log.time[rows[0]]:g} s")
    return found
