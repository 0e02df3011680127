"""Which output passes on which input within the same instant, and the reasons that Drake reports."""

from __future__ import annotations

import re
from dataclasses import dataclass

from pydrake.systems.framework import CacheIndex, System

from forcectl.framework.wiring import input_names, output_names
from forcectl.inspect.start import is_library_plant
from forcectl.inspect.wiring import Wiring

_OUTPUT_ENTRY = re.compile(r"output port (\d+)\(")  # how Drake describes the cache entry of an output port


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
        pairs, inputs = sorted(wiring.feedthrough(path)), input_names(system)
        for o, output in enumerate(output_names(system)):
            passed = tuple(inputs[i] for i, out in pairs if out == o)
            if passed or not is_library_plant(system):
                rows.append(FeedthroughRow(path, output, passed))
    return tuple(rows)


def outputs_that_depend_on_everything(system: System) -> set[int]:
    """The outputs of a leaf block whose declared prerequisites are all sources, Drake's default when none are given."""
    found: set[int] = set()
    left = set(range(system.num_output_ports()))
    index = 0
    while left:  # every output of a leaf has its entry, and an index past the last entry must not be asked for
        entry = system.get_cache_entry(CacheIndex(index))
        index += 1
        if match := _OUTPUT_ENTRY.match(entry.description()):
            left.discard(int(match[1]))
            if system.all_sources_ticket() in entry.prerequisites():
                found.add(int(match[1]))
    return found
