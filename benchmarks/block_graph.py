"""Block diagrams of a hundred nested blocks: reading, laying out and writing them, in time of the processor."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from statistics import median
from time import process_time
from typing import Any

# Found also when this file is run as a script, from a checkout.
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks._measure import Row, main


def _cpu_seconds(work: Callable[[], Any]) -> float:
    started = process_time()
    work()
    return process_time() - started


def _median(work: Callable[[], Any], repeats: int) -> float:
    work()
    return median(_cpu_seconds(work) for _ in range(repeats))


def benchmark(repeats: int) -> Iterator[Row]:
    from forcectl.graph.export import graph
    from forcectl.graph.formats.dot import to_dot
    from forcectl.graph.formats.html import to_html
    from forcectl.graph.formats.picture import Layouter
    from forcectl.graph.formats.svg import to_svg
    from tests.examples.graph_diagrams import random_diagram

    diagram = random_diagram(100, 1)
    model = graph(diagram)
    yield Row("read 100 nested blocks", _median(partial(graph, diagram), repeats), "s", "<= 1")
    yield Row("lay out 100 blocks", _median(lambda: Layouter(model).picture(), repeats), "s", "<= 1")
    yield Row("100 blocks as SVG", _median(partial(to_svg, model), repeats), "s", "<= 1")
    yield Row("100 blocks as DOT", _median(partial(to_dot, model), repeats), "s")
    page = graph(random_diagram(40, 1))
    yield Row("40 blocks as interactive page", _median(partial(to_html, page), min(repeats, 2)), "s", "<= 10")


if __name__ == "__main__":
    main("Block diagrams", benchmark)
