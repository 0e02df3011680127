import gc
import weakref

import pytest
from pydrake.systems.framework import BasicVector, DiagramBuilder, LeafSystem
from pydrake.systems.primitives import ConstantVectorSource, LogVectorOutput, Multiplexer, VectorLogSink, ZeroOrderHold

from forcectl.errors import BadInputError
from forcectl.force.integral import IntegralForceLaw
from forcectl.graph.export import graph
from forcectl.graph.model import Endpoint
from tests.examples.graph_diagrams import ALL, ForceLaw, arm_with_controller, force_loop, odd_names, primitive_loop


def names(ports):
    return [port.name for port in ports]


def test_nodes_follow_the_depth():
    inside = ["position_loop", "contact_stiffness", "one_sided", "force_sensor"]
    expected = {
        0: ["closed_loop"],
        1: ["closed_loop", "station", "reference", "force_law"],
        None: ["closed_loop", "station", *inside, "reference", "force_law"],
    }
    for depth, wanted in expected.items():
        assert [block.name for block in graph(force_loop(), depth=depth).nodes] == wanted
    assert graph(force_loop(), depth=0).edges == ()
    assert graph(force_loop(), depth=2).nodes == graph(force_loop(), depth=None).nodes
    assert graph(force_loop()).root.height == 2


def test_wires_carry_size_and_unit_even_from_ports_without_a_unit():
    edges = {(edge.source, edge.target): edge for edge in graph(force_loop()).edges}
    reference = edges[Endpoint("reference", "y0"), Endpoint("force_law", "desired_force")]
    assert (reference.signal, reference.size) == ("1 · N", 1)
    force = edges[Endpoint("station", "contact_force"), Endpoint("", "contact_force")]
    assert force.signal == "1 · N"
    assert len(edges) == 4


def test_units_of_a_block_override_the_table():
    class Motor(LeafSystem):
        port_units = {"current": "A"}

        def __init__(self):
            super().__init__()
            self.DeclareVectorInputPort("current", 3)

    model = graph(Motor(), hide_unused=False)
    assert model.root.inputs[0].signal == "3 · A"


def test_loggers_are_hidden_but_what_they_record_keeps_its_port():
    plain = graph(force_loop())
    assert "log" not in plain.by_path
    assert "contact_displacement" in names(plain.by_path["station"].outputs)
    shown = graph(force_loop(), loggers=True)
    assert "log" in shown.by_path
    assert Endpoint("log", "data") in {edge.target for edge in shown.edges}


def test_unused_ports_are_hidden_by_default():
    plant = graph(arm_with_controller()).by_path["plant"]
    assert set(names(plant.inputs)) == {"geometry_query", "actuation"}
    everything = graph(arm_with_controller(), hide_unused=False).by_path["plant"]
    assert len(everything.outputs) > 10 > len(plant.outputs)
    connected = {port.name for port in everything.outputs if port.connected}
    assert connected == set(names(plant.outputs))


def test_what_is_unused_outside_is_left_out_inside():
    builder = DiagramBuilder()
    builder.AddNamedSystem("inner", primitive_loop())
    outer = builder.Build()
    outer.set_name("outer")
    model = graph(outer, depth=None)
    assert model.by_path["inner"].outputs == ()
    assert all(edge.target.block != "inner" for edge in model.edges)


def test_states_sample_times_and_kinds():
    model = graph(force_loop(), depth=None)
    law = model.by_path["force_law"]
    assert (law.kind, law.category, law.type_name) == ("leaf", "discrete", "ForceLaw")
    assert (law.period_text, law.states) == ("2 ms", (0, 1, 0))
    sensor = model.by_path["station/force_sensor"]
    assert (sensor.category, sensor.states) == ("continuous", (1, 0, 0))
    assert model.by_path["station"].category == "nested"
    assert model.by_path["station"].type_name == "Station"
    assert model.by_path["station/contact_stiffness"].category == "stateless"
    arm = graph(arm_with_controller())
    assert arm.by_path["plant"].category == "multibody"
    assert arm.by_path["plant"].period_text == "1 ms"


def test_direct_feedthrough_is_told_per_output():
    model = graph(odd_names(), depth=None)
    block = model.by_path['block "A" <1> & </script>']
    by_name = {port.name: port for port in block.outputs}
    assert by_name["list & dict"].feedthrough == ('in "a" <b>', "x|{y}")
    assert by_name["v"].feedthrough == ()


def test_parameters_come_from_the_context_with_documented_names():
    diagram = force_loop()
    context = diagram.CreateDefaultContext()
    law = diagram.GetSubsystemByName("force_law")
    law.GetMyMutableContextFromRoot(context).get_mutable_numeric_parameter(0).SetAtIndex(0, 4.5)
    given = graph(diagram, context=context).by_path["force_law"].parameters
    assert [(p.name, p.values) for p in given] == [("integral_gain", (4.5,)), ("compliance", (3.2e-5,))]
    default = graph(diagram).by_path["force_law"].parameters
    assert default[0].values == (3.0,)


