"""Wires are straight where blocks may grow for it."""

import itertools

import pytest

from forcectl.graph.layout.heights import path_lengths, set_heights
from forcectl.graph.layout.rows import Columns, Crossing, Item
from forcectl.graph.layout.shapes import PORT_PITCH

FIRST, LAST = 46.5, 16.5  # from the top of a box to its first port, and from its last one to the bottom


def box(rank: int, inputs: int, outputs: int, more: float = 0.0) -> Item:
    """A box with ports in the upper rows of it, `more` higher than it has to be."""
    ports = {"in": [f"u{i}" for i in range(inputs)], "out": [f"y{i}" for i in range(outputs)]}
    slots = {side: [(0.0, FIRST + PORT_PITCH * i) for i in range(len(names))] for side, names in ports.items()}
    height = FIRST + PORT_PITCH * (max(inputs, outputs) - 1) + LAST + more
    return Item(rank, 100.0, height, ports, slots, elastic=True)


def placed(columns: Columns, wires: list[tuple[Item, int, Item, int]], elastic: bool = True) -> list[float]:
    """How much lower each wire ends than it starts."""
    for column in columns:
        for row, item in enumerate(column):
            item.row = row
    hops = [Crossing(n, a.rank, a, f"y{i}", b, f"u{j}") for n, (a, i, b, j) in enumerate(wires)]
    set_heights(columns, hops, path_lengths(hops), elastic)
    return [hop.right.place("in", hop.right_port)[1] - hop.left.place("out", hop.left_port)[1] for hop in hops]


def sums(more: float) -> tuple[Columns, list[tuple[Item, int, Item, int]]]:
    """Two boxes one below the other, the upper one higher by `more`, that lead to one box with two inputs."""
    upper, lower, end = box(0, 0, 1, more), box(0, 0, 1), box(1, 2, 1)
    return [[upper, lower], [end]], [(upper, 0, end, 0), (lower, 0, end, 1)]


def test_a_block_grows_so_that_both_of_its_wires_are_straight():
    columns, wires = sums(0.0)
    assert placed(columns, wires) == pytest.approx([0.0, 0.0], abs=0.02)
    ((upper, lower), (end,)) = columns
    first, second = (y for _, y in end.slots["in"])
    assert second - first == pytest.approx(upper.height + 26.0, abs=0.02)  # as far as the two boxes are apart
    assert (first, end.height - second) == pytest.approx((FIRST, LAST), abs=0.02)
    assert lower.height == FIRST + LAST  # where nothing is won, the shape stays
    assert end.slots["out"] == [(0.0, FIRST)]


def test_blocks_that_may_not_grow_keep_their_shape():
    columns, wires = sums(0.0)
    before = columns[1][0].height
    bent = placed(columns, wires, elastic=False)
    assert columns[1][0].height == before
    assert sum(abs(step) > 1.0 for step in bent) == 1
    rigid, wires = sums(0.0)
    rigid[1][0].elastic = False
    assert placed(rigid, wires) == pytest.approx(bent)


@pytest.mark.parametrize(("more", "grows"), [(10.0, True), (14.0, False)])
def test_no_block_grows_by_more_than_five_ports(more: float, grows: bool):
    # The ports have to be 89 px and `more` apart: 72 px and `more` further than they are.
    columns, wires = sums(more)
    bent = placed(columns, wires)
    assert all(abs(step) < 0.1 for step in bent) == grows
    assert columns[1][0].height <= FIRST + PORT_PITCH + LAST + 5 * PORT_PITCH + 0.01


def test_ports_keep_their_order_and_distance_and_stay_on_the_block():
    left = [box(0, 0, 1) for _ in range(2)]
    middle = box(1, 5, 4)
    right = [box(2, 1, 0) for _ in range(3)]
    wires = [(left[0], 0, middle, 1), (left[1], 0, middle, 3), *((middle, i, end, 0) for i, end in enumerate(right))]
    placed([left, [middle], right], wires)
    for slots in middle.slots.values():
        heights = [y for _, y in slots]
        assert all(b - a >= PORT_PITCH - 0.02 for a, b in itertools.pairwise(heights))
        assert heights[0] >= FIRST - 0.02
        assert heights[-1] <= middle.height - LAST + 0.02


def test_what_stands_below_a_block_that_grows_keeps_its_distance():
    columns, wires = sums(0.0)
    below = box(1, 1, 0)
    columns[1].append(below)
    source = box(0, 0, 1)
    columns[0].append(source)
    assert placed(columns, [*wires, (source, 0, below, 0)]) == pytest.approx([0.0] * 3, abs=0.02)
    end = columns[1][0]
    assert below.y - end.y - end.height >= 26.0 - 0.02
