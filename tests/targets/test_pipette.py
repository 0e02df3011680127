"""What goes wrong in `pipette` while it fetches ends in a mode that says so; the whole run is judged by its targets."""

from typing import Any

import pytest

import forcectl as fc
from forcectl.analysis.transitions import stays

PARTS = "station.environment.parts"
FAULTS: dict[str, tuple[dict[str, Any], list[str], str]] = {
    # 8 mm beyond what a closing gripper reaches, and one search in place of five.
    "no plunger": (
        {
            f"{PARTS}.plunger.lies_at": [0.43, 0.343, 0.08],
            "controller.modes.take_plunger.exits.1.when": "visits > 1 and time > 0.3",
            "controller.modes.search_plunger.exits.0.when": "time > 0.3",
        },
        ["reach_plunger", "take_plunger", "search_plunger", "take_plunger"],
        "no_plunger",
    ),
    "a lost plunger": (
        {f"{PARTS}.plunger.grasp.released_at": 0.8},
        ["reach_plunger", "take_plunger", "lift_plunger"],
        "lost",
    ),
}


@pytest.mark.slow
@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_while_fetching_ends_in_a_named_failure(fault: str) -> None:
    overrides, way, end = FAULTS[fault]
    short = {"duration": 4.0, "after_end": 0.0, "expect": []}
    log = fc.run("pipette", variant="6 mm, 10 degrees", overrides=overrides | short).log
    assert [stay.mode for stay in stays(log)] == [*way, end]
    assert stays(log)[-1].kind == 2
    assert float(log["arm_contact_force"].max()) < 18.0


@pytest.mark.slow
@pytest.mark.parametrize("seed", [3, 7])
def test_the_mouth_of_a_body_beside_its_place_is_found(seed: int) -> None:
    """The seed draws the direction. Pressed on the rim all along, tip and rim hold each other in both."""
    beside = {f"{PARTS}.tube.misplaced.offset": 0.013, f"{PARTS}.tube.misplaced.tilt_deg": 5.0}
    found = {"controller.modes.other_side.exits.2.to": "assembled"}  # ends there
    short = {"duration": 16.5, "after_end": 0.0, "expect": []}
    log = fc.run("pipette", variant="6 mm, 10 degrees", seed=seed, overrides=beside | found | short).log
    way = [stay.mode for stay in stays(log)]
    searched = ["approach", "taring", "compliant", "align", "withdraw", "search_bore", "compliant"]
    assert way[way.index("approach") :][: len(searched)] == searched
    assert set(way[way.index("search_bore") + 1 : -3]) <= {"compliant", "align"}
    assert way[-3:] == ["one_side", "other_side", "assembled"]
    assert float(log["arm_contact_force"].max()) < 18.0


@pytest.mark.slow
def test_a_plunger_beside_the_body_is_not_taken_for_one_in_its_bore() -> None:
    """The tip goes down freely and meets the hand where the seat would be; only one side resists before."""
    beside = {f"{PARTS}.tube.misplaced.offset": 0.033}
    once = {"controller.modes.other_side.on_timeout": "jammed", "controller.modes.one_side.on_timeout": "jammed"}
    short = {"duration": 7.0, "after_end": 0.0, "expect": []}
    log = fc.run("pipette", variant="6 mm, 10 degrees", seed=7, overrides=beside | once | short).log
    way = [stay.mode for stay in stays(log)]
    assert way[way.index("compliant") : way.index("one_side") + 1] == ["compliant", "one_side"]
    assert way[-1] == "jammed"
    assert float(log["arm_contact_force"].max()) < 18.0
