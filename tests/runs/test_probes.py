"""The part `log` of a scenario names further outputs by path; the log says what it is of."""

import numpy as np
import pytest

import forcectl as fc
from forcectl.runs.logs import read_netcdf
from forcectl.runs.simulate_batch import batch_size

LOOP = {"title": "own", "station": {"fidelity": "Kinematic"}, "duration": 0.1}
NAMES = ["station.measured_force", "station/force_sensor.measured_wrench", "controller.joint_position_command"]


def test_named_outputs_are_logged_when_the_log_takes_its_samples():
    plain, probed = fc.run(LOOP).log, fc.run(LOOP | {"log": NAMES}).log
    for name in plain.data_vars:
        assert plain[name].identical(probed[name])
    np.testing.assert_array_equal(probed["station.measured_force"], plain["measured_force"])
    np.testing.assert_array_equal(probed["controller.joint_position_command"], plain["joint_position_command"])
    wrench = probed["station.force_sensor.measured_wrench"]
    assert (wrench.dims, wrench.attrs["units"]) == (("time", "contact_component"), "Nm,N")
    assert list(wrench["contact_component"].values)[3:] == ["force_x", "force_y", "force_z"]
    assert probed["controller.joint_position_command"].dims == ("time", "joint")
    assert not np.isnan(wrench.values).any()


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("station.mesured_force", r"^scenario: log\.0: unknown port 'station\.mesured_force'.*station\.measured_force"),
        ("nothing/of.this", r"^scenario: log\.0: unknown port"),
    ],
)
def test_an_output_that_is_not_there_is_named_with_the_nearest(name, message):
    with pytest.raises(fc.BadInputError, match=message):
        fc.build(LOOP | {"log": [name]})


def test_a_loop_with_further_outputs_runs_by_itself():
    scalar = fc.load_scenario("fig_2_8", fidelity="OneDimensional")
    named = fc.load_scenario("fig_2_8", fidelity="OneDimensional", overrides={"log": NAMES[:1]})
    assert batch_size(scalar) > 1
    assert batch_size(named) == 0


@pytest.mark.slow
def test_the_file_says_what_it_is_and_is_the_same_for_the_same_run(tmp_path, without_pictures):
    for name in ("one", "two"):
        fc.run(LOOP | {"seed": 7}, out=tmp_path / name)
    log = read_netcdf(tmp_path / "one" / "log.nc")
    assert (log.attrs["Conventions"], log.attrs["title"], log.attrs["scenario"]) == ("CF-1.11", "own", "scenario")
    assert (log.attrs["seed"], log.attrs["fidelity"]) == (7, "Kinematic")
    assert log.attrs["forcectl_version"] in log.attrs["source"]
    assert log.attrs["history"] == "forcectl run scenario, fidelity Kinematic, seed 7"
    assert log["contact_force"].attrs["comment"].startswith("true force of each surface on the tool")
    assert (tmp_path / "one/log.nc").read_bytes() == (tmp_path / "two/log.nc").read_bytes()


def test_what_is_logged_anyway_is_not_named_again():
    with pytest.raises(fc.BadInputError, match=r"log\.0 = 'measured_force': must be left out: it is logged anyway"):
        fc.build(LOOP | {"log": ["measured_force"]})
