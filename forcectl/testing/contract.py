"""The contract of a block: exactly these ports, exactly this direct feedthrough."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping

from pydrake.systems.framework import InputPort, OutputPort, System

from forcectl.doctor.feedthrough import missing_prerequisites
from forcectl.framework.wiring import input_names, output_names
from forcectl.inspect.names import own_name
from forcectl.inspect.start import StartValues
from forcectl.inspect.wiring import Wiring, is_vector

ABSTRACT = "abstract"  # stands for the size of a port that carries no vector


def assert_ports(system: System, inputs: Mapping[str, int | str], outputs: Mapping[str, int | str]) -> None:
    """The system has exactly these ports.

    Args:
        system: any diagram or block.
        inputs: port name -> size, or "abstract" for a port that carries no vector.
        outputs: likewise.

    Raises:
        AssertionError: a port is missing, not in the contract, or of another size; all differences are listed.
    """
    __tracebackhide__ = True
    found_inputs = _sizes(system.get_input_port(i, False) for i in range(system.num_input_ports()))
    found_outputs = _sizes(system.get_output_port(i, False) for i in range(system.num_output_ports()))
    lines = [*_differences("input", inputs, found_inputs), *_differences("output", outputs, found_outputs)]
    if lines:
        raise AssertionError("\n".join([f"ports of {own_name(system)} differ from the contract:", *lines]))


def _sizes(ports: Iterable[InputPort | OutputPort]) -> dict[str, int | str]:
    return {port.get_name(): port.size() if is_vector(port) else ABSTRACT for port in ports}


def _differences(side: str, wanted: Mapping[str, int | str], found: Mapping[str, int | str]) -> Iterator[str]:
    for name in wanted:
        if name not in found:
            yield f"  {side} {name!r} is missing (contract: {_size(wanted[name])}); there are {sorted(found) or 'none'}"
        elif wanted[name] != found[name]:
            yield f"  {side} {name!r} has {_size(found[name])}, contract: {_size(wanted[name])}"
    for name in found:
        if name not in wanted:
            yield f"  {side} {name!r} ({_size(found[name])}) is not in the contract"


def _size(size: int | str) -> str:
    return ABSTRACT if size == ABSTRACT else f"size {size}"


def assert_feedthrough(system: System, pairs: Iterable[tuple[str, str]]) -> None:
    """The outputs pass on within one instant exactly these inputs.

    Args:
        system: any diagram or block.
        pairs: (output port, input port) of every direct feedthrough; an empty set for none at all.

    Raises:
        AssertionError: a pair is missing or too many, or an output of a Python block changes with an input that it did
            not declare; all are listed.
    """
    __tracebackhide__ = True
    wanted, wiring = set(pairs), Wiring(system)
    outputs, inputs = output_names(system), input_names(system)
    found = {(outputs[o], inputs[i]) for i, o in wiring.feedthrough("")}
    lines = [
        f"  ({output!r}, {source!r}): no such {'output' if output not in outputs else 'input'}; outputs {outputs}, "
        f"inputs {inputs}"
        for output, source in sorted(wanted)
        if output not in outputs or source not in inputs
    ]
    if not lines:
        lines = [f"  {o} <- {i} is missing" for o, i in sorted(wanted - found)]
        lines += [
            f"  {o} <- {i} is too many: declare prerequisites_of_calc of {o} without it, or hold {o} in a state"
            for o, i in sorted(found - wanted)
        ]
        lines += [f"  {each.path} {each.message}" for each in missing_prerequisites(StartValues(wiring))]
    if lines:
        raise AssertionError("\n".join([f"direct feedthrough of {own_name(system)} is not as stated:", *lines]))
