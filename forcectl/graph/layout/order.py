"""Which wires close the loops of a diagram, and how far to the right each block belongs.

A block diagram is read along its forward path. The wires that run against it are chosen so that they are few, and are
wires one would call feedback: measurements and estimates rather than references and commands.
"""

from __future__ import annotations

import re
from collections import defaultdict

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
    return frozenset(
        edge
        for edge in block.edges
        if block.path not in (edge.source.block, edge.target.block)
        and place[edge.source.block] >= place[edge.target.block]
    )


def ranks(block: Block, feedback: frozenset[Edge]) -> dict[str, int]:
    """Column of each block inside a diagram, from 1 on; every forward wire leads at least one column to the right."""
    order = _forward_order(block)
    after: dict[str, set[str]] = defaultdict(set)
    before: dict[str, set[str]] = defaultdict(set)
    for edge in block.edges:
        source, target = edge.source.block, edge.target.block
        if edge not in feedback and block.path not in (source, target):
            after[source].add(target)
            before[target].add(source)
    rank: dict[str, int] = {}
    for path in order:
        rank[path] = 1 + max((rank[earlier] for earlier in before[path]), default=0)
    for path in reversed(order):  # short wires: what has more to the right than to the left moves to the right
        if after[path] and len(after[path]) > len(before[path]):
            rank[path] = min(rank[later] for later in after[path]) - 1
    return rank


def _forward_order(block: Block) -> list[str]:
    """The blocks so that as little weight as possible runs backwards."""
    weights = _weights(block)
    paths = [child.path for child in block.blocks]
    order: list[str] = []
    for component in _components(paths, weights):
        order += _best_order(component, weights) if len(component) > 1 else component
    return order


def _weights(block: Block) -> dict[_Arc, float]:
    """What it costs to draw each connection backwards."""
    inside = {child.path: child for child in block.blocks}
    entered_from_outside = {edge.target.block for edge in block.edges if edge.source.block == block.path}
    has_input = {edge.target.block for edge in block.edges}
    entered_from_outside |= {e.target.block for e in block.edges if e.source.block not in has_input}
    leaves = {edge.source.block for edge in block.edges if edge.target.block == block.path}
    weights: dict[_Arc, float] = defaultdict(float)
    for edge in block.edges:
        source, target = edge.source.block, edge.target.block
        if source not in inside or target not in inside or source == target:
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
    """Strongly connected groups in forward order (Tarjan, without recursion)."""
    after: dict[str, list[str]] = {path: [] for path in paths}
    for source, target in weights:
        after[source].append(target)
    index: dict[str, int] = {}
    low: dict[str, int] = {}
    stack: list[str] = []
    on_stack: set[str] = set()
    found: list[list[str]] = []
    for root in reversed(paths):  # groups come out last first
        if root in index:
            continue
        work = [(root, iter(sorted(after[root], key=paths.index, reverse=True)))]
        index[root] = low[root] = len(index)
        stack.append(root)
        on_stack.add(root)
        while work:
            path, later = work[-1]
            step = next(later, None)
            if step is None:
                work.pop()
                if work:
                    low[work[-1][0]] = min(low[work[-1][0]], low[path])
                if low[path] == index[path]:
                    cut = stack.index(path)
                    group, stack[cut:] = stack[cut:], []
                    on_stack -= set(group)
                    found.append(sorted(group, key=paths.index))
            elif step not in index:
                index[step] = low[step] = len(index)
                stack.append(step)
                on_stack.add(step)
                work.append((step, iter(sorted(after[step], key=paths.index, reverse=True))))
            elif step in on_stack:
                low[path] = min(low[path], index[step])
    return found[::-1]


def _best_order(group: list[str], weights: dict[_Arc, float]) -> list[str]:
    """The cheapest order found from every starting block, improved by moving single blocks."""
    member = set(group)
    arcs = {arc: weight for arc, weight in weights.items() if arc[0] in member and arc[1] in member}
    starts = group if len(group) <= 12 else group[:1]
    candidates = [_improved(_depth_first(start, group, arcs), arcs) for start in starts]
    return min(candidates, key=lambda order: (round(_cost(order, arcs), 6), candidates.index(order)))


def _depth_first(start: str, group: list[str], arcs: dict[_Arc, float]) -> list[str]:
    order: list[str] = []
    seen: set[str] = set()
    for root in [start, *group]:
        stack = [(root, False)]
        while stack:
            path, done = stack.pop()
            if done:
                order.append(path)
            elif path not in seen:
                seen.add(path)
                stack.append((path, True))
                stack += [(other, False) for other in group if (path, other) in arcs and other not in seen]
    return order[::-1]


def _cost(order: list[str], arcs: dict[_Arc, float]) -> float:
    place = {path: number for number, path in enumerate(order)}
    return sum(weight for (source, target), weight in arcs.items() if place[source] > place[target])


def _improved(order: list[str], arcs: dict[_Arc, float]) -> list[str]:
    """Move one block at a time to where it costs least, until nothing gets better."""
    touching: dict[str, list[tuple[str, float, bool]]] = defaultdict(list)
    for (source, target), weight in arcs.items():
        touching[source].append((target, weight, True))
        touching[target].append((source, weight, False))
    for _ in range(len(order)):
        changed = False
        for path in list(order):
            rest = [other for other in order if other != path]
            place = {other: number for number, other in enumerate(rest)}
            # Cost of standing before everything, then what each step to the right changes.
            step = [0.0] * (len(rest) + 1)
            for other, weight, leaves in touching[path]:
                step[place[other] + 1] += weight if leaves else -weight
            total, best, best_at = 0.0, 0.0, 0
            current = order.index(path)
            sums = []
            for number, change in enumerate(step):
                total += change
                sums.append(total)
                if total < best - 1e-9:
                    best, best_at = total, number
            if sums[current] > best + 1e-9:
                rest.insert(best_at, path)
                order = rest
                changed = True
        if not changed:
            break
    return order
