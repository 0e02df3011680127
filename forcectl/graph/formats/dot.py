"""A block graph as pydot objects and as Graphviz DOT, to be restyled or drawn with other tools.

Blocks are records with their ports inside, unfolded diagrams are clusters with their terminals at the border. Wires
that close a loop do not affect the order of blocks (`constraint=false`), so the forward path reads from left to right.
"""

from __future__ import annotations

import pydot

from forcectl.graph.formats.paint import PALETTE
from forcectl.graph.layout.order import feedback_edges
from forcectl.graph.layout.shapes import shape_of, subtitle
from forcectl.graph.model import Block, BlockGraph, Endpoint, Port


def to_dot(graph: BlockGraph) -> str:
    """The graph at its depth as a DOT document."""
    return to_pydot(graph).to_string(indent=2)


def to_pydot(graph: BlockGraph) -> pydot.Dot:
    """The graph at its depth as pydot objects: a `Node` per block, an `Edge` per wire, a `Cluster` per open diagram."""
    dot = pydot.Dot(
        pydot.make_quoted(graph.root.name), graph_type="digraph", rankdir="LR", nodesep=0.35, ranksep=0.8,
        fontname="Helvetica", fontsize=12, compound=True,
    )  # fmt: skip
    dot.set_node_defaults(shape="record", style="filled", fontname="Helvetica", fontsize=11, penwidth=1.2)
    dot.set_edge_defaults(fontname="Helvetica", fontsize=9, color="#2f3c48", fontcolor="#5b6873", arrowsize=0.7)
    _Writer(graph).add(dot, graph.root)
    return dot


class _Writer:
    """Adds blocks to pydot graphs under short names: `b3`, its ports `b3:in0`, terminals of an open one `b3_in0`."""

    def __init__(self, graph: BlockGraph) -> None:
        self._graph = graph
        self._opened = graph.unfolded()
        self._ids = {block.path: f"b{number}" for number, block in enumerate(graph.root.walk())}

    def add(self, parent: pydot.Graph, block: Block) -> None:
        """Add a block, and what is inside of it when it is open."""
        if block.path not in self._opened:
            parent.add_node(_node(block, self._ids[block.path]))
            return
        title = block.name + (f"  ({subtitle(block)})" if subtitle(block) else "")
        cluster = pydot.Cluster(
            self._ids[block.path], label=label_of(title), labeljust="l", style="rounded", color="#8b97a3",
            bgcolor="#f7f8f9",
        )  # fmt: skip
        self._add_terminals(cluster, block, "in", block.inputs)
        self._add_terminals(cluster, block, "out", block.outputs)
        for child in block.blocks:
            self.add(cluster, child)
        returning = feedback_edges(block)
        for edge in block.edges:
            wire = pydot.Edge(self._end(edge.source, "out", block.path), self._end(edge.target, "in", block.path))
            wire.set("label", label_of(edge.signal))
            if edge in returning:
                wire.set("constraint", False)
            if not edge.size:
                wire.set("style", "dashed")
            cluster.add_edge(wire)
        parent.add_subgraph(cluster)  # type: ignore[arg-type]  # pydot's annotation leaves its Cluster out

    def _add_terminals(self, cluster: pydot.Cluster, block: Block, side: str, ports: tuple[Port, ...]) -> None:
        row: pydot.Graph = cluster
        if ports and block is self._graph.root:  # the outermost terminals are at both ends of the picture
            row = pydot.Subgraph(f"{self._ids[block.path]}_{side}", rank="source" if side == "in" else "sink")
            cluster.add_subgraph(row)
        for number, port in enumerate(ports):
            name = f"{self._ids[block.path]}_{side}{number}"
            row.add_node(
                pydot.Node(name, shape="cds", fillcolor="white", height=0.2, fontsize=10, label=label_of(port.name))
            )

    def _end(self, end: Endpoint, side: str, inside: str) -> str:
        """A node, or a port of a record with the compass point of the wire's end."""
        side, number = self._graph.port_number(end, side, inside)
        if end.block in self._opened:
            return f"{self._ids[end.block]}_{side}{number}"
        return f"{self._ids[end.block]}:{side}{number}:{'w' if side == 'in' else 'e'}"


def _node(block: Block, name: str) -> pydot.Node:
    fill, line = PALETTE[block.category]
    symbol = shape_of(block).symbol
    rows = [block.name, "" if symbol.startswith(":") else symbol, subtitle(block), block.period_text]
    text = "\\n".join(_field(row) for row in rows if row)
    left = "|".join(f"<in{i}> {_field(port.name)}" for i, port in enumerate(block.inputs))
    right = "|".join(f"<out{i}> {_field(port.name)}" for i, port in enumerate(block.outputs))
    # Each pair of braces changes the direction: the outer pair puts inputs, name and outputs side by side.
    fields = (f"{{{left}}}" if left else "", text, f"{{{right}}}" if right else "")
    label = "{" + "|".join(field for field in fields if field) + "}"
    node = pydot.Node(name, label=pydot.make_quoted(label), fillcolor=fill, color=line)
    if block.kind == "diagram":
        node.set("peripheries", 2)
    return node


def _field(text: str) -> str:
    """Text of a record label, in which braces, bars, angle brackets and spaces must be escaped."""
    escaped = "".join(f"\\{c}" if c in "\\{}|<> " else c for c in text)
    return escaped.replace("&", "&amp;").replace("\n", "\\n")


def label_of(text: str) -> str:
    """Text of a plain label, always in quotes: pydot takes a text in angle brackets for HTML."""
    return pydot.make_quoted(text.replace("\\", "\\\\").replace("&", "&amp;"))
