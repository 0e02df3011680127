"""docs/compliant_tasks.md says what is true."""

import dataclasses
import re
from dataclasses import dataclass

import numpy as np
import pytest

from forcectl.force.admittance import admittance_step
from forcectl.framework.reader import Reader
from forcectl.framework.yaml_tree import parse
from forcectl.tasks.compliance.force_filter import decay
from forcectl.tasks.compliance.parts import AdmittanceGainsConfig, ReferenceConfig, mode_references
from forcectl.tasks.reactive_motion import MotionLimitsConfig
from tests.examples.pages import blocks, page_text, run_python

PAGE = page_text("compliant_tasks.md")


@dataclass
class Said:
    references: dict[str, dict[str, ReferenceConfig]]


def test_the_code_prints_what_is_shown_and_the_references_fit_its_task(capsys):
    names = run_python("compliant_tasks.md")
    assert [capsys.readouterr().out] == blocks(PAGE, "text")
    (text,) = blocks(PAGE, "yaml")
    said = Reader().dataclass(Said, parse(text, "page")).references
    gains, limits = AdmittanceGainsConfig(), MotionLimitsConfig()
    made = mode_references(said, {"peg": names["peg"]}, gains=gains, limits=limits, period=0.004)
    assert made.comply.tolist() == [True, True, False, True, True]


def test_every_key_of_a_reference_is_told():
    table = PAGE.split("| key | says |")[1].split("\n\n")[0]
    told = set(re.findall(r"`(\w+)`", table))
    assert {field.name for field in dataclasses.fields(ReferenceConfig)} <= told


def test_the_stiffness_that_the_low_pass_takes():
    found = [largest_stiffness(smoothing) for smoothing in (0.0, 0.02)]
    told = re.search(r"(\d+) N/m become (\d+) N/m with 20 ms", " ".join(PAGE.split()))
    assert told is not None
    assert found == pytest.approx([float(each) for each in told.groups()], abs=5.0)


def largest_stiffness(smoothing: float) -> float:
    """Of the sampled loop of the page: estimate, low-pass, admittance, two ticks of delay, servo [N/m]."""
    H, D, period = 0.6, 36.0, 0.004
    lag, fades = decay(0.02, period), decay(smoothing, period)

    def tick(state: np.ndarray, stiffness: float) -> np.ndarray:
        x, v, smooth, estimate, first, second, moved = state
        force = estimate + fades * (smooth - estimate)
        after = admittance_step(x, v, force, H, D, period)
        felt = lag * estimate - (1.0 - lag) * stiffness * moved
        return np.array([*after, force, felt, x, first, lag * moved + (1.0 - lag) * second])

    def stable(stiffness: float) -> bool:
        loop = np.transpose([tick(row, stiffness) for row in np.eye(7)])
        return bool(np.abs(np.linalg.eigvals(loop)).max() < 1.0)

    stiffnesses = np.arange(100.0, 2000.0, 1.0)
    return float(stiffnesses[np.argmin([stable(each) for each in stiffnesses])]) - 1.0
