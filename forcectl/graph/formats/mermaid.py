"""A block graph as a Mermaid flowchart, for Markdown pages that render it (README, pull requests, wikis)."""

from __future__ import annotations

from collections.abc import Iterator

from forcectl.graph.formats.paint import PALETTE
from forcectl.graph.layout.shapes import shape_of, subtitle
from forcectl.graph.model import Block, BlockGraph, Endpoint


def to_mermaid(graph: BlockGraph) -> str:
    """The graph at its depth as a Mermaid document."""
    writer = _Flowchart(graph)
    return "\n".join(["flowchart LR", *writer.block(graph.root, "  "), *writer.colours()]) + "\n"


class _Flowchart:
    """Lines of blocks under short names: `b3`, terminals of an open one `b3_in0`."""

    def __init__(self, graph: BlockGraph) -> None:
        self._graph = graph
        self._opened = graph.unfolded()
        self._ids = {block.path: f"b{number}" for number, block in enumerate(graph.root.walk())}

    def block(self, block: Block, indent: str) -> Iterator[str]:
        node = self._ids[block.path]
        if block.path not in self._opened:
            yield indent + _node(block, node)
            return
        inner = indent + "  "
        title = block.name + (f" ({subtitle(block)})" if subtitle(block) else "")
        yield f'{indent}subgraph {node}["{text_of(title)}"]'
        yield f"{inner}direction LR"
        for side, terminals in (("in", block.inputs), ("out", block.outputs)):
            for number, port in enumerate(terminals):
                yield f'{inner}{node}_{side}{number}(["{text_of(port.name)}"])'
        for child in block.blocks:
            yield from self.block(child, inner)
        yield f"{indent}end"
        for edge in block.edges:
            source, from_port = self._end(edge.source, "out", block.path)
            target, to_port = self._end(edge.target, "in", block.path)
            ports = " → ".join(dict.fromkeys(name for name in (from_port, to_port) if name))
            label = ": ".join(word for word in (ports, edge.signal) if word)
            arrow = "-->" if edge.size else "-.->"
            yield f'{indent}{source} {arrow}|"{text_of(label)}"| {target}'

    def colours(self) -> Iterator[str]:
        for name, (fill, line) in PALETTE.items():
            folded = (b for b in self._graph.nodes if b.category == name and b.path not in self._opened)
            if members := [self._ids[block.path] for block in folded]:
                yield f"  classDef {name} fill:{fill},stroke:{line},color:#1d2730"
                yield f"  class {','.join(members)} {name}"

    def _end(self, end: Endpoint, side: str, inside: str) -> tuple[str, str]:
        """Node at the end of a wire, and the port to be named on the wire (terminals show their own name)."""
        side, number = self._graph.port_number(end, side, inside)
        if end.block in self._opened:
            return f"{self._ids[end.block]}_{side}{number}", ""
        return self._ids[end.block], end.port if shape_of(self._graph.by_path[end.block]).form == "box" else ""


def _node(block: Block, node: str) -> str:
    shape = shape_of(block)
    symbol = "" if shape.symbol.startswith(":") else shape.symbol
    text = "<br/>".join(text_of(row) for row in (symbol, block.name, subtitle(block), block.period_text) if row)
    if shape.form == "circle":
        return f'{node}(("{text}"))'
    if block.kind == "diagram":
        return f'{node}[["{text}"]]'
    return f'{node}["{text}"]'


def text_of(text: str) -> str:
    """Text inside quotes, with special characters as Mermaid's `#` entities; else Markdown would be interpreted."""
    special = '#"&<>`*_\\|{}[]()~'
    return "".join(f"#{ord(c)};" if c in special and c != "_" else c for c in text.replace("\n", " "))
