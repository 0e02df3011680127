"""docs/from_a_public_urdf.md says what is true: its parameters complete a public arm, and its scenarios run."""

import numpy as np
import pytest

import forcectl as fc
from forcectl.framework.yaml_tree import parse
from forcectl.runs.robots.report import examine_robot
from tests.examples.pages import blocks, page_text
from tests.examples.public_robots import write_public_robot

pytestmark = pytest.mark.slow

PAGE = page_text("from_a_public_urdf.md")
(PARAMETERS,) = blocks(PAGE, "text")
PRESS, REACH = blocks(PAGE, "yaml")


@pytest.fixture(autouse=True)
def arm(tmp_path, monkeypatch):
    """The arm of the page, from where its commands are given."""
    folder = write_public_robot(tmp_path)
    (folder / "arm.control.yaml").write_text(PARAMETERS)
    monkeypatch.chdir(tmp_path)
    return folder


def test_what_is_pasted_is_what_is_proposed_but_for_what_was_checked(arm):
    assert examine_robot("acme_support/urdf").complete
    (arm / "arm.control.yaml").unlink()
    proposed, pasted = parse(examine_robot(arm).yaml(), "proposed"), parse(PARAMETERS, "pasted")
    assert list(proposed) == [*pasted][: len(proposed)] or set(proposed) == set(pasted)
    checked = {"default_posture_deg", "flange_turn_deg"}
    for key in set(pasted) - checked:
        if key in ("characteristic_length", "torque_limit"):
            np.testing.assert_allclose(proposed[key], pasted[key], rtol=0.1)
        else:
            assert proposed[key] == pasted[key]


def test_it_presses():
    log = fc.run(parse(PRESS, "press.yaml")).log
    assert abs(float(log["contact_force"][-200:].mean()) - 10.0) < 1.0


def test_it_reaches():
    metrics = fc.run(parse(REACH, "reach.yaml")).metrics["default"]
    assert metrics["reach_offset_mm"] < 2.0
    assert metrics["peak_contact_force_N"] == 0.0
