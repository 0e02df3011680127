"""What the tests of the law of relative degree 4 share: the law, and the plant it assumes (3.61)."""

from functools import lru_cache

import numpy as np
import pytest
from pydrake.systems.framework import Diagram, DiagramBuilder
from pydrake.systems.primitives import LinearSystem

from forcectl.analysis.force_metrics import Step, settling_time
from forcectl.force.invariance.fourth_degree import (
    FourthDegreeForceLaw,
)
from forcectl.framework.linear_batch import interleave
from forcectl.plant.drives.position_loop import second_order, zero_order_hold
from forcectl.testing import Log, run_diagram

PERIOD, C, W, GAMMA, FORCE = 0.002, 1e-4, 12.6, -1e5, 15.0
both_forms = pytest.mark.parametrize("form", ["model", "difference"])


def law(size: int = 1, **changed: object) -> FourthDegreeForceLaw:
    return FourthDegreeForceLaw(
        size, **{"gamma": GAMMA, "alpha": 3.0, "bandwidth": W, "compliance": C, "period": PERIOD, **changed}
    )


def ideal_loop(block: FourthDegreeForceLaw, bandwidth: float = W) -> Diagram:
    """(3.61): F = -h(s) dx_bar/C for a command that is held, without loss of contact. Input desired_force."""
    builder = DiagramBuilder()
    builder.AddSystem(block)
    n = block.size
    a, b = zero_order_hold(*second_order(bandwidth, 1.0), PERIOD)
    output = np.hstack([-np.eye(n) / C, np.zeros((n, n))])
    sampled = LinearSystem(interleave([a] * n), interleave([b] * n), output, np.zeros((n, n)), PERIOD)
    plant = builder.AddSystem(sampled)
    builder.Connect(block.GetOutputPort("displacement_command"), plant.get_input_port())
    builder.Connect(plant.get_output_port(), block.GetInputPort("measured_force"))
    builder.ExportInput(block.GetInputPort("desired_force"), "desired_force")
    builder.ExportOutput(plant.get_output_port(), "force")
    for name in ("displacement_command", "invariance_function", "status"):
        builder.ExportOutput(block.GetOutputPort(name), name)
    return builder.Build()


@lru_cache(maxsize=64)
def ideal(alpha: float, form: str = "model", ratio: float = 1.0, bandwidth: float = W, duration: float = 4.0) -> Log:
    """A step of 15 N; `ratio` is C_T_hat/C_T."""
    block = law(alpha=alpha, compliance=ratio * C, derivatives=form, bandwidth=bandwidth)
    return run_diagram(ideal_loop(block, bandwidth), duration, period=PERIOD, inputs={"desired_force": FORCE})


def the_step(log: Log, target: float = FORCE, start: float = 0.0) -> Step:
    return Step(0, len(log.time), 0.0, start, target)


def settled(log: Log, band: float = 0.02) -> float | None:
    return settling_time(log.time, log["force"][:, 0], the_step(log), band)
