"""Rows of the table of faults, from logs made by hand."""

import numpy as np
import pytest
import xarray as xr

import forcectl as fc
from forcectl.sweeps.faults.declared import chosen
from forcectl.sweeps.faults.response import response_of

TIME = 0.002 * np.arange(1000)
(NAN,) = chosen("nan")
(STIFFER,) = chosen("stiffness x10")


@pytest.fixture(scope="module")
def scenario():
    return fc.load_scenario({}, overrides={"station.fidelity": "OneDimensional", "guard.maximum_force": 20.0})


def row(scenario, force, status=0.0, command=0.0, fault=NAN, findings=(), sound=()):
    signals = {"contact_force": force, "status": status, "displacement_command": command, "desired_force": 15.0}
    log = xr.Dataset({name: ("time", value + np.zeros(1000)) for name, value in signals.items()}, {"time": TIME})
    return response_of("Integral", fault, scenario, log, 1.0, findings, sound)


def test_the_time_to_a_safe_state_counts_from_the_fault(scenario):
    assert row(scenario, 15.0).safe_time == 0.0
    assert row(scenario, np.where(TIME < 1.3, 25.0, 15.0)).safe_time == pytest.approx(0.3)
    assert row(scenario, np.where(TIME < 0.9, 25.0, 15.0)).safe_time == 0.0  # before the fault
    assert row(scenario, np.where(TIME > 1.3, 25.0, 15.0)).safe_time is None


def test_peak_and_step_are_those_after_the_fault(scenario):
    force, command = np.where(TIME < 0.5, 19.0, 15.0), np.where(TIME < 0.5, 0.0, -1e-3) - 2e-4 * (TIME > 1.5)
    late = row(scenario, force, command=command)
    assert (late.peak_force, late.command_step, late.step_unit) == (15.0, pytest.approx(0.2), "mm")
    early = row(scenario, force, command=command, fault=STIFFER)
    assert (early.peak_force, early.command_step) == (19.0, pytest.approx(1.0))


def test_what_names_a_fault(scenario):
    held = np.where(TIME > 1.2, 110.0, 0.0)
    assert row(scenario, 15.0, held).named_by == ("status 1: reading",)
    assert row(scenario, 15.0, held, fault=STIFFER).named_by == ()  # a reading says nothing of the surface
    assert row(scenario, 15.0, fault=STIFFER, findings=["limit_cycle"]).named_by == ("limit_cycle",)
    assert row(scenario, 15.0, fault=STIFFER, findings=["limit_cycle"], sound=["limit_cycle"]).named_by == ()


def test_a_command_that_is_no_number_is_seen(scenario):
    assert row(scenario, 15.0).finite
    assert not row(scenario, 15.0, command=np.where(TIME[700] == TIME, np.nan, 0.0)).finite
