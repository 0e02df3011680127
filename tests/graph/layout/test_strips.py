"""Rows of blocks, and the wires from one to another."""

from collections.abc import Mapping, Sequence

from forcectl.graph.layout.rows import Item
from forcectl.graph.layout.sorting.measure import count_bends
from forcectl.graph.layout.strips import Strips
from forcectl.graph.model import Block, Endpoint

WHOLE = Block("/", "", "", "diagram", "nested", (), ())


def strips(columns: Mapping[str, int], wires: Mapping[str, Sequence[str]], cuts: Sequence[int]) -> Strips:
    """Boxes with one output and one input, by name, in their columns."""
    items = {
        name: Item(rank, 100.0, 60.0, {"in": ["u"], "out": ["y"]}, {"in": [(0.0, 30.0)], "out": [(100.0, 30.0)]})
        for name, rank in columns.items()
    }
    ends = {Endpoint(a, "y"): [Endpoint(b, "u") for b in targets] for a, targets in wires.items()}
    return Strips(WHOLE, items, ends, dict.fromkeys(ends, 20.0), {}, cuts)


def test_a_wire_to_the_next_row_runs_down_beside_its_own_row():
    chain = {"a": 1, "b": 2, "c": 3, "d": 4, "e": 5}
    placed = strips(chain, {"a": ["b"], "b": ["c"], "c": ["d"], "d": ["e"]}, [2])
    (wire,) = placed.paths(Endpoint("b", "y"))
    assert count_bends([[wire]]) == 4
    end_of_row = placed.corner("b")[0] + 100.0
    furthest = max(x for x, _ in wire)
    assert end_of_row < furthest < end_of_row + 60.0
    assert furthest < placed.corner("e")[0] + 100.0  # where the next row ends


def test_one_way_round_for_what_leads_to_the_next_row_and_back_in_its_own():
    placed = strips({"a": 1, "b": 2, "c": 3}, {"a": ["b"], "b": ["a", "c"]}, [2])
    back, down = placed.paths(Endpoint("b", "y"))
    assert back[:4] == down[:4]  # right, down, and left below the row
    assert back[-1] == (placed.corner("a")[0], placed.corner("a")[1] + 30.0)
    assert count_bends([[back, down]]) == 5


def test_what_leads_back_in_a_row_only_stays_in_it():
    placed = strips({"a": 1, "b": 2, "c": 3}, {"a": ["b", "c"], "b": ["a"]}, [2])
    (back,) = placed.paths(Endpoint("b", "y"))
    assert max(y for _, y in back) < placed.corner("c")[1]
    assert count_bends([[back]]) == 4
