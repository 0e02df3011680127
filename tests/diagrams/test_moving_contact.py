"""Moving contact: an uneven surface in all fidelities, its truth, and what a flat one costs (nothing)."""

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr
from pydrake.systems.analysis import Simulator

import forcectl
from forcectl.diagrams.fidelities.multibody import MultibodyStation
from forcectl.diagrams.mechanics.station_surface import surface_profile
from forcectl.diagrams.one_dimensional_loop import OneDimensionalLoopConfig
from forcectl.diagrams.station import SHIPPED_FIDELITIES, StationConfig, build_station
from forcectl.diagrams.workcell import Workcell, describe
from forcectl.errors import BadInputError
from forcectl.framework.yaml_tree import Tagged
from forcectl.plant.contact.compliant_contact import EnvironmentConfig
from forcectl.plant.contact.contact_monitor import ContactMode
from forcectl.plant.contact.surface import GrooveConfig, RoughnessConfig, SurfaceConfig
from forcectl.plant.drives.servo import ServoConfig
from forcectl.runs.replay.write import write_replay
from forcectl.scenario.trees import to_tree
from forcectl.testing import run_diagram
from tests.examples.station_runs import PERIOD, closed_loop, command_for, compliance_of, quiet_sensor, signal
from tests.examples.stations import pressing

START = 1.0  # of the motion along the surface [s]
LIGHT = ("OneDimensional", "Kinematic")
every_fidelity = pytest.mark.parametrize("fidelity", SHIPPED_FIDELITIES)


def ideal(
    fidelity: str, stiffness: float = 1e4, speed: float = 0.02, distance: float = 0.02, **surface: Any
) -> xr.Dataset:
    """A loop that differs between fidelities by nothing but how they are computed; in motion after START."""
    changes = {f"station__environment__surface__{name}": value for name, value in surface.items()}
    return closed_loop(
        preset="ideal",
        duration=START + distance / speed + 0.3,
        station__period=PERIOD,
        station__time_step=0.001,
        station__fidelity=fidelity,
        station__environment__stiffness=stiffness,
        controller__integral_gain=3.0,
        motion__distance=distance,
        motion__speed=speed,
        motion__start_time=START,
        motion__acceleration=0.2,
        **changes,
    )


class Heights(dict[str, Any]):
    """Heights by which `closed_loop` keeps its runs."""

    __hash__ = object.__hash__  # type: ignore[assignment]


HEIGHTS = Heights(grooves=GrooveConfig(positions=[0.007, 0.014], width=5e-3), roughness=RoughnessConfig(rms=3e-6))
GROOVES = {"heights": HEIGHTS}


# --- fidelities ------------------------------------------------------------------------------------------------------


def assert_all_agree(**case: Any) -> None:
    logs = {fidelity: ideal(fidelity, **case) for fidelity in SHIPPED_FIDELITIES}
    reference = logs["Kinematic"]
    moving = signal(reference, "time") > START
    felt = np.ptp(signal(reference, "contact_force")[moving])
    assert felt > 0.5  # the surface is there
    for name, log in logs.items():
        for force in ("contact_force", "measured_force"):
            expected = signal(reference, force)
            # The multibody robot follows a step of its plant later, which shows where a groove takes the force away.
            around = [np.roll(expected, shift) for shift in range(2 if name == "Multibody" else 1)]
            apart = np.abs(signal(log, force) - np.clip(signal(log, force), np.min(around, 0), np.max(around, 0))).max()
            assert apart < 0.02 * 15.0, (name, force)
            assert apart < 0.15 * felt, (name, force)


@pytest.mark.slow
@pytest.mark.parametrize(
    "case",
    [
        {"stiffness": 1e4, **GROOVES},
        {"stiffness": 1e5, "speed": 0.005, "distance": 0.0105, **GROOVES},  # slowly over one groove
        {"stiffness": 1e5, "slope": 0.004, "heights": Heights(roughness=RoughnessConfig(rms=1e-6))},
    ],
)
def test_fidelities_agree_on_an_uneven_surface(case: dict[str, Any]) -> None:
    assert_all_agree(**case)


