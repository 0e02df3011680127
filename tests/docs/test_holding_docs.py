"""docs/holding.md says what is true."""

import re
import sys

import numpy as np
import pytest

import forcectl as fc
from forcectl.framework.yaml_tree import parse
from tests.examples.pages import blocks, page_text

PAGE = page_text("holding.md")
SCENARIO, LETTING_GO = blocks(PAGE, "yaml")
(CODE,) = blocks(PAGE, "python")


@pytest.mark.slow
def test_a_plunger_in_one_hand_and_a_tube_in_the_other_that_lets_go():
    log = fc.run(parse(SCENARIO, "holding.yaml")).log
    assert log["part_position"].attrs["units"] == "m"
    place, released = log["part_position"].values, log["part_released"].values
    assert not released[:, 0].any()
    np.testing.assert_array_equal(released[:, 1], log["time"].values > 0.2 + 1e-9)  # what the tick there decides
    # The hand of the tube stands: the tube moves by its sag, then falls freely for 0.1 s.
    assert np.abs(place[:50, 3:] - place[0, 3:]).max() < 5e-4  # [m]
    fall = place[-1, 5] - place[50, 5]
    assert abs(fall + 0.5 * 9.81 * 0.1**2) < 1.5e-3  # [m], a step of 1 ms is 1 mm of that
    # The plunger goes with its hand, and nothing touches.
    assert np.linalg.norm(place[-1, :3] - place[0, :3]) > 5e-3
    assert not log["body_contact_wrench"].values.any()
    assert not log["tip_wrench"].values.any()


@pytest.mark.slow
def test_the_contact_without_meshes_is_built_from_its_line():
    """Beside parts that do not touch it changes nothing."""
    (seat,) = re.findall(r"`(seat: !PegInBore {.*?})`", PAGE)
    tube, short = "      tube: !Part\n", {"duration": 0.04}  # cut short before the tube is released
    assert tube in SCENARIO
    texts = (SCENARIO, SCENARIO.replace(tube, f"      {seat}\n{tube}"))
    logs = [fc.run(parse(text, "holding.yaml"), overrides=short).log for text in texts]
    np.testing.assert_array_equal(logs[1]["part_position"].values, logs[0]["part_position"].values)


def test_a_controller_of_ones_own_opens_a_hand_and_closes_it(tmp_path, monkeypatch):
    (tmp_path / "my_grippers.py").write_text(CODE)
    monkeypatch.chdir(tmp_path)
    try:
        log = fc.run(parse(LETTING_GO, "letting_go.yaml")).log
    finally:
        sys.modules.pop("my_grippers", None)
    time, holds, height = log["time"].values, log["gripper_holds"].values, log["part_position"].values[:, 2]
    free = (time > 0.1 + 1e-9) & (time < 0.12 + 1e-9)
    assert not holds[:, 0].any()  # nothing is in the left hand
    np.testing.assert_array_equal(holds[:, 1], ~free)
    np.testing.assert_array_equal(log["part_released"].values, free)
    fall = height[time > 0.1999][0] - height[time < 0.101][-1]
    # Free for 20 ms; the fingers stop it within a millimetre.
    assert -0.5 * 9.81 * 0.02**2 - 1e-3 < fall < -0.5 * 9.81 * 0.02**2
