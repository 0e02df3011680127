"""Faults of signals: what the readers get and when, and that the run is the same outside of them."""

import numpy as np
import pytest
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import RevoluteJoint, SpatialInertia
from pydrake.systems.controllers import InverseDynamicsController
from pydrake.systems.framework import DiagramBuilder, EventStatus, LeafSystem
from pydrake.systems.primitives import Adder, ConstantVectorSource, Gain, Integrator, LinearSystem, ZeroOrderHold

from forcectl.errors import BadInputError, RunFailedError
from forcectl.testing import DropOut, Fault, Frozen, Noise, NotANumber, Spike, run_diagram

PERIOD = 0.01


def ramp():
    """An integrator of 1 and its double, in a nested diagram: `inner.y0` is t, `double.y0` 2 t."""
    nested = DiagramBuilder()
    one = nested.AddNamedSystem("one", ConstantVectorSource([1.0]))
    clock = nested.AddNamedSystem("clock", Integrator(1))
    nested.Connect(one.get_output_port(), clock.get_input_port())
    nested.ExportOutput(clock.get_output_port(), "t")
    builder = DiagramBuilder()
    inner = nested.Build()
    inner.set_name("inner")
    builder.AddSystem(inner)
    double = builder.AddNamedSystem("double", Gain(2.0, 1))
    triple = builder.AddNamedSystem("triple", Gain(3.0, 1))
    builder.Connect(inner.get_output_port(), double.get_input_port())
    builder.Connect(inner.get_output_port(), triple.get_input_port())
    builder.ExportOutput(double.get_output_port(), "double")
    builder.ExportOutput(triple.get_output_port(), "triple")
    return builder.Build()


def readings(fault, port="inner.t"):
    return run_diagram(ramp(), 0.1, period=PERIOD, faults={port: fault})


TIMES = np.arange(11) * PERIOD


@pytest.mark.parametrize(
    ("fault", "value"),
    [
        (DropOut(start=0.03, duration=0.02), np.where([k in (3, 4) for k in range(11)], 0.0, TIMES)),
        (Frozen(start=0.03, duration=0.02), np.where([k in (3, 4) for k in range(11)], 0.03, TIMES)),
        (NotANumber(start=0.07), np.where(np.arange(11) >= 7, np.nan, TIMES)),
        (Spike(5.0, start=0.03), TIMES + 5.0 * (np.arange(11) == 3)),
        (Spike(5.0, start=0.03, duration=0.03), TIMES + 5.0 * np.isin(np.arange(11), (3, 4, 5))),
    ],
)
@pytest.mark.parametrize("port", ["inner.t", "t", "inner/clock.y0"])
def test_all_readers_of_an_output_get_it(fault, value, port):
    log = readings(fault, port)
    np.testing.assert_allclose(log["double"][:, 0], 2 * value, atol=1e-12)
    np.testing.assert_allclose(log["triple"][:, 0], 3 * value, atol=1e-12)


def test_what_drake_refuses_is_said_with_its_time():
    """Drake's controller has a plant of its own, which takes no state that is not a number."""
    plant = MultibodyPlant(0.0)
    body = plant.AddRigidBody("arm", SpatialInertia.SolidSphereWithMass(1.0, 0.1))
    plant.AddJointActuator(
        "motor", plant.AddJoint(RevoluteJoint("hinge", plant.world_frame(), body.body_frame(), [1, 0, 0]))
    )
    plant.Finalize()
    builder = DiagramBuilder()
    state = builder.AddNamedSystem("state", ConstantVectorSource(np.zeros(2)))
    wanted = builder.AddNamedSystem("wanted", ConstantVectorSource(np.zeros(2)))
    law = builder.AddNamedSystem("law", InverseDynamicsController(plant, [1.0], [0.0], [1.0], False))
    builder.Connect(state.get_output_port(), law.get_input_port_estimated_state())
    builder.Connect(wanted.get_output_port(), law.get_input_port_desired_state())
    fault = {"state.y0": NotANumber(start=0.03)}
    with pytest.raises(RunFailedError, match=r"^the simulation stopped at t = 0.03 s: .*AllFinite"):
        run_diagram(builder.Build(), 0.1, period=PERIOD, outputs=["law.generalized_force"], faults=fault)


def test_of_an_input_only_this_reader_gets_it():
    log = readings(DropOut(start=0.05), "double.u0")
    np.testing.assert_allclose(log["double"][:, 0], np.where(np.arange(11) < 5, 2 * TIMES, 0.0), atol=1e-12)
    np.testing.assert_allclose(log["triple"][:, 0], 3 * TIMES, atol=1e-12)


@pytest.mark.slow
def test_noise_has_its_deviation_and_follows_its_seed():
    runs = [run_diagram(ramp(), 10.0, period=PERIOD, faults={"t": Noise(0.1, seed=seed)}) for seed in (0, 0, 1)]
    noise = [run["double"][:, 0] / 2 - run.time for run in runs]
    assert noise[0].std() == pytest.approx(0.1, rel=0.1)
    np.testing.assert_array_equal(noise[0], noise[1])
    assert abs(np.corrcoef(noise[0], noise[2])[0, 1]) < 0.15


