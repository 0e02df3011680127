"""Choice of the feedback wires of a diagram, and of the column of each block.

A block diagram is read along its forward path. The wires that run backwards are chosen to be few, and to be those that
an engineer would call feedback: measurements and estimates rather than references and commands.
"""

from __future__ import annotations

import itertools
import re
from collections import defaultdict
from collections.abc import Container, Iterable, Sequence

from forcectl.graph.model import Block, Edge

_FEEDBACK_WORDS = re.compile(
    r"measur|estimat|feedback|actual|state|sens|query|velocity|position|spring|load|reaction|contact"
)
_FORWARD_WORDS = re.compile(r"desired|refer|setpoint|target|command|nominal|actuation|goal|motor_torque")
_SENSOR_WORDS = re.compile(r"sensor|filter|observer|estimat|measure|feedback|minus|delay")

_Arc = tuple[str, str]


def feedback_edges(block: Block) -> frozenset[Edge]:
    """The wires inside a diagram that run against its forward path (from a block to an earlier one or to itself)."""
    place = {path: number for number, path in enumerate(_forward_order(block))}
    return frozenset(edge for edge in _inner(block) if place[edge.source.block] >= place[edge.target.block])


def ranks(block: Block) -> dict[str, int]:
    """Column of each block inside a diagram, from 1 on; every forward wire leads at least one column to the right."""
    return columns_of(_forward_order(block), ((edge.source.block, edge.target.block) for edge in _inner(block)))


def columns_of(order: Sequence[str], arcs: Iterable[_Arc]) -> dict[str, int]:
    """Column of each block, from 1 on, from the forward order of the blocks and their connections."""
    place = {path: number for number, path in enumerate(order)}
    after: dict[str, set[str]] = defaultdict(set)
    before: dict[str, set[str]] = defaultdict(set)
    for source, target in arcs:
        if place[source] < place[target]:
            after[source].add(target)
            before[target].add(source)
    rank: dict[str, int] = {}
    for path in order:
        rank[path] = 1 + max((rank[earlier] for earlier in before[path]), default=0)
    for path in reversed(order):  # for short wires, a block moves to the right if it has more neighbours there
        if len(after[path]) > len(before[path]):
            rank[path] = min(rank[later] for later in after[path]) - 1
    return rank


def _inner(block: Block) -> list[Edge]:
    """The wires from block to block."""
    return [edge for edge in block.edges if block.path not in (edge.source.block, edge.target.block)]


def _forward_order(block: Block) -> list[str]:
    """The blocks in an order in which the backward connections have a small total weight."""
    weights = _weights(block)
    paths = [child.path for child in block.blocks]
    order: list[str] = []
    for component in _components(paths, weights):
        order += _best_order(component, weights) if len(component) > 1 else component
    return order


def _weights(block: Block) -> dict[_Arc, float]:
    """Cost of drawing each connection backwards."""
    inside = {child.path: child for child in block.blocks}
    entered_from_outside = {edge.target.block for edge in block.edges if edge.source.block == block.path}
    has_input = {edge.target.block for edge in block.edges}
    entered_from_outside |= {e.target.block for e in block.edges if e.source.block not in has_input}
    leaves = {edge.source.block for edge in block.edges if edge.target.block == block.path}
    weights: dict[_Arc, float] = defaultdict(float)
    for edge in _inner(block):
        source, target = edge.source.block, edge.target.block
        if source == target:
            continue
        cost = 4.0
        port = edge.target.port.lower()
        if _FORWARD_WORDS.search(port):
            cost += 4.0
        elif _FEEDBACK_WORDS.search(port):
            cost -= 2.5
        if _SENSOR_WORDS.search(inside[source].name.lower()):
            cost -= 0.5
        if target in entered_from_outside:
            cost -= 0.5
        if source in leaves:
            cost -= 0.25
        if not edge.size:
            cost -= 0.5
        weights[source, target] += max(cost, 0.1)
    return dict(weights)


def _components(paths: list[str], weights: dict[_Arc, float]) -> list[list[str]]:
    """Strongly connected groups in forward order (Kosaraju's two searches)."""
    order = forwards(paths[::-1], paths, weights)
    backwards = {(target, source) for source, target in weights}
    return [sorted(tree, key=paths.index) for tree in _depth_first(order, paths, backwards)]


def _best_order(group: list[str], weights: dict[_Arc, float]) -> list[str]:
    """The order of least cost: from searches that start at each block, improved by moving single blocks."""
    member = set(group)
    arcs = {arc: weight for arc, weight in weights.items() if member.issuperset(arc)}
    starts = group if len(group) <= 12 else group[:1]
    candidates = [_improved(forwards([start, *group], group, arcs), arcs) for start in starts]
    return min(candidates, key=lambda order: round(_cost(order, arcs), 6))


def forwards(roots: Iterable[str], paths: list[str], arcs: Container[_Arc]) -> list[str]:
    """The blocks in an order in which only arcs that close a cycle run backwards."""
    return [path for tree in _depth_first(roots, paths, arcs) for path in tree][::-1]


def _depth_first(roots: Iterable[str], paths: list[str], arcs: Container[_Arc]) -> list[list[str]]:
    """For each root the blocks that are reached from it first, in postorder."""
    trees: list[list[str]] = []
    seen: set[str] = set()
    for root in roots:
        tree: list[str] = []
        stack = [(root, False)]
        while stack:  # iterative, as a chain of blocks may be long
            path, done = stack.pop()
            if done:
                tree.append(path)
            elif path not in seen:
                seen.add(path)
                stack.append((path, True))
                stack += [(other, False) for other in paths if (path, other) in arcs and other not in seen]
        if tree:
            trees.append(tree)
    return trees


def _cost(order: list[str], arcs: dict[_Arc, float]) -> float:
    place = {path: number for number, path in enumerate(order)}
    return sum(weight for (source, target), weight in arcs.items() if place[source] > place[target])


def _improved(order: list[str], arcs: dict[_Arc, float]) -> list[str]:
    """Move one block at a time to its place of least cost, until nothing improves."""
    touching: dict[str, list[tuple[str, float]]] = defaultdict(list)  # cost of passing a neighbour to the right
    for (source, target), weight in arcs.items():
        touching[source].append((target, weight))
        touching[target].append((source, -weight))
    for _ in range(len(order)):
        before = order
        for path in before:
            rest = [other for other in order if other != path]
            place = {other: number for number, other in enumerate(rest)}
            steps = [0.0] * len(order)
            for other, change in touching[path]:
                steps[place[other] + 1] += change
            costs = [round(cost, 9) for cost in itertools.accumulate(steps)]  # relative to the first place
            best = costs.index(min(costs))
            if costs[order.index(path)] > costs[best]:
                order = [*rest[:best], path, *rest[best:]]
        if order == before:
            break
    return order
