"""Logs as labelled data: names, units, stacking, bit-exact files, and the first fault."""

import gc
import sys
from dataclasses import replace

import numpy as np
import pytest

import forcectl as fc
from forcectl.conventions import SIGNALS as CONVENTIONS
from forcectl.diagrams.log import LoggedSignal
from forcectl.runs.logs import ChunkedLog, first_fault, read_netcdf, stack, to_dataset, write_netcdf

SIGNALS = {
    "desired_force": LoggedSignal(slice(0, 1), "N", None),
    "contact_force": LoggedSignal(slice(1, 2), "N", None),
    "motor_position": LoggedSignal(slice(2, 4), "rad", ("shoulder", "elbow"), "joint"),
}


TASK = LoggedSignal(slice(0, 2), "m/s,rad/s", ("touch.z", "touch.phi"), "task_coordinate", units=("m/s", "rad/s"))


class FakeVectorLog:
    def __init__(self, times, data):
        self._times, self._data = np.asarray(times, dtype=float), np.asarray(data, dtype=float)

    def sample_times(self):
        return self._times

    def data(self):
        return self._data

    def Clear(self):
        self._times, self._data = self._times[:0], self._data[:, :0]


def samples(n=5, seed=1):
    times = 0.002 * np.arange(n)
    values = np.random.default_rng(seed).normal(size=(4, n))
    values[0] = 15.0
    return times, values


def test_the_names_of_values_stand_in_the_log_and_the_file(tmp_path):
    """Where variants have different ones no name is better than a wrong one."""
    meanings, reasons = ("press", "turn", "lost"), ("", "", "no part: why?")
    signals = {"mode": LoggedSignal(slice(0, 1), "1", None, meanings=meanings, reasons=reasons)}
    logs = [to_dataset(*samples(), signals, name) for name in ("a", "b")]
    write_netcdf(stack(logs), tmp_path / "log.nc")
    read = read_netcdf(tmp_path / "log.nc")
    assert read["mode"].attrs["flag_meanings"] == "press turn lost"
    assert read["mode"].attrs["flag_reasons"] == "lost: no part: why?"
    np.testing.assert_array_equal(read["mode"].attrs["flag_values"], [0.0, 1.0, 2.0])
    logs[1]["mode"].attrs["flag_meanings"] = "turn press lost"
    mixed = stack(logs)["mode"].attrs
    assert mixed == {"units": "1", "long_name": "mode", "comment": CONVENTIONS["mode"].meaning}


def test_the_log_says_in_which_axes_deviations_are():
    signals = {"wrench_deviation": LoggedSignal(slice(0, 4), "N", None)}
    comment = to_dataset(*samples(), signals, "a")["wrench_deviation"].attrs["comment"]
    assert comment == "standard deviations of the estimated wrenches, in the axes of each TCP"


def test_one_variant_is_one_dimensional_with_units_and_joint_names():
    times, values = samples()
    log = to_dataset(times, values, SIGNALS, "soft")
    assert log["desired_force"].dims == ("time",)
    assert log["motor_position"].dims == ("time", "joint")
    assert log["variant"].item() == "soft"
    assert list(log["joint"].values) == ["shoulder", "elbow"]
    assert log["motor_position"].attrs["units"] == "rad"
    assert log["time"].attrs["units"] == "s"
    np.testing.assert_array_equal(log["motor_position"].sel(joint="elbow"), values[3])
    assert "model_force" not in log


def test_the_reference_model_is_added_on_request():
    times, values = samples(1000)
    values[1, 0] = 0.0
    log = to_dataset(times, values, SIGNALS, "soft", model_bandwidth=2.0)
    np.testing.assert_allclose(log["model_force"], 15 * (1 - np.exp(-2.0 * times)), atol=1e-9)
    assert log["model_force"].attrs["units"] == "N"


def test_several_variants_are_stacked_and_shorter_ones_filled_up():
    a = to_dataset(*samples(5, 1), SIGNALS, "a")
    b = to_dataset(*samples(3, 2), SIGNALS, "b")
    both = stack([a, b])
    assert both["desired_force"].dims == ("variant", "time")
    assert both["motor_position"].dims == ("variant", "time", "joint")
    assert list(both["variant"].values) == ["a", "b"]
    assert np.isnan(both["desired_force"].sel(variant="b").values[3:]).all()
    assert both["motor_position"].attrs["units"] == "rad"
    np.testing.assert_array_equal(both["contact_force"].sel(variant="a"), a["contact_force"])


def test_several_units_stand_one_for_each_component():
    log = to_dataset(*samples(), {"task_velocity": TASK}, "a")
    assert log["task_velocity"].attrs["units"] == "m/s,rad/s"
    assert log["task_velocity"].attrs["component_units"] == "m/s rad/s"
    assert "component_units" not in to_dataset(*samples(), SIGNALS, "a")["motor_position"].attrs


def test_components_that_only_some_variants_have_keep_their_order():
    other = replace(TASK, labels=("touch.z", "rub.phi"))
    logs = [to_dataset(*samples(), {"task_velocity": each}, name) for name, each in (("a", TASK), ("b", other))]
    both = stack(logs)
    assert list(both["task_coordinate"].values) == ["touch.z", "touch.phi", "rub.phi"]
    for log in logs:
        for label in log["task_coordinate"].values:
            np.testing.assert_array_equal(
                both["task_velocity"].sel(variant=log["variant"], task_coordinate=label),
                log["task_velocity"].sel(task_coordinate=label),
            )


