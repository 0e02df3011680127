"""Stations on a surface of several materials: the force is that of the place, in all fidelities, and costs nothing."""

from functools import cache
from typing import Any

import numpy as np
import pytest
import xarray as xr

import forcectl
from forcectl.diagrams.one_dimensional_loop import OneDimensionalLoopConfig
from forcectl.diagrams.station import SHIPPED_FIDELITIES, StationConfig, build_station
from forcectl.diagrams.workcell import describe
from forcectl.errors import BadInputError
from forcectl.plant.contact.compliant_contact import EnvironmentConfig
from forcectl.plant.contact.surface import SurfaceConfig
from forcectl.plant.contact.surface_materials import MATERIALS, MaterialsConfig, SegmentConfig
from tests.examples.station_runs import FORCE, signal

every_fidelity = pytest.mark.parametrize("fidelity", SHIPPED_FIDELITIES)


def materials(*, blend: float = 0.004, damping: float = 0.0, height: float = 0.0) -> MaterialsConfig:
    """Plastic, from 12 mm on aluminium, from 24 mm on wood."""
    return MaterialsConfig(
        blend=blend,
        segments=[
            SegmentConfig(material="plastic", start=-0.1, end=0.012),
            SegmentConfig(material="aluminium", start=0.012, end=0.024, damping=damping),
            SegmentConfig(material="wood", start=0.024, end=0.1, height=height),
        ],
    )


def closed_loop(**changes: Any) -> xr.Dataset:
    """Log of a loop with the integral law; keys are scenario keys with "__" for "."."""
    overrides = {name.replace("__", "."): value for name, value in changes.items()}
    return forcectl.run({"reference": {"force": FORCE}}, overrides=overrides).log.squeeze()


@cache
def slide(fidelity: str, **surface: Any) -> xr.Dataset:
    """36 mm at 20 mm/s after 1 s of pressing, by a rigid robot without friction, noise or delay."""
    return closed_loop(
        preset="ideal",
        duration=3.1,
        station__fidelity=fidelity,
        station__period=0.002,
        station__time_step=0.001,
        station__environment__surface__materials=materials(**surface),
        controller__integral_gain=3.0,
        station__environment__surface__direction=[0.0, 1.0, 0.0],
        motion__direction=[0.0, 1.0, 0.0],
        motion__distance=0.036,
        motion__speed=0.02,
        motion__start_time=1.0,
        motion__acceleration=0.1,
    )


@pytest.mark.slow
@pytest.mark.parametrize("surface", [{"height": 2e-5}, {"damping": 300.0, "height": 5e-5}])
def test_fidelities_agree_on_several_materials(surface: dict[str, float]) -> None:
    logs = {fidelity: slide(fidelity, **surface) for fidelity in SHIPPED_FIDELITIES}
    expected = signal(logs["Kinematic"], "contact_force")
    # Where the speed is constant: the inertia of the robot acts in one fidelity only.
    time = signal(logs["Kinematic"], "time")
    moving = (time > 1.45) & (time < 2.8)
    assert np.ptp(expected[moving]) > 5.0  # the materials are felt
    for log in logs.values():
        # The multibody robot follows a tick later.
        around = [np.roll(expected, shift) for shift in range(2)]
        force = signal(log, "contact_force")
        apart = np.abs(force - np.clip(force, np.min(around, 0), np.max(around, 0)))
        assert apart[moving].max() < 0.01 * FORCE


@pytest.mark.slow
@every_fidelity
def test_the_force_is_stiffness_of_the_place_times_penetration(fidelity: str) -> None:
    """F = K(s) (h - dx) of a rigid robot, tick by tick, with the stiffness and height that the station shows."""
    log = slide(fidelity, height=2e-5)
    depth = signal(log, "surface_height") - signal(log, "contact_displacement")
    expected = signal(log, "surface_stiffness") * np.maximum(depth, 0.0)
    # Half a micrometre: displacement by the posture of the last renewal, and springs that stand for rigid joints.
    tolerance = {"OneDimensional": 1e-6, "Kinematic": 0.15, "Multibody": 0.25}[fidelity]
    np.testing.assert_allclose(signal(log, "contact_force"), expected, atol=tolerance)
    stiffness = signal(log, "surface_stiffness")
    assert [stiffness[0], stiffness.min(), stiffness[-1]] == [MATERIALS[n] for n in ("plastic", "aluminium", "wood")]


@every_fidelity
def test_one_material_everywhere_is_the_same_as_its_stiffness(fidelity: str) -> None:
    whole = MaterialsConfig(segments=[SegmentConfig(material="wood", start=0.0, end=0.1)])
    same = {"preset": "linear", "duration": 0.8, "station__fidelity": fidelity}
    plain = closed_loop(**same, station__environment__stiffness=MATERIALS["wood"])
    log = closed_loop(**same, station__environment__surface__materials=whole)
    tolerance = 0.05 if fidelity == "Multibody" else 1e-9  # the carrier of the surface has a mass
    np.testing.assert_allclose(signal(log, "contact_force"), signal(plain, "contact_force"), atol=tolerance)


def test_controllers_are_told_the_material_at_the_start() -> None:
    environment = EnvironmentConfig(surface=SurfaceConfig(materials=materials()))
    assert describe(StationConfig(environment=environment)).contact.environment_compliance == 1 / MATERIALS["plastic"]


@every_fidelity
def test_blocks_and_ports_are_there_only_when_used(fidelity: str) -> None:
    def station(surface: SurfaceConfig) -> Any:
        return build_station(describe(StationConfig(fidelity=fidelity, environment=EnvironmentConfig(surface=surface))))

    plain, several = station(SurfaceConfig()), station(SurfaceConfig(materials=materials(damping=10.0)))
    ports = [{s.get_output_port(i).get_name() for i in range(s.num_output_ports())} for s in (plain, several)]
    assert ports[1] - ports[0] == {"surface_stiffness", "surface_damping"}
    names = [{system.get_name() for system in s.GetSystems()} for s in (plain, several)]
    assert {"path_position", "surface_material"} <= names[1] - names[0]
    assert not any("surface" in name for name in names[0])


def test_the_loop_without_a_robot_has_no_place_on_several_materials() -> None:
    with pytest.raises(BadInputError, match=r"environment\.surface is not flat and of one material"):
        OneDimensionalLoopConfig(environment=EnvironmentConfig(surface=SurfaceConfig(materials=materials())))
