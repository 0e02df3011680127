"""What goes wrong in `peg_in_hole` ends in a mode that says so, with small forces."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import forcectl as fc
from forcectl.analysis.transitions import Stay, stays
from forcectl.framework.yaml_tree import parse
from forcectl.models import models_folder

TUBE, PLUNGER = "station.environment.parts.tube", "station.environment.parts.plunger"
SEAT = "station.environment.parts.seat"
SPRINGS = {SEAT: parse("!PegInBore {peg: plunger, bore: tube}", "springs")}
BESIDE = {f"{TUBE}.misplaced": {"offset": 0.06, "direction_deg": 90.0}}
# 0.7 s less at the start: what follows begins earlier by as much.
QUICK = {"controller.modes.settle.exits.0.when": "time > 0.3 and reached > 0.5"}
LARGEST = 11.0  # [N]
BACK = 0.02  # [m]
# What is changed, the last mode, when the fault begins and how long after it that mode does [s].
FAULTS: dict[str, tuple[dict[str, Any], str, float, float]] = {
    "a reading of one joint is no number": (
        {"station.faults": [{"kind": "nan", "joint": "left_joint_2", "start": 1.0, "duration": 9.0}]},
        "no_reading",
        1.0,
        0.044,
    ),
    "an encoder is frozen": (
        {"station.faults": [{"kind": "frozen", "joint": "left_joint_4", "start": 1.0, "duration": 9.0}]},
        "no_reading",
        1.0,
        0.1,
    ),
    "an encoder of a joint that hardly moves is frozen": (
        {"station.faults": [{"kind": "frozen", "joint": "right_joint_1", "start": 1.7, "duration": 9.0}]},
        "no_reading",
        1.7,
        0.228,
    ),
    "the interface is lost": (
        {"station.faults": [{"kind": "lost", "start": 1.0, "duration": 9.0}]},
        "no_reading",
        1.0,
        0.052,
    ),
    "the tube is missing": ({f"{TUBE}.grasp.released_at": 0.0}, "lost", 0.0, 0.024),
    "the plunger is dropped": ({f"{PLUNGER}.grasp.released_at": 1.2}, "lost", 1.2, 0.024),
    "an elbow is pushed": (
        {"station.loads": [{"body": "left_link_3", "start": 1.1, "hold": 0.6, "wrenches": [[0, 0, 0, 0, 0, -30.0]]}]},
        "pushed",
        1.1,
        0.036,
    ),
    "the tube is not where the plunger goes": (BESIDE, "no_bore", 1.912, 0.5),  # from the begin of `one_side` on
}


def failed(overrides: dict[str, Any]) -> tuple[Stay, Any]:
    """The end, and the log. The true force between plunger and tube is small."""
    log = fc.run("peg_in_hole", variant="3 mm, 5 degrees", overrides=QUICK | overrides).log
    end = stays(log)[-1]
    assert end.kind == 2
    assert np.linalg.norm(log["body_contact_wrench"].values[:, 3:], axis=1).max() < LARGEST
    return end, log


def gone_back(end: Stay, log: Any) -> float:
    """How far the plunger was commanded out of the bore since the end began [m]."""
    z = log["task_position"].values[:, 2]
    return float(z[-1] - z[log["time"].values >= end.begin - 1e-9][0])


@pytest.mark.slow
@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_ends_in_a_named_failure_with_small_forces(fault: str) -> None:
    overrides, mode, begins, after = FAULTS[fault]
    end, _ = failed(SPRINGS | overrides)
    assert end.mode == mode
    assert end.begin - begins == pytest.approx(after, abs=0.012)  # [s] three ticks


@pytest.mark.slow
def test_a_force_that_is_too_large_draws_the_plunger_back() -> None:
    """The force at the seat, 7 N, stands for one that is too large: as the shipped 18 N, above what `align` presses."""
    guard = {
        "controller.always.3.when": "abs(insert_force.force_z) > 5.5",
        "controller.modes.align.references.insert.z.force": 4.0,
    }
    end, log = failed(SPRINGS | guard | {"after_end": 0.6})
    assert end.mode == "too_hard"
    assert gone_back(end, log) == pytest.approx(BACK, abs=5e-4)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("offset", "direction", "side"),
    [
        pytest.param(0.025, 0.0, "other_side", id="its outer wall resists"),
        pytest.param(0.08, 200.0, "one_side", id="only the hand is below"),
    ],
)
def test_a_plunger_beside_the_tube_is_not_inserted(offset: float, direction: float, side: str) -> None:
    """With the shapes: the tip goes down freely and would meet the hand near the depth of the seat."""
    beside = {"offset": offset, "direction_deg": direction, "tilt_deg": 5.0, "tilt_direction_deg": direction}
    log = fc.run("peg_in_hole", variant="3 mm, 5 degrees", overrides=QUICK | {f"{TUBE}.misplaced": beside}).log
    assert [stay.mode for stay in stays(log)[-2:]] == [side, "no_bore"]
    assert float(log["arm_contact_force"].max()) < 3.0  # [N]


@pytest.mark.slow
def test_a_bore_that_is_too_narrow_jams(tmp_path: Path) -> None:
    """The shapes of both parts, the tube a tenth narrower than the plunger needs."""
    folder = models_folder() / "parts"
    model = (folder / "pipette_body.urdf").read_text()
    mesh = f'<mesh filename="{folder}/meshes/pipette_body.obj" scale="0.9 0.9 1"/>'
    (tmp_path / "narrow.urdf").write_text(model.replace('<mesh filename="meshes/pipette_body.obj"/>', mesh))
    narrow = {f"{TUBE}.model": str(tmp_path / "narrow.urdf"), "controller.modes.align.timeout": 1.0}
    end, log = failed(narrow | {"after_end": 0.6})
    assert end.mode == "jammed"
    assert gone_back(end, log) == pytest.approx(BACK, abs=5e-4)


@pytest.mark.slow
def test_a_bore_that_is_less_deep_is_not_taken_for_the_right_one() -> None:
    shallow = {SEAT: parse("!PegInBore {peg: plunger, bore: tube, depth: 0.088}", "springs")}
    end, log = failed(shallow | {"after_end": 0.6})
    assert end.mode == "above_seat"
    assert gone_back(end, log) == pytest.approx(BACK, abs=5e-4)


@pytest.mark.slow
def test_a_joint_that_hardly_moves_does_not_follow_the_noise_as_the_plunger_slides() -> None:
    """A trial of Table 6.1 in which noise at the edge of the hysteresis made 3 reversals a second without smoothing."""
    overrides = {f"{TUBE}.misplaced": {"offset": 0.003, "tilt_deg": 20.0}}
    variant = "3 mm, 5 degrees"
    metrics = fc.run("peg_in_hole", variant=variant, overrides=overrides, seed=64).metrics[variant]
    assert metrics["inserted"] == 1.0
    assert metrics["reversals_at_rest_1_s"] <= 2.0
