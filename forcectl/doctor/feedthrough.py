"""Outputs without declared prerequisites."""

from __future__ import annotations

from collections.abc import Iterator

from pydrake.systems.framework import System

from forcectl.doctor.report import Finding, warning
from forcectl.framework.wiring import input_names
from forcectl.inspect.feedthrough import outputs_that_depend_on_everything
from forcectl.inspect.wiring import PortAddress, Wiring, is_python_block


def undeclared_prerequisites(wiring: Wiring) -> Iterator[Finding]:
    """Outputs of Python blocks with state and inputs that never said what they depend on.

    Drake then assumes that they depend on everything: the output is computed again at every instant, and every
    input counts as feedthrough, which makes algebraic loops that are not there.
    """
    for path, system in wiring.leaves():
        if not is_python_block(system) or system.num_input_ports() == 0 or not _has_state(system):
            continue
        names = ", ".join(input_names(system))
        for o in sorted(outputs_that_depend_on_everything(system)):
            if sum(output == o for _, output in wiring.feedthrough(path)) == system.num_input_ports():
                yield warning(
                    "undeclared-prerequisites",
                    wiring.output_name(PortAddress(path, o)),
                    f"declares no prerequisites, so every input ({names}) counts as feedthrough; pass "
                    "prerequisites_of_calc={...} or use DeclareStateOutputPort",
                )


def _has_state(system: System) -> bool:
    return bool(system.num_continuous_states() or system.num_discrete_state_groups() or system.num_abstract_states())
