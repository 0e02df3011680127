"""docs/peg_in_hole.md says what is true."""

from __future__ import annotations

import math
import re
from pathlib import Path

import pytest

from forcectl.framework.yaml_tree import parse
from forcectl.scenario.catalog import find_scenario
from forcectl.scenario.scenario import as_file, resolve

PAGE = (Path(__file__).parents[2] / "docs" / "peg_in_hole.md").read_text(encoding="utf-8")
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
    (text,) = re.findall(r"```yaml\n(.*?)```", PAGE, re.DOTALL)
    tube = parse(text, "page")["tube"]
    scenario = resolve(as_file("peg_in_hole"), "6 mm, 10 degrees", {"station.environment.parts.tube": tube})
    (given, shipped) = (
        each.station.environment.parts["tube"]
        for each in (scenario, resolve(as_file("peg_in_hole"), "6 mm, 10 degrees", {}))
    )
    assert given == shipped


def test_the_arithmetic_of_the_printed_damping():
    turn, rim = math.radians(10), 12.85e-3
    assert f"{15 * turn / 0.5:.1f} Nm" in PAGE
    assert f"{5 * rim:.3f} Nm" in PAGE
    assert f"{math.degrees(5 * rim / 15):.2f} degrees per second" in PAGE
    assert f"needs {0.2 * turn / 0.5:.2f} Nm" in PAGE
