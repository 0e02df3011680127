"""What goes wrong in `cap_rotation` ends in a mode that says so, with small forces."""

from typing import Any

import numpy as np
import pytest

import forcectl as fc
from forcectl.analysis.transitions import Stay, stays

PARTS, MODES = "station.environment.parts", "controller.modes"
LARGEST = 10.0  # [N] above it the machine gives up
# Less time in the air: from 2 mm above, twice as fast, with a shorter tare.
SHORT = {
    f"{MODES}.approach.references.cap.z.position": 0.002,
    f"{MODES}.compliant.references.cap.z.velocity": -0.002,
    "estimators.force.tare_window": [0.4, 1.0],
}
# What is changed, the last mode, and when it begins [s].
FAULTS: dict[str, tuple[dict[str, Any], str, float]] = {
    "a reading of one joint is no number": (
        {"station.faults": [{"kind": "nan", "joint": "left_joint_2", "start": 0.4, "duration": 9.0}]},
        "no_reading",
        0.444,
    ),
    "the mount is missing": ({f"{PARTS}.mount.grasp.released_at": 0.0}, "part_lost", 0.024),
    "the cap is dropped": ({f"{PARTS}.cap.grasp.released_at": 0.5}, "part_lost", 0.524),
    "an elbow is pushed": (
        {"station.loads": [{"body": "left_link_3", "start": 0.5, "hold": 0.6, "wrenches": [[0, 0, 0, 0, 0, -30.0]]}]},
        "pushed",
        0.536,
    ),
}


def failed(overrides: dict[str, Any]) -> tuple[Stay, Any]:
    """The end, and the log from its begin on. The true force between cap and mount is small."""
    log = fc.run("cap_rotation", variant="1450 N/m", overrides=overrides).log
    end = stays(log)[-1]
    assert end.kind == 2
    assert np.linalg.norm(log["body_contact_wrench"].values[:, 3:], axis=1).max() < LARGEST
    return end, log.sel(time=slice(end.begin - 1e-9, None))


@pytest.mark.slow
@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_ends_in_a_named_failure_with_small_forces(fault: str) -> None:
    overrides, mode, begins = FAULTS[fault]
    end, _ = failed(overrides)
    assert end.mode == mode
    assert end.begin == pytest.approx(begins, abs=0.012)  # [s] three ticks


@pytest.mark.slow
def test_a_mount_that_is_not_where_the_cap_goes_is_missed_below_its_place() -> None:
    down = {f"{PARTS}.mount.misplaced": {"offset": 0.04}, f"{MODES}.compliant.references.cap.z.velocity": -0.01}
    end, after = failed(SHORT | down)
    assert end.mode == "no_contact"
    assert after["task_position"].values[0, 2] == pytest.approx(-0.004, abs=1e-4)


@pytest.mark.slow
def test_a_cap_that_cannot_be_turned_goes_back() -> None:
    end, after = failed(SHORT | {f"{PARTS}.lock.lock_deg": 0.0, "after_end": 0.6})
    assert end.mode == "jammed"
    z, psi = after["task_position"].values[:, 2], after["task_position"].values[:, 5]
    assert z[-1] - z[0] == pytest.approx(0.01, abs=5e-4)
    assert psi[0] < 0.15
