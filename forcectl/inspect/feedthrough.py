"""Table of direct feedthrough: the inputs on which each output depends within the same instant."""

from __future__ import annotations

from dataclasses import dataclass

from forcectl.inspect.start import is_library_plant
from forcectl.inspect.wiring import Wiring


@dataclass(frozen=True)
class FeedthroughRow:
    """One output port and the input ports that have direct feedthrough to it."""

    block: str
    output: str
    inputs: tuple[str, ...]  # empty: the output depends on state, time or parameters only


def feedthrough_table(wiring: Wiring) -> tuple[FeedthroughRow, ...]:
    """One row per output port of every block; for plants only outputs that are read and have feedthrough.

    A plant with parts has some hundred outputs: querying all of them took a third of the time of an examination.
    """
    rows = []
    for path, system in wiring.leaves():
        plant = is_library_plant(system)
        for output in wiring.outputs(path):
            if plant and not wiring.is_read(output):
                continue
            passed = tuple(wiring.port(port).get_name() for port in wiring.passed(output))
            if passed or not plant:
                rows.append(FeedthroughRow(path, wiring.port(output).get_name(), passed))
    return tuple(rows)