@pytest.mark.slow
@every_fidelity
def test_the_force_is_that_of_the_spring_between_tool_and_surface(fidelity: str) -> None:
    """F = (h - dx)/C_T tick by tick, with the height that the station shows."""
    stiffness = 1e4
    log = ideal(fidelity, stiffness=stiffness, **GROOVES)
    expected = stiffness * (signal(log, "surface_height") - signal(log, "contact_displacement"))
    tolerance = 0.15 if fidelity == "Multibody" else 0.02
    np.testing.assert_allclose(signal(log, "contact_force"), np.maximum(expected, 0.0), atol=tolerance)


@every_fidelity
def test_the_height_is_the_profile_where_the_tool_is(fidelity: str) -> None:
    log = ideal(fidelity, **GROOVES)
    workcell = describe(StationConfig(fidelity=fidelity, elastic_joints=False))
    config = SurfaceConfig(heights=HEIGHTS)
    context, s = workcell.robot.create_context(), []
    workcell.robot.set_positions(context, workcell.start)
    start = workcell.robot.tip_position(context)[0]
    for q in log["motor_position"].values:
        workcell.robot.set_positions(context, q)
        s.append(workcell.robot.tip_position(context)[0] - start)
    # The constant Jacobian of one dimension and rigid joints that give a little place the tool up to 30 um elsewhere.
    np.testing.assert_allclose(signal(log, "surface_height"), config.profile(0.01).height(np.array(s)), atol=5e-6)
    assert s[-1] == pytest.approx(0.02, abs=1e-4)


# --- truth -----------------------------------------------------------------------------------------------------------


def sliding(workcell: Workcell, force: float, speed: float, duration: float) -> Any:
    """Joint command that presses with `force` [N] on the flat part and then moves along x, as a function of time."""
    row = workcell.robot.jacobian(workcell.start_context())
    along = np.linalg.solve(row, [0, 0, 0, 1, 0, 0])
    pressing = command_for(workcell, -force * compliance_of(workcell))

    def command(t: float) -> np.ndarray:
        return (
            workcell.motor_start
            + (pressing - workcell.motor_start) * min(1.0, 2 * t)
            + along * speed * max(0.0, t - 1.0)
        )

    return command


def multibody_workcell(**surface: Any) -> Workcell:
    return describe(
        pressing(
            fidelity="Multibody",
            force_sensor=quiet_sensor(),
            servo=ServoConfig(ideal=True),
            environment=EnvironmentConfig(stiffness=1e5, surface=SurfaceConfig(**surface)),
        )
    )


@pytest.mark.slow
def test_truth_of_a_moving_plate_is_the_force_of_the_contact_without_the_plates_inertia() -> None:
    """Against Drake's contact results, on a steep groove at 20 mm/s that accelerates the plate of 1.6 kg."""
    workcell = multibody_workcell(heights={"grooves": GrooveConfig(positions=[0.006], width=2e-3, depth=5e-5)})
    station = build_station(workcell)
    assert isinstance(station, MultibodyStation)
    plant, command = station.plant, sliding(workcell, 15.0, 0.02, 1.6)
    simulator = Simulator(station)
    context = simulator.get_mutable_context()
    port = station.GetInputPort("joint_position_command")
    heights, accelerations = [], []
    for k in range(801):
        port.FixValue(context, command(0.002 * k))
        simulator.AdvanceTo(0.002 * k)
        if k < 500:
            continue
        own = plant.GetMyContextFromRoot(context)
        results = plant.get_contact_results_output_port().Eval(own)
        contact = sum(
            abs(results.point_pair_contact_info(i).contact_force() @ workcell.contact.n)
            for i in range(results.num_point_pair_contacts())
        )
        truth = station.GetOutputPort("contact_force").Eval(context).item()
        assert truth == pytest.approx(contact, abs=1e-6)
        heights.append(station.GetOutputPort("surface_height").Eval(context).item())
        slide = plant.GetJointByName("surface_slide")
        accelerations.append(plant.get_generalized_acceleration_output_port(slide.model_instance()).Eval(own).item())
        assert slide.get_translation(own) == pytest.approx(heights[-1], abs=3e-6)
    assert np.ptp(heights) > 3e-5
    assert np.abs(accelerations).max() > 0.05  # 80 mN of inertia would show


