"""Drake's CENIC scheme takes the desired velocity of actuator gains with the wrong sign: the doctor refuses the two."""

import numpy as np
import pytest
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.multibody.tree import PdControllerGains, PrismaticJoint, SpatialInertia
from pydrake.systems.analysis import ApplySimulatorConfig, GetIntegrationSchemes, Simulator, SimulatorConfig
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource, Integrator, MatrixGain, Multiplexer, ZeroOrderHold

from forcectl.doctor import examine
from forcectl.errors import BadInputError


def slider(state, *, damping=10.0, connected=True):
    """A mass on a PD actuator whose desired position and velocity come from `state`."""
    builder = DiagramBuilder()
    plant, _ = AddMultibodyPlantSceneGraph(builder, 0.0)
    body = plant.AddRigidBody("mass", SpatialInertia.SolidBoxWithMass(1.0, 0.1, 0.1, 0.1))
    joint = plant.AddJoint(PrismaticJoint("x", plant.world_frame(), body.body_frame(), [1, 0, 0]))
    plant.AddJointActuator("motor", joint).set_controller_gains(PdControllerGains(p=0.0, d=damping))
    plant.Finalize()
    source = state(builder)
    if connected:
        instance = plant.GetModelInstanceByName("DefaultModelInstance")
        builder.Connect(source, plant.get_desired_state_input_port(instance))
    builder.ExportOutput(plant.get_state_output_port(), "state")
    return builder.Build()


def constant(*state):
    return lambda builder: builder.AddNamedSystem("wanted", ConstantVectorSource(state)).get_output_port()


def through_a_gain(builder):
    source = builder.AddNamedSystem("wanted", ConstantVectorSource([0.3]))
    gain = builder.AddNamedSystem("rows", MatrixGain(np.array([[1.0], [0.0]])))
    builder.Connect(source.get_output_port(), gain.get_input_port())
    return gain.get_output_port()


def integrated(builder):
    """At rest at the start, but a state may move later."""
    source = builder.AddNamedSystem("rate", ConstantVectorSource([0.0, 1.0]))
    integral = builder.AddNamedSystem("integral", Integrator(2))
    builder.Connect(source.get_output_port(), integral.get_input_port())
    return integral.get_output_port()


def held(builder):
    source = builder.AddNamedSystem("wanted", ConstantVectorSource([0.0, 0.0]))
    hold = builder.AddNamedSystem("hold", ZeroOrderHold(0.01, 2))
    builder.Connect(source.get_output_port(), hold.get_input_port())
    return hold.get_output_port()


def from_outside(builder):
    both = builder.AddNamedSystem("both", Multiplexer([1, 1]))
    source = builder.AddNamedSystem("zero", ConstantVectorSource([0.0]))
    builder.Connect(source.get_output_port(), both.get_input_port(0))
    builder.ExportInput(both.get_input_port(1), "velocity")
    return both.get_output_port()


def refused(diagram, scheme="cenic"):
    return examine(diagram, scheme=scheme).with_code("cenic-desired-velocity")


@pytest.mark.parametrize("state", [constant(0.0, 1.0), integrated, held, from_outside])
def test_a_desired_velocity_that_may_differ_from_zero_is_refused_with_the_reason(state):
    (finding,) = refused(slider(state))
    assert finding.severity == "error"
    assert finding.path == "plant.DefaultModelInstance_desired_state"
    for word in ("CENIC", "wrong sign", "runge_kutta3"):
        assert word in finding.message


@pytest.mark.parametrize("state", [constant(0.3, 0.0), through_a_gain])
def test_a_constant_desired_state_at_rest_is_fine(state):
    assert refused(slider(state)) == ()


def test_gains_that_do_not_meet_the_velocity_are_fine():
    assert refused(slider(constant(0.0, 1.0), damping=0.0)) == ()
    assert refused(slider(constant(0.0, 1.0), connected=False)) == ()


@pytest.mark.parametrize("scheme", [None, "runge_kutta3", "implicit_euler"])
def test_other_schemes_are_fine(scheme):
    assert refused(slider(constant(0.0, 1.0)), scheme) == ()


def test_an_unknown_scheme_is_told():
    with pytest.raises(BadInputError, match="unknown integration scheme 'cenix': did you mean 'cenic'"):
        examine(slider(constant(0.0, 0.0)), scheme="cenix")


has_cenic = pytest.mark.skipif("cenic" not in GetIntegrationSchemes(), reason="this Drake has no CENIC scheme")


def simulator_of(diagram, scheme):
    simulator = Simulator(diagram)
    ApplySimulatorConfig(SimulatorConfig(integration_scheme=scheme, max_step_size=0.01, accuracy=1e-3), simulator)
    return simulator


@has_cenic
def test_the_scheme_of_a_simulator_is_read_from_it():
    diagram = slider(constant(0.0, 1.0))
    assert refused(diagram, simulator_of(diagram, "cenic"))
    assert not refused(diagram, simulator_of(diagram, "runge_kutta3"))


@has_cenic
def test_the_fault_that_is_refused_is_there():
    """When this fails, Drake has mended its scheme, and the refusal can go."""
    ends = {}
    for scheme in ("runge_kutta3", "cenic"):
        simulator = simulator_of(slider(constant(0.0, 1.0)), scheme)
        simulator.AdvanceTo(2.0)
        ends[scheme] = simulator.get_system().GetOutputPort("state").Eval(simulator.get_context())[1]
    assert ends["runge_kutta3"] == pytest.approx(1.0, abs=1e-3)
    assert ends["cenic"] < 0
