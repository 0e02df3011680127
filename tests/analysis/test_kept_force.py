"""A rotation under a force in a band, on a made-up log."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import xarray as xr
from pydrake.math import RotationMatrix

from forcectl.analysis.kept_force import KeptForceAnalysis
from forcectl.analysis.tables.motion_tables import is_motion_metric
from forcectl.analysis.tables.task_tables import KEPT_FORCE_METRICS
from forcectl.errors import BadInputError

ANALYSIS = KeptForceAnalysis(force=[0.2, 0.5])
SETTING: Any = SimpleNamespace(workcell=SimpleNamespace(parts={"mount": None, "table": None, "cap": None}))
TICK = 0.004


def log(force: Any = 0.4, last: int = 1) -> xr.Dataset:
    """Contact after 1 s, rotation from 2 s on with 0.1 rad/s, locked from 5 s, decided at 5.1 s, at rest at 5.2 s."""
    time = TICK * np.arange(1501)
    mode = np.select([time < 2.0 - 1e-9, time < 5.1 - 1e-9, time < 5.2 - 1e-9], [0, 1, 2], 3)
    speed = np.where((mode == 1) | (mode == 2), 0.1, 0.0)
    angle = np.concatenate([[0.0], np.cumsum(speed[:-1]) * TICK])
    position, velocity, wrench = (np.zeros((len(time), 6)) for _ in range(3))
    position[:, 5], velocity[:, 5] = angle, speed
    # Turned about their axes otherwise, and 0.02 rad askew.
    mount = RotationMatrix.MakeXRotation(0.7)
    cap = mount @ RotationMatrix.MakeZRotation(1.0) @ RotationMatrix.MakeYRotation(0.02)
    turns = [each.ToQuaternion().wxyz() for each in (mount, RotationMatrix(), cap)]
    wrench[:, 5] = np.where(time < 1.0, 0.0, force(time) if callable(force) else force)
    wrench[:, 2] = -5.0 * np.maximum(angle - 0.3, 0.0)
    signals = {"transition": mode, "transition_value": np.zeros(len(time)), "machine_end": np.where(mode == 3, last, 0)}
    flags = {"flag_meanings": "compliant rotation stopping end"}
    return xr.Dataset(
        {name: ("time", values) for name, values in signals.items()}
        | {"mode": ("time", mode, flags)}
        | {
            name: (("time", f"{name}_component"), values)
            for name, values in (
                ("task_position", position),
                ("task_velocity", velocity),
                ("body_contact_wrench", wrench),
                ("part_orientation", np.tile(np.concatenate(turns), (len(time), 1))),
            )
        },
        coords={"time": time},
    )


def metrics(**options: Any) -> dict[str, float | None]:
    return ANALYSIS.metrics(log(**options), SETTING)


def test_a_force_in_the_band():
    found = metrics()
    assert set(found) == set(KEPT_FORCE_METRICS)
    assert all(is_motion_metric(name) for name in found)
    assert found["contact_s"] == pytest.approx(1.0)
    assert found["force_at_switch_N"] == found["force_min_N"] == found["force_max_N"] == 0.4
    assert found["tilt_at_switch_deg"] == pytest.approx(np.degrees(0.02))
    assert (found["in_band_pct"], found["lost_pct"]) == (100.0, 0.0)
    assert found["turning_rad_s"] == pytest.approx(0.1)
    assert found["turning_error_pct"] == pytest.approx(0.0, abs=1e-9)
    assert found["turned_rad"] == pytest.approx(0.31, abs=1e-6)
    assert found["torque_at_decision_Nm"] == pytest.approx(0.05, abs=1e-6)
    assert found["turned_after_decision_rad"] == pytest.approx(0.01, abs=1e-6)
    assert found["turned_past_lock_rad"] == pytest.approx(0.02 - 0.02 / 5, abs=1e-3)
    assert found["torque_max_Nm"] == pytest.approx(0.1, abs=1e-6)


def test_what_is_outside_after_the_first_moment_and_what_is_lost():
    """A tenth of the rest of the rotation is above the band; the contact is lost in the part that is left out."""
    found = metrics(force=lambda t: np.select([t < 2.1, t < 2.2, t < 2.49], [0.4, 0.0, 0.6], 0.3))
    assert found["in_band_pct"] == pytest.approx(90.0, abs=0.2)
    assert found["lost_pct"] == pytest.approx(100 * 0.1 / 3.1, abs=0.2)
    assert (found["force_min_N"], found["force_max_N"]) == (0.3, 0.6)


def test_without_a_lock_or_a_rotation_there_are_no_numbers_of_it():
    found = metrics(last=2)
    assert found["in_band_pct"] == 100.0
    assert {found[name] for name in ("torque_at_decision_Nm", "turned_past_lock_rad", "torque_max_Nm")} == {None}
    never = KeptForceAnalysis(mode="other", force=[0.2, 0.5]).metrics(log(), SETTING)
    assert never.pop("contact_s") == pytest.approx(1.0)
    assert never.pop("decided_in_the_air") == 0.0
    assert set(never.values()) == {None}


def test_a_figure_of_it_and_a_band_the_wrong_way_round():
    (figure,) = ANALYSIS.figures(log(), None, "Title").values()
    force = figure.axes[0]
    (curve,) = [line for line in force.lines if len(line.get_xdata()) > 2]
    assert curve.get_xdata()[0] == pytest.approx(-1.0)  # from the beginning of the rotation
    assert {line.get_ydata()[0] for line in force.lines if len(line.get_xdata()) == 2} == {0.2, 0.5}
    with pytest.raises(BadInputError, match=r"force = .*: must be the smaller one first"):
        KeptForceAnalysis(force=[0.5, 0.2])
    with pytest.raises(BadInputError, match=r"parts\.1 = 'cap': must be another one than those before it"):
        KeptForceAnalysis(force=[0.2, 0.5], parts=["cap", "cap"])


def test_a_rotation_that_begins_without_contact_was_decided_in_the_air():
    analysis = KeptForceAnalysis(force=[0.2, 0.5], on_contact=["rotation", "stopping"])
    assert analysis.metrics(log(), SETTING)["decided_in_the_air"] == 0.0
    late = log(force=lambda t: np.where(t < 3.0, 0.0, 0.4))
    assert analysis.metrics(late, SETTING)["decided_in_the_air"] == 1.0


def test_parts_that_there_are_none_of():
    with pytest.raises(BadInputError, match=r"parts\.0: unknown part 'lid': known: mount, table, cap"):
        KeptForceAnalysis(force=[0.2, 0.5], parts=["lid", "mount"]).check({}, SETTING)
