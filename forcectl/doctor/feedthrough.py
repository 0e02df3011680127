"""Outputs without declared prerequisites."""

from __future__ import annotations

import re
from collections.abc import Iterator

from pydrake.systems.framework import CacheIndex, System

from forcectl.doctor.report import Finding, warning
from forcectl.framework.wiring import input_names
from forcectl.inspect.wiring import Wiring, is_python_block

_OUTPUT_ENTRY = re.compile(r"output port (\d+)\(")  # how Drake describes the cache entry of an output port


def undeclared_prerequisites(wiring: Wiring) -> Iterator[Finding]:
    """Outputs of Python blocks with state and inputs that never said what they depend on.

    Drake then assumes that they depend on everything: the output is computed again at every instant, and every
    input counts as feedthrough, which makes algebraic loops that are not there.
    """
    for path, system in wiring.leaves():
        state = system.num_continuous_states() or system.num_discrete_state_groups() or system.num_abstract_states()
        if not (is_python_block(system) and system.num_input_ports() and state):
            continue
        names = ", ".join(input_names(system))
        undeclared = _depend_on_everything(system)
        for output in wiring.outputs(path):
            if output.index in undeclared and len(wiring.passed(output)) == system.num_input_ports():
                yield warning(
                    "undeclared-prerequisites",
                    wiring.name(output),
                    f"declares no prerequisites, so every input ({names}) counts as feedthrough; pass "
                    "prerequisites_of_calc={...} or use DeclareStateOutputPort",
                )


def _depend_on_everything(system: System) -> set[int]:
    """The outputs of a leaf whose declared prerequisites are all sources, Drake's default when none are given."""
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
