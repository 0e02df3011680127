"""Mermaid text: its grammar, what is written on blocks and wires, odd characters."""

import re

import pytest

from forcectl.graph.export import graph
from forcectl.graph.formats.mermaid import to_mermaid
from tests.examples.graph_diagrams import ALL, force_loop, odd_names

TEXT = r'"[^"]*"'
NODE = re.compile(rf"^(b\d+(?:_(?:in|out)\d+)?)(?:\[{TEXT}\]|\(\[{TEXT}\]\)|\(\({TEXT}\)\)|\[\[{TEXT}\]\])$")
EDGE = re.compile(rf"^(b\d+\w*) (?:-->|-\.->)(?:\|{TEXT}\|)? (b\d+\w*)$")
SUBGRAPH = re.compile(rf"^subgraph (b\d+)\[{TEXT}\]$")
CLASS = re.compile(r"^(classDef \w+ fill:#\w{6},stroke:#\w{6},color:#\w{6}|class (b\d+,?)+ \w+)$")


@pytest.mark.parametrize("make", ALL.values(), ids=ALL)
@pytest.mark.parametrize("depth", [0, 1, None])
def test_every_line_is_one_of_the_grammar_and_every_wire_joins_known_nodes(make, depth):
    model = graph(make(), depth=depth)
    source = to_mermaid(model)
    assert source == to_mermaid(graph(make(), depth=depth))
    first, *lines = source.splitlines()
    assert first == "flowchart LR"
    nodes, edges, nesting = set(), [], 0
    for line in map(str.strip, lines):
        if SUBGRAPH.match(line):
            nesting += 1
        elif line == "end":
            nesting -= 1
            assert nesting >= 0
        elif node := NODE.match(line):
            assert node.group(1) not in nodes
            nodes.add(node.group(1))
        elif edge := EDGE.match(line):
            edges.append(edge.groups())
        else:
            assert line == "direction LR" or CLASS.match(line), line
    assert nesting == 0
    assert len(edges) == len(model.edges)
    assert {end for edge in edges for end in edge} <= nodes


def test_ports_sizes_units_and_sample_times_are_written():
    source = to_mermaid(graph(force_loop(), depth=1))
    assert '|"measured_force: 1 · N"|' in source
    assert "force_law<br/>ForceLaw<br/>2 ms" in source
    assert '[["station<br/>Station"]]' in source  # folded


def test_odd_characters_are_entities():
    source = to_mermaid(graph(odd_names()))
    assert "block #34;A#34; #60;1#62; #38; #60;/script#62;" in source
    assert "x#124;#123;y#125;" in source
