"""How many samples a signal takes through one block, measured by running the block alone."""

from __future__ import annotations

import numpy as np
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.analysis import Simulator

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
    system = values.wiring.systems[hop.block]
    if hop.event is None or isinstance(system, MultibodyPlant):
        return None
    ports = (system.get_input_port(hop.input, False), system.get_output_port(hop.output, False))
    if not all(is_vector(port) for port in ports):
        return None
    try:
        return min((n for step in _STEPS if (n := _count(values, hop, step)) is not None), default=None)
    except FAILURES:
        return None


def _count(values: StartValues, hop: Hop, step: float) -> int | None:
    if hop.event is None:
        return None
    system = values.wiring.systems[hop.block]
    plain, disturbed = values.block_context(hop.block), values.block_context(hop.block)
    port = system.get_input_port(hop.input, False)
    port.FixValue(disturbed, port.Eval(plain) + step)
    output = system.get_output_port(hop.output, False)
    runs = [Simulator(system, plain), Simulator(system, disturbed)]
    for run in runs:
        run.Initialize()
    for sample in range(1, _MOST_SAMPLES + 1):
        for run in runs:
            run.AdvanceTo(hop.event.offset + sample * hop.event.period)
        if _differ(output.Eval(runs[0].get_context()), output.Eval(runs[1].get_context())):
            return sample
    return None


def _differ(a: np.ndarray, b: np.ndarray) -> bool:
    return not np.array_equal(a, b, equal_nan=True)
