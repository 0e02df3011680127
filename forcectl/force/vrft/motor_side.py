"""VRFT on motor positions while an experiment runs; equations: `forcectl.tuning.motor_positions`."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import Adder, MatrixGain

from forcectl.framework.batch import batch_values
from forcectl.framework.block import PythonDiagram
from forcectl.framework.wiring import split, through
from forcectl.plant.drives.position_loop import PositionLoop
from forcectl.tuning.motor_positions import DriveFilter


class MotorSideRecord(PythonDiagram):
    """Input and output of n experiments with the effect of friction left out: x_m + C_R_hat (h y) and h y.

    ```
    name: MotorSideRecord
    input_ports: [measured_force, motor_displacement]
    output_ports: [input, output]
    ```

    measured_force: shape (n,), y [N], zero before the first sample.
    motor_displacement: shape (n,), x_m [m].
    input: shape (n,) [m]. Feedthrough of motor_displacement.
    output: shape (n,), h y [N]. State, no direct feedthrough.

    Sampling: every `period` [s]; h has the delay of the position loop on purpose.

    Args:
        size: n.
        robot_compliance: C_R_hat of (4.12), a number or shape (n,) [m/N].
        drive: h, the nominal filter of the joint references.
        period: tick [s].
    """

    def __init__(self, size: int, robot_compliance: ArrayLike, drive: DriveFilter, period: float):
        super().__init__()
        self.port_units = {"input": "m", "output": "N"}
        builder = DiagramBuilder()
        lagged = PositionLoop(
            size,
            bandwidth=drive.bandwidth,
            damping_ratio=drive.damping_ratio,
            period=period,
            delay=drive.delay,
            unit="N",
        )
        builder.AddNamedSystem("force_behind_h", lagged)
        force, _ = split(builder, "force_and_rate", [size, size], lagged.GetOutputPort("reference"))
        compliance = MatrixGain(np.diag(batch_values("robot_compliance", robot_compliance, size)))
        fed_back = through(builder, "compensation", compliance, force)
        acted = builder.AddNamedSystem("acted", Adder(2, size))
        builder.Connect(fed_back, acted.get_input_port(1))
        builder.ExportInput(lagged.GetInputPort("command"), "measured_force")
        builder.ExportInput(acted.get_input_port(0), "motor_displacement")
        builder.ExportOutput(acted.get_output_port(), "input")
        builder.ExportOutput(force, "output")
        builder.BuildInto(self)
