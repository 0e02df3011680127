"""VRFT gains that follow the compliance: over several materials in one run, against every fixed controller."""

import math
from typing import Any

import numpy as np
import pytest
import xarray as xr

import forcectl
from forcectl.errors import BadInputError
from forcectl.force.vrft.scaled import ScaledVrftConfig
from forcectl.plant.contact.surface_materials import MATERIALS
from tests.examples.experiment_runs import run_variant

SURFACE = "station.environment.surface"


def shipped(variant: str) -> xr.Dataset:
    """Log of the shipped experiment, over plastic, wood and aluminium."""
    return run_variant("multi_material", variant).log


def error(variant: str) -> float:
    """From aluminium to plastic, the way back of the shipped experiment, which tests of it run anyway [N]."""
    segments = [
        {"material": "aluminium", "start": -0.05, "end": 0.04},
        {"material": "plastic", "start": 0.04, "end": 0.17},
    ]
    changes = {f"{SURFACE}.materials.segments": segments, "duration": 16.0}
    result = forcectl.run("multi_material", variant=variant, overrides=changes, fidelity="Kinematic")
    return float(result.metrics[variant]["run_model_error_sd_N"])


def signal(log: xr.Dataset, name: str) -> np.ndarray:
    return np.asarray(log[name].squeeze().values)


@pytest.mark.slow
def test_it_finds_the_compliance_of_each_material_on_the_way() -> None:
    log = shipped("adaptive")
    time, found = signal(log, "time"), signal(log, "environment_compliance")
    for when, name in ((7.5, "plastic"), (15.5, "wood"), (23.5, "aluminium")):
        # By less than what 3 um of roughness are beside the 80 um of 12 N on plastic, and by what the posture changes.
        assert np.interp(when, time, found) == pytest.approx(1 / MATERIALS[name], rel=0.25), name


@pytest.mark.slow
def test_the_gains_are_those_of_the_compliance() -> None:
    log = shipped("adaptive")
    compliance, kp, ki, kd = (
        signal(log, name)
        for name in ("environment_compliance", "proportional_gain", "integral_gain", "derivative_gain")
    )
    np.testing.assert_allclose(ki, -1.5 * compliance, rtol=1e-12)
    np.testing.assert_allclose(kd / kp, kd[0] / kp[0], rtol=1e-9)
    slope = np.polyfit(compliance, kp, 1)
    np.testing.assert_allclose(np.polyval(slope, compliance), kp, rtol=1e-6)
    assert [kp[0], ki[0]] == pytest.approx([-1.527e-5, -6.724e-6], rel=1e-9)
    assert slope[1] / slope[0] == pytest.approx(3.2e-5, rel=0.15)  # C_R


@pytest.mark.slow
def test_the_command_bends_and_does_not_jump_when_gains_change() -> None:
    """Where the gains change fastest the command moves no more from tick to tick than with fixed gains."""
    adaptive, fixed = (
        np.abs(np.diff(signal(shipped(v), "displacement_command"))) for v in ("adaptive", "fixed, of wood")
    )
    steps = [round(t / 0.002) for t in (0.0, 1.0, 2.5, 4.5, 6.0, 9.0, 10.5, 12.5, 14.0, 17.0, 18.5, 20.5, 22.0)]
    away = np.ones(len(adaptive), dtype=bool)
    for step in steps:
        away[max(step - 2, 0) : step + 2] = False
    assert adaptive[away].max() < 2 * fixed[away].max()


@pytest.mark.slow
def test_at_rest_it_keeps_its_gains_over_all_materials() -> None:
    """A constant force tells nothing: whatever the surface does, the gains of the start stay."""
    rest = {"reference.times": [0.0], "reference.forces": [12.0], "duration": 9.0}
    rest |= {"motion.start_time": 3.0, "motion.speed": 0.02}
    log = forcectl.run("multi_material", variant="adaptive", overrides=rest, fidelity="Kinematic").log
    assert np.ptp(signal(log, "integral_gain")[signal(log, "time") > 3.0]) == 0.0


@pytest.mark.slow
def test_it_tracks_better_than_the_fixed_gains_of_any_material_on_the_way_back() -> None:
    """From the largest compliance to the smallest, with the gains of the smallest at the start."""
    adaptive = error("adaptive")
    for name in ("plastic", "wood", "aluminium"):
        assert adaptive < 0.9 * error(f"fixed, of {name}")


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("drift_bandwidth", 0.0),
        ("surface_deviation", 0.0),
        ("memory", 0.0),
        ("minimum_excitation", -1.0),
        ("minimum_force", math.nan),
        ("gain_range", 0.5),
        ("gain_rate", 0.0),
        ("fir", [1e-6]),
        ("proportional_gain", 0.0),
        ("integral_gain", 0.0),
    ],
)
def test_bad_values_are_refused_by_name(name: str, value: Any) -> None:
    with pytest.raises(BadInputError, match=name):
        ScaledVrftConfig(**{name: value})
