"""A block graph as a Mermaid flowchart, for Markdown pages that render one (README, pull requests, wikis)."""

from __future__ import annotations

from forcectl.graph.formats.paint import PALETTE
from forcectl.graph.layout.shapes import shape_of, subtitle
from forcectl.graph.model import Block, BlockGraph


def to_mermaid(graph: BlockGraph) -> str:
    """The graph at its depth as a Mermaid document."""
    opened = graph.unfolded()
    ids = {block.path: f"b{number}" for number, block in enumerate(graph.root.walk())}
    lines = ["flowchart LR", *_block(graph, graph.root, opened, ids, "  ")]
    for name, (fill, line) in PALETTE.items():
        members = [ids[b.path] for b in graph.nodes if b.category == name and b.path not in opened]
        if members:
            lines.append(f"  classDef {name} fill:{fill},stroke:{line},color:#1d2730")
            lines.append(f"  class {','.join(members)} {name}")
    return "\n".join(lines) + "\n"


def _block(graph: BlockGraph, block: Block, opened: frozenset[str], ids: dict[str, str], indent: str) -> list[str]:
    node = ids[block.path]
    if block.path not in opened:
        return [indent + _node(block, node)]
    inner = indent + "  "
    title = block.name + (f" ({subtitle(block)})" if subtitle(block) else "")
    lines = [f'{indent}subgraph {node}["{_text(title)}"]', f"{inner}direction LR"]
    for side, terminals in (("in", block.inputs), ("out", block.outputs)):
        lines += [f'{inner}{node}_{side}{number}(["{_text(port.name)}"])' for number, port in enumerate(terminals)]
    for child in block.blocks:
        lines += _block(graph, child, opened, ids, inner)
    lines.append(f"{indent}end")
    for edge in block.edges:
        source, from_port = _end(graph.by_path[edge.source.block], edge.source.port, "out", block, opened, ids)
        target, to_port = _end(graph.by_path[edge.target.block], edge.target.port, "in", block, opened, ids)
        ports = " → ".join(dict.fromkeys(name for name in (from_port, to_port) if name))
        words = [ports, edge.signal if graph.signals else ""]
        label = ": ".join(word for word in words if word)
        arrow = "-->" if edge.size else "-.->"
        lines.append(
            f'{indent}{source} {arrow}|"{_text(label)}"| {target}' if label else f"{indent}{source} {arrow} {target}"
        )
    return lines


def _end(
    block: Block, port: str, side: str, scope: Block, opened: frozenset[str], ids: dict[str, str]
) -> tuple[str, str]:
    """Node at which a wire ends, and the port to be named on the wire (terminals carry their own name)."""
    if block is scope:
        side = "in" if side == "out" else "out"
    ports = [p.name for p in (block.inputs if side == "in" else block.outputs)]
    if block.path in opened:
        return f"{ids[block.path]}_{side}{ports.index(port)}", ""
    return ids[block.path], port if shape_of(block).names_shown else ""


def _node(block: Block, node: str) -> str:
    shape = shape_of(block)
    symbol = "" if shape.symbol.startswith(":") else shape.symbol
    name = "" if symbol and block.automatic_name else block.name
    text = "<br/>".join(_text(row) for row in (symbol, name, subtitle(block), block.period_text) if row)
    if shape.form == "circle":
        return f'{node}(("{text}"))'
    if block.kind == "diagram":
        return f'{node}[["{text}"]]'
    return f'{node}["{text}"]'


def _text(text: str) -> str:
    """Text inside quotes: Mermaid knows entities written with `#`; Markdown marks would be interpreted."""
    special = '#"&<>`*_\\|{}[]()~'
    return "".join(f"#{ord(c)};" if c in special and c != "_" else c for c in text.replace("\n", " "))
