"""Three levels of success of an assembly, on a made-up log of a plunger that goes in and a cap that is turned."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import xarray as xr
from scipy.spatial.transform import Rotation

from forcectl.analysis.assembly import AssemblyAnalysis
from forcectl.analysis.tables.motion_tables import is_motion_metric
from forcectl.analysis.tables.task_tables import ASSEMBLY_METRICS
from forcectl.errors import BadInputError

HELD, FIXED = SimpleNamespace(arm="left"), SimpleNamespace(arm="")
PARTS = {"stand": FIXED, "plunger": HELD, "cap": HELD, "tube": SimpleNamespace(arm="right"), "mount": FIXED}
SETTING: Any = SimpleNamespace(workcell=SimpleNamespace(parts=PARTS))
WORLD = Rotation.from_euler("xyz", [0.3, -0.8, 1.1])  # of everything
LEVELS = ("engaged", "full_depth", "stays")


def log(
    depth: Any,
    angle: Any,
    *,
    gap: float = 0.0,
    tilt_deg: float = 0.0,
    force: float = 7.0,
    held: Any = (0, 0),
    beside: float = 0.0,
) -> xr.Dataset:
    """Depths of the plunger [m] and angles of the cap on its mount [deg] at three times; what is held at the end."""
    depth, angle = np.broadcast_to(depth, 3), np.broadcast_to(angle, 3)
    tube, cap = np.array([0.1, 0.2, 0.3]), np.array([0.4, 0.0, 0.1])
    mounts = [Rotation.from_euler("zx", [one, tilt_deg], degrees=True) for one in angle]
    places = [[np.zeros(3), tube - [beside, 0, d], cap, tube, cap + np.array([0, 0, gap])] for d in depth]
    turns = [[Rotation.identity()] * 4 + [mount] for mount in mounts]
    position = [WORLD.apply(each).ravel() for each in places]
    orientation = [np.roll([(WORLD * turn).as_quat() for turn in each], 1, axis=1).ravel() for each in turns]
    released = [[0, 0, 0], [0, 0, 0], [1 - held[0], 1 - held[1], 0]]
    signals = {"part_position": position, "part_orientation": orientation, "part_released": released}
    return xr.Dataset(
        {name: (("time", f"{name}_rows"), np.array(values, dtype=float)) for name, values in signals.items()}
        | {"arm_contact_force": (("time", "arm"), [[0.0, 0.0], [force, 1.0], [0.0, 0.0]])},
        coords={"time": [0.0, 1.0, 2.0]},
    )


def metrics(*args: Any, **options: Any) -> dict[str, float | None]:
    return AssemblyAnalysis().metrics(log(*args, **options), SETTING)


def levels(of: str, found: dict[str, float | None]) -> tuple[float | None, ...]:
    return tuple(found[f"{of}_{level}"] for level in LEVELS)


def test_an_assembly_that_stays():
    found = metrics([0.0, 0.05, 0.095], [0.0, 10.0, 17.0], tilt_deg=2.0)
    assert set(found) == set(ASSEMBLY_METRICS)
    assert all(is_motion_metric(name) for name in found)
    assert levels("peg", found) == levels("cap", found) == levels("both", found) == (1, 1, 1)
    assert found["depth_at_end_mm"] == pytest.approx(95.0)
    assert found["cap_angle_at_end_deg"] == pytest.approx(17.0, abs=0.1)
    assert found["cap_tilt_at_end_deg"] == pytest.approx(2.0)


def test_a_plunger_beside_the_tube_is_not_inserted():
    assert levels("peg", metrics(0.096, 17.0, beside=0.03)) == (0, 0, 0)
    assert levels("peg", metrics(0.096, 17.0, beside=0.001)) == (1, 1, 1)


@pytest.mark.parametrize(
    ("depth", "expected"),
    [(0.01, (0, 0, 0)), (0.05, (1, 0, 0)), ([0.0, 0.0959, 0.09], (1, 1, 0)), (0.099, (1, 0, 0))],
)
def test_the_plunger_is_judged_by_its_depth(depth, expected):
    found = metrics(depth, 17.0)
    assert levels("peg", found) == levels("both", found) == expected
    assert levels("cap", found) == (1, 1, 1)


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        ({"angle": 15.0}, (0, 0, 0)),
        ({"angle": 17.0, "gap": 0.003}, (0, 0, 0)),
        ({"angle": 17.0, "tilt_deg": 8.0}, (1, 0, 0)),
        ({"angle": [0.0, 17.0, 12.0]}, (1, 1, 0)),
    ],
)
def test_the_cap_is_judged_by_angle_distance_and_tilt(options, expected):
    found = metrics(0.096, **options)
    assert levels("cap", found) == levels("both", found) == expected


def test_nothing_stays_that_a_hand_holds_nor_after_a_large_force():
    assert levels("both", metrics(0.096, 17.0, held=(1, 0))) == (1, 1, 0)
    assert levels("both", metrics(0.096, 17.0, held=(0, 1))) == (1, 1, 0)
    pressed = metrics(0.096, 17.0, force=18.5)
    assert (pressed["peg_stays"], pressed["cap_stays"], pressed["both_stays"]) == (1, 1, 0)


def test_parts_that_there_are_none_of_and_one_that_is_fixed_are_refused():
    with pytest.raises(BadInputError, match="peg: unknown part 'plugner': did you mean 'plunger'"):
        AssemblyAnalysis(peg="plugner").check({}, SETTING)
    with pytest.raises(BadInputError, match="cap must be a part that an arm can hold"):
        AssemblyAnalysis(cap="mount", mount="cap").check({}, SETTING)


@pytest.mark.parametrize(
    ("options", "told"),
    [
        ({"seat": 96.0}, "seat = 96.0: must be above 0 and at most 1"),
        ({"within": 0.096}, "within = 0.096: must be below seat = 0.096 m"),
        ({"lead_in": 0.12}, "lead_in = 0.12: must be below seat = 0.096 m"),
        ({"bore": "plunger"}, "bore = 'plunger': must be another part than peg"),
        ({"mount": "cap"}, "mount = 'cap': must be another part than cap"),
        ({"lock_deg": 916.0}, "lock_deg = 916.0: must be from -180 to 180"),
        ({"straight_deg": 360.0}, "straight_deg = 360.0: must be above 0 and at most 180"),
    ],
)
def test_what_no_assembly_can_be_is_refused(options, told):
    with pytest.raises(BadInputError) as error:
        AssemblyAnalysis(**options)
    assert told in str(error.value)
