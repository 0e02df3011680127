"""Closed loops beyond the step: steps down to nothing and up again, motion along the surface, adaptation, limits."""

from typing import Any

import numpy as np
import pytest
import xarray as xr
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import Adder, ConstantVectorSource, LogVectorOutput, TrajectorySource

import forcectl
from forcectl.diagrams.force_controller import build_controller
from forcectl.diagrams.model import plant_model
from forcectl.diagrams.station import StationConfig, build_station
from forcectl.diagrams.workcell import describe
from forcectl.force.adaptive_integral import AdaptiveIntegralConfig
from forcectl.force.integral import IntegralConfig
from forcectl.motion.references import SequenceConfig, held_trajectory
from forcectl.plant.contact.compliant_contact import EnvironmentConfig
from forcectl.plant.contact.contact_monitor import ContactMode
from tests.examples.station_runs import FORCE, SPRINGS, quiet_sensor
from tests.examples.stations import pressing


def simulate(fidelity: str, duration: float, scenario: dict[str, Any] | None = None, **changes: Any) -> xr.Dataset:
    """Log of a run; keys of `changes` are scenario keys with "__" for "."."""
    overrides = {name.replace("__", "."): value for name, value in changes.items()}
    overrides |= {"station.fidelity": fidelity, "duration": duration}
    return forcectl.run(scenario or {}, overrides=overrides).log.squeeze()


def values(log: xr.Dataset, name: str, start: float = 0.0, end: float = np.inf) -> np.ndarray:
    return log[name].sel(time=slice(start - 1e-9, end)).values


# --- leaving the surface and coming back -----------------------------------------------------------------------------


def pulled_away(fidelity: str, damping: float, duration: float) -> dict[str, np.ndarray]:
    """Signals of a loop whose robot is sent 8 mm off the surface from 1 s to 1.8 s, behind the controller's back."""
    environment = EnvironmentConfig(stiffness=SPRINGS, damping=damping)
    workcell = describe(pressing(fidelity=fidelity, environment=environment, force_sensor=quiet_sensor()))
    away = 8e-3 * workcell.contact.direction
    path = held_trajectory([0.0, 1.0, 1.8], np.array([0 * away, away, 0 * away]).T)
    builder = DiagramBuilder()
    force = builder.AddNamedSystem("desired", ConstantVectorSource([FORCE]))
    rest = builder.AddNamedSystem("motion", ConstantVectorSource(np.zeros(len(away))))
    pull = builder.AddNamedSystem("pull", TrajectorySource(path))
    command = builder.AddNamedSystem("command", Adder(2, len(away)))
    law = build_controller(IntegralConfig(integral_gain=1.5), plant_model(workcell))
    control = builder.AddNamedSystem("controller", law)
    station = builder.AddNamedSystem("station", build_station(workcell))
    for source, name in (
        (force.get_output_port(), "desired_force"),
        (rest.get_output_port(), "unconstrained_reference"),
        *((station.GetOutputPort(name), name) for name in ("measured_force", "motor_position", "motor_velocity")),
    ):
        builder.Connect(source, control.GetInputPort(name))
    builder.Connect(control.GetOutputPort("joint_position_command"), command.get_input_port(0))
    builder.Connect(pull.get_output_port(), command.get_input_port(1))
    builder.Connect(command.get_output_port(), station.GetInputPort("joint_position_command"))
    sinks = {
        name: LogVectorOutput(station.GetOutputPort(name), builder, 0.002)
        for name in ("contact_force", "contact_state", "contact_losses", "measured_force")
    }
    simulator = Simulator(builder.Build())
    simulator.AdvanceTo(duration)
    logs = {name: sink.FindLog(simulator.get_context()) for name, sink in sinks.items()}
    return {name: log.data()[0] for name, log in logs.items()} | {"time": logs["contact_force"].sample_times()}


