"""The slot of a station: the same ports in every fidelity, and what any diagram of ours has to hold."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from pydrake.systems.analysis import InitializeParams, Simulator
from pydrake.systems.framework import Context, Diagram

import forcectl as fc
from forcectl.conventions import SIGNALS
from forcectl.diagrams.loop import Loop
from forcectl.diagrams.mechanics.assembly import STATION_INPUTS
from forcectl.diagrams.station import SHIPPED_FIDELITIES, StationConfig, build_station
from forcectl.diagrams.workcell import describe
from forcectl.doctor import Report
from forcectl.errors import BadInputError
from forcectl.force.adaptive_integral import AdaptiveIntegralConfig
from forcectl.force.integral import IntegralConfig
from forcectl.framework.yaml_tree import parse
from forcectl.plant.drives.servo import ServoConfig
from forcectl.scenario.scenario import Scenario
from forcectl.testing import (
    assert_deterministic,
    assert_feedthrough,
    assert_memory_released,
    assert_ports,
    assert_same_after_reset_and_clone,
    run_diagram,
)
from tests.examples.robot_folders import CONTROL, write_planar_robot
from tests.examples.station_runs import PERIOD, SENSOR, quiet_sensor
from tests.examples.stations import pressing

JOINTS = 6
INPUTS = {"joint_position_command": JOINTS}
OUTPUTS = {
    "motor_position": JOINTS,
    "motor_velocity": JOINTS,
    "measured_wrench": 6,
    "measured_force": 1,
    "contact_force": 1,
    "contact_displacement": 1,
    "link_position": JOINTS,
    "contact_state": 1,
    "contact_losses": 1,
}


def outputs(fidelity: str, joints: int = JOINTS) -> dict[str, int]:
    """Outputs of a station of this fidelity with their sizes; only links with dynamics have a speed."""
    sizes = {name: joints if size == JOINTS and name != "measured_wrench" else size for name, size in OUTPUTS.items()}
    return sizes | ({"link_velocity": joints} if fidelity == "Multibody" else {})


CONTROLLERS = [IntegralConfig(), AdaptiveIntegralConfig()]

every_fidelity = pytest.mark.parametrize("fidelity", SHIPPED_FIDELITIES)


def build_loop(fidelity: str, controller: object = None, seed: int = 3) -> Loop:
    return Scenario(
        station=StationConfig(fidelity=fidelity), controller=controller or IntegralConfig(integral_gain=3.0), seed=seed
    ).build()


def run_loop(loop: Loop, context: Context | None = None, duration: float = 0.3) -> np.ndarray:
    simulator = Simulator(loop.diagram, context) if context is not None else Simulator(loop.diagram)
    simulator.AdvanceTo(simulator.get_context().get_time() + duration)
    return loop.sink.FindLog(simulator.get_context()).data().copy()


@every_fidelity
@pytest.mark.parametrize("ideal", [False, True])
def test_every_fidelity_has_exactly_the_ports_of_the_slot(fidelity: str, ideal: bool) -> None:
    config = pressing(fidelity=fidelity, servo=ServoConfig(ideal=ideal), elastic_joints=not ideal)
    assert_ports(build_station(describe(config)), INPUTS, outputs(fidelity))
    assert set(INPUTS) <= set(STATION_INPUTS)
    assert set(outputs(fidelity)) <= set(SIGNALS)


@every_fidelity
def test_controller_has_exactly_the_ports_of_its_slot(fidelity: str) -> None:
    diagram = build_loop(fidelity).diagram
    inputs = {
        "desired_force": 1,
        "measured_force": 1,
        "motor_position": JOINTS,
        "motor_velocity": JOINTS,
        "unconstrained_reference": JOINTS,
    }
    outputs = {"joint_position_command": JOINTS, "displacement_command": 1, "status": 1}
    assert_ports(diagram.GetSubsystemByName("controller"), inputs, outputs)
    assert set(inputs) <= set(SIGNALS)


@every_fidelity
@pytest.mark.parametrize("ideal", [False, True])
def test_no_output_of_a_station_depends_on_the_command_of_the_same_instant(fidelity: str, ideal: bool) -> None:
    config = pressing(fidelity=fidelity, servo=ServoConfig(ideal=ideal))
    assert_feedthrough(build_station(describe(config)), [])


@every_fidelity
def test_controller_acts_at_once_on_force_reference_and_free_motion_only(fidelity: str) -> None:
    assert_feedthrough(
        build_loop(fidelity).diagram.GetSubsystemByName("controller"),
        [
            ("joint_position_command", "desired_force"),
            ("joint_position_command", "measured_force"),
            ("joint_position_command", "unconstrained_reference"),
            ("displacement_command", "desired_force"),
            ("displacement_command", "measured_force"),
            ("status", "desired_force"),
            ("status", "measured_force"),
        ],
    )


@every_fidelity
@pytest.mark.parametrize("controller", CONTROLLERS, ids=lambda c: type(c).__name__)
def test_doctor_finds_nothing_wrong_with_a_closed_loop(
    check_diagram: Callable[..., Report], fidelity: str, controller: object
) -> None:
    report = check_diagram(build_loop(fidelity, controller).diagram)
    # The tick's force makes the tick's command: the controller adds no sample of its own.
    assert report.delays[-1].total == 0.0


@every_fidelity
def test_station_runs_the_same_after_reset_and_clone(fidelity: str) -> None:
    workcell = describe(StationConfig(fidelity=fidelity))
    command = workcell.motor_start - 5e-4 * workcell.contact.direction
    log = assert_same_after_reset_and_clone(
        build_station(workcell, seed=5), duration=0.2, period=0.01, inputs={"joint_position_command": command}
    )
    assert log["contact_force"][-1, 0] > 0.1


@every_fidelity
def test_station_is_deterministic_and_its_noise_follows_the_seed(fidelity: str) -> None:
    workcell = describe(StationConfig(fidelity=fidelity))
    inputs = {"joint_position_command": workcell.motor_start - 5e-4 * workcell.contact.direction}
    first = assert_deterministic(lambda: build_station(workcell, seed=5), duration=0.1, period=0.01, inputs=inputs)
    other = run_diagram(build_station(workcell, seed=6), 0.1, period=0.01, inputs=inputs)
    assert not np.array_equal(first["measured_force"], other["measured_force"])
    np.testing.assert_array_equal(first["contact_force"], other["contact_force"])


@pytest.mark.slow
@every_fidelity
@pytest.mark.parametrize("controller", CONTROLLERS, ids=lambda c: type(c).__name__)
def test_closed_loop_repeats_bit_by_bit_also_from_a_reset_and_a_cloned_context(
    fidelity: str, controller: object
) -> None:
    loop = build_loop(fidelity, controller)
    first = run_loop(loop)
    assert np.abs(first).max() > 0.1
    np.testing.assert_array_equal(run_loop(build_loop(fidelity, controller)), first)
    np.testing.assert_array_equal(run_loop(loop), first)
    assert not np.array_equal(run_loop(build_loop(fidelity, controller, seed=4)), first)

    simulator = Simulator(loop.diagram)
    simulator.AdvanceTo(0.1)
    clone = simulator.get_context().Clone()
    simulator.AdvanceTo(0.2)
    straight = loop.sink.FindLog(simulator.get_context()).data()[:, -40:].copy()
    rest = Simulator(loop.diagram, clone)
    # A sensor is tared when a run begins, and this one goes on.
    rest.Initialize(InitializeParams(suppress_initialization_events=True))
    rest.AdvanceTo(0.2)
    np.testing.assert_array_equal(loop.sink.FindLog(rest.get_context()).data()[:, -40:], straight)


@every_fidelity
def test_noise_of_the_sensor_stays_out_of_the_truth(fidelity: str) -> None:
    workcell = describe(pressing(fidelity=fidelity, force_sensor=quiet_sensor(noise_std=0.5)))
    log = run_diagram(
        build_station(workcell), 2.0, period=0.01, inputs={"joint_position_command": workcell.motor_start}
    )
    settled = log["measured_force"][50:, 0]
    # White noise at 500 Hz behind a critically damped filter of bandwidth w: the variance falls by w T/4.
    assert settled.std() == pytest.approx(0.5 * np.sqrt(SENSOR * PERIOD / 4), rel=0.4)
    np.testing.assert_allclose(log["contact_force"], 0.0, atol=1e-6)


@every_fidelity
def test_a_robot_with_another_number_of_joints_has_ports_of_that_size(fidelity: str, tmp_path: Path) -> None:
    control = CONTROL.replace("[0, 0, 0]", "[0.1, 0.1, 0.1]")
    folder = write_planar_robot(tmp_path / "planar", control=control, finger=False)
    # Three joints about z move the tool in the plane; a force in the plane is what such a robot can control.
    config = StationConfig(fidelity=fidelity, robot=str(folder), normal=[1.0, 0.0, 0.0], period=PERIOD)
    station = build_station(describe(config))
    assert_ports(station, {"joint_position_command": 3}, outputs(fidelity, 3))


def test_a_delay_that_does_not_fit_a_robots_own_period_names_both() -> None:
    """The position loop's 2 ms, of a robot with a tick of 4 ms."""
    told = r"position_loop\.delay = 0\.002: .* whole multiple of station\.period \(null: the robot's\) = 0\.004"
    with pytest.raises(BadInputError, match=told):
        describe(StationConfig(robot="yumi/left", tool="yumi_gripper"))


