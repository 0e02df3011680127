"""Algebraic loops, reported as a path of ports before Drake's builder refuses them."""

from __future__ import annotations

from collections.abc import Iterator
from traceback import walk_tb
from types import TracebackType

from pydrake.systems.framework import Diagram, DiagramBuilder

from forcectl.doctor.report import Finding, error
from forcectl.errors import BadInputError
from forcectl.inspect.wiring import PortAddress, Wiring

_ADVICE = (
    "break it with a block that holds its output over a sample (a discrete state, ZeroOrderHold), or declare "
    "prerequisites_of_calc of an output that does not really depend on its input"
)


def algebraic_loops(wiring: Wiring) -> Iterator[Finding]:
    """Algebraic loops: at least one finding for each group of ports that depend on each other."""
    for loop in _loops(wiring):
        names = [name for output, reader in loop for name in map(wiring.name, (output, reader))]
        path = " -> ".join([*names, names[0]])
        yield error("algebraic-loop", path, f"each of these needs the next within one instant; {_ADVICE}")


def _loops(wiring: Wiring) -> Iterator[list[tuple[PortAddress, PortAddress]]]:
    """Loops as lists of wires (output, input), found by depth-first search over the wires."""
    readers = wiring.readers()

    def following(reader: PortAddress) -> list[tuple[PortAddress, PortAddress]]:
        read = [output for output in wiring.outputs(reader.system) if output in readers]
        return [(output, other) for output in read if reader in wiring.passed(output) for other in readers[output]]

    done: set[PortAddress] = set()
    for start in wiring.leaf_inputs():
        if start in done:
            continue
        trail: list[tuple[PortAddress, PortAddress]] = []  # wires walked so far
        position = {start: 0}
        stack = [iter(following(start))]
        while stack:
            wire = next(stack[-1], None)
            if wire is None:
                stack.pop()
                left = trail.pop()[1] if trail else start
                done.add(left)
                position.pop(left, None)
            elif wire[1] in position:
                yield [*trail[position[wire[1]] :], wire]
            elif wire[1] not in done:
                trail.append(wire)
                position[wire[1]] = len(trail)
                stack.append(iter(following(wire[1])))


def _builders_at(traceback: TracebackType | None) -> Iterator[DiagramBuilder]:
    """The builders among the local variables in a traceback, the innermost first."""
    frames = [frame.f_locals for frame, _ in walk_tb(traceback)]
    for variables in reversed(frames):
        values = [*variables.values(), *getattr(variables.get("self"), "__dict__", {}).values()]
        yield from (value for value in values if isinstance(value, DiagramBuilder))


def build(builder: DiagramBuilder) -> Diagram:
    """`builder.Build()`, but with an algebraic loop reported as a path.

    Raises:
        BadInputError: the diagram has an algebraic loop.
        RuntimeError: Drake refused the diagram for another reason.
    """
    try:
        return builder.Build()
    except RuntimeError as error:
        if (loop := loop_behind(error)) is None:
            raise
        raise loop from error


def loop_behind(error: BaseException) -> BadInputError | None:
    """The error with the path of the algebraic loop for which Drake refused a diagram; None for another reason.

    Args:
        error: error of Drake. The builder must be a variable of the function that called `Build()`, or an attribute of
            its `self`.
    """
    if "algebraic loop" not in str(error):
        return None
    loops = (loop for builder in _builders_at(error.__traceback__) for loop in algebraic_loops(Wiring(builder)))
    loop = next(loops, None)
    return None if loop is None else BadInputError(f"algebraic loop: {loop.path}; {_ADVICE}")
