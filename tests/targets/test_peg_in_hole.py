"""What goes wrong in `peg_in_hole` ends in a mode that says so, with small forces."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import forcectl as fc
from forcectl.analysis.transitions import stays
from forcectl.framework.yaml_tree import parse
from forcectl.models import models_folder

TUBE, PLUNGER = "station.environment.parts.tube", "station.environment.parts.plunger"
RINGS = {"station.environment.parts.seat": parse("!PegInBore {peg: plunger, bore: tube}", "rings")}
BESIDE = {f"{TUBE}.misplaced": {"offset": 0.06, "direction_deg": 90.0}, "controller.modes.seating.timeout": 0.6}
# 0.7 s less at the start: what follows begins earlier by as much.
QUICK = {"controller.modes.settle.exits.0.when": "time > 0.3 and reached > 0.5"}
LARGEST = 18.0  # [N] above it the machine gives up
FAULTS: dict[str, tuple[dict[str, Any], str]] = {
    "a reading of one joint is no number": (
        {"station.faults": [{"kind": "nan", "joint": "left_joint_2", "start": 1.0, "duration": 9.0}]},
        "no_reading",
    ),
    "an encoder is frozen": (
        {"station.faults": [{"kind": "frozen", "joint": "left_joint_4", "start": 1.0, "duration": 9.0}]},
        "no_reading",
    ),
    "the interface is lost": ({"station.faults": [{"kind": "lost", "start": 1.0, "duration": 9.0}]}, "no_reading"),
    "the tube is missing": ({f"{TUBE}.grasp.released_at": 0.0}, "lost"),
    "the plunger is dropped": ({f"{PLUNGER}.grasp.released_at": 1.2}, "lost"),
    "an elbow is pushed": (
        {"station.loads": [{"body": "left_link_3", "start": 1.1, "hold": 0.6, "wrenches": [[0, 0, 0, 0, 0, -30.0]]}]},
        "pushed",
    ),
    "the tube is not where the plunger goes": (BESIDE, "no_seat"),
}


def last(overrides: dict[str, Any], **options: Any) -> tuple[str, float]:
    """Name of the last mode, and the largest true force between plunger and tube [N]."""
    log = fc.run("peg_in_hole", variant="3 mm, 5 degrees", overrides=QUICK | overrides | options).log
    force = np.linalg.norm(log["body_contact_wrench"].values[:, 3:], axis=1).max()
    end = stays(log)[-1]
    assert end.kind == 2
    return end.mode, float(force)


@pytest.mark.slow
@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_ends_in_a_named_failure_with_small_forces(fault: str) -> None:
    overrides, mode = FAULTS[fault]
    ended, force = last(RINGS | overrides)
    assert ended == mode
    assert force < LARGEST


@pytest.mark.slow
def test_a_bore_that_is_too_narrow_jams(tmp_path: Path) -> None:
    """The shapes of both parts, the tube a tenth narrower than the plunger needs."""
    folder = models_folder() / "parts"
    model = (folder / "pipette_body.urdf").read_text()
    mesh = f'<mesh filename="{folder}/meshes/pipette_body.obj" scale="0.9 0.9 1"/>'
    (tmp_path / "narrow.urdf").write_text(model.replace('<mesh filename="meshes/pipette_body.obj"/>', mesh))
    ended, force = last({f"{TUBE}.model": str(tmp_path / "narrow.urdf"), "controller.modes.align.timeout": 1.0})
    assert ended == "jammed"
    assert force < LARGEST


@pytest.mark.slow
def test_a_joint_that_hardly_moves_does_not_follow_the_noise_as_the_plunger_slides() -> None:
    """A trial of Table 6.1 in which noise at the edge of the hysteresis made 3 reversals a second without smoothing."""
    overrides = {f"{TUBE}.misplaced": {"offset": 0.003, "tilt_deg": 20.0}}
    variant = "3 mm, 5 degrees"
    metrics = fc.run("peg_in_hole", variant=variant, overrides=overrides, seed=64).metrics[variant]
    assert metrics["inserted"] == 1.0
    assert metrics["reversals_at_rest_1_s"] <= 2.0
