"""Same bits at every build, after reset and in a clone."""

import copy
import itertools

import numpy as np
import pytest
from pydrake.common import RandomDistribution
from pydrake.common.value import Value
from pydrake.systems.framework import DiagramBuilder, DiscreteStateIndex, LeafSystem
from pydrake.systems.primitives import Gain, LinearSystem, RandomSource

from forcectl.errors import BadInputError
from forcectl.testing import assert_deterministic, assert_same_after_reset_and_clone


class Counter(LeafSystem):
    """Counts its updates, in the Context or (wrongly) in an attribute."""

    def __init__(self, hidden):
        super().__init__()
        self.hidden = hidden
        self.count = 0.0
        self.DeclareDiscreteState(1)
        self.DeclareStateOutputPort("count", DiscreteStateIndex(0))
        self.DeclarePeriodicDiscreteUpdateEvent(0.1, 0.0, self._update)

    def _update(self, context, state):
        self.count += 1.0
        inside = context.get_discrete_state(0).GetAtIndex(0) + 1.0
        state.set_value(0, [self.count if self.hidden else inside])


class CloneBreaker(Counter):
    """Starts again after a reset, but a clone shares its attribute."""

    def __init__(self):
        super().__init__(hidden=True)
        self.DeclareInitializationDiscreteUpdateEvent(self._restart)

    def _restart(self, context, state):
        self.count = 0.0
        state.set_value(0, [0.0])


class Noise(LeafSystem):
    """White noise; the generator's state is in the Context."""

    def __init__(self, seed):
        super().__init__()
        self._state = self.DeclareAbstractState(Value(np.random.default_rng(seed)))
        self.DeclareDiscreteState(1)
        self.DeclareStateOutputPort("force", DiscreteStateIndex(0))
        self.DeclarePeriodicUnrestrictedUpdateEvent(0.1, 0.0, self._update)

    def _update(self, context, state):
        generator = copy.deepcopy(context.get_abstract_state(0).get_value())
        state.get_mutable_discrete_state(0).SetFromVector([generator.normal()])
        state.get_mutable_abstract_state(0).set_value(generator)


def test_the_same_build_gives_the_same_bits():
    log = assert_deterministic(lambda: Noise(0), duration=1.0, period=0.1)
    assert np.std(log["force"]) > 0


def test_a_build_that_changes_is_told_with_the_first_difference():
    seeds = itertools.count()
    with pytest.raises(AssertionError, match=r"two builds give different runs, first in force\[0\] at t = 0\.1 s"):
        assert_deterministic(lambda: Noise(next(seeds)), duration=1.0, period=0.1)


def test_drakes_own_noise_has_another_seed_in_every_instance():
    """What the assertion is for: RandomSource gives each instance a seed of its own unless one is set."""
    with pytest.raises(AssertionError, match="seed every random source"):
        assert_deterministic(lambda: RandomSource(RandomDistribution.kUniform, 1, 0.1), duration=1.0, period=0.1)


def test_one_bit_is_enough():
    gains = iter([1.0, np.nextafter(1.0, 2.0)])
    with pytest.raises(AssertionError, match=r"1\.0\S* and \S*1\.0000000000000002"):
        assert_deterministic(lambda: Gain(next(gains), 1), duration=0.1, period=0.1, inputs={"u0": 1.0})


@pytest.mark.parametrize("duration", [0.2, 0.5, 2.0])
def test_memory_in_the_context_passes(duration):
    log = assert_same_after_reset_and_clone(Counter(hidden=False), duration=duration, period=0.1)
    assert log["count"][-1, 0] > 0
    assert_same_after_reset_and_clone(Noise(0), duration=duration, period=0.1)
    lag = LinearSystem([[-1.0]], [[1.0]], [[1.0]], [[0.0]])
    assert_same_after_reset_and_clone(lag, duration=duration, period=0.1, inputs={"u0": np.sin})


def test_memory_in_an_attribute_is_found_by_the_reset():
    with pytest.raises(AssertionError, match=r"Counter runs differently after a reset, first in count\[0\]"):
        assert_same_after_reset_and_clone(Counter(hidden=True), duration=1.0, period=0.1)


def test_memory_in_an_attribute_is_found_by_the_clone():
    with pytest.raises(
        AssertionError, match=r"CloneBreaker and its clone run differently, first in count\[0\] at t = 0\.6"
    ):
        assert_same_after_reset_and_clone(CloneBreaker(), duration=1.0, period=0.1)


def test_outputs_inside_of_a_diagram_that_exports_none():
    def build(hidden):
        builder = DiagramBuilder()
        builder.AddNamedSystem("counter", Counter(hidden))
        return builder.Build()

    with pytest.raises(
        BadInputError, match=r"no vector output to look at: export one, or name a block\.port in `outputs`"
    ):
        assert_deterministic(lambda: build(False), duration=1.0, period=0.1)
    inside = {"duration": 1.0, "period": 0.1, "outputs": ["counter.count"]}
    assert assert_deterministic(lambda: build(False), **inside)["counter.count"][-1, 0] > 0
    assert_same_after_reset_and_clone(build(False), **inside)
    with pytest.raises(AssertionError, match=r"first in counter\.count\[0\]"):
        assert_same_after_reset_and_clone(build(True), **inside)
