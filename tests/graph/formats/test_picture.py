"""Layout, routing and shapes, looked at through the finished picture."""

import itertools

import pytest
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import Demultiplexer, Multiplexer

from forcectl.graph.export import graph
from forcectl.graph.formats.picture import Layouter
from forcectl.graph.layout.placed import Picture
from forcectl.graph.layout.shapes import SIGNAL_SIZE, text_width
from tests.examples.graph_diagrams import ALL, force_loop, primitive_loop, random_diagram


def picture_of(diagram, depth=None) -> Picture:
    return Layouter(graph(diagram, depth=depth)).picture()


def permuted(order):
    """A vector whose elements change places."""
    builder = DiagramBuilder()
    split = builder.AddNamedSystem("split", Demultiplexer(len(order), 1))
    join = builder.AddNamedSystem("join", Multiplexer(len(order)))
    for source, target in enumerate(order):
        builder.Connect(split.get_output_port(source), join.get_input_port(target))
    builder.ExportInput(split.get_input_port(0), "u")
    builder.ExportOutput(join.get_output_port(0), "y")
    return builder.Build()


def legs(net):
    """The straight pieces of a net's wires."""
    for wire in net.wires:
        yield from itertools.pairwise(wire)


def body(box):
    x, y, width, height = box.shape.body
    return box.x + x, box.y + y, box.x + x + width, box.y + y + height


PICTURES = {f"{name}-{depth}": (make, depth) for name, make in ALL.items() for depth in (0, 1, None)} | {
    f"random-{seed}-{depth}": ((lambda seed=seed: random_diagram(12, seed)), depth)
    for seed in range(6)
    for depth in (1, None)
}
PICTURES |= {
    "permuted-" + "".join(map(str, order)): (lambda order=order: permuted(order), None)
    for order in [*itertools.permutations(range(3)), (5, 4, 3, 2, 1, 0), (3, 4, 0, 2, 1), (1, 2, 3, 4, 5, 0)]
}


@pytest.fixture(params=PICTURES.values(), ids=PICTURES)
def picture(request) -> Picture:
    make, depth = request.param
    return picture_of(make(), depth)


def test_wires_run_at_right_angles_and_end_at_their_ports(picture):
    places = {
        (b.path, side, n): p for b in picture.boxes for side in ("inputs", "outputs") for n, p in getattr(b, side)
    }
    for net in picture.nets:
        own = net.source.block == net.inside
        start = places[net.source.block, "inputs" if own else "outputs", net.source.port]
        for target, wire in zip(net.targets, net.wires, strict=True):
            end = places[target.block, "outputs" if target.block == net.inside else "inputs", target.port]
            assert wire[0] == pytest.approx(start, abs=0.05)
            assert wire[-1] == pytest.approx(end, abs=0.05)
            for (x0, y0), (x1, y1) in itertools.pairwise(wire):
                assert abs(x0 - x1) < 0.01 or abs(y0 - y1) < 0.01


def test_wires_arrive_from_the_left_and_leave_to_the_right(picture):
    for net in picture.nets:
        for wire in net.wires:
            assert wire[1][0] > wire[0][0]
            assert wire[-2][0] < wire[-1][0] - 8.0  # room for the arrow head


def test_no_wire_runs_down_through_the_text_of_a_signal(picture):
    for net, other in itertools.product(picture.nets, picture.nets):
        left, low = net.text_at
        right = left + text_width(net.signal, SIGNAL_SIZE)
        for (x, y), (same, z) in legs(other):
            if abs(x - same) < 0.01 and left < x < right:
                assert max(y, z) < low - SIGNAL_SIZE or min(y, z) > low, (net.source, other.source)


def test_no_two_signals_run_on_top_of_each_other(picture):
    for a, b in itertools.combinations(picture.nets, 2):
        for (p, q), (r, s) in itertools.product(legs(a), legs(b)):
            for along, across in ((0, 1), (1, 0)):
                parallel = abs(p[across] - q[across]) < 0.01 and abs(r[across] - s[across]) < 0.01
                if parallel and abs(p[across] - r[across]) < 3.0:
                    low = max(min(p[along], q[along]), min(r[along], s[along]))
                    high = min(max(p[along], q[along]), max(r[along], s[along]))
                    assert high - low < 3.0, (a.source, b.source)


