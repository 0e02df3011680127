"""What is said of the log of a state machine whose way is known."""

from functools import cache
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import xarray as xr
from matplotlib.backends.backend_agg import FigureCanvasAgg
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import TrajectorySource

from forcectl.analysis.tables.metric_tables import is_metric, metric_unit
from forcectl.analysis.transitions import Stay, TransitionAnalysis, stays
from forcectl.diagrams.log import add_log
from forcectl.motion.references import held_trajectory
from forcectl.runs.logs import stack, to_dataset
from tests.examples.machines import PERIOD, peg, peg_machine

FORCES = {0.0: (0.0, 0.0), 0.05: (0.0, 1.5), 0.1: (0.0, 0.2), 0.15: (0.0, 2.0)}


@cache
def peg_log(variant: str = "") -> xr.Dataset:
    """Contact at 0.05 s, lost at 0.1 s, found again at 0.15 s; the peg is at rest from 0.2 s on."""
    builder = DiagramBuilder()
    machine = builder.AddSystem(peg_machine())
    moves = {0.0: (0.01, 1.0), 0.02: (0.0, 1.0), 0.2: (0.0, 0.0)}
    for name, steps in (("touch", FORCES), ("insert", moves)):
        values = [list(row) for row in zip(*steps.values(), strict=True)]
        source = builder.AddSystem(TrajectorySource(held_trajectory([*steps], values)))
        builder.Connect(source.get_output_port(), machine.GetInputPort(name))
    names = ("mode", "transition", "transition_value", "machine_end", "time_in_mode")
    sink, signals = add_log(builder, {name: machine.GetOutputPort(name) for name in names}, PERIOD, {})
    diagram = builder.Build()
    simulator = Simulator(diagram)
    simulator.AdvanceTo(0.6)
    found = sink.FindLog(simulator.get_context())
    return to_dataset(found.sample_times(), found.data(), signals, variant)


def metrics(log: Any) -> dict[str, float | None]:
    return TransitionAnalysis().metrics(log, None)


TIMES = ("begins", "last_begins")
WAY = ["approach", "compliant", "stopping", "compliant", "stopping", "opening", "inserted"]


def test_the_way_of_the_peg():
    found = stays(peg_log())
    assert [stay.mode for stay in found] == WAY
    # The second stay in compliant motion begins at 0.1 s, because the force is 0.2 N.
    assert found[3] == Stay("compliant", pytest.approx(0.1), pytest.approx(0.152), 0.2, 0)
    assert found[-1] == Stay("inserted", pytest.approx(0.404), pytest.approx(0.6), pytest.approx(0.204), 1)
    assert found[0].value is None
    assert {stay.reason for stay in found} == {""}
    failed = peg_log().copy()
    failed["mode"] = failed["mode"] * 0 + [*peg()].index("no_contact")
    failed["mode"].attrs = peg_log()["mode"].attrs
    assert stays(failed)[-1].reason == "nothing touched the peg: is the part there?"


def test_metrics():
    found = metrics(peg_log())
    assert found["stopping.begins_s"] == pytest.approx(0.052)  # its first time
    assert found["stopping.last_begins_s"] == pytest.approx(0.152)
    assert found["inserted.begins_s"] == pytest.approx(0.404)
    assert found["approach.begins_s"] == 0.0
    never = {name for name, value in found.items() if value is None}
    assert never == {f"{mode}.{which}_s" for mode in ("missed", "no_contact", "stuck") for which in TIMES}
    assert (found["transitions"], found["ended"]) == (6.0, 1.0)
    assert all(map(is_metric, found))
    assert {metric_unit(f"stopping.{which}_s") for which in TIMES} == {"s"}


def test_jerk_and_reversals_count_for_the_mode_they_are_in():
    """A joint that shakes with 10 Hz all the time, at rest from 0.2 s on; the speed of another jumps at 0.55 s."""
    log = peg_log()
    time = log["time"].values
    shaking = 1e-4 * np.sin(2 * np.pi * 10.0 * time)
    position = np.stack([shaking, np.zeros_like(time)], axis=1)
    speed = np.stack([np.gradient(shaking, PERIOD), np.where(time > 0.55, 0.01, 0.0)], axis=1)
    both = {"joint_position_command": position, "joint_velocity_command": speed}
    limits = SimpleNamespace(acceleration=np.array([1e6, 20.0]))
    robot = SimpleNamespace(limits=limits)
    truth = SimpleNamespace(period=PERIOD, known_robot=lambda: robot)
    given = log.assign({name: (("time", "joint"), values) for name, values in both.items()})
    found = TransitionAnalysis().metrics(given, SimpleNamespace(truth=truth))
    assert all(map(is_metric, found))
    shares = {name.partition(".")[0]: value for name, value in found.items() if name.endswith("jerk_share_1_s")}
    assert set(shares) == {*WAY, "transitions"}
    loud = {name for name, share in shares.items() if share > 1.0}
    assert loud == {"inserted"}
    assert shares["inserted"] == pytest.approx(0.01 / PERIOD**2 / 20.0)
    # 0.2 s at 20 reversals a second; of the seven transitions two are after the joint is at rest.
    assert found["inserted.reversals_at_rest_1_s"] == pytest.approx(4.0, abs=1)
    assert found["approach.reversals_at_rest_1_s"] == 0.0
    assert 2.0 <= found["transitions.reversals_at_rest_1_s"] <= 5.0


@pytest.mark.parametrize(("until", "ended"), [(0.3, 0.0), (0.41, 1.0)])
def test_how_it_ended(until, ended):
    assert metrics(peg_log().sel(time=slice(None, until)))["ended"] == ended


def test_of_a_log_without_a_machine_there_is_nothing():
    log = peg_log().drop_vars("transition")
    assert metrics(log) == {}
    assert TransitionAnalysis().figures(log, None, "") == {}


def test_the_time_line_has_the_modes_in_words_and_the_values():
    logs = stack([peg_log("first"), peg_log("second").sel(time=slice(None, 0.12))])
    figure = TransitionAnalysis().figures(logs, None, "Peg")["transitions"]
    FigureCanvasAgg(figure).draw()
    assert [axes.get_title(loc="left") for axes in figure.axes] == ["first", "second"]
    for axes, way in zip(figure.axes, (WAY, WAY[:4]), strict=True):
        assert [label.get_text() for label in axes.get_yticklabels()] == list(peg())[:5]
        rows = [list(peg()).index(mode) for mode in way]
        assert [round(bar.get_y() + bar.get_height() / 2) for bar in axes.patches] == rows
        begins = [stay.begin for stay in stays(peg_log())][: len(way)]
        assert [bar.get_x() for bar in axes.patches] == pytest.approx(begins)
        values = ["0", "1.5", "0.2", "2", "2", "0.204"][: len(way) - 1]
        assert [text.get_text() for text in axes.texts] == values