def test_several_faults_of_one_port_come_one_after_the_other():
    log = readings([Frozen(start=0.02, duration=0.05), Spike(1.0, start=0.04)])
    frozen = np.where(np.isin(np.arange(11), range(2, 7)), 0.02, TIMES)
    np.testing.assert_allclose(log["double"][:, 0], 2 * (frozen + (np.arange(11) == 4)), atol=1e-12)


class Nothing(Fault):
    def begin(self, value):
        return lambda: lambda value: value


def sampled_loop():
    builder = DiagramBuilder()
    plant = builder.AddNamedSystem("plant", LinearSystem([[-1.0]], [[1.0]], [[1.0]], [[0.0]]))
    gain = builder.AddNamedSystem("gain", Gain(-3.0, 1))
    hold = builder.AddNamedSystem("hold", ZeroOrderHold(PERIOD, 1))
    total = builder.AddNamedSystem("sum", Adder(2, 1))
    for source, reader in ((plant, gain), (gain, hold), (hold, total)):
        builder.Connect(source.get_output_port(), reader.get_input_port(0))
    builder.Connect(total.get_output_port(), plant.get_input_port())
    builder.ExportInput(total.get_input_port(1), "disturbance")
    builder.ExportOutput(plant.get_output_port(), "y")
    return builder.Build()


@pytest.mark.parametrize("port", ["hold.y", "plant.y0", "y", "disturbance", "sum.u0"])
def test_a_fault_that_changes_nothing_delays_nothing(port):
    loop, inputs = sampled_loop(), {"disturbance": np.sin}
    sound = run_diagram(loop, 0.5, period=PERIOD, inputs=inputs)
    always = run_diagram(loop, 0.5, period=PERIOD, inputs=inputs, faults={port: Nothing()})
    np.testing.assert_array_equal(always["y"], sound["y"])
    part = run_diagram(loop, 0.5, period=PERIOD, inputs=inputs, faults={port: Nothing(start=0.1, duration=0.1)})
    np.testing.assert_allclose(part["y"], sound["y"], atol=1e-9)  # the integrator begins anew


def test_the_run_before_a_fault_is_the_one_without_it():
    loop, inputs = sampled_loop(), {"disturbance": np.sin}
    sound = run_diagram(loop, 0.5, period=PERIOD, inputs=inputs)["y"]
    faulty = run_diagram(loop, 0.5, period=PERIOD, inputs=inputs, faults={"hold.y": Spike(1.0, start=0.2)})["y"]
    np.testing.assert_array_equal(faulty[:21], sound[:21])
    assert (faulty[21:] != sound[21:]).all()


def test_nan_runs_through_a_continuous_loop_to_the_end():
    log = run_diagram(sampled_loop(), 0.5, period=PERIOD, faults={"plant.y0": NotANumber(start=0.1, duration=0.05)})
    assert np.isnan(log["y"][-1, 0])


def test_one_element_of_an_input_of_a_single_block():
    log = run_diagram(Gain(2.0, 2), 0.1, period=PERIOD, inputs={"u0": [1.0, 1.0]}, faults={"u0": DropOut(index=1)})
    np.testing.assert_array_equal(log["y0"], np.tile([2.0, 0.0], (11, 1)))


class Counter(LeafSystem):
    """Counts its updates, and its initialisations in tens."""

    def __init__(self):
        super().__init__()
        self.DeclareVectorInputPort("u", 1)
        self.DeclareStateOutputPort("count", self.DeclareDiscreteState(1))
        self.DeclarePeriodicDiscreteUpdateEvent(PERIOD, 0.0, lambda _, state: self._add(state, 1))
        self.DeclareInitializationDiscreteUpdateEvent(lambda _, state: self._add(state, 10))

    @staticmethod
    def _add(state, number):
        state.set_value(0, state.value(0) + number)
        return EventStatus.Succeeded()


def test_events_happen_once_where_a_fault_begins_and_ends():
    faults = {"u": [DropOut(start=0.02, duration=0.03), Noise(1.0, start=0.04, duration=0.03)]}
    counter = Counter()
    context = counter.CreateDefaultContext()
    log = run_diagram(counter, 0.1, period=PERIOD, faults=faults, context=context)
    np.testing.assert_array_equal(log["count"][:, 0], 10.0 + np.arange(11))
    assert context.get_time() == pytest.approx(0.1)
    assert context.get_discrete_state(0).value()[0] == 20.0


@pytest.mark.parametrize(
    ("faults", "message"),
    [
        ({"hold.z": DropOut()}, r"unknown port 'hold.z': must be block.port, nearest: hold.y"),
        ({"y0": DropOut()}, r"port 'y0' is ambiguous: give the block as well, one of plant.y0, gain.y0"),
        ({"hold.y": "frozen"}, r"faults\['hold.y'\] = 'frozen': must be a fault such as Frozen"),
        ({"hold.y": DropOut(index=1)}, r"faults\['hold.y'\].index = 1: must be 0 ... 0"),
    ],
)
def test_bad_faults(faults, message):
    with pytest.raises(BadInputError, match=message):
        run_diagram(sampled_loop(), 0.1, period=PERIOD, faults=faults)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: DropOut(start=-1), "start = -1: must be not negative"),
        (lambda: DropOut(duration=0), "duration = 0: must be positive"),
        (lambda: Noise(0.0), "std = 0.0: must be positive"),
    ],
)
def test_bad_values(make, message):
    with pytest.raises(BadInputError, match=message):
        make()