def test_no_wire_runs_through_a_block(picture):
    folded = [box for box in picture.boxes if box.shape is not None and box.shape.form != "circle"]
    for net in picture.nets:
        for (x0, y0), (x1, y1) in legs(net):
            for box in folded:
                left, top, right, bottom = body(box)
                inside_x = max(x0, x1) > left + 2 and min(x0, x1) < right - 2
                inside_y = max(y0, y1) > top + 2 and min(y0, y1) < bottom - 2
                assert not (inside_x and inside_y), (net.source, box.path)


def above(box):
    """Path of the diagram around a box; no diagram of these tests has a slash in its name."""
    path = box.path.replace("</", "<")
    return path.rpartition("/")[0]


def test_blocks_do_not_overlap_and_lie_in_their_frame(picture):
    by_path = {box.path: box for box in picture.boxes}
    for box in picture.boxes[1:]:
        parent = by_path[above(box)]
        assert parent.x < box.x
        assert parent.y < box.y
        assert box.x + box.width < parent.x + parent.width + 0.05
        assert box.y + box.height < parent.y + parent.height + 0.05
    for a, b in itertools.combinations(picture.boxes[1:], 2):
        if above(a) == above(b):
            apart_x = a.x + a.width <= b.x or b.x + b.width <= a.x
            apart_y = a.y + a.height <= b.y or b.y + b.height <= a.y
            assert apart_x or apart_y, (a.path, b.path)


def test_everything_lies_on_the_paper(picture):
    for box in picture.boxes:
        assert box.x >= 0
        assert box.y >= 0
        assert box.x + box.width <= picture.width
        assert box.y + box.height <= picture.height
    for x, y in (point for net in picture.nets for wire in net.wires for point in wire):
        assert 0 <= x <= picture.width
        assert 0 <= y <= picture.height


def test_the_forward_path_is_one_straight_row_and_the_loop_returns_below():
    picture = picture_of(force_loop())
    box = {b.path.rpartition("/")[2]: b for b in picture.boxes}
    row = ["reference", "force_law", "position_loop", "contact_stiffness", "one_sided", "force_sensor"]
    for left, right in itertools.pairwise(row):
        assert box[left].x + box[left].width < box[right].x
    ends = [*(f"station/{name}" for name in row[3:]), "station"]
    forward = {
        target.block: wire
        for net in picture.nets
        if net.inside == "station"
        for target, wire in zip(net.targets, net.wires, strict=True)
        if target.block in ends and target.port in ("u0", "measured_force")
    }
    assert set(forward) == set(ends)
    assert len({round(y, 1) for wire in forward.values() for _, y in wire}) == 1  # one height through the whole station
    (back,) = [n for n in picture.nets if n.source.port == "measured_force" and n.inside == ""]
    assert max(y for _, y in back.wires[0]) > box["station"].y + box["station"].height
    assert back.wires[0][-1][0] < back.wires[0][0][0]


def test_a_signal_that_goes_two_ways_parts_at_a_dot():
    picture = picture_of(force_loop())
    split = [net for net in picture.nets if len(net.targets) == 2]
    assert {net.source.block.rpartition("/")[2] for net in split} == {"one_sided", "position_loop"}
    assert all(len(net.dots) == 1 for net in split)
    assert all(net.dots == () for net in picture.nets if len(net.targets) == 1)


def test_primitives_have_their_usual_symbols():
    shapes = {box.path.rpartition("/")[2]: box.shape for box in picture_of(primitive_loop()).boxes[1:]}
    assert (shapes["error"].form, shapes["error"].symbol) == ("circle", "Σ")
    assert (shapes["gain"].form, shapes["gain"].symbol) == ("triangle", "−0.00012")
    assert shapes["plant"].symbol == "K"
    assert shapes["integral"].symbol == "1/s"
    assert shapes["delay"].symbol == "z⁻³"
    assert shapes["reference"].symbol == "15"
    assert (shapes["mux"].form, shapes["demux"].form) == ("bar", "bar")
    assert shapes["hold"].captions == ("hold", "2 ms")


def test_any_set_of_diagrams_can_be_open():
    model = graph(random_diagram(4, 3), depth=None)
    layouter = Layouter(model)
    some = frozenset({"", "block_1"})
    opened = {box.path for box in layouter.picture(some).boxes if box.shape is None}
    assert opened == some
    assert layouter.picture(some) == Layouter(model).picture(some)
