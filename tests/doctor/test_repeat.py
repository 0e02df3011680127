"""Blocks that remember something outside of their Context, or are random."""

import numpy as np
import pytest
from pydrake.common.value import Value
from pydrake.systems.framework import DiagramBuilder, LeafSystem
from pydrake.systems.primitives import ConstantVectorSource

from forcectl.doctor import examine


class Law(LeafSystem):
    """An integral of its input, in its state, and something that a sub-class adds."""

    def __init__(self, period=0.01):
        super().__init__()
        self.total, self.calls = 0.0, 0
        self._force = self.DeclareVectorInputPort("force", 1)
        state = self.DeclareDiscreteState(1)
        self.DeclareStateOutputPort("command", state)
        if period:
            self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, self._update)

    def _update(self, context, state):
        integral = context.get_discrete_state_vector().value() + self._force.Eval(context)
        state.set_value(integral + self.more(self._force.Eval(context)[0]))

    def more(self, force):
        self.calls += 1  # counts, but changes no output
        return 0.0


class Remembering(Law):
    def more(self, force):
        self.total += 0.1 * force
        return self.total


class Random(Law):
    def more(self, force):
        return np.random.default_rng().normal()


class Counting(LeafSystem):
    """Its output changes with every call."""

    def __init__(self):
        super().__init__()
        self.calls = 0
        self.DeclareVectorOutputPort("y", 1, self._calc)

    def _calc(self, context, output):
        self.calls += 1
        output.SetFromVector([self.calls])


class Ticking(LeafSystem):
    """Counts in one of the ways that need no periodic event, and shows the count."""

    def __init__(self, way):
        super().__init__()
        self.calls, self.way = 0, way
        if way == "step":
            self.DeclarePerStepPublishEvent(self._count)
        elif way == "initialisation":
            self.DeclareInitializationPublishEvent(self._count)
        elif way == "derivative":
            self.DeclareStateOutputPort("y", self.DeclareContinuousState(1))
            return
        if way == "message":
            self.DeclareAbstractOutputPort("y", lambda: Value({}), self._show)
        else:
            self.DeclareVectorOutputPort("y", 1, lambda context, output: output.SetFromVector([self.calls]))

    def _count(self, context):
        self.calls += 1

    def _show(self, context, output):
        self.calls += 1
        output.set_value({"calls": self.calls})

    def DoCalcTimeDerivatives(self, context, derivatives):
        self.calls += 1
        derivatives.SetFromVector([self.calls])


def found_in(block):
    """What is found in a diagram in which no force is measured at the start."""
    builder = DiagramBuilder()
    builder.AddNamedSystem("law", block)
    if block.num_input_ports():
        source = builder.AddNamedSystem("source", ConstantVectorSource([0.0]))
        builder.Connect(source.get_output_port(), block.get_input_port())
    builder.ExportOutput(block.get_output_port(), "command")
    return examine(builder.Build()).with_code("not-repeatable")


@pytest.mark.parametrize(
    ("block", "words"),
    [
        (Remembering(), ("different command", "(attributes that changed: total)")),
        (Random(), ("different command",)),
        (Counting(), ("different y", "changed: calls)")),
        *[
            (Ticking(way), ("different y", "changed: calls)"))
            for way in ("step", "initialisation", "derivative", "message")
        ],
    ],
)
def test_memory_outside_of_the_context_and_random_numbers_are_found(block, words):
    (finding,) = found_in(block)
    assert (finding.severity, finding.path) == ("warning", "law")
    assert all(word in finding.message for word in words)


def test_memory_that_no_output_shows_is_no_matter():
    assert not found_in(Law())
    assert not found_in(Law(period=0.0))


def test_a_random_block_without_changed_attributes():
    draw = np.random.default_rng(0)

    class Drawn(LeafSystem):
        def __init__(self):
            super().__init__()
            self.DeclareVectorOutputPort("y", 1, lambda context, out: out.SetFromVector(draw.normal(size=1)))

    (finding,) = found_in(Drawn())
    assert "Context, draws random numbers or reads a clock" in finding.message


def test_a_block_that_refuses_another_input_is_run_with_the_one_at_the_start():
    class Strict(Remembering):
        def more(self, force):
            if force != 0.0:
                raise ValueError("only zero")
            self.total += 1.0
            return self.total

    assert len(found_in(Strict())) == 1


def test_values_that_are_new_objects_each_time_are_no_memory():
    class Listing(LeafSystem):
        def __init__(self):
            super().__init__()
            self.DeclareAbstractOutputPort("y", lambda: Value([]), lambda context, out: out.set_value([object()]))

    assert not found_in(Listing())


def test_rates_that_are_no_numbers_end():
    class Broken(LeafSystem):
        def __init__(self):
            super().__init__()
            self.DeclareStateOutputPort("y", self.DeclareContinuousState(1))
            self.DeclarePeriodicPublishEvent(0.1, 0.0, lambda context: None)

        def DoCalcTimeDerivatives(self, context, derivatives):
            derivatives.SetFromVector([np.nan])

    assert not found_in(Broken())
