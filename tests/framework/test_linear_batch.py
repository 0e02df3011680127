import numpy as np
import pytest
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource, LinearSystem

from forcectl.framework.linear_batch import WIDE, LinearBatch, behind_delay, interleave, sampled_system

PERIOD, STEPS = 0.01, 40


def systems(n, m=3, p=2, q=2, seed=0):
    """n random stable systems."""
    draw = np.random.default_rng(seed).standard_normal
    a = draw((n, m, m))
    return (
        a / (1.2 * np.abs(np.linalg.eigvals(a)).max(axis=1))[:, None, None],
        draw((n, m, p)),
        draw((n, q, m)),
        draw((n, q, p)),
    )


def response(block, inputs):
    """Outputs after each step under inputs (steps, ...) that change from step to step."""
    context = block.CreateDefaultContext()
    outputs = []
    for u in inputs:
        block.get_input_port().FixValue(context, u.ravel())
        outputs.append(block.get_output_port().Eval(context).copy())
        context.SetDiscreteState(block.EvalUniquePeriodicDiscreteUpdate(context))
    return np.array(outputs)


def made(n, ticks, stateful, state, line, seed=0):
    a, b, c, d = systems(n, seed=seed)
    outputs = (None, None) if stateful else (c, d)
    return sampled_system(a, b, *outputs, PERIOD, ticks, state=state, line=line)


@pytest.mark.parametrize("ticks", [0, 1, 4])
@pytest.mark.parametrize("stateful", [False, True])
def test_each_element_is_a_linear_system_of_its_own(ticks, stateful):
    n, (m, p) = WIDE + 5, (3, 2)
    draw = np.random.default_rng(1).standard_normal
    state, line, inputs = draw((m, n)), draw((p, n)), draw((STEPS, p, n))
    wide = made(n, ticks, stateful, state.ravel(), line.ravel())
    assert isinstance(wide, LinearBatch)
    found = response(wide, inputs).reshape(STEPS, -1, n)
    a, b, c, d = systems(n)
    for i in range(0, n, 7):
        outputs = (None, None) if stateful else (c[i : i + 1], d[i : i + 1])
        alone = sampled_system(a[i : i + 1], b[i : i + 1], *outputs, PERIOD, ticks, state=state[:, i], line=line[:, i])
        assert isinstance(alone, LinearSystem)
        np.testing.assert_allclose(found[..., i], response(alone, inputs[..., i]), rtol=1e-12, atol=1e-12)


def test_a_long_delay_is_a_line_of_its_own_with_the_same_outputs():
    n, ticks = 2, 80
    rng = np.random.default_rng(3)
    state, line, inputs = rng.standard_normal(3 * n), rng.standard_normal(2 * n), rng.standard_normal((200, 2, n))
    long = made(n, ticks, False, state, line)
    assert isinstance(long, LinearBatch)
    dense = behind_delay(*(interleave(part) for part in systems(n)), ticks, PERIOD)
    dense.configure_default_state(np.concatenate([state, np.tile(line, ticks)]))
    np.testing.assert_allclose(response(long, inputs), response(dense, inputs), rtol=1e-12, atol=1e-12)


def test_an_element_gives_the_same_bits_in_any_batch():
    inputs = np.random.default_rng(2).standard_normal((STEPS, 2, 3 * WIDE))
    whole = response(made(3 * WIDE, 2, False, None, None), inputs).reshape(STEPS, -1, 3 * WIDE)
    a, b, c, d = systems(3 * WIDE)
    part = slice(5, 5 + WIDE)
    some = response(sampled_system(a[part], b[part], c[part], d[part], PERIOD, 2), inputs[..., part])
    assert whole[..., part].tobytes() == some.reshape(STEPS, -1, WIDE).tobytes()


def test_what_is_not_a_number_stays_in_its_element():
    n = WIDE
    inputs = np.ones((STEPS, 2, n))
    healthy = response(made(n, 1, False, None, None), inputs).reshape(STEPS, -1, n)
    inputs[3, 0, 4] = np.nan
    found = response(made(n, 1, False, None, None), inputs).reshape(STEPS, -1, n)
    others = np.arange(n) != 4
    assert np.isnan(found[-1, :, 4]).all()
    assert found[..., others].tobytes() == healthy[..., others].tobytes()


@pytest.mark.parametrize(("ticks", "stateful", "through"), [(0, False, True), (1, False, False), (0, True, False)])
def test_feedthrough_is_that_of_the_equations(ticks, stateful, through):
    assert made(WIDE, ticks, stateful, None, None).HasAnyDirectFeedthrough() == through


def test_size_and_memory_grow_with_the_number_of_elements():
    states = [made(n, 3, False, None, None).CreateDefaultContext().num_total_states() for n in (WIDE, 10 * WIDE)]
    assert states[1] == 10 * states[0]


def test_it_runs_in_a_diagram():
    builder = DiagramBuilder()
    block = builder.AddSystem(made(WIDE, 0, False, None, None))
    source = builder.AddSystem(ConstantVectorSource(np.ones(2 * WIDE)))
    builder.Connect(source.get_output_port(), block.get_input_port())
    assert builder.Build().CreateDefaultContext().num_total_states() == 3 * WIDE
