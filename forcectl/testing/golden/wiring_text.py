"""The wiring of a diagram as text: one line for each block and each wire, in an order that depends on names only."""

from __future__ import annotations

from pydrake.systems.framework import System

from forcectl.graph.export import graph
from forcectl.graph.model import Block, Endpoint


def wiring_text(diagram: System, depth: int | None = None) -> str:
    """Blocks with their types, sample times and ports, and the wires between them.

    Args:
        diagram: any diagram or block.
        depth: levels of nested diagrams that are written down, None for all.
    """
    picture = graph(diagram, depth=depth, hide_unused=False)
    lines = []
    for block in sorted(picture.nodes, key=lambda each: each.path):
        lines += _block(block)
    for path in sorted(picture.unfolded()):
        of = picture.by_path[path]
        wires = [f"{_end(path, edge.source)} -> {_end(path, edge.target)}" for edge in of.edges]
        lines += [f"wire {wire}" for wire in sorted(wires)]
    return "\n".join(lines) + "\n"


def _block(block: Block) -> list[str]:
    """A line for a block, and one for each of its ports."""
    samples = f" every {block.period_text}" if block.period_text else ""
    # The name of the whole diagram is left out: by default Drake makes it from a memory address.
    lines = [f"block {block.path or '(diagram)'}: {block.type_name}{samples}"]
    for side, ports in (("in", block.inputs), ("out", block.outputs)):
        lines += [f"  {side} {port.name}: {port.signal}" for port in ports]
    return lines


def _end(path: str, end: Endpoint) -> str:
    return f"{'(diagram)' if end.block == path == '' else end.block}.{end.port}"
