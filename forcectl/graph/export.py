"""Block diagrams of any Drake diagram that people want to look at::

    from forcectl.graph.export import graph
    picture = graph(diagram, depth=2)     # shows itself in a notebook
    picture.save("loop.pdf")              # dot, html, mermaid, pdf, png, svg

The picture reads from left to right: the forward path in one row, the wires that close loops below. Nested diagrams are
boxes that can be unfolded, ports have names, wires carry size and unit, sampled blocks their sample time.
"""

from __future__ import annotations

import os
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

from pydrake.systems.framework import Context, System

from forcectl.errors import BadInputError, invalid, unknown
from forcectl.graph.extract import read_blocks
from forcectl.graph.model import BlockGraph

if TYPE_CHECKING:
    import pydot

FORMATS = ("dot", "html", "mermaid", "pdf", "png", "svg")
_SUFFIXES = {".gv": "dot", ".htm": "html", ".mmd": "mermaid"}


class Graph(BlockGraph):
    """A block graph that shows itself in a notebook and can be saved in every format; none needs another program."""

    def render(self, format: str) -> str | bytes:
        """The graph in one of `FORMATS`: text, or bytes for png and pdf.

        Raises:
            BadInputError: an unknown format.
        """
        if format not in FORMATS:
            raise unknown("format", format, FORMATS)
        # The room imports a format when it is asked for: Matplotlib alone takes half a second.
        content: str | bytes = getattr(import_module("forcectl.graph"), f"to_{format}")(self)
        return content

    def save(self, path: str | os.PathLike[str], format: str | None = None) -> None:
        """Write a file in `format`, by default the one its name ends in; a file that exists is replaced."""
        content = self.render(format or format_of(path))
        Path(path).write_bytes(content.encode() if isinstance(content, str) else content)

    def to_pydot(self) -> pydot.Dot:
        """The graph as pydot objects, to be restyled: a `Cluster` per open diagram, a `Node` per block."""
        from forcectl.graph.formats.dot import to_pydot

        return to_pydot(self)

    def _repr_svg_(self) -> str:
        return str(self.render("svg"))

    def _repr_html_(self) -> str:
        return f'<div style="overflow-x:auto">{self._repr_svg_()}</div>'

    def __repr__(self) -> str:
        return f"<block diagram {self.root.name!r}: {len(self.nodes)} blocks, {len(self.edges)} wires>"


def graph(
    diagram: System,
    *,
    depth: int | None = 1,
    hide_unused: bool = True,
    loggers: bool = False,
    context: Context | None = None,
) -> Graph:
    """The block diagram of a Drake diagram; it does not refer to the diagram any more.

    Args:
        diagram: any Drake diagram, or a single leaf system.
        depth: levels of nested diagrams that are unfolded: 0 shows one box, 1 its blocks, None everything.
        hide_unused: leave out ports that nothing is connected to.
        loggers: show blocks that only record a signal.
        context: of the diagram, for the values of parameters; the default context when None.

    Raises:
        BadInputError: when `diagram` is no Drake system or `depth` is negative.
    """
    if not isinstance(diagram, System):
        raise BadInputError(f"diagram = {diagram!r}: must be a Drake diagram or system that is built")
    if depth is not None and (isinstance(depth, bool) or not isinstance(depth, int) or depth < 0):
        raise invalid("depth", depth, "a whole number >= 0, or None for all levels")
    blocks = read_blocks(diagram, context or diagram.CreateDefaultContext(), hide_unused, loggers)
    return Graph(blocks, depth)


def format_of(path: str | os.PathLike[str]) -> str:
    """The format that a file name asks for.

    Raises:
        BadInputError: when its ending is none of a known format.
    """
    suffix = Path(path).suffix.lower()
    name = _SUFFIXES.get(suffix, suffix[1:])
    if name not in FORMATS:
        raise unknown("format", name, FORMATS)
    return name
