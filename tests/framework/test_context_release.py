"""What a block keeps of its context lets the context go.

A numpy view of the state, handed on into a cache of the same context, holds that context for ever: where Python's
garbage collector cannot look. It costs a plant context or two per run of a sweep.
"""

import gc
import weakref

import pytest
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Diagram, System

from forcectl.testing.runs import fix_inputs, vector_outputs
from tests.examples.block_examples import EXAMPLES

LEAVES = [
    pytest.param(example, id=f"{kind.__name__}-{i}")
    for kind, examples in EXAMPLES.items()
    for i, example in enumerate(examples)
    if not issubclass(kind, Diagram) and example.runnable is None
]


def used(system: System, inputs: object) -> weakref.ref:
    """Run the system, with its outputs read at ticks and between them; its context when all is dropped."""
    simulator = Simulator(system)
    context = simulator.get_mutable_context()
    fix_inputs(system, context, inputs)
    for time in (0.0, 0.0005, 0.004, 0.0045):
        simulator.AdvanceTo(time)
        for port in vector_outputs(system, None).values():
            port.Eval(context)
    return weakref.ref(context)


@pytest.mark.parametrize("example", LEAVES)
def test_the_context_is_let_go(example):
    reference = used(example.build(), example.inputs)
    gc.collect()
    assert reference() is None