def test_the_units_of_parameters_come_from_the_block_or_from_its_documentation():
    documented = graph(force_loop()).by_path["force_law"].parameters
    assert [p.text for p in documented] == ["3 1/s", "3.2e-05 m/N"]
    # A block of ours says itself which parameters it has this time: with a port for the compliance it has one fewer.
    law = graph(IntegralForceLaw(1, integral_gain=1.5, dead_zone=0.1, upper_limit=0.02)).root.parameters
    assert [(p.name, p.text) for p in law] == [
        ("integral_gain", "1.5 1/s"),
        ("dead_zone", "0.1 N"),
        ("lower_limit", "-inf m"),
        ("upper_limit", "0.02 m"),
    ]


def test_parameters_without_a_unit_have_none():
    class Plain(LeafSystem):
        """Numbers.

        Parameters: share in [0, 1]. A threshold, tried between; gain [-], lag and delay [s].

        Attributes:
            parameters: [share, threshold, gain, lag, delay, unsaid (optional)]
        """

        def __init__(self):
            super().__init__()
            for value in range(6):
                self.DeclareNumericParameter(BasicVector([float(value)]))

    given = graph(Plain()).root.parameters
    assert [(p.name, p.unit) for p in given] == [
        ("share", ""),
        ("threshold", ""),
        ("gain", ""),
        ("lag", "s"),
        ("delay", "s"),
        ("unsaid", ""),
    ]


def test_gains_and_limits_of_primitives_are_read():
    model = graph(force_loop(), depth=None)
    gain = model.by_path["station/contact_stiffness"].parameters
    assert [(p.name, p.values) for p in gain] == [("gain", (-25000.0,))]
    limits = model.by_path["station/one_sided"].parameters
    assert [p.values for p in limits] == [(0.0,), (1e4,)]
    matrices = {p.name: p.values for p in model.by_path["station/force_sensor"].parameters}
    assert matrices["A"] == (-300.0,)


def test_unnamed_systems_are_numbered_by_type_and_abstract_ports_tell_their_type():
    model = graph(odd_names())
    assert [block.name for block in model.nodes[1:]] == ['block "A" <1> & </script>', "Odd 1", "Odd 2"]
    assert model.root.name == "Diagram"
    assert {edge.signal for edge in model.edges} == {"object", "3"}
    query = [edge for edge in graph(arm_with_controller()).edges if edge.source.port == "query"]
    assert [edge.signal for edge in query] == ["QueryObject"]


def test_a_single_leaf_is_a_graph_of_one_box():
    model = graph(ForceLaw(), depth=None)
    assert [block.name for block in model.nodes] == ["ForceLaw"]
    assert names(model.root.inputs) == ["desired_force", "measured_force"]
    assert names(model.root.outputs) == ["displacement_command"]


@pytest.mark.parametrize("make", ALL.values(), ids=ALL)
def test_two_diagrams_built_alike_give_equal_graphs(make):
    assert graph(make(), depth=None) == graph(make(), depth=None)


def test_the_graph_does_not_keep_the_diagram_alive():
    # Drake never frees a Python block that declares its own methods as callbacks, nor a diagram of which Python has
    # seen a port of a block that was added in C++, as LogVectorOutput does.
    builder = DiagramBuilder()
    hold = builder.AddNamedSystem("kept", ZeroOrderHold(0.1, 1))
    log = builder.AddSystem(VectorLogSink(1, 0.1))
    builder.Connect(hold.get_output_port(), log.get_input_port())
    diagram = builder.Build()
    watched = weakref.ref(diagram)
    model = graph(diagram)
    del builder, hold, log, diagram
    gc.collect()
    assert watched() is None
    assert model.nodes[1].name == "kept"


def test_a_multiplexer_that_only_gathers_for_a_log_is_hidden_with_it():
    builder = DiagramBuilder()
    source = builder.AddNamedSystem("source", ConstantVectorSource([1.0]))
    mux = builder.AddNamedSystem("gather", Multiplexer([1, 1]))
    for i in range(2):
        builder.Connect(source.get_output_port(), mux.get_input_port(i))
    LogVectorOutput(mux.get_output_port(), builder)
    diagram = builder.Build()
    assert [block.name for block in graph(diagram).nodes] == ["Diagram", "source"]
    assert len(graph(diagram, loggers=True).nodes) == 4


@pytest.mark.parametrize("depth", [-1, 1.5, True, "2"])
def test_bad_depth_is_refused_by_name(depth):
    with pytest.raises(BadInputError, match=r"^depth = .*whole number"):
        graph(force_loop(), depth=depth)


def test_something_that_is_no_diagram_is_refused():
    with pytest.raises(BadInputError, match="takes a Drake system, not str"):
        graph("loop")
