"""Few wires cross and few bend: compared with elkjs, for the same blocks, ports and wires.

elkjs lays out in layers as well, with its default options and wires at right angles. It gets the forward path, from
left to right, that the picture has: left alone it puts stations before their controllers, which saves bends and is no
block diagram any more. Where the picture is broken into rows, elkjs may wrap its layers as well.
"""

from dataclasses import replace

import pytest

from forcectl.graph.export import Graph, graph
from forcectl.graph.formats.picture import Layouter
from forcectl.graph.layout.sorting.measure import count_bends, count_crossings
from forcectl.graph.model import Block
from forcectl.scenario.catalog import list_experiments
from forcectl.scenario.layers import select_variants
from forcectl.scenario.scenario import as_file, build, resolve
from tests.examples.elk import as_elk, laid_out

DEPTHS = (1, 2)

# Experiment and depth where elkjs is better: crossings, or bends, of ours and of its. A number that gets worse fails
# the test, and so does a line that is not needed any more.
MORE_CROSSINGS: dict[tuple[str, int], tuple[int, int]] = {
    ("baselines", 2): (5, 4),
}
MORE_BENDS: dict[tuple[str, int], tuple[int, int]] = {
    ("fig_6_5", 2): (46, 39),
}


def shipped() -> dict[str, Graph]:
    """The graphs of all experiments; those that differ in numbers only are one, named after the first."""
    named: dict[Block, str] = {}
    for experiment in list_experiments():
        file = as_file(experiment)
        drawn = graph(build(resolve(file, select_variants(file)[0])).diagram)
        named.setdefault(without_parameters(drawn.root), experiment)
    return {experiment: Graph(root) for root, experiment in named.items()}


def without_parameters(block: Block) -> Block:
    return replace(block, parameters=(), blocks=tuple(map(without_parameters, block.blocks)))


@pytest.mark.slow
def test_no_more_crossings_and_bends_than_elkjs_makes_but_where_it_is_said() -> None:
    laid_out([])  # skips here, before anything is drawn, where there is no elkjs
    ours, tasks = {}, {}
    for experiment, drawn in shipped().items():
        layouter = Layouter(drawn)
        for depth in DEPTHS:
            picture = layouter.picture(drawn.unfolded(depth))
            ours[experiment, depth] = [net.wires for net in picture.nets]
            tasks[experiment, depth] = as_elk(drawn, picture)
    theirs = dict(zip(tasks, laid_out(list(tasks.values())), strict=True))
    for count, exceptions in ((count_crossings, MORE_CROSSINGS), (count_bends, MORE_BENDS)):
        numbers = {key: (count(ours[key]), count(theirs[key])) for key in ours}
        worse = {key: pair for key, pair in numbers.items() if pair[0] > pair[1]}
        assert set(worse) == set(exceptions), worse
        for key, (own, elk) in worse.items():
            known_own, known_elk = exceptions[key]
            assert own - elk <= known_own - known_elk, (key, own, elk)


def test_crossings_and_bends_are_those_that_one_sees() -> None:
    across = [[(0.0, 0.0), (10.0, 0.0)]]
    # Two wires of one signal along the same line, one of which goes on: the line across crosses them once.
    down = [[(5.0, -5.0), (5.0, 5.0)], [(5.0, -5.0), (5.0, 8.0), (9.0, 8.0)]]
    assert count_crossings([across, down]) == 1
    assert count_bends([across, down]) == 1
    # What only touches does not cross, and wires of one signal do not cross each other.
    assert count_crossings([across, [[(5.0, 0.0), (5.0, 5.0)]], [[(10.0, -5.0), (10.0, 5.0)]]]) == 0
    assert count_crossings([[*across, *down]]) == 0
    # Two wires of a signal that part at one corner, points that are none, and a step.
    parting = [[(0.0, 0.0), (5.0, 0.0), (5.0, 5.0)], [(0.0, 0.0), (5.0, 0.0), (5.0, 0.0), (5.0, -5.0)]]
    step = [[(0.0, 9.0), (2.0, 9.0), (4.0, 9.0), (4.0, 12.0), (8.0, 12.0)]]
    assert count_bends([parting, step]) == 1 + 2
