"""The content of a picture of a Drake diagram, as plain immutable values.

Nothing here keeps a reference to a Drake object: a graph can be stored, compared and drawn after its diagram is gone.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

from forcectl.inspect.events import PeriodicEvent

Kind = Literal["leaf", "diagram"]
Category = Literal["continuous", "discrete", "hybrid", "stateless", "multibody", "nested"]

CATEGORY_TEXT: dict[Category, str] = {
    "continuous": "continuous states",
    "discrete": "sampled",
    "hybrid": "continuous and sampled",
    "stateless": "no state",
    "multibody": "multibody and geometry",
    "nested": "nested diagram",
}


@dataclass(frozen=True)
class Port:
    """One input or output of a block.

    Attributes:
        name: as declared in Drake.
        size: number of elements; 0 for an abstract port.
        unit: SI unit of `forcectl.conventions`, or "".
        abstract: type of the value of an abstract port, "" for a vector.
        connected: whether a wire of the picture ends at it.
        feedthrough: inputs with direct feedthrough to this output (outputs of leaf systems only).
        logged: whether it is connected only to a logger that the picture leaves out.
    """

    name: str
    size: int
    unit: str = ""
    abstract: str = ""
    connected: bool = True
    feedthrough: tuple[str, ...] = ()
    logged: bool = False

    @property
    def label(self) -> str:
        """Name as written in the picture, with "→ log" for a port that is only logged."""
        return f"{self.name} → log" if self.logged else self.name

    @property
    def signal(self) -> str:
        """Size and unit as written on an edge, such as `6 · rad`."""
        if self.abstract:
            return self.abstract
        return f"{self.size} · {self.unit}" if self.unit else str(self.size)


@dataclass(frozen=True)
class Parameter:
    """A numeric parameter.

    Attributes:
        name: name of the parameter.
        values: its elements.
        unit: unit of each element; "" for none or an unknown one.
    """

    name: str
    values: tuple[float, ...]
    unit: str = ""

    @property
    def text(self) -> str:
        """Values and unit for a tooltip, such as `1.5 1/s`."""
        return f"{format_values(self.values)} {self.unit}".rstrip()


@dataclass(frozen=True, order=True)
class Endpoint:
    """One end of a wire: a port of the block at `block`, or a terminal of the diagram that holds the wire."""

    block: str
    port: str


@dataclass(frozen=True)
class Edge:
    """A wire inside one diagram, labelled with the signal of its source."""

    source: Endpoint
    target: Endpoint
    signal: str
    size: int


@dataclass(frozen=True)
class Block:
    """A leaf system, or a diagram with its own blocks and wires.

    Attributes:
        path: path as in `forcectl.inspect`, such as `station/plant`; unique in the graph. "" is the whole diagram.
        samples: periodic events, shortest period first.
        every_step: whether it has an event at every step of the simulator.
        states: numbers of continuous, discrete and abstract states.
        parameters: numeric parameters with their values.
        beside: what its periodic events refresh in a block whose outputs have feedthrough, such as "posture"; else "".
        about: first sentence of the documentation and its equation, for blocks written in Python.
        blocks, edges: contents of a diagram; an edge at a port of the diagram itself names the diagram.
    """

    path: str
    name: str
    type_name: str
    kind: Kind
    category: Category
    inputs: tuple[Port, ...]
    outputs: tuple[Port, ...]
    samples: tuple[PeriodicEvent, ...] = ()
    every_step: bool = False
    states: tuple[int, int, int] = (0, 0, 0)
    parameters: tuple[Parameter, ...] = ()
    about: tuple[str, ...] = ()
    beside: str = ""
    blocks: tuple[Block, ...] = ()
    edges: tuple[Edge, ...] = ()

    def walk(self, levels: int | None = None) -> Iterator[Block]:
        """This block and those inside it, parents first, down to a number of levels (None: all)."""
        yield self
        if levels != 0:
            for block in self.blocks:
                yield from block.walk(None if levels is None else levels - 1)

    @property
    def height(self) -> int:
        """Levels of diagrams inside: 0 for a leaf."""
        return 1 + max((block.height for block in self.blocks), default=0) if self.kind == "diagram" else 0

    @property
    def mark(self) -> str:
        """Sample times as written on the block; "" where the outputs do not depend on them (see `beside`)."""
        return "" if self.beside else self.period_text

    @property
    def period_text(self) -> str:
        """All its sample times, such as `2 ms`."""
        periods = sorted({sample.period for sample in self.samples})
        return ", ".join([format_time(period) for period in periods] + (["every step"] if self.every_step else []))


@dataclass(frozen=True)
class BlockGraph:
    """A diagram ready to be drawn.

    Attributes:
        root: the top-level diagram (or a single leaf).
        depth: number of levels that are unfolded; None: all.
        title: heading of the page, such as the name of the scenario; empty: the name of the diagram.
    """

    root: Block
    depth: int | None = 1
    title: str = ""

    @property
    def heading(self) -> str:
        """Heading of a page with the picture."""
        return self.title or self.root.name

    @cached_property
    def by_path(self) -> dict[str, Block]:
        """Every block of the graph, folded away or not."""
        return {block.path: block for block in self.root.walk()}

    def unfolded(self, depth: int | None = None) -> frozenset[str]:
        """Paths of the diagrams drawn open at `depth` (default: the depth of the graph)."""
        levels = self.depth if depth is None else depth
        if levels == 0:
            return frozenset()
        reached = self.root.walk(None if levels is None else levels - 1)
        return frozenset(block.path for block in reached if block.kind == "diagram")

    @property
    def nodes(self) -> tuple[Block, ...]:
        """The blocks that are visible at the graph's depth, open diagrams included, parents first."""
        return tuple(self.root.walk(self.depth))

    @property
    def edges(self) -> tuple[Edge, ...]:
        """The wires that are visible at the graph's depth."""
        shown = self.unfolded()
        return tuple(edge for block in self.nodes if block.path in shown for edge in block.edges)

    def port_number(self, end: Endpoint, side: str, inside: str) -> tuple[str, int]:
        """Side and number of the port at one end of a wire; an input of the diagram `inside` is a source inside of it.

        Args:
            end: end of the wire.
            side: "out" for its source, "in" for its target.
            inside: path of the diagram that holds the wire.
        """
        if end.block == inside:
            side = "in" if side == "out" else "out"
        block = self.by_path[end.block]
        return side, [port.name for port in (block.inputs if side == "in" else block.outputs)].index(end.port)


def format_time(seconds: float) -> str:
    """A sample time with a suitable prefix: `2 ms`, `250 µs`, `1.5 s`."""
    for scale, unit in ((1.0, "s"), (1e-3, "ms"), (1e-6, "µs")):
        if seconds >= scale * 0.9999999:
            return f"{seconds / scale:.3g} {unit}"
    return f"{seconds:.3g} s"


def format_values(values: tuple[float, ...], most: int = 8) -> str:
    """Numbers for a tooltip: one alone as it is, several in brackets, long lists cut off."""
    texts = [f"{value:.6g}" for value in values[:most]]
    if len(values) == 1:
        return texts[0]
    return "[" + ", ".join(texts) + (f", … {len(values)} values" if len(values) > most else "") + "]"
