"""How many samples a signal takes through one block, measured by running the block alone."""

from __future__ import annotations

import numpy as np
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.analysis import Simulator

from forcectl.inspect.events import PeriodicEvent
from forcectl.inspect.start import FAILURES, StartValues
from forcectl.inspect.ways import Hop
from forcectl.inspect.wiring import is_vector

_MOST_SAMPLES = 200
_STEPS = (1.0, -1.0, 1e-3)  # sizes of the disturbance: one of them should leave a dead zone or a saturation


def samples_through(values: StartValues, hop: Hop) -> int | None:
    """Samples between a change at the input and the first change a reader of the same period sees at the output.

    Two copies of the block run from the same start, one with its input disturbed. None: no change was seen within
    200 samples, or the block cannot be run alone.
    """
    if hop.event is None or isinstance(values.wiring.systems[hop.block], MultibodyPlant):
        return None
    if not all(is_vector(values.wiring.port(port)) for port in (hop.input, hop.output)):
        return None
    try:
        return min((n for step in _STEPS if (n := _count(values, hop, hop.event, step)) is not None), default=None)
    except FAILURES:
        return None


def _count(values: StartValues, hop: Hop, event: PeriodicEvent, step: float) -> int | None:
    plain, disturbed = values.block_context(hop.block), values.block_context(hop.block)
    port, output = values.wiring.port(hop.input), values.wiring.port(hop.output)
    port.FixValue(disturbed, port.Eval(plain) + step)
    runs = [Simulator(values.wiring.systems[hop.block], context) for context in (plain, disturbed)]
    for run in runs:
        run.Initialize()
    for sample in range(1, _MOST_SAMPLES + 1):
        for run in runs:
            run.AdvanceTo(event.offset + sample * event.period)
        a, b = (output.Eval(run.get_context()) for run in runs)
        if not np.array_equal(a, b, equal_nan=True):
            return sample
    return None
