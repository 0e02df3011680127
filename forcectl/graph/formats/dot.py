"""A block graph as Graphviz DOT, for people who lay it out or draw it with their own tools.

Blocks are records with their ports inside, unfolded diagrams are clusters with their terminals at the border. Wires
that close a loop do not move their target behind their source (`constraint=false`), so the forward path reads left to
right.
"""

from __future__ import annotations

from forcectl.graph.formats.paint import PALETTE
from forcectl.graph.layout.order import feedback_edges
from forcectl.graph.layout.shapes import shape_of, subtitle
from forcectl.graph.model import Block, BlockGraph, Port


def to_dot(graph: BlockGraph) -> str:
    """The graph at its depth as a DOT document."""
    opened = graph.unfolded()
    ids = {block.path: f"b{number}" for number, block in enumerate(graph.root.walk())}
    lines = [
        f"digraph {_quoted(graph.root.name)} {{",
        '  graph [rankdir=LR, nodesep=0.35, ranksep=0.8, fontname="Helvetica", fontsize=12, compound=true];',
        '  node [shape=record, style="filled", fontname="Helvetica", fontsize=11, penwidth=1.2];',
        '  edge [fontname="Helvetica", fontsize=9, color="#2f3c48", fontcolor="#5b6873", arrowsize=0.7];',
        *_block(graph, graph.root, opened, ids, "  "),
        "}",
    ]
    return "\n".join(lines) + "\n"


def _block(graph: BlockGraph, block: Block, opened: frozenset[str], ids: dict[str, str], indent: str) -> list[str]:
    if block.path not in opened:
        return [indent + _node(block, ids[block.path])]
    inner = indent + "  "
    title = block.name + (f"  ({subtitle(block)})" if subtitle(block) else "")
    lines = [
        f"{indent}subgraph cluster_{ids[block.path]} {{",
        f'{inner}label={_quoted(title)}; labeljust=l; style="rounded"; color="#8b97a3"; bgcolor="#f7f8f9";',
    ]
    for side, ports, rank in (("in", block.inputs, "source"), ("out", block.outputs, "sink")):
        for number, port in enumerate(ports):
            name = f"{ids[block.path]}_{side}{number}"
            lines.append(
                f"{inner}{name} [shape=cds, fillcolor=white, height=0.2, fontsize=10, label={_quoted(port.name)}];"
            )
        if ports and block is graph.root:
            names = "; ".join(f"{ids[block.path]}_{side}{number}" for number in range(len(ports)))
            lines.append(f"{inner}{{ rank={rank}; {names}; }}")
    for child in block.blocks:
        lines += _block(graph, child, opened, ids, inner)
    returning = feedback_edges(block)
    for edge in block.edges:
        source = _end(graph.by_path[edge.source.block], edge.source.port, "out", block, opened, ids)
        target = _end(graph.by_path[edge.target.block], edge.target.port, "in", block, opened, ids)
        options = [f"label={_quoted(edge.signal)}"] if graph.signals else []
        options += ["constraint=false"] if edge in returning else []
        options += ["style=dashed"] if not edge.size else []
        lines.append(f"{inner}{source} -> {target}" + (f" [{', '.join(options)}];" if options else ";"))
    return [*lines, f"{indent}}}"]


def _end(block: Block, port: str, side: str, scope: Block, opened: frozenset[str], ids: dict[str, str]) -> str:
    """A node, or a port of a record with the compass point at which wires meet it."""
    of_scope = block is scope
    if of_scope:  # the diagram's own terminals: its inputs are sources inside
        side = "in" if side == "out" else "out"
    ports = [p.name for p in (block.inputs if side == "in" else block.outputs)]
    name = f"{side}{ports.index(port)}"
    if block.path in opened:
        return f"{ids[block.path]}_{name}"
    return f"{ids[block.path]}:{name}:{'w' if side == 'in' else 'e'}"


def _node(block: Block, node: str) -> str:
    fill, line = PALETTE[block.category]
    symbol = shape_of(block).symbol
    rows = [block.name, "" if symbol.startswith(":") else symbol, subtitle(block), block.period_text]
    text = "\\n".join(_record(row) for row in rows if row)
    left = "|".join(f"<in{i}> {_port_text(port)}" for i, port in enumerate(block.inputs))
    right = "|".join(f"<out{i}> {_port_text(port)}" for i, port in enumerate(block.outputs))
    # Each pair of braces turns the direction: the outer one makes inputs, name and outputs stand side by side.
    fields = (f"{{{left}}}" if left else "", text, f"{{{right}}}" if right else "")
    label = "{" + "|".join(field for field in fields if field) + "}"
    # Record fields are written into quotes as they are: their own escapes must reach Graphviz.
    quoted = label.replace('"', '\\"')
    outline = ", peripheries=2" if block.kind == "diagram" else ""
    return f'{node} [label="{quoted}", fillcolor="{fill}", color="{line}"{outline}];'


def _port_text(port: Port) -> str:
    return _record(port.name)


def _record(text: str) -> str:
    escaped = "".join(f"\\{c}" if c in "\\{}|<> " else c for c in text)
    return escaped.replace("&", "&amp;").replace("\n", "\\n")


def _quoted(text: str) -> str:
    escaped = text.replace("\\", "\\\\").replace('"', '\\"').replace("\n", "\\n").replace("&", "&amp;")
    return f'"{escaped}"'
