"""docs/peg_in_hole.md says what is true."""

import math

import numpy as np
import pytest

from forcectl.framework.yaml_tree import parse
from forcectl.scenario.catalog import find_scenario
from forcectl.scenario.scenario import as_file, resolve
from tests.examples.joint_interface_runs import torque_elsewhere
from tests.examples.pages import blocks, page_text

PAGE = page_text("peg_in_hole.md")
METRICS = ("seated_after_s", "lateral_force_N", "axial_force_N")


def test_the_figures_are_those_of_the_experiment():
    table = PAGE.split("| variant | seated")[1].split("\n\n")[0].splitlines()[2:]
    rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in table]
    expected = {
        (line["variant"], line["metric"]): line["expected"] for line in find_scenario("peg_in_hole").tree["expect"]
    }
    assert [row[0] for row in rows] == list(find_scenario("peg_in_hole").tree["variants"])
    for variant, *figures in rows:
        for metric, figure in zip(METRICS, figures, strict=True):
            assert float(figure) == pytest.approx(expected[variant, metric], abs=0.05)


def test_the_misalignment_of_the_page_is_one_of_a_part():
    (text,) = blocks(PAGE, "yaml")
    tube = parse(text, "page")["tube"]
    scenario = resolve(as_file("peg_in_hole"), "6 mm, 10 degrees", {"station.environment.parts.tube": tube})
    (given, shipped) = (
        each.station.environment.parts["tube"]
        for each in (scenario, resolve(as_file("peg_in_hole"), "6 mm, 10 degrees", {}))
    )
    assert given == shipped


def test_the_pushes_that_are_noticed():
    tree = find_scenario("peg_in_hole").tree
    (guard,) = (line["when"] for line in tree["controller"]["always"] if line["to"] == "pushed")
    assert guard == "torque_elsewhere.left > 0.6 or torque_elsewhere.right > 0.6"
    torque = torque_elsewhere(tree["station"]["posture_deg"])
    needed = {link: min(0.6 / torque[side, link][0] for side in ("left", "right")) for link in (2, 7, 3, 4, 5)}
    text = " ".join(PAGE.split("**What `pushed` does not notice.**")[1].split("\n\n")[0].split())
    for link, digits in ((3, 1), (4, 1), (7, 0), (5, 0)):
        assert f"{needed[link]:.{digits}f} N at `link_{link}`" in text
    assert f"(`link_2`) {needed[2]:.0f} N" in text
    elbow = 0.6 / np.array([torque[side, link][1:] for side in ("left", "right") for link in (3, 4)])
    across, along = elbow[:, 1], elbow[:, [0, 2]]
    assert f"{along.min():.0f} to {along.max():.0f} N along x or z" in text
    assert f"{across.min():.0f} to {across.max():.0f} N along y" in text


def test_the_arithmetic_of_the_printed_damping():
    turn, rim = math.radians(10), 12.85e-3
    assert f"{15 * turn / 0.5:.1f} Nm" in PAGE
    assert f"{5 * rim:.3f} Nm" in PAGE
    assert f"{math.degrees(5 * rim / 15):.2f} degrees per second" in PAGE
    assert f"needs {0.2 * turn / 0.5:.2f} Nm" in PAGE
