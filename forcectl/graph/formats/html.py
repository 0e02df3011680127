"""A block graph as one interactive page that needs no network: fold and unfold, search, tooltips, zoom, dark mode.

The layout of every fold state is computed here and stored in the page; the script only moves blocks between states.
If there are too many states, the page has every depth, every diagram opened alone, and diagrams folded alone.
"""

from __future__ import annotations

import itertools
import json
import math
from collections.abc import Iterator
from typing import Any

from jinja2 import Environment, PackageLoader, select_autoescape

from forcectl.graph.formats.paint import PALETTE
from forcectl.graph.formats.picture import Layouter
from forcectl.graph.formats.svg import draw, elements, net_key, style
from forcectl.graph.layout.marks import groups
from forcectl.graph.layout.placed import Picture, PlacedBox
from forcectl.graph.model import CATEGORY_TEXT, Block, BlockGraph

_WORK = 4000  # limit of fold states times blocks
_MOST_STATES = 128


def to_html(graph: BlockGraph) -> str:
    """A complete HTML document; it opens at the graph's depth."""
    layouter = Layouter(graph)
    start = layouter.picture()
    fragments: dict[str, int] = {}
    paths = {block.path: number for number, block in enumerate(graph.root.walk())}
    around = _around(graph)
    depths = [graph.unfolded(depth) for depth in range(graph.root.height + 1)]
    for opened in depths:  # careful layouts come first, as other states reuse parts of them
        layouter.picture(opened)
    states = [
        _state(graph, layouter.picture(opened, careful=opened in depths), opened, paths, fragments)
        for opened in fold_states(graph)
    ]
    data = {
        "title": graph.heading,
        "style": style(),
        "blocks": [_details(b, paths[around[b.path][0]] if around[b.path] else -1) for b in graph.root.walk()],
        "states": states,
        "signals": _signals(graph),
        "fragments": list(fragments),
        "start": _key(graph.unfolded(), paths),
        "depths": [_key(opened, paths) for opened in depths],
    }
    template = Environment(
        loader=PackageLoader("forcectl.graph.formats"), autoescape=select_autoescape(["html.j2"]), trim_blocks=True
    ).get_template("graph.html.j2")
    return template.render(
        title=graph.heading,
        style=style(),
        width=f"{start.width:.2f}",
        height=f"{start.height:.2f}",
        scene=draw(groups(graph, start)),
        kinds=[(name, CATEGORY_TEXT[name]) for name in PALETTE if any(b.category == name for b in graph.root.walk())],
        max_depth=graph.root.height,
        depth=graph.root.height if graph.depth is None else min(graph.depth, graph.root.height),
        # A closing tag in a name must not end the script element.
        data=json.dumps(data, ensure_ascii=False, separators=(",", ":")).replace("<", "\\u003c"),
    )


def fold_states(graph: BlockGraph) -> list[frozenset[str]]:
    """The sets of open diagrams that the page can show; in the first one all are folded."""
    count = sum(1 for _ in graph.root.walk())
    limit = min(_MOST_STATES, max(16, _WORK // count))
    if _number_of_states(graph.root) <= limit:
        return sorted(map(frozenset, _all_states(graph.root)), key=lambda s: (len(s), sorted(s)))
    found = {graph.unfolded(depth) for depth in range(graph.root.height + 1)} | {graph.unfolded()}
    around = _around(graph)
    for block in graph.root.walk():
        if block.kind == "diagram":
            found.add(frozenset([block.path, *around[block.path]]))
            if len(found) < limit:
                found.add(graph.unfolded(1 + len(around[block.path])) - {block.path})
    return sorted(found, key=lambda s: (len(s), sorted(s)))


def _around(graph: BlockGraph) -> dict[str, list[str]]:
    """Paths of the diagrams around each block, the innermost first."""
    around: dict[str, list[str]] = {graph.root.path: []}
    for block in graph.root.walk():
        around |= {child.path: [block.path, *around[block.path]] for child in block.blocks}
    return around


def _number_of_states(block: Block) -> int:
    if block.kind == "leaf":
        return 1
    return 1 + math.prod(map(_number_of_states, block.blocks))


def _all_states(block: Block) -> Iterator[set[str]]:
    yield set()
    if block.kind == "diagram":
        for choice in itertools.product(*(list(_all_states(c)) for c in block.blocks if c.kind == "diagram")):
            yield {block.path}.union(*choice)


def _key(opened: frozenset[str], paths: dict[str, int]) -> str:
    return ",".join(str(number) for number in sorted(paths[path] for path in opened))


def _state(
    graph: BlockGraph, picture: Picture, opened: frozenset[str], paths: dict[str, int], fragments: dict[str, int]
) -> dict[str, Any]:
    def stored(text: str) -> int:
        return fragments.setdefault(text, len(fragments))

    boxes, nets = [], []
    for placed, role, marks in groups(graph, picture):
        if isinstance(placed, PlacedBox):
            at = [round(placed.x, 1), round(placed.y, 1)]
            boxes.append([paths[placed.path], stored(role), stored(elements(marks)), *at])
        else:
            nets.append([stored(net_key(placed.inside, placed.source)), stored(role), stored(elements(marks))])
    size = [round(picture.width, 2), round(picture.height, 2)]
    return {"open": _key(opened, paths), "size": size, "boxes": boxes, "nets": nets}


def _details(block: Block, parent: int) -> dict[str, Any]:
    """Data of a block for the tooltip and the search."""
    continuous, discrete, abstract = block.states
    return {
        "path": block.path,
        "name": block.name,
        "type": block.type_name,
        "kind": CATEGORY_TEXT[block.category],
        "nested": block.kind == "diagram",
        "parent": parent,
        "about": list(block.about),
        "sample": f"{block.period_text} (of the {block.beside} only)" if block.beside else block.period_text,
        "states": [continuous, discrete, abstract],
        "parameters": [[p.name, p.text] for p in block.parameters],
        "inputs": [[port.name, port.signal, ""] for port in block.inputs],
        "outputs": [
            [port.name, port.signal, f"direct from {', '.join(port.feedthrough)}" if port.feedthrough else ""]
            for port in block.outputs
        ],
    }


def _signals(graph: BlockGraph) -> dict[str, list[str]]:
    """Name, size with unit, and origin of every net."""
    return {
        net_key(block.path, edge.source): [edge.source.port, edge.signal, graph.by_path[edge.source.block].name]
        for block in graph.root.walk()
        for edge in block.edges
    }
