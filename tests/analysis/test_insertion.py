"""What is said of an insertion whose course is known: a made-up log of a plunger that goes into a tube."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import xarray as xr
from pydrake.math import RotationMatrix

from forcectl.analysis.insertion import InsertionAnalysis
from forcectl.analysis.slot import check_fits
from forcectl.analysis.tables.motion_tables import is_motion_metric
from forcectl.analysis.tables.task_tables import INSERTION_METRICS
from forcectl.errors import BadInputError

TICK = 0.004
SETTING: Any = SimpleNamespace(workcell=SimpleNamespace(parts={"table": None, "tube": None, "plunger": None}))
MODES = ("compliant", "stopping", "inserted", "jammed")
OUT = np.array([0.0, -0.6, 0.8])  # of the bore, in the world
ASIDE = np.array([1.0, 0.0, 0.0])


def facing(angle: float) -> Any:
    """Quaternion [w, x, y, z] of a frame whose z axis is so far from the bore's [rad]."""
    axis = np.cos(angle) * OUT + np.sin(angle) * ASIDE
    return RotationMatrix.MakeFromOneVector(axis, 2).ToQuaternion().wxyz()


def log(
    depth: Any,
    *,
    aside: float = 0.003,
    tilt: float = 0.0,
    contact: float = 0.5,
    modes: dict[float, str] | None = None,
) -> xr.Dataset:
    """Of 2 s: tip at a depth over time and aside [m], plunger askew [rad], 3, 4 and 12 N from contact on."""
    time = np.arange(0.0, 2.0, TICK)
    begins = {0.0: "compliant", 1.4: "stopping", 1.5: "inserted"} if modes is None else modes
    index = np.searchsorted(list(begins), time + 1e-9, side="right") - 1
    numbers = np.array([MODES.index(name) for name in begins.values()])[index]
    tube = np.array([0.4, 0.1, 0.2])
    tip = tube - depth(time)[:, None] * OUT + aside * ASIDE
    wrench = np.zeros((len(time), 6))
    wrench[time > contact] = [9.0, 9.0, 9.0, 3.0, -4.0, 12.0]

    def of_parts(*each: Any) -> Any:
        rows = [np.broadcast_to(one, (len(time), np.shape(one)[-1])) for one in each]
        return ("time", f"of {np.shape(each[0])[-1]}"), np.column_stack(rows)

    mode = ("time", numbers.astype(float), {"flag_meanings": " ".join(MODES)})
    return xr.Dataset(
        {
            "part_position": of_parts(np.zeros(3), tube, tip),
            "part_orientation": of_parts([1, 0, 0, 0], facing(0.0), facing(tilt)),
            "body_contact_wrench": (("time", "component"), wrench),
            "mode": mode,
            "transition": ("time", index.astype(float)),
            "transition_value": ("time", np.zeros(len(time))),
            "machine_end": ("time", np.array([0.0, 0.0, 1.0, 2.0])[numbers]),
        },
        coords={"time": time},
    )


def metrics(made: xr.Dataset, **options: Any) -> dict[str, float | None]:
    return InsertionAnalysis(seat=0.09, within=0.002, **options).metrics(made, SETTING)


def test_an_insertion():
    found = metrics(log(lambda t: np.minimum(0.1 * t, 0.091), tilt=0.1), on_contact=["stopping"])
    assert set(found) == set(INSERTION_METRICS)
    assert all(is_motion_metric(name) for name in found)
    assert found["first_contact_s"] == pytest.approx(0.504)
    assert found["seated_after_s"] == pytest.approx(0.88 - 0.504, abs=1.01 * TICK)  # 88 mm deep
    assert found["finished_after_s"] == pytest.approx(1.5 - 0.504)
    assert found["depth_mm"] == pytest.approx(91.0)
    assert found["tilt_deg"] == pytest.approx(np.degrees(0.1))
    assert found["offset_at_contact_mm"] == pytest.approx(3.0)
    assert (found["lateral_force_N"], found["axial_force_N"]) == (5.0, 12.0)
    assert (found["inserted"], found["decided_in_the_air"]) == (1.0, 0.0)