@pytest.mark.parametrize(
    ("fidelity", "damping_time"),
    [
        ("OneDimensional", 0.0),
        ("Kinematic", 0.02),
        pytest.param("Multibody", 0.0, marks=pytest.mark.slow),
    ],
)
def test_a_robot_sent_away_loses_contact_and_finds_it_again(fidelity: str, damping_time: float) -> None:
    log = pulled_away(fidelity, damping_time * SPRINGS, 5.0)
    time = log["time"]
    touching, gone = (time > 0.3) & (time < 1.0), (time > 1.4) & (time < 1.79)
    assert (log["contact_state"][touching] == ContactMode.CONTACT).all()
    assert not log["contact_force"][gone].any()
    assert (log["contact_state"][gone] == ContactMode.LOST).all()
    assert abs(log["measured_force"][gone][-1]) < 0.05
    # The law went on pressing meanwhile: it comes back hard, but the contact never pulls, and the force settles.
    assert (log["contact_force"] >= 0).all()
    assert (log["contact_state"][time > 2.3] == ContactMode.CONTACT).all()
    lost = log["contact_state"] == ContactMode.LOST
    assert log["contact_losses"][-1] == np.count_nonzero(np.diff(lost.astype(int)) == 1) >= 1
    assert log["contact_force"][time > 1.8].max() > FORCE
    assert log["contact_force"][-1] == pytest.approx(FORCE, rel=0.02)


@pytest.mark.parametrize("fidelity", ["OneDimensional", "Kinematic", pytest.param("Multibody", marks=pytest.mark.slow)])
def test_zero_force_lifts_off_no_further_than_needed_and_the_next_step_is_as_good(fidelity: str) -> None:
    reference = SequenceConfig(times=[0.0, 2.0, 4.0], forces=[FORCE, 0.0, FORCE])
    log = simulate(fidelity, 6.0, reference=reference, controller__integral_gain=2.0)
    first, between, second = (values(log, "measured_force", *span) for span in ((0, 2.0), (3.8, 4.0), (4.0, 6.0)))
    assert np.abs(between).max() < 0.3
    assert values(log, "contact_force").min() >= 0
    assert second.max() == pytest.approx(first.max(), rel=0.05)
    assert second[-1] == pytest.approx(FORCE, rel=0.02)


# --- motion along the surface ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("fidelity", ["Kinematic", pytest.param("Multibody", marks=pytest.mark.slow)])
def test_moving_along_the_surface_keeps_the_force(fidelity: str) -> None:
    motion = {"direction": [1.0, 0.0, 0.0], "distance": 0.01, "speed": 0.01, "start_time": 2.0}
    log = simulate(fidelity, 3.8, {"motion": motion, "reference": {"force": FORCE}})
    still, moving = values(log, "measured_force", 1.9, 2.0), values(log, "measured_force", 2.0, 3.5)
    assert still == pytest.approx(FORCE, rel=0.02)
    assert np.abs(moving - FORCE).max() < 0.1 * FORCE
    assert values(log, "measured_force")[-1] == pytest.approx(FORCE, rel=0.02)
    assert (values(log, "contact_state", 0.5) == ContactMode.CONTACT).all()


@pytest.mark.parametrize(
    ("fidelity", "normal"),
    [("Kinematic", [0.0, 0.0, 1.0]), ("Kinematic", [1.0, 0.0, 1.0]), ("Multibody", [1.0, 0.0, 1.0])],
)
def test_the_tool_goes_where_the_motion_sends_it(fidelity: str, normal: list[float]) -> None:
    along = np.array([0.0, 1.0, 0.0])
    motion = {"direction": along.tolist(), "distance": 0.02, "speed": 0.02, "start_time": 0.5}
    log = simulate(fidelity, 2.2, {"motion": motion}, station__normal=normal)
    workcell = describe(StationConfig(fidelity=fidelity, normal=normal))
    context = workcell.robot.create_context()
    workcell.robot.set_positions(context, workcell.motor_start)
    start = workcell.robot.pose(context)
    workcell.robot.set_positions(context, values(log, "motor_position")[-1])
    moved = workcell.robot.pose(context)
    travel = moved.translation() - start.translation()
    assert travel @ along == pytest.approx(0.02, rel=0.03)
    assert abs(travel @ np.cross(along, workcell.contact.n)) < 0.03 * 0.02
    turned = (start.rotation().inverse() @ moved.rotation()).ToAngleAxis().angle()
    assert turned < np.radians(0.5)


