"""Block diagrams of any Drake diagram that people want to look at::

    from forcectl.graph.export import graph, export
    graph(diagram)                              # shows itself in a notebook
    export(diagram, "loop.pdf", depth=2)        # dot, html, mermaid, pdf, png, svg

The picture reads from left to right: the forward path in one row, the wires that close loops below. Nested diagrams are
boxes that can be unfolded, ports have names, wires carry size and unit, sampled blocks their sample time.
"""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Any

from pydrake.systems.framework import Context, System

from forcectl.graph.extract import block_graph
from forcectl.graph.formats.html import to_html
from forcectl.graph.formats.mermaid import to_mermaid
from forcectl.graph.formats.render import FORMATS, format_of, render
from forcectl.graph.formats.svg import to_svg
from forcectl.graph.model import Block, BlockGraph, Edge, Endpoint, Parameter, Port

if TYPE_CHECKING:
    import pydot

__all__ = [
    "FORMATS",
    "Block",
    "BlockGraph",
    "Edge",
    "Endpoint",
    "Graph",
    "Parameter",
    "Port",
    "block_graph",
    "export",
    "graph",
    "render",
]


class Graph:
    """A block graph that shows itself in a notebook and can be saved.

    Attributes:
        model: the blocks and wires as plain values.
    """

    def __init__(self, model: BlockGraph) -> None:
        self.model = model

    def to_svg(self, *, legend: bool = False) -> str:
        """SVG document; with `legend` a line below explains the colours."""
        return to_svg(self.model, legend=legend)

    def to_html(self) -> str:
        """One interactive page without any network access."""
        return to_html(self.model)

    def to_pydot(self) -> pydot.Dot:
        """The graph as pydot objects, to be restyled: a `Cluster` per open diagram, a `Node` per block."""
        from forcectl.graph.formats.dot import to_pydot

        return to_pydot(self.model)

    def to_dot(self) -> str:
        """Graphviz source, the text of `to_pydot`."""
        return str(render(self.model, "dot"))

    def to_mermaid(self) -> str:
        """Mermaid flowchart."""
        return to_mermaid(self.model)

    def save(self, path: str | os.PathLike[str], format: str | None = None) -> None:
        """Write a file in `format`, by default the one its name ends in."""
        render(self.model, format or format_of(path), path)

    def _repr_svg_(self) -> str:
        return self.to_svg()

    def _repr_html_(self) -> str:
        return f'<div style="overflow-x:auto">{self.to_svg()}</div>'

    def _repr_mimebundle_(self, include: Any = None, exclude: Any = None) -> dict[str, str]:
        return {"image/svg+xml": self.to_svg(), "text/plain": repr(self)}

    def __repr__(self) -> str:
        nodes, edges = len(self.model.nodes), len(self.model.edges)
        return f"<block diagram {self.model.root.name!r}: {nodes} blocks, {edges} wires>"


def graph(
    diagram: System,
    *,
    depth: int | None = 1,
    hide_unused: bool = True,
    signals: bool = True,
    loggers: bool = False,
    context: Context | None = None,
) -> Graph:
    """The block diagram of a Drake diagram, ready to be shown; the arguments are those of `block_graph`."""
    return Graph(
        block_graph(diagram, depth=depth, hide_unused=hide_unused, signals=signals, loggers=loggers, context=context)
    )


def export(
    diagram: System,
    path: str | os.PathLike[str] | None = None,
    format: str | None = None,
    depth: int | None = 1,
    *,
    hide_unused: bool = True,
    signals: bool = True,
    loggers: bool = False,
    context: Context | None = None,
) -> str | bytes:
    """Draw a diagram, write it to `path` when given, and return it.

    Args:
        diagram: any Drake diagram or system.
        path: file to write; replaced if it exists.
        format: one of `FORMATS`; by default what `path` ends in, else svg.
        depth, hide_unused, signals, loggers, context: as for `block_graph`.

    Raises:
        BadInputError: an unknown format, or an argument that `block_graph` refuses.
    """
    chosen = format or (format_of(path) if path is not None else "svg")
    model = block_graph(
        diagram, depth=depth, hide_unused=hide_unused, signals=signals, loggers=loggers, context=context
    )
    return render(model, chosen, path)
