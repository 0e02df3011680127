"""The multibody station over its range of environments: stable, and not a matter of the step."""

from typing import Any

import numpy as np
import pytest
import xarray as xr

from forcectl.diagrams.station import build_station
from forcectl.diagrams.workcell import describe
from forcectl.errors import BadInputError
from forcectl.plant.contact.compliant_contact import EnvironmentConfig
from tests.examples.station_runs import FORCE, closed_loop, multibody, signal

SOFT, STIFF = 1e3, 1e6  # [N/m]
# The ends of the range without damping and with much of it, a little of it in between.
ENVIRONMENTS = [(SOFT, 0.0), (STIFF, 0.0), (3e4, 1e-3), (SOFT, 2e-2), (STIFF, 2e-2)]


def press(stiffness: float, damping_time: float, duration: float = 4.0, **changes: Any) -> xr.Dataset:
    return closed_loop(
        station__fidelity="Multibody",
        station__environment__stiffness=stiffness,
        station__environment__damping=damping_time * stiffness,
        controller__integral_gain=1.5,
        duration=duration,
        **changes,
    )


def assert_settled(log: xr.Dataset) -> None:
    """At the reference, with nothing growing: the last second is calmer than the second before."""
    for name in ("contact_force", "measured_force"):
        force = signal(log, name)
        assert np.isfinite(force).all()
        assert force.max() < 1.1 * FORCE
        assert force[-1] == pytest.approx(FORCE, rel=0.02)
        quiet = np.ptp(force[-500:])
        assert quiet < 0.02 * FORCE
        assert quiet <= np.ptp(force[-1000:-500]) + 0.005 * FORCE


@pytest.mark.slow
@pytest.mark.parametrize(("stiffness", "damping_time"), ENVIRONMENTS)
def test_environments_are_stable_at_the_default_step(stiffness: float, damping_time: float) -> None:
    assert_settled(press(stiffness, damping_time))


@pytest.mark.slow
@pytest.mark.parametrize("stiffness", [SOFT, STIFF])
@pytest.mark.parametrize("damping_time", [0.0, 2e-2])
def test_half_the_step_gives_the_same_force(stiffness: float, damping_time: float) -> None:
    """While the force rises, which is when it depends on the step."""
    rising = press(stiffness, damping_time).sel(time=slice(0.0, 1.5))
    halved = press(stiffness, damping_time, station__time_step=5e-4, duration=1.5)
    assert np.abs(signal(rising, "measured_force") - signal(halved, "measured_force")).max() < 0.01 * FORCE


@pytest.mark.slow
@pytest.mark.parametrize(("stiffness", "normal"), [(SOFT, (1.0, 0.0, 0.0)), (STIFF, (0.3, -0.8, 0.5))])
def test_other_directions_are_stable_too(stiffness: float, normal: tuple[float, ...]) -> None:
    assert_settled(press(stiffness, 0.0, station__normal=normal))


@pytest.mark.slow
@pytest.mark.parametrize(("stiffness", "friction"), [(5.9e3, 1.0), (1e5, 0.0)])
def test_rigid_joints_run_with_real_drives(stiffness: float, friction: float) -> None:
    # On stiff contacts without the elasticity of the robot the friction makes the loop hunt.
    assert_settled(press(stiffness, 0.0, station__elastic_joints=False, station__drive__servo__friction_scale=friction))


def test_stiffness_that_the_contact_cannot_have_is_refused() -> None:
    with pytest.raises(BadInputError, match=r"stiffness = 1e\+08.*below"):
        build_station(describe(multibody(elastic_joints=False, environment=EnvironmentConfig(stiffness=1e8))))


def test_tool_without_a_wrist_sensor_is_refused() -> None:
    with pytest.raises(BadInputError, match="tool"):
        build_station(describe(multibody(tool="no_such_tool")))
