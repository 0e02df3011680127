"""docs/motion_loop.md says what is true."""

from __future__ import annotations

import re
import sys
import types
from pathlib import Path

import numpy as np

PAGE = (Path(__file__).parents[2] / "docs" / "motion_loop.md").read_text(encoding="utf-8")


def test_the_example_yields(monkeypatch):
    (example,) = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)
    module = types.ModuleType("page_of_the_motion_loop")
    monkeypatch.setitem(sys.modules, module.__name__, module)
    exec(compile(example, "docs/motion_loop.md", "exec"), vars(module))
    moved = np.abs(module.moved.values).max()
    assert 1e-4 < moved < 0.05


def test_the_figures_in_the_table_are_those_of_the_experiment():
    """What the page says is what the experiment expects, to the digits it says it with."""
    from forcectl.scenario.catalog import find_scenario

    expected = {line["target"]: line.get("expected") for line in find_scenario("force_estimation").tree["expect"]}
    for target, shown in (
        ("5 N static, 10 poses and 6 directions", "0.7 %"),
        ("friction 30 % off, tared, 5 N static", "3.2 %"),
        ("at rest, torque hidden, by Coulomb's friction", "0.94 tau_C"),
        ("fast motion, nothing acts", "2.4 N"),
        ("fast motion, friction 30 % off, nothing acts", "0.5 N"),
        ("sliding contact, mean force", "1.7 %"),
    ):
        number = float(shown.split()[0])
        assert abs(expected[target] - number) <= 0.05 * max(number, 1.0)
        assert shown in PAGE
