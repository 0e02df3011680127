"""Connections between ports of different units or frames."""

from __future__ import annotations

from collections.abc import Iterator

from forcectl.doctor.report import Finding, warning
from forcectl.inspect.ports import unit
from forcectl.inspect.wiring import PortAddress, Wiring


def _some_of(one: str, other: str) -> bool:
    """Whether the units of one port are a subset of those of the other, such as "m" and "m,rad"."""
    units, others = set(one.split(",")), set(other.split(","))
    return units <= others or others <= units


def mismatches(wiring: Wiring) -> Iterator[Finding]:
    """Connections between ports of different units, by `conventions.unit_of` and the blocks' `port_units`.

    Frames are compared where both blocks name them in a `port_frames` attribute, {port name: frame}.
    """

    def frame(port: PortAddress) -> str:
        return getattr(wiring.systems[port.system], "port_frames", {}).get(wiring.port(port).get_name(), "")

    for reader, source in wiring.sources.items():
        if source.system not in wiring.systems:
            continue  # an exported input of a builder has no name yet
        wire = f"{wiring.name(source)} -> {wiring.name(reader)}"
        one, other = unit(wiring, source), unit(wiring, reader)
        if one and other and not _some_of(one, other):
            advice = "convert between them or correct port_units of one block"
            yield warning("unit-mismatch", wire, f"[{one}] is wired to [{other}]; {advice}")
        one, other = frame(source), frame(reader)
        if one and other and one != other:
            advice = "rotate in between or correct port_frames"
            yield warning("frame-mismatch", wire, f"frame {one} is wired to frame {other}; {advice}")
