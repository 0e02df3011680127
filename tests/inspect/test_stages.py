"""How many samples a block holds a signal, seen by running it alone."""

import pytest
from pydrake.systems.framework import DiagramBuilder, DiscreteStateIndex, LeafSystem
from pydrake.systems.primitives import Adder, ConstantVectorSource

from forcectl.doctor import examine

PERIOD = 0.002


class RateLimited(LeafSystem):
    """Follows its input by at most 0.1 a sample."""

    def __init__(self):
        super().__init__()
        self._input = self.DeclareVectorInputPort("u", 1)
        self.DeclareDiscreteState(1)
        self.DeclareStateOutputPort("y", DiscreteStateIndex(0))
        self.DeclarePeriodicDiscreteUpdateEvent(PERIOD, 0.0, self._update)

    def _update(self, context, state):
        y = context.get_discrete_state(0).value()
        state.set_value(0, y + (self._input.Eval(context) - y).clip(-0.1, 0.1))


@pytest.mark.parametrize("wanted", [0.0, 3.0, 300.0])
def test_a_limit_that_holds_a_block_at_the_start_is_no_delay(wanted):
    builder = DiagramBuilder()
    source = builder.AddNamedSystem("source", ConstantVectorSource([wanted]))
    error = builder.AddNamedSystem("error", Adder(2, 1))
    law = builder.AddNamedSystem("law", RateLimited())
    builder.Connect(source.get_output_port(), error.get_input_port(0))
    builder.Connect(error.get_output_port(), law.get_input_port())
    builder.ExportInput(error.get_input_port(1), "measured_force")
    builder.ExportOutput(law.get_output_port(), "displacement_command")
    (found,) = examine(builder.Build(), sensor="measured_force", command="displacement_command").delays
    assert [(row.block, row.samples, row.basis) for row in found.rows] == [
        ("error", 0, "structure"),
        ("law", 1, "measured"),
    ]
    assert found.total == PERIOD