# --- adaptation ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("fidelity", "error", "stiffness"),
    [
        ("OneDimensional", 1.25, SPRINGS),
        ("OneDimensional", 0.8, 5e4),
        ("Kinematic", 0.8, SPRINGS),
        ("Kinematic", 1.25, 5e4),
        pytest.param("Multibody", 1.25, 5e4, marks=pytest.mark.slow),
    ],
)
def test_adaptive_controller_learns_the_compliance_of_the_environment(
    fidelity: str, error: float, stiffness: float
) -> None:
    controller = AdaptiveIntegralConfig(compliance_error=error, integral_gain=1.5)
    log = simulate(
        fidelity, 3.0, controller=controller, station__environment__stiffness=stiffness, station__normal=[0.0, 0.0, 1.0]
    )
    estimate = values(log, "environment_compliance") * stiffness
    assert estimate[0] == pytest.approx(error)
    # What the robot's compliance is believed to be shows in the estimate of a stiff environment.
    assert estimate[-1] == pytest.approx(1.0, abs=0.02)
    assert values(log, "measured_force")[-1] == pytest.approx(FORCE, rel=0.02)


@pytest.mark.slow
def test_after_learning_a_second_step_is_that_of_the_known_compliance() -> None:
    fidelity = "Kinematic"
    start = 2.5  # of the second step [s]
    reference = SequenceConfig(times=[0.0, start], forces=[FORCE, 25.0])
    changes = {"reference": reference, "station__drive__servo__ideal": True, "station__sensors__force": quiet_sensor()}
    known = simulate(fidelity, start + 1.5, controller=IntegralConfig(integral_gain=3.0), **changes)
    for error in (0.8, 1.25):
        controller = AdaptiveIntegralConfig(integral_gain=3.0, compliance_error=error)
        learned = simulate(fidelity, start + 1.5, controller=controller, **changes)
        first, second = (
            np.abs(values(learned, "measured_force", *span) - values(known, "measured_force", *span)).max()
            for span in ((0.0, start), (start, np.inf))
        )
        assert second < 0.02 * 10.0
        assert first > second


# --- limits ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("fidelity", ["OneDimensional", pytest.param("Multibody", marks=pytest.mark.slow)])
def test_limited_command_holds_and_does_not_wind_up(fidelity: str) -> None:
    # 1.5 mm into the springs are about 8 N; the reference asks for 15 N, then for 4 N.
    reference = SequenceConfig(times=[0.0, 1.2], forces=[FORCE, 4.0])
    limit = 1.5e-3
    controller = IntegralConfig(integral_gain=3.0, lower_limit=-limit)
    log = simulate(fidelity, 2.7, reference=reference, controller=controller, preset="linear")
    command, force = values(log, "displacement_command"), values(log, "measured_force")
    assert command.min() == pytest.approx(-limit)
    stiffness = 1 / (1 / SPRINGS + describe(StationConfig(fidelity=fidelity)).contact.robot_compliance)
    assert values(log, "measured_force", 1.1, 1.2) == pytest.approx(limit * stiffness, rel=0.02)
    # A wound-up integral would keep pressing; this one leaves the limit in the first tick after the step.
    after = values(log, "displacement_command", 1.2, 1.21)
    assert after[2] > -limit
    assert force[-1] == pytest.approx(4.0, rel=0.03)