def test_files_read_back_bit_for_bit_and_the_same_log_gives_the_same_file(tmp_path):
    log = stack([to_dataset(*samples(50, i), SIGNALS, f"v{i}") for i in range(3)])
    write_netcdf(log, tmp_path / "a.nc")
    write_netcdf(log, tmp_path / "b.nc")
    assert (tmp_path / "a.nc").read_bytes() == (tmp_path / "b.nc").read_bytes()
    again = read_netcdf(tmp_path / "a.nc")
    assert again.identical(log)


def test_a_log_that_cannot_be_written_leaves_nothing_in_memory(tmp_path, monkeypatch):
    unraisable = []
    monkeypatch.setattr(sys, "unraisablehook", unraisable.append)
    with pytest.raises(OSError, match="missing") as caught:
        write_netcdf(to_dataset(*samples(), SIGNALS, "v"), tmp_path / "missing" / "log.nc")
    caught.value.__context__ = ValueError(caught.value)  # a cycle, which only the garbage collector ends
    del caught
    gc.collect()
    assert unraisable == []


def test_chunks_are_taken_once_and_a_repeated_sample_is_dropped():
    times, values = samples(6)
    log = ChunkedLog()
    first = FakeVectorLog(times[:4], values[:, :4])
    log.take(first)
    assert first.sample_times().size == 0
    log.take(FakeVectorLog(times[3:], values[:, 3:]))
    found_times, found = log.samples()
    np.testing.assert_array_equal(found_times, times)
    np.testing.assert_array_equal(found, values)
    log.cut(times[4])
    assert log.samples()[0][-1] == times[4]


@pytest.mark.parametrize(
    ("row", "column", "value", "expected"),
    [
        (1, 3, np.nan, "contact_force"),
        (3, 2, np.inf, "motor_position"),
        (1, 4, 900.0, "contact_force"),
        (1, 0, -900.0, "contact_force"),
    ],
)
def test_the_first_fault_has_signal_time_and_value(row, column, value, expected):
    times, values = samples()
    values[row, column] = value
    values[1, 4] = np.nan if column < 4 else value
    name, when, found = first_fault(times, values, SIGNALS, {"contact_force": 800.0})
    assert (name, when) == (expected, times[column])
    np.testing.assert_equal(found, value)


def test_readings_that_fail_on_purpose_may_be_no_numbers_but_commands_and_the_truth_may_not():
    times, values = samples()
    values[3, 1] = np.nan  # of motor_position, a reading
    assert first_fault(times, values, SIGNALS, {}, faulty=True) is None
    values[1, 3] = np.nan
    assert first_fault(times, values, SIGNALS, {}, faulty=True)[:2] == ("contact_force", times[3])
    values[3, 2] = np.inf
    assert first_fault(times, values, SIGNALS, {}, faulty=True)[:2] == ("motor_position", times[2])


def test_a_healthy_or_empty_log_has_no_fault():
    times, values = samples()
    assert first_fault(times, values, SIGNALS, {"contact_force": 800.0, "other": 1.0}) is None
    assert first_fault(times[:0], values[:, :0], SIGNALS, {"contact_force": 800.0}) is None


def test_torques_sticking_and_poses_of_the_tool_stand_in_the_log():
    log = fc.run("fig_2_7", overrides={"duration": 0.1}, variant="K_I = 3 1/s").log
    workcell = fc.build("fig_2_7").workcell
    assert log["spring_torque"].dims == log["stick_state"].dims == ("time", "joint")
    assert log["stick_state"].attrs["flag_meanings"] == "moves sticks"
    assert log["spring_torque"].attrs["units"] == "Nm"
    np.testing.assert_allclose(log["spring_torque"][0], workcell.gravity_torque, rtol=1e-6, atol=1e-9)
    assert log["torque_share"].dims == ("time", "joint")
    friction = workcell.robot.parameters.coulomb_friction
    held = (np.abs(workcell.gravity_torque) + friction) / workcell.robot.limits.torque
    np.testing.assert_allclose(log["torque_share"][0, :4], held[:4], rtol=1e-3)
    moved = np.diff(log["motor_position"].values, axis=0) != 0
    assert not (moved & (log["stick_state"].values[1:] == 1) & (log["stick_state"].values[:-1] == 1)).any()
    assert 0 < log["stick_state"].mean() < 1
    pose = workcell.robot.pose(workcell.robot.context_at(log["link_position"].values[-1]))
    np.testing.assert_allclose(log["tool_position"][-1], pose.translation(), atol=1e-12)
    quaternion = pose.rotation().ToQuaternion().wxyz()
    assert abs(log["tool_orientation"].values[-1] @ quaternion) == pytest.approx(1.0)
    assert [str(name) for name in log["tool_orientation_component"].values] == ["arm_w", "arm_x", "arm_y", "arm_z"]


def test_status_and_contact_state_say_what_their_values_mean():
    stops = {"controller.integral_gain": 300.0, "station.sensors.force.faults": [{"kind": "nan", "start": 0.3}]}
    log = fc.run({"duration": 0.6}, fidelity="OneDimensional", overrides=stops).log
    state, touches = log["contact_state"], log["contact_force"].values > 0.0
    assert state.attrs["flag_values"].tolist() == [0.0, 1.0, 2.0]
    assert state.attrs["flag_meanings"] == "approach contact lost"
    assert set(np.unique(state)) == {0.0, 1.0, 2.0}
    np.testing.assert_array_equal((state == 1.0)[1:], touches[:-1])
    hundreds, tens, ones = (part.split(": ")[1] for part in log["status"].attrs["comment"].split("; "))
    reaction, cause, own = (int(digit) for digit in f"{int(log['status'].max()):03}")
    assert f"{reaction} retreat" in hundreds or f"{reaction} stop" in hundreds
    assert f"{cause} reading" in tens
    assert f"{own} optimal" in ones
    assert "flag_values" not in log["status"].attrs  # it is three numbers in one