def test_the_plate_of_an_uneven_surface_takes_nothing_from_the_stiffness() -> None:
    forces = []
    for slope in (0.0, 1e-12):
        workcell = multibody_workcell(slope=slope)
        target = command_for(workcell, -15.0 * compliance_of(workcell))
        run = run_diagram(build_station(workcell), 0.6, period=0.1, inputs={"joint_position_command": target})
        forces.append(run["contact_force"][-1, 0])
    assert forces[1] == pytest.approx(forces[0], rel=1e-4)
    assert forces[0] == pytest.approx(15.0, rel=0.02)


@every_fidelity
def test_no_contact_gives_zero_above_any_surface(fidelity: str) -> None:
    config = pressing(
        fidelity=fidelity,
        force_sensor=quiet_sensor(),
        environment=EnvironmentConfig(surface=SurfaceConfig(slope=-0.05, heights={"grooves": GrooveConfig()})),
    )
    workcell = describe(config)
    above = command_for(workcell, 2e-3)
    run = run_diagram(build_station(workcell), 0.4, period=0.02, inputs={"joint_position_command": above})
    np.testing.assert_allclose(run["contact_force"][5:], 0.0, atol=1e-9)
    assert (run["contact_state"][5:] != ContactMode.CONTACT).all()


# --- what it costs ---------------------------------------------------------------------------------------------------


@every_fidelity
def test_a_flat_surface_adds_no_block_and_no_port(fidelity: str) -> None:
    flat = build_station(describe(StationConfig(fidelity=fidelity)))
    uneven = build_station(
        describe(StationConfig(fidelity=fidelity, environment=EnvironmentConfig(surface=SurfaceConfig(slope=0.01))))
    )
    names = [{system.get_name() for system in station.GetSystems()} for station in (flat, uneven)]
    assert not [name for name in names[0] if "surface" in name or "path" in name or "height" in name]
    assert {"path_position", "surface_height"} <= names[1] - names[0]
    ports = [{s.get_output_port(i).get_name() for i in range(s.num_output_ports())} for s in (flat, uneven)]
    assert ports[1] - ports[0] == {"surface_height"}
    assert "surface_height" not in closed_loop(duration=0.1, station__fidelity=fidelity)


# --- scenarios -------------------------------------------------------------------------------------------------------


def refused(**overrides: Any) -> str:
    with pytest.raises(BadInputError) as error:
        forcectl.run({}, overrides={k.replace("__", "."): v for k, v in overrides.items()} | {"duration": 0.01})
    return str(error.value)


def test_bad_surfaces_are_named_with_their_full_key() -> None:
    key = "station.environment.surface"
    assert f"{key}.slope = 2.0: must be from" in refused(station__environment__surface__slope=2.0)
    surface = "station__environment__surface__heights"
    for name, wrong in (
        ("grooves.depth = -1.0: must be positive", {"grooves": {"depth": -1.0}}),
        ("roughness.seed", {"roughness": {"seed": -1}}),
        ("board.path = 'none.csv'", {"board": {"path": "none.csv"}}),
        ("a.correlation_length = 1.0: must be at most the length", {"a": {"correlation_length": 1.0}}),
    ):
        ((part, values),) = wrong.items()
        tag = {"grooves": "Grooves", "board": "ProfileFile"}.get(part, "Roughness")
        assert f"{key}.heights.{name}" in refused(**{surface: {part: Tagged(values, tag)}})
    assert f"{key}.heights.a: must have a tag: one of !Grooves" in refused(**{surface: {"a": {"depth": 1e-4}}})
    assert f"{key}.bumps" in refused(station__environment__surface__bumps=1)
    tilted = refused(station__environment__surface={"slope": 0.01, "direction": [1.0, 0.0, 1.0]})
    assert re.search(r"surface\.direction = \[1\.0, 0\.0, 1\.0\]: must be perpendicular to the normal", tilted)


