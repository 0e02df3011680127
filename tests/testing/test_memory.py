"""Whether systems and memory are released, and by whom they are held."""

import gc

import numpy as np
import pytest
from pydrake.systems.framework import DiagramBuilder, DiscreteStateIndex, LeafSystem
from pydrake.systems.primitives import ConstantVectorSource

from forcectl.errors import BadInputError
from forcectl.framework import PythonBlock
from forcectl.testing import assert_memory_released, memory


class Block(LeafSystem):
    """A block as they all are: callbacks, ports kept, some state."""

    def __init__(self):
        super().__init__()
        self.u = self.DeclareVectorInputPort("u", 1)
        self.DeclareDiscreteState(1)
        self.DeclareStateOutputPort("y", DiscreteStateIndex(0))
        self.DeclarePeriodicDiscreteUpdateEvent(0.01, 0.0, self._update)

    def _update(self, context, state):
        state.set_value(0, self.u.Eval(context))


def build():
    builder = DiagramBuilder()
    source = builder.AddNamedSystem("source", ConstantVectorSource([1.0]))
    block = builder.AddNamedSystem("block", Block())
    builder.Connect(source.get_output_port(), block.get_input_port())
    return builder.Build()


def test_a_plain_diagram_is_released():
    record = assert_memory_released(build, duration=0.1, builds=3)
    assert record.systems == 3
    assert record.growth_kb < 1024


def test_growth_of_the_process_is_told():
    kept = []

    def leak():
        kept.append(np.ones(500_000))  # 4 MB
        return build()

    with pytest.raises(AssertionError, match=r"the process grows by [34]\d{3} kB per build, allowed are 1024 kB"):
        assert_memory_released(leak, builds=3)
    assert assert_memory_released(leak, builds=3, allowed_kb=6000).growth_kb > 3000


def test_systems_that_live_on_are_told_with_their_holder():
    kept = []

    def leak():
        kept.append(build())
        return kept[-1]

    record_possible = memory._drake_releases_blocks()
    if record_possible:
        with pytest.raises(AssertionError, match=r"systems are still alive after use: .*\(held by .*list"):
            assert_memory_released(leak, builds=1)
    else:
        # This Drake keeps every Python block by itself, so who else holds it cannot be told; the record says so.
        assert assert_memory_released(leak, builds=1).checked_references is False


def test_whether_this_drake_releases_blocks_is_measured_not_assumed():
    import weakref

    reference = weakref.ref(build().GetSubsystemByName("block"))
    gc.collect()
    assert memory._drake_releases_blocks() == (reference() is None)


def test_the_use_can_be_anything():
    seen = []
    assert_memory_released(build, builds=2, run=lambda system: seen.append(system.num_output_ports()))
    assert len(seen) == 5


def test_at_least_one_build_is_needed():
    with pytest.raises(BadInputError, match="builds = 0: must be at least 1"):
        assert_memory_released(build, builds=0)


class Light(PythonBlock):
    """A block that every release of Drake frees."""

    def __init__(self):
        super().__init__()
        self.DeclareVectorOutputPort("y", 1, lambda context, out: out.SetFromVector([1.0]))


@pytest.mark.parametrize("make", [lambda: ConstantVectorSource([1.0]), Light])
def test_of_blocks_that_every_drake_frees_none_may_live_on(make):
    kept = []

    def leak():
        builder = DiagramBuilder()
        builder.AddSystem(make())
        kept.append(builder.Build())
        return kept[-1]

    with pytest.raises(AssertionError, match=r"2 of 2 systems are still alive after use: .*held by .*list"):
        assert_memory_released(leak)
    kept.clear()
