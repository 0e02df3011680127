"""Which output passes on which input within the same instant."""

from __future__ import annotations

from dataclasses import dataclass

from forcectl.inspect.start import is_library_plant
from forcectl.inspect.wiring import Wiring


@dataclass(frozen=True)
class FeedthroughRow:
    """One output port and the input ports it passes on within the same instant."""

    block: str
    output: str
    inputs: tuple[str, ...]  # empty: the output depends on state, time or parameters only


def feedthrough_table(wiring: Wiring) -> tuple[FeedthroughRow, ...]:
    """One row per output port of every block; of plants only the outputs that pass something through."""
    rows = []
    for path, system in wiring.leaves():
        for output in wiring.outputs(path):
            passed = tuple(wiring.port(port).get_name() for port in wiring.passed(output))
            if passed or not is_library_plant(system):
                rows.append(FeedthroughRow(path, wiring.port(output).get_name(), passed))
    return tuple(rows)
