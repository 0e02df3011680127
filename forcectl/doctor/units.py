"""Wires that join two units or two frames."""

from __future__ import annotations

from collections.abc import Iterator

from forcectl.conventions import unit_of
from forcectl.doctor.report import Finding, warning
from forcectl.doctor.wiring import Level, Port, Wiring


def _wires(level: Level) -> Iterator[tuple[tuple[str, Port], tuple[str, Port]]]:
    """Every pair of port names that stand for the same signal at this level: ("output" or "input", port)."""
    for reader, source in level.connections.items():
        yield ("output", source), ("input", reader)
    for inner, index in level.exported_inputs.items():
        yield ("input", Port(level.path, index)), ("input", inner)
    for index, inner in level.exported_outputs.items():
        yield ("output", inner), ("output", Port(level.path, index))


def mismatches(wiring: Wiring) -> Iterator[Finding]:
    """Wires whose two ends mean different units, by `conventions.unit_of` and the blocks' `port_units`.

    Frames are compared where both blocks tell them in a `port_frames` attribute, {port name: frame}.
    """

    def look(side: str, port: Port) -> tuple[str, str, str]:
        """Full name, unit and frame of one end of a wire; "" for what is not known."""
        system = wiring.systems[port.system]
        drake_port = wiring.input_port(port) if side == "input" else wiring.output_port(port)
        name = drake_port.get_name()
        full = wiring.input_name(port) if side == "input" else wiring.output_name(port)
        frames = getattr(system, "port_frames", {})
        return full, unit_of(name, getattr(system, "port_units", None)), frames.get(name, "")

    for level in wiring.levels:
        for source, reader in _wires(level):
            if source[1].system not in wiring.systems:
                continue  # an exported input of a builder has no name yet
            name, unit, frame = look(*source)
            other, other_unit, other_frame = look(*reader)
            wire = f"{name} -> {other}"
            if unit and other_unit and unit != other_unit:
                yield warning(
                    "unit-mismatch",
                    wire,
                    f"[{unit}] is wired to [{other_unit}]; convert between them or correct port_units of one block",
                )
            if frame and other_frame and frame != other_frame:
                yield warning(
                    "frame-mismatch",
                    wire,
                    f"frame {frame} is wired to frame {other_frame}; rotate in between or correct port_frames",
                )