@pytest.mark.parametrize("depth", [lambda t: 0.05 + 0.0 * t, lambda t: np.where(t < 1.3, 0.09, 0.05)])
def test_a_success_of_the_machine_without_a_seat_is_none(depth):
    found = metrics(log(depth))
    assert found["seated_after_s"] is None
    assert found["inserted"] == 0.0


def test_a_plunger_beside_the_tube_is_not_seated():
    found = metrics(log(lambda t: 0.09 + 0.0 * t * t, aside=0.025))
    assert (found["seated_after_s"], found["inserted"]) == (None, 0.0)
    found = metrics(log(lambda t: np.minimum(0.1 * t, 0.09), aside=0.025), beside=0.03)
    assert found["inserted"] == 1.0


def test_a_seat_without_a_success_is_none():
    found = metrics(log(lambda t: 0.1 * t * (t < 0.9) + 0.09 * (t >= 0.9), modes={0.0: "compliant", 1.9: "jammed"}))
    assert found["seated_after_s"] is not None
    assert found["finished_after_s"] is None
    assert found["inserted"] == 0.0


def test_what_comes_after_the_success_does_not_count():
    found = metrics(log(lambda t: np.where(t < 0.8, 0.0, np.where(t < 1.6, 0.09, 0.02))))
    assert found["inserted"] == 1.0
    assert found["depth_mm"] == pytest.approx(90.0)


def test_contact_that_was_decided_in_the_air():
    made = log(
        lambda t: 0.1 * t, contact=1.0, modes={0.0: "compliant", 0.4: "stopping", 0.6: "compliant", 1.2: "stopping"}
    )
    assert metrics(made, on_contact=["stopping"])["decided_in_the_air"] == 1.0
    assert metrics(made, on_contact=[])["decided_in_the_air"] == 0.0


def test_a_plunger_that_never_touches():
    found = metrics(log(lambda t: -0.01 + 0.0 * t, contact=3.0, modes={0.0: "compliant"}))
    assert found["first_contact_s"] is None
    assert found["depth_mm"] == pytest.approx(-10.0)
    assert (found["lateral_force_N"], found["inserted"]) == (0.0, 0.0)


@pytest.mark.parametrize(("options", "key"), [({"peg": "plungr"}, "peg"), ({"bore": "tub"}, "bore")])
def test_an_unknown_part(options, key):
    with pytest.raises(BadInputError, match=f"{key}: unknown part '{options[key]}': did you mean"):
        InsertionAnalysis(**options).check({}, SETTING)


@pytest.mark.parametrize(
    ("options", "told"),
    [
        ({"seat": 96.0}, "seat = 96.0: must be above 0 and at most 1"),
        ({"beside": 10.0}, "beside = 10.0: must be above 0 and at most 1"),
        ({"within": 0.2}, "within = 0.2: must be below seat = 0.096 m"),
        ({"bore": "plunger"}, "bore = 'plunger': must be another part than peg"),
    ],
)
def test_what_no_insertion_can_be_is_refused(options, told):
    with pytest.raises(BadInputError) as error:
        InsertionAnalysis(**options)
    assert told in str(error.value)


def test_without_the_truth_of_the_contact():
    with pytest.raises(BadInputError, match="finds no body_contact_wrench: must go together with"):
        check_fits(InsertionAnalysis(), {}, SETTING)


def test_the_figure_has_the_true_forces_and_the_modes():
    figures = InsertionAnalysis().figures(log(lambda t: 0.1 * t), SETTING, "title")
    assert list(figures) == ["insertion"]
    along, across, *_, depth, _ = figures["insertion"].axes
    np.testing.assert_allclose(np.unique(along.lines[0].get_ydata()), [0.0, 12.0])
    np.testing.assert_allclose(np.unique(across.lines[0].get_ydata()), [0.0, 5.0])
    assert depth.lines[0].get_ydata().max() == pytest.approx(199.6)
    assert [text.get_text() for text in along.texts] == ["compliant", "stopping", "inserted"]