def test_singular_postures_and_unknown_fidelities_are_refused_by_name() -> None:
    with pytest.raises(BadInputError, match=r"posture_deg.*singular"):
        describe(StationConfig(posture_deg=[0.0, 0.0, -90.0, 0.0, 0.0, 0.0], normal=[0.0, 1.0, 0.0]))
    with pytest.raises(BadInputError, match="fidelity"):
        StationConfig(fidelity="Multibdy")


@every_fidelity
def test_memory_is_released(fidelity: str) -> None:
    def build() -> Diagram:
        return build_loop(fidelity).diagram

    assert assert_memory_released(build, duration=0.02, builds=5, allowed_kb=500).checked_references


@pytest.mark.parametrize(
    ("surface", "station", "key"),
    [
        ("friction: 0.2", {"fidelity": "Kinematic"}, "friction"),
        ("one_sided: false", {"fidelity": "Kinematic"}, "one_sided"),
        ("surface: {turning: true, heights: {a: !Arc {}}}", {"fidelity": "OneDimensional"}, "surface.turning"),
        ("dissipation: 5.0", {"self_collision": True}, "dissipation"),
        (
            "surface: {materials: {segments: [{material: steel, stiffness: 1e7, start: 0, end: 1}]}}",
            {"elastic_joints": False},
            "surface.materials.segments.0.stiffness",
        ),
    ],
)
@pytest.mark.parametrize("place", ["environment", "environment.parts.plate"])
def test_what_a_fidelity_cannot_do_is_told_by_the_key_that_asks_for_it(surface, station, key, place):
    plate = f"!Surface {{{surface}}}"
    environment = plate if place == "environment" else f"!Parts {{parts: {{plate: {plate}}}}}"
    with pytest.raises(BadInputError, match=rf"^(scenario: )?station\.{place}\.{key} ?[=:]"):
        fc.build({"station": parse(f"environment: {environment}", "s.yaml") | station})
