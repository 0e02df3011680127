"""Wires that join two units or two frames."""

from __future__ import annotations

from collections.abc import Iterator

from forcectl.doctor.report import Finding, warning
from forcectl.inspect.ports import unit
from forcectl.inspect.wiring import PortAddress, Side, Wiring


def mismatches(wiring: Wiring) -> Iterator[Finding]:
    """Wires whose two ends mean different units, by `conventions.unit_of` and the blocks' `port_units`.

    Frames are compared where both blocks name them in a `port_frames` attribute, {port name: frame}.
    """

    def look(side: Side, port: PortAddress) -> tuple[str, str, str]:
        """Full name, unit and frame of one end of a wire; "" for what is not known."""
        full = wiring.input_name(port) if side == "input" else wiring.output_name(port)
        frames = getattr(wiring.systems[port.system], "port_frames", {})
        return full, unit(wiring, side, port), frames.get(wiring.port(side, port).get_name(), "")

    for level in wiring.levels:
        for source, reader in level.wires():
            if source[1].system not in wiring.systems:
                continue  # an exported input of a builder has no name yet
            name, first, frame = look(*source)
            other, second, other_frame = look(*reader)
            wire = f"{name} -> {other}"
            if first and second and first != second:
                yield warning(
                    "unit-mismatch",
                    wire,
                    f"[{first}] is wired to [{second}]; convert between them or correct port_units of one block",
                )
            if frame and other_frame and frame != other_frame:
                yield warning(
                    "frame-mismatch",
                    wire,
                    f"frame {frame} is wired to frame {other_frame}; rotate in between or correct port_frames",
                )
