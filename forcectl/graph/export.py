"""Block diagrams of any Drake diagram, as readable pictures::

    from forcectl.graph.export import graph
    picture = graph(diagram, depth=2)     # is displayed in a notebook
    picture.save("loop.pdf")              # dot, html, mermaid, pdf, png, svg

The picture reads from left to right: the forward path in one row, the wires that close loops mostly below it. Nested
diagrams are boxes that can be unfolded. Ports have names, wires are labelled with size and unit, and sampled blocks
with their sample time. A state machine (`MachineChart`) is drawn alike, with modes as boxes and guards at the arrows.
"""

from __future__ import annotations

import os
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, overload

from pydrake.systems.framework import Context, System

from forcectl.errors import BadInputError, invalid, unknown
from forcectl.graph.extract import read_blocks
from forcectl.graph.model import BlockGraph
from forcectl.inspect.names import type_in_words
from forcectl.tasks.machine.chart import MachineChart

if TYPE_CHECKING:
    import pydot

FORMATS = ("dot", "html", "mermaid", "pdf", "png", "svg")
_SUFFIXES = {".gv": "dot", ".htm": "html", ".mmd": "mermaid"}


class _Drawing:
    """Base of pictures, which are displayed in a notebook and can be saved in every format without other programs."""

    _formats = "forcectl.graph"  # module with the functions of the formats

    @property
    def _content(self) -> Any:
        """Argument of these functions."""
        return self

    def render(self, format: str) -> str | bytes:
        """The picture in one of `FORMATS`: text, or bytes for png and pdf.

        Raises:
            BadInputError: an unknown format.
        """
        if format not in FORMATS:
            raise unknown("format", format, FORMATS)
        # A format is imported when it is needed: Matplotlib alone takes half a second.
        return getattr(import_module(self._formats), f"to_{format}")(self._content)

    def save(self, path: str | os.PathLike[str], format: str | None = None) -> None:
        """Write a file in `format`, by default that of its suffix; an existing file is replaced.

        Raises:
            BadInputError: `path` is no path, or the format is unknown.
        """
        if not isinstance(path, str | os.PathLike):
            raise invalid("path", path, "the path of a file")
        content = self.render(format or format_of(path))
        Path(path).write_bytes(content.encode() if isinstance(content, str) else content)

    def _repr_svg_(self) -> str:
        return str(self.render("svg"))

    def _repr_html_(self) -> str:
        return f'<div style="overflow-x:auto">{self._repr_svg_()}</div>'


class Graph(_Drawing, BlockGraph):
    """The picture of a diagram."""

    def to_pydot(self) -> pydot.Dot:
        """The graph as pydot objects that can be restyled: a `Cluster` per open diagram, a `Node` per block."""
        from forcectl.graph.formats.dot import to_pydot

        return to_pydot(self)

    def __repr__(self) -> str:
        return f"<block diagram {self.root.name!r}: {len(self.nodes)} blocks, {len(self.edges)} wires>"


class MachineGraph(_Drawing):
    """The picture of a state machine.

    Attributes:
        chart: its modes and arrows.
    """

    _formats = "forcectl.graph.formats.state_chart"

    def __init__(self, chart: MachineChart):
        self.chart = chart

    @property
    def _content(self) -> MachineChart:
        return self.chart

    def to_pydot(self) -> pydot.Dot:
        """The machine as pydot objects that can be restyled: a `Node` per mode, an `Edge` per arrow."""
        from forcectl.graph.formats.state_chart import to_pydot

        return to_pydot(self.chart)

    def __repr__(self) -> str:
        return f"<state machine {self.chart.name!r}: {len(self.chart.modes)} modes, {len(self.chart.arrows)} arrows>"


@overload
def graph(diagram: MachineChart, *, depth: int | None = 1) -> MachineGraph: ...
@overload
def graph(
    diagram: System,
    *,
    depth: int | None = 1,
    hide_unused: bool = True,
    loggers: bool = False,
    context: Context | None = None,
    title: str = "",
) -> Graph: ...
def graph(
    diagram: System | MachineChart,
    *,
    depth: int | None = 1,
    hide_unused: bool = True,
    loggers: bool = False,
    context: Context | None = None,
    title: str = "",
) -> Graph | MachineGraph:
    """The block diagram of a Drake diagram, without references to it; or the picture of a state machine.

    Args:
        diagram: any Drake diagram, or a single leaf system; or a state machine, to which the other arguments do not
            apply.
        depth: levels of nested diagrams that are unfolded: 0 shows one box, 1 its blocks, None everything.
        hide_unused: leave out ports that nothing is connected to.
        loggers: show blocks that only log a signal.
        context: context of the diagram, for the values of parameters; None: the default context.
        title: heading of the page; empty: the name of the diagram.

    Raises:
        BadInputError: when `diagram` is no Drake system or `depth` is negative.
    """
    if isinstance(diagram, MachineChart):
        return MachineGraph(diagram)
    if not isinstance(diagram, System):
        raise BadInputError(f"graph() takes a Drake system, not {type_in_words(diagram)}")
    if depth is not None and (isinstance(depth, bool) or not isinstance(depth, int) or depth < 0):
        raise invalid("depth", depth, "a whole number >= 0, or None for all levels")
    blocks = read_blocks(diagram, context or diagram.CreateDefaultContext(), hide_unused, loggers)
    return Graph(blocks, depth, title)


def format_of(path: str | os.PathLike[str]) -> str:
    """The format for the suffix of a file name.

    Raises:
        BadInputError: no format has this suffix.
    """
    suffix = Path(path).suffix.lower()
    name = _SUFFIXES.get(suffix, suffix[1:])
    if name not in FORMATS:
        raise unknown("format", name, FORMATS)
    return name