def test_the_loop_without_a_robot_has_no_place_on_a_surface() -> None:
    with pytest.raises(BadInputError, match=r"environment\.surface is not flat"):
        OneDimensionalLoopConfig(environment=EnvironmentConfig(surface=SurfaceConfig(slope=0.01)))


def test_a_profile_beside_the_scenario_is_found_from_anywhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / "study"
    folder.mkdir()
    (folder / "board.csv").write_text("position,height\n-1,0\n0,0\n0.1,0.0001\n")
    (folder / "study.yaml").write_text(
        "station: {environment: {surface: {heights: {board: !ProfileFile {path: board.csv}}}}}\nduration: 0.01\n"
    )
    monkeypatch.chdir(tmp_path)
    scenario = forcectl.load_scenario(folder / "study.yaml")
    profile = surface_profile(describe(scenario.station).contact)
    assert float(profile.height(0.05)) == pytest.approx(5e-5, rel=0.01)
    # What a run writes down starts the same run again.
    assert to_tree(scenario)["station"]["environment"]["surface"]["heights"]["board"]["path"] == str(
        folder / "board.csv"
    )


@pytest.mark.slow
def test_the_replay_moves_the_plate(tmp_path: Path) -> None:
    sizes = []
    for slope in (0.0, 0.05):
        changes = {"motion.distance": 0.05, "motion.speed": 0.02, "station.environment.surface.slope": slope}
        overrides = {"station.fidelity": "Kinematic", "duration": 1.0} | changes
        workcell = describe(forcectl.load_scenario({}, overrides=overrides).station)
        log = forcectl.run({}, overrides=overrides).log.squeeze()
        write_replay(log, workcell, tmp_path / f"{slope}.html")
        sizes.append((tmp_path / f"{slope}.html").stat().st_size)
    assert sizes[1] > sizes[0] + 1000


# --- Fig. 3.6 faster --------------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("fidelity", ["Kinematic", "Multibody"])
def test_ten_times_faster(fidelity: str) -> None:
    """20 mm/s over two grooves: the loop is slower than they are, the force stays finite, contact is kept."""
    changes = {"motion.speed": 0.02, "motion.distance": 0.055, "motion.start_time": 2.5, "duration": 6.0}
    result = forcectl.run("fig_3_6", variant="plastic", fidelity=fidelity, overrides=changes)
    (values,) = result.metrics.values()
    assert values["contact_loss_s"] == 0.0
    assert values["mean_force_in_motion_N"] == pytest.approx(15.0, rel=0.02)
    assert values["recovery_time_2pct_s"] is not None


@pytest.mark.slow
@pytest.mark.parametrize("law", ["AdaptiveInvariance", "PredictiveInvariance"])
def test_a_path_far_from_the_start_of_one_dimension_is_no_slope(law: str) -> None:
    """Joints that lead the tool straight ahead have a part along the linearised normal, which nothing moves along."""
    changes = {"controller": Tagged({}, law), "duration": 6.0, "reference.force": 15.0}
    changes |= {"motion.distance": 0.1, "motion.speed": 0.05, "motion.start_time": 3.5}
    log = forcectl.run({}, overrides={"station.fidelity": "OneDimensional"} | changes).log.squeeze()
    assert log.contact_force.sel(time=slice(3.5, None)).values == pytest.approx(15.0, rel=0.02)
