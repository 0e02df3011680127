"""A surface that gives otherwise than the model of it: what the run shows of it, in every fidelity."""

import re
from typing import Any

import pytest

import forcectl as fc
from forcectl.analysis.findings.finding import RunFinding, Severity
from forcectl.motion.loads import LoadConfig

WORDS: Any = re.compile(r"the compliance of the surface is (.+) um/N, in the model (.+) um/N: it is (.+) times as (.+)")
STIFFNESS, MODEL = "station.environment.stiffness", "model.environment_compliance"


def told(fidelity: str, stiffness: float, model: float, **changes: Any) -> list[RunFinding]:
    """The finding of 12 N on a surface, with `model` times its compliance in the model."""
    part = {"station.fidelity": fidelity, STIFFNESS: stiffness, MODEL: model, "reference.force": 12.0, "duration": 1.2}
    part["controller.integral_gain"] = 3.0
    (found,) = fc.run({}, overrides=part | changes).findings.values()
    return [one for one in found if one.kind == "compliance_off"]


@pytest.mark.parametrize("fidelity", ["OneDimensional", "Kinematic", "Multibody"])
@pytest.mark.parametrize(("stiffness", "model", "side"), [(4e4, 10.0, "stiff"), (8e4, 0.2, "soft")])
def test_the_factor_is_that_of_the_compliances(fidelity: str, stiffness: float, model: float, side: str) -> None:
    (one,) = told(fidelity, stiffness, model)
    assert one.severity is Severity.INFO
    seen, believed, factor, found_side = WORDS.fullmatch(one.text).groups()
    # What damping and the tilt of the robot's links take is not told apart.
    assert float(seen) == pytest.approx(1e6 / stiffness, rel=0.1)
    assert float(believed) == pytest.approx(1e6 / stiffness * model, rel=0.01)
    assert float(factor) == pytest.approx(max(model, 1 / model), rel=0.1)
    assert found_side == side


@pytest.mark.parametrize("model", [0.6, 1.0, 1.8])
def test_less_than_twice_is_no_finding(model: float) -> None:
    assert told("OneDimensional", 3e4, model) == []


def test_beside_the_compliance_of_the_robot_a_stiff_surface_is_no_finding() -> None:
    assert told("OneDimensional", 5e6, 3.0) == []


@pytest.mark.parametrize(
    "changes",
    [
        {"station.environment.surface.gap": 0.05, "controller.integral_gain": 0.1},
        {"motion.distance": 0.05, "motion.start_time": 0.0},
        {"station.environment.surface.moves": [{"start": 0.5, "distance": 1e-3, "duration": 0.1}]},
    ],
)
def test_what_the_way_does_not_show_is_not_told(changes: dict[str, Any]) -> None:
    assert told("OneDimensional", 3e4, 10.0, **changes) == []


def test_a_damped_surface_and_one_that_is_touched_later_are_measured_as_well() -> None:
    touched = {"station.environment.surface.gap": 1e-3, "station.environment.damping": 100.0}
    (one,) = told("OneDimensional", 2e4, 4.0, **touched)
    assert float(WORDS.fullmatch(one.text)[3]) == pytest.approx(4.0, rel=0.1)


def test_a_push_on_the_tool_is_no_compliance() -> None:
    push = LoadConfig(start=0.6, hold=0.3, wrenches=[[0.0, 0.0, 0.0, 15.0, 15.0, -15.0]])
    assert told("Multibody", 6e4, 1.0, **{"station.loads": [push]}) == []
