"""Small wiring helpers for the diagrams."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.framework import DiagramBuilder, OutputPort, System
from pydrake.systems.primitives import AffineSystem

Matrix = NDArray[np.float64]


def affine(gain: Matrix, offset: Matrix) -> AffineSystem:
    """y = gain u + offset, without state."""
    outputs, inputs = gain.shape
    empty = np.zeros((0, 0))
    return AffineSystem(empty, np.zeros((0, inputs)), np.zeros(0), np.zeros((outputs, 0)), gain, offset, 0.0)


def export_outputs(builder: DiagramBuilder, ports: Mapping[str, OutputPort]) -> None:
    """Export the ports under their names, in this order."""
    for name, port in ports.items():
        builder.ExportOutput(port, name)


def input_names(system: System) -> set[str]:
    """Names of the input ports."""
    return {system.get_input_port(i).get_name() for i in range(system.num_input_ports())}


def output_names(system: System) -> set[str]:
    """Names of the output ports."""
    return {system.get_output_port(i).get_name() for i in range(system.num_output_ports())}
