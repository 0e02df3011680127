"""Pictures laid out by elkjs."""

import itertools
import json
import shutil
import subprocess
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import pytest

from forcectl.graph.layout.order import ranks
from forcectl.graph.layout.placed import Picture, PlacedBox
from forcectl.graph.layout.rows import Point
from forcectl.graph.layout.sorting.measure import Wires
from forcectl.graph.model import BlockGraph, Endpoint

_SCRIPT = Path(__file__).parents[1] / "graph" / "layout" / "elk.mjs"
_LAYERED = {"elk.algorithm": "layered", "elk.edgeRouting": "ORTHOGONAL", "elk.json.edgeCoords": "ROOT"}
_IN_ROWS = {"elk.layered.wrapping.strategy": "MULTI_EDGE", "elk.aspectRatio": "2.3"}


def laid_out(graphs: Sequence[Mapping[str, Any]]) -> list[list[Wires]]:
    """The wires of each net of each graph, as elkjs leads them; skips the test where there is no elkjs."""
    node = shutil.which("node")
    if node is None:
        pytest.skip("no Node on this machine to run elkjs")
    done = subprocess.run([node, _SCRIPT], input=json.dumps(graphs), capture_output=True, text=True, timeout=300)
    if "Cannot find module 'elkjs'" in done.stderr:
        pytest.skip("Node finds no elkjs along NODE_PATH or in node_modules beside the project")
    assert done.returncode == 0, done.stderr
    return [_nets(graph) for graph in json.loads(done.stdout)]


def as_elk(graph: BlockGraph, picture: Picture) -> dict[str, Any]:
    """The task of a picture for elkjs: sizes of blocks, ports with sides, wires, forward path, and rows if it has any.

    Ports of blocks are where they are in the picture; those of open diagrams stay at their side, in any order.
    """
    boxes = {box.path: box for box in picture.boxes}
    around = {child.path: block.path for block in graph.root.walk() for child in block.blocks}

    def node(box: PlacedBox) -> dict[str, Any]:
        ports = [
            {
                "id": _port_id(side, box.path, name),
                "x": x - box.x,
                "y": y - box.y,
                "layoutOptions": {"elk.port.side": side},
            }
            for side, placed in (("WEST", box.inputs), ("EAST", box.outputs))
            for name, (x, y) in placed
        ]
        if box.shape is not None:
            fixed = {"elk.portConstraints": "FIXED_POS"}
            return {"id": box.path, "width": box.width, "height": box.height, "ports": ports, "layoutOptions": fixed}
        nets = [net for net in picture.nets if net.inside == box.path]
        inner = [inside for path, inside in boxes.items() if around.get(path) == box.path]
        column = ranks(graph.by_path[box.path])
        options = {"elk.portConstraints": "FIXED_SIDE", "elk.layered.cycleBreaking.strategy": "MODEL_ORDER"}
        return {
            "id": f"open {box.path}",
            "ports": ports,
            "children": [node(inside) for inside in sorted(inner, key=lambda inside: column[inside.path])],
            "edges": [
                {
                    "id": f"{number} {place} {box.path}",
                    "sources": [_end_id(box.path, net.source, "EAST", "WEST")],
                    "targets": [_end_id(box.path, target, "WEST", "EAST")],
                }
                for number, net in enumerate(nets)
                for place, target in enumerate(net.targets)
            ],
            "layoutOptions": options | (_IN_ROWS if _has_rows(inner, column) else {}),
        }

    return {"id": "page", "children": [node(picture.boxes[0])], "layoutOptions": _LAYERED}


def _has_rows(inner: Iterable[PlacedBox], column: Mapping[str, int]) -> bool:
    """Whether a block stands left of one in an earlier column."""
    return any(
        column[a.path] < column[b.path] and b.x + b.width < a.x for a, b in itertools.permutations(list(inner), 2)
    )


def _port_id(side: str, block: str, port: str) -> str:
    return f"{side} {port} {block}"


def _end_id(inside: str, end: Endpoint, of_block: str, of_diagram: str) -> str:
    return _port_id(of_diagram if end.block == inside else of_block, end.block, end.port)


def _nets(graph: Mapping[str, Any]) -> list[Wires]:
    found: dict[tuple[str, str], list[list[Point]]] = defaultdict(list)
    waiting = [graph]
    while waiting:
        node = waiting.pop()
        waiting += node.get("children", ())
        for edge in node.get("edges", ()):
            number, _, inside = edge["id"].split(" ", 2)
            (way,) = edge["sections"]
            points = [way["startPoint"], *way.get("bendPoints", ()), way["endPoint"]]
            found[number, inside].append([(point["x"], point["y"]) for point in points])
    return list(found.values())
