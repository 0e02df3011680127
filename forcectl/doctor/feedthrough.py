"""Which output passes on which input within the same instant, and which outputs forgot to say."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from types import FrameType
from typing import Any

from pydrake.systems.framework import Context, System

from forcectl.doctor.connections import is_library_plant
from forcectl.doctor.report import FeedthroughRow, Finding, warning
from forcectl.doctor.wiring import Port, Wiring, is_python_block


def feedthrough_table(wiring: Wiring) -> tuple[FeedthroughRow, ...]:
    """One row per output port of every block; of plants only the outputs that pass something through."""
    rows = []
    for path, system in wiring.leaves():
        pairs = wiring.feedthrough(path)
        for o in range(system.num_output_ports()):
            inputs = tuple(wiring.input_port(Port(path, i)).get_name() for i, out in sorted(pairs) if out == o)
            if inputs or not is_library_plant(system):
                rows.append(FeedthroughRow(path, wiring.output_port(Port(path, o)).get_name(), inputs))
    return tuple(rows)


def undeclared_prerequisites(wiring: Wiring, context_of: Callable[[str], Context]) -> Iterator[Finding]:
    """Outputs of Python blocks with state and inputs that never said what they depend on.

    Drake then assumes that they depend on everything: the output is computed again at every instant, and every
    input counts as feedthrough, which makes algebraic loops that are not there.
    """
    for path, system in wiring.leaves():
        if not is_python_block(system) or system.num_input_ports() == 0 or not has_state(system):
            continue
        for o in range(system.num_output_ports()):
            if len({pair for pair in wiring.feedthrough(path) if pair[1] == o}) < system.num_input_ports():
                continue
            port = wiring.output_port(Port(path, o))
            names = ", ".join(system.get_input_port(i, False).get_name() for i in range(system.num_input_ports()))
            if _depends_on_everything(port.EvalAbstract, context_of(path)):
                yield warning(
                    "undeclared-prerequisites",
                    wiring.output_name(Port(path, o)),
                    f"declares no prerequisites, so every input ({names}) counts as feedthrough; pass "
                    "prerequisites_of_calc={...} or use DeclareStateOutputPort",
                )


def has_state(system: System) -> bool:
    """Whether the block remembers anything."""
    return bool(system.num_continuous_states() or system.num_discrete_state_groups() or system.num_abstract_states())


def _depends_on_everything(evaluate: Callable[[Context], Any], context: Context) -> bool:
    """Whether a Python output is computed again after a change that no output ever names: the wanted accuracy.

    Drake does not show the prerequisites of a port. But a port that has declared some is answered from the cache
    after such a change, without a call into Python.
    """
    if sys.getprofile() is not None:
        return False  # calls are noticed with the profile hook, and somebody else's profiler holds it
    try:
        evaluate(context)
        if _calls_python(evaluate, context):
            return False  # never cached, so nothing can be concluded
        wanted = context.get_accuracy()
        context.SetAccuracy(0.5 if wanted != 0.5 else 0.25)
        return _calls_python(evaluate, context)
    except (Exception, SystemExit):
        return False  # an output that cannot be computed is reported as such elsewhere


def _calls_python(evaluate: Callable[[Context], Any], context: Context) -> bool:
    calls = 0

    def count(frame: FrameType, event: str, argument: object) -> None:
        nonlocal calls
        calls += event == "call"

    sys.setprofile(count)
    try:
        evaluate(context)
    finally:
        sys.setprofile(None)
    return calls > 0
