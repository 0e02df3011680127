import pytest

from forcectl.graph.export import graph
from forcectl.graph.layout.order import feedback_edges, ranks
from tests.examples.graph_diagrams import arm_with_controller, force_loop, odd_names, primitive_loop, random_diagram


def ends(edges):
    return {(edge.source.block.rpartition("/")[2], edge.target.block.rpartition("/")[2]) for edge in edges}


def test_the_measurement_closes_the_loop_whatever_was_added_first():
    loop = graph(force_loop()).root
    assert ends(feedback_edges(loop)) == {("station", "force_law")}
    column = {path.rpartition("/")[2]: rank for path, rank in ranks(loop).items()}
    assert column["reference"] < column["force_law"] < column["station"]


def test_a_loop_of_primitives_is_closed_at_the_summing_junction():
    loop = graph(primitive_loop()).root
    assert ends(feedback_edges(loop)) == {("minus", "error")}


def test_the_state_and_the_geometry_query_return():
    arm = graph(arm_with_controller()).root
    assert ends(feedback_edges(arm)) == {("plant", "controller"), ("scene_graph", "plant")}


def test_a_diagram_without_loops_has_no_feedback():
    station = graph(force_loop(), depth=None).by_path["station"]
    assert feedback_edges(station) == frozenset()
    assert list(ranks(station).values()) == [1, 2, 3, 4]


def test_one_wire_closes_a_ring():
    assert len(feedback_edges(graph(odd_names()).root)) == 1


@pytest.mark.parametrize("seed", range(8))
def test_every_other_wire_leads_to_the_right(seed):
    root = graph(random_diagram(14, seed)).root
    returning = feedback_edges(root)
    column = ranks(root)
    assert min(column.values()) == 1
    for edge in root.edges:
        if edge in returning or root.path in (edge.source.block, edge.target.block):
            continue
        assert column[edge.source.block] < column[edge.target.block]


@pytest.mark.parametrize("seed", range(8))
def test_no_wire_is_turned_around_without_need(seed):
    """Taking any single returning wire as a forward one would close a loop among the forward wires."""
    root = graph(random_diagram(10, seed)).root
    returning = {(e.source.block, e.target.block) for e in feedback_edges(root)}
    forward = {(e.source.block, e.target.block) for e in root.edges} - returning
    for source, target in returning:
        reached, waiting = set(), [target]
        while waiting:
            at = waiting.pop()
            reached.add(at)
            waiting += [b for a, b in forward if a == at and b not in reached]
        assert source in reached
