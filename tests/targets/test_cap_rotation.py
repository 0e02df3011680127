"""What goes wrong in `cap_rotation` ends in a mode that says so, with small forces."""

from typing import Any

import numpy as np
import pytest

import forcectl as fc
from forcectl.analysis.transitions import stays

PARTS, MODES = "station.environment.parts", "controller.modes"
LARGEST = 10.0  # [N] above it the machine gives up
# Less time in the air: from 2 mm above, twice as fast, with a shorter tare.
SHORT = {
    f"{MODES}.approach.references.cap.z.position": 0.002,
    f"{MODES}.compliant.references.cap.z.velocity": -0.002,
    "estimators.force.tare_window": [0.4, 1.0],
}
FAULTS: dict[str, tuple[dict[str, Any], str]] = {
    "a reading of one joint is no number": (
        {"station.faults": [{"kind": "nan", "joint": "left_joint_2", "start": 0.4, "duration": 9.0}]},
        "no_reading",
    ),
    "the mount is missing": ({f"{PARTS}.mount.grasp.released_at": 0.0}, "part_lost"),
    "the cap is dropped": ({f"{PARTS}.cap.grasp.released_at": 0.5}, "part_lost"),
    "an elbow is pushed": (
        {"station.loads": [{"body": "left_link_3", "start": 0.5, "hold": 0.6, "wrenches": [[0, 0, 0, 0, 0, -30.0]]}]},
        "pushed",
    ),
    "the mount is not where the cap goes": (
        SHORT | {f"{PARTS}.mount.misplaced": {"offset": 0.04}, f"{MODES}.compliant.references.cap.z.velocity": -0.01},
        "no_contact",
    ),
    "the cap cannot be turned": (SHORT | {f"{PARTS}.lock.lock_deg": 0.0}, "jammed"),
}


@pytest.mark.slow
@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_ends_in_a_named_failure_with_small_forces(fault: str) -> None:
    overrides, mode = FAULTS[fault]
    log = fc.run("cap_rotation", variant="1450 N/m", overrides=overrides).log
    end = stays(log)[-1]
    assert (end.mode, end.kind) == (mode, 2)
    assert np.linalg.norm(log["body_contact_wrench"].values[:, 3:], axis=1).max() < LARGEST
