"""Findings about outputs without declared prerequisites, or with too few."""

from __future__ import annotations

import re
from collections.abc import Iterator

import numpy as np
from pydrake.systems.framework import CacheIndex, Context, System

from forcectl.doctor.report import Finding, error, warning
from forcectl.framework.wiring import input_names
from forcectl.inspect.start import FAILURES, StartValues
from forcectl.inspect.wiring import PortAddress, Wiring, is_python_block, is_vector

_OUTPUT_ENTRY = re.compile(r"output port (\d+)\(")  # Drake's description of the cache entry of an output port


def undeclared_prerequisites(wiring: Wiring) -> Iterator[Finding]:
    """Outputs without declared prerequisites, of Python blocks with state and inputs.

    Drake then assumes that they depend on everything. The output is computed again at every instant, and every input
    counts as feedthrough, which makes false algebraic loops.
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


def missing_prerequisites(values: StartValues) -> Iterator[Finding]:
    """Outputs of Python blocks that change with an input within one instant without declaring it."""
    wiring = values.wiring
    for path, system in wiring.leaves():
        if not is_python_block(system):
            continue
        inputs = [port for port in wiring.inputs(path) if is_vector(wiring.port(port))]
        for output in filter(lambda port: is_vector(wiring.port(port)), wiring.outputs(path)):
            declared = wiring.passed(output)
            hidden = [port for port in inputs if port not in declared and _changes(values, output, port)]
            if hidden:
                names = ", ".join(wiring.port(port).get_name() for port in hidden)
                yield error(
                    "missing-prerequisites",
                    wiring.name(output),
                    f"changes with {names} within one instant, which its prerequisites do not list: Drake may use an "
                    f"old value of it, and finds no algebraic loop through it; add {names} to prerequisites_of_calc",
                )


def _changes(values: StartValues, output: PortAddress, reader: PortAddress) -> bool:
    """Whether the start value of an output changes with an input of its block, and is repeatable without a change."""
    try:
        with np.errstate(all="ignore"):  # a step may lead to values that the block is not made for
            first, again, other = (
                values.wiring.port(output).Eval(_stepped(values, reader, step)) for step in (0.0, 0.0, 1.0)
            )
    except FAILURES:
        return False
    same, unchanged = (np.array_equal(first, value, equal_nan=True) for value in (again, other))
    return same and not unchanged


def _stepped(values: StartValues, reader: PortAddress, step: float) -> Context:
    """A context of a block, with `step` added to one of its inputs; inputs without a value are zero."""
    context = values.block_context(reader.system)
    for address in values.wiring.inputs(reader.system):
        port = values.wiring.port(address)
        if is_vector(port) and not port.HasValue(context):
            port.FixValue(context, np.zeros(port.size()))
    port = values.wiring.port(reader)
    port.FixValue(context, port.Eval(context) + step)
    return context


def _depend_on_everything(system: System) -> set[int]:
    """The outputs of a leaf whose declared prerequisites are all sources, Drake's default when none are given."""
    found: set[int] = set()
    left = set(range(system.num_output_ports()))
    index = 0
    while left:  # every output of a leaf has an entry; an index past the last entry is not allowed
        entry = system.get_cache_entry(CacheIndex(index))
        index += 1
        if match := _OUTPUT_ENTRY.match(entry.description()):
            left.discard(int(match[1]))
            if system.all_sources_ticket() in entry.prerequisites():
                found.add(int(match[1]))
    return found
