"""Lookup of ports by the names that users write, and unit and type of a port."""

from __future__ import annotations

import difflib
import re

from pydrake.systems.framework import InputPort, OutputPort

from forcectl.conventions import unit_of
from forcectl.errors import BadInputError
from forcectl.inspect.wiring import PortAddress, Side, Wiring, is_vector

PortName = str | tuple[str, str]  # "station/sensor.measured_force", "measured_force", or (system path, port name)


def find_outputs(wiring: Wiring, name: PortName) -> list[PortAddress]:
    """The leaf outputs that a name stands for; where no output has the name, the sources of the inputs of that name.

    A bare port name means the ports of that name at the outermost level: `measured_force` is the station's, not that of
    a block inside it.
    """
    sources = map(wiring.source, _nested_least(wiring, "output", name) or find_inputs(wiring, name))
    return list(dict.fromkeys(port for port in sources if port is not None and port.side == "output"))


def named_outputs(wiring: Wiring, name: PortName) -> list[PortAddress]:
    """The output ports, of blocks and of diagrams, with a name, at the outermost level where there are any."""
    return _nested_least(wiring, "output", name)


def find_inputs(wiring: Wiring, name: PortName) -> list[PortAddress]:
    """The input ports, of blocks and of diagrams, with a name, at the outermost level where there are any."""
    return _nested_least(wiring, "input", name)


def one_output(wiring: Wiring, name: PortName) -> PortAddress:
    """The leaf output that a user's name stands for.

    Raises:
        BadInputError: no port has this name, or several different ones have it.
    """
    found = find_outputs(wiring, name)
    if len(found) == 1:
        return found[0]
    if found:
        options = ", ".join(map(wiring.name, found))
        raise BadInputError(f"port {_text(name)!r} is ambiguous: give the block as well, one of {options}")
    raise unknown_port(wiring, name)


def start_of_way(wiring: Wiring, name: PortName) -> tuple[str, list[PortAddress], PortAddress | None]:
    """The port that a user names as the start of a signal path: its full name, and its leaf inputs or its leaf output.

    Raises:
        BadInputError: no port has this name, or several different outputs have it.
    """
    if _nested_least(wiring, "output", name):
        output = one_output(wiring, name)
        return wiring.shown_name(output), [], output
    inputs = find_inputs(wiring, name)
    if not inputs:
        raise unknown_port(wiring, name)
    inner = dict.fromkeys(reader for port in inputs for reader in wiring.inner_inputs(port))
    return wiring.name(inputs[0]), list(inner), None


def unit(wiring: Wiring, port: PortAddress) -> str:
    """Unit of a port by `conventions.unit_of` and its system's `port_units`, "" for an unknown one."""
    return unit_of(wiring.port(port).get_name(), getattr(wiring.systems[port.system], "port_units", None))


def value_type(port: InputPort | OutputPort) -> str:
    """Short name of the value type of an abstract port; "" for a vector port."""
    if is_vector(port):
        return ""
    try:
        holder = port.Allocate()
    except RuntimeError:  # C++ types without a Python binding cannot be allocated from here
        return "abstract"
    inner = re.search(r"(?:\[|𝓣)(.*?)(?:\]|𝓤)*$", type(holder).__name__)
    if inner is None:
        return "abstract"
    text = re.sub(r"(?:𝓣|\[).*", "", inner.group(1).rpartition(".")[2])
    return text if text and text != "object" else type(holder.get_value()).__name__


def _all_ports(wiring: Wiring, side: Side) -> dict[PortAddress, tuple[str, str]]:
    """Every port with the path of its system and its name."""
    ports = [port for path in wiring.systems for port in (wiring.inputs if side == "input" else wiring.outputs)(path)]
    return {port: (port.system, wiring.port(port).get_name()) for port in ports}


def _nested_least(wiring: Wiring, side: Side, name: PortName) -> list[PortAddress]:
    depths = {
        port: len(wiring.parents(port.system)) + bool(port.system)
        for port, own in _all_ports(wiring, side).items()
        if (own == name if isinstance(name, tuple) else name in (own[1], _text(own)))
    }
    least = min(depths.values(), default=0)
    return [port for port, depth in depths.items() if depth == least]


def _text(name: PortName) -> str:
    return ".".join(part for part in name if part) if isinstance(name, tuple) else name


def unknown_port(wiring: Wiring, name: PortName) -> BadInputError:
    """The error for an unknown port. It lists only the most similar names, as a plant alone has hundreds of ports."""
    known = [_text(own) for own in (*_all_ports(wiring, "input").values(), *_all_ports(wiring, "output").values())]
    bare = {full.rpartition(".")[2]: full for full in reversed(known)}
    wanted = _text(name)
    near = difflib.get_close_matches(wanted, known, n=3, cutoff=0.5)
    near += [bare[own] for own in difflib.get_close_matches(wanted.rpartition(".")[2], bare, n=3, cutoff=0.6)]
    nearest = ", ".join(list(dict.fromkeys(near))[:3]) or "none; `forcectl graph` shows the ports"
    return BadInputError(f"unknown port {wanted!r}: must be block.port, nearest: {nearest}")
