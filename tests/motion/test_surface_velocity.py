"""Scenario part `!VelocityAlongSurface`: Algorithm 3 along a line on the surface, in a loop."""

from typing import Any

import numpy as np
import pytest
from pydrake.systems.framework import DiagramBuilder

import forcectl as fc
from forcectl.diagrams.station import StationConfig
from forcectl.diagrams.workcell import describe
from forcectl.errors import BadInputError
from forcectl.motion.surface_velocity import SurfaceVelocityConfig
from forcectl.testing import run_diagram

SHAPE: dict[str, Any] = {"times": [0.0, 0.5, 1.0, 1.6], "velocities": [0.02, -0.04, 0.01, 0.0], "acceleration": 0.1}


def place(times: np.ndarray, acceleration: float) -> np.ndarray:
    """Path coordinate by hand: speeds reached with the acceleration, integrated finely [m]."""
    h, v, s, found = 1e-4, 0.0, 0.0, [0.0]
    for t in np.arange(0.0, times[-1], h):
        wanted = SHAPE["velocities"][int(np.searchsorted(SHAPE["times"], t + 1e-9, side="right")) - 1]
        after = v + np.clip(wanted - v, -acceleration * h, acceleration * h)
        s, v = s + h * (v + after) / 2, after
        found.append(s)
    return np.interp(times, h * np.arange(len(found)), found)


def test_the_tool_moves_with_the_speeds_along_the_line() -> None:
    workcell = describe(StationConfig())
    builder = DiagramBuilder()
    config = SurfaceVelocityConfig(**SHAPE, direction=[0.0, 2.0, 0.0], slope=0.05)
    block = config.add_to(builder, workcell.robot, workcell.start, workcell.contact.n)
    builder.ExportOutput(block.get_output_port(), "unconstrained_reference")
    run = run_diagram(builder.Build(), 2.2, period=0.02)
    context = workcell.robot.create_context()
    tips = []
    for q in run["unconstrained_reference"]:
        workcell.robot.set_positions(context, workcell.start + q)
        tips.append(workcell.robot.tip_position(context))
    # The position of a tick is that of its end.
    s = place(run.time + workcell.period, 0.1)
    expected = np.outer(s, [0.0, 1.0, 0.05])
    np.testing.assert_allclose(
        np.array(tips) - workcell.contact.robot.pose(workcell.start_context()).translation(), expected, atol=2e-5
    )
    assert config.interval() == (0.0, 2.0)


def test_the_line_is_as_long_as_ticks_make_the_path() -> None:
    """There and back ten times, back 0.1 ms after a tick each time: seen a tick later, that makes it 1.7 mm longer."""
    workcell = describe(StationConfig())
    times = [k * workcell.period + 1e-4 * (k % 100 > 0) for k in range(0, 1050, 50)]
    speeds = [0.05, -0.05] * 10 + [0.0]
    config = SurfaceVelocityConfig(times=times, velocities=speeds, acceleration=5.0, direction=[0.0, 1.0, 0.0])
    block = config.add_to(DiagramBuilder(), workcell.robot, workcell.start, workcell.contact.n)
    run = run_diagram(block, 2.1, period=workcell.period, outputs=["generator.position", "unconstrained_reference"])
    context, tips = workcell.robot.create_context(), []
    for q in run["unconstrained_reference"][::25]:
        workcell.robot.set_positions(context, workcell.start + q)
        tips.append(workcell.robot.tip_position(context)[1])
    path = run["generator.position"][::25, 0]
    assert path.max() > 6.6e-3
    np.testing.assert_allclose(np.array(tips) - tips[0], path - path[0], atol=2e-5)


@pytest.mark.slow
def test_it_is_a_motion_of_a_scenario() -> None:
    motion = {"motion": SurfaceVelocityConfig(**SHAPE, direction=[0.0, 1.0, 0.0])}
    log = fc.run({"duration": 2.2, "station": {"fidelity": "Kinematic"}} | motion).log
    assert np.ptp(log["motor_position"].values[:, 0]) > 1e-3


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"velocities": [0.1, 0.2, 0.1, 0.1]}, "velocities"),
        ({"velocities": [0.0, 0.0, 0.0, 0.0]}, "velocities"),
        ({"velocities": []}, "velocities"),
        ({"velocities": [np.nan, 0.0, 0.0, 0.0]}, "velocities"),
        ({"times": [0.0, 1.0]}, "times"),
        ({"times": [0.0, 1.0, 1.0, 2.0]}, "times"),
        ({"times": [0.1, 0.5, 1.0, 2.0]}, "times"),
        ({"acceleration": 0.0}, "acceleration"),
        ({"direction": [0.0, 0.0]}, "direction"),
        ({"slope": 0.5}, "slope"),
    ],
)
def test_bad_values_are_refused_by_name(changes: dict[str, Any], told: str) -> None:
    with pytest.raises(BadInputError, match=told):
        SurfaceVelocityConfig(**SHAPE | changes)


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"times": [0.0, 20.0], "velocities": [0.2, 0.0]}, r"motion\.velocities"),
        (
            {"times": [0.0, 5.0], "velocities": [1e3, 0.0], "acceleration": 100.0},
            r"motion\.velocities = .* path of at most 2 m",
        ),
        ({"times": [0.0, 1e6], "velocities": [1e3, 0.0]}, r"motion takes 1\.01e\+06 s"),
        ({"direction": [0.0, 0.0, 1.0]}, r"motion\.direction"),
    ],
)
def test_a_line_that_cannot_be_gone_along_is_refused(changes: dict[str, Any], told: str) -> None:
    with pytest.raises(BadInputError, match=told):
        fc.build(fc.load_scenario({"motion": SurfaceVelocityConfig(**SHAPE | changes)}))
