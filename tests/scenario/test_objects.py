"""Objects given from Python are used themselves, whatever is done with the scenario that holds them."""

from __future__ import annotations

from dataclasses import dataclass, field

import pytest
from pydrake.systems.framework import Diagram

import forcectl as fc
from forcectl.diagrams.station import StationConfig
from forcectl.estimation.force_estimator import ForceEstimatorConfig
from forcectl.force.integral import IntegralConfig
from forcectl.motion.joint_path import JointMovesConfig
from forcectl.motion.references import StepConfig
from forcectl.motion.tangential import TangentialMotionConfig
from forcectl.plant.contact.compliant_contact import EnvironmentConfig
from forcectl.scenario.motion_scenario import MotionScenario
from forcectl.scenario.scenario import Scenario, load_scenario


@dataclass(kw_only=True)
class MyConfig(IntegralConfig):
    """Not a tag of ours."""

    added = 0

    def add_to(self, builder, facts):
        type(self).added += 1
        law = super().add_to(builder, facts)
        law.set_name("mine")
        return law


@dataclass(kw_only=True)
class StiffEnvironment(EnvironmentConfig):
    """An environment of the user's: always 7 kN/m."""

    stiffness: float = 7e3


@dataclass(kw_only=True)
class MyStep(StepConfig):
    """A reference of the user's."""

    def add_to(self, builder, size):
        source = super().add_to(builder, size)
        source.set_name("my_step")
        return source


@dataclass(kw_only=True)
class MyEstimator(ForceEstimatorConfig):
    """An estimator of the user's."""

    def add_to(self, builder, facts):
        block = super().add_to(builder, facts)
        block.set_name("my_estimator")
        return block


@dataclass(kw_only=True)
class MyMoves(JointMovesConfig):
    """A motion controller of the user's."""

    def add_to(self, builder, facts):
        block = super().add_to(builder, facts)
        block.set_name("my_moves")
        return block


@dataclass(kw_only=True)
class MyTangential(TangentialMotionConfig):
    """A motion of the user's."""

    def add_to(self, builder, *rest):
        block = super().add_to(builder, *rest)
        block.set_name("my_motion")
        return block


@dataclass
class MyAnalysis:
    """An analysis of the user's."""

    seen: list = field(default_factory=list)

    def metrics(self, log, facts):
        self.seen.append(log.sizes["time"])
        return {"samples": float(log.sizes["time"])}

    def figures(self, log, facts, title):
        return {}


def names(system: Diagram, path: str = "") -> list[str]:
    found = []
    for block in system.GetSystems():
        found.append(f"{path}{block.get_name()}:{type(block).__name__}")
        if isinstance(block, Diagram):
            found += names(block, f"{path}{block.get_name()}/")
    return found


FORCE = {
    "controller": (MyConfig, "mine"),
    "reference": (MyStep, "my_step"),
    "motion": (MyTangential, "my_motion"),
}
MOTION = {"controller": (MyMoves, "my_moves"), "estimator": (MyEstimator, "my_estimator")}
CASES = [(Scenario, *item) for item in FORCE.items()] + [(MotionScenario, *item) for item in MOTION.items()]


@pytest.mark.parametrize(("kind", "slot", "filler"), CASES)
def test_run_and_build_make_the_same_blocks_of_a_users_object(kind, slot, filler):
    cls, block = filler
    scenario = kind(duration=0.02, **{slot: cls()})
    built = names(fc.build(scenario).diagram)
    assert any(name.split("/")[-1].startswith(f"{block}:") for name in built)
    assert names(fc.run(scenario).diagram) == built
    base = {"duration": 0.02} if kind is Scenario else {"duration": 0.02, "loop": "motion"}
    assert names(fc.run(base, overrides={slot: cls()}).diagram) == built
    assert names(fc.build(load_scenario(base | {slot: cls()})).diagram) == built


@pytest.mark.parametrize("fidelity", ["OneDimensional", "Kinematic", "Multibody"])
def test_a_subclass_of_an_environment_is_kept(fidelity):
    station = StationConfig(fidelity=fidelity, environment=StiffEnvironment())
    scenario = load_scenario({"station": station, "duration": 0.02})
    assert scenario.station.environment is station.environment
    assert fc.build(scenario).true_compliance == fc.build(Scenario(station=station)).true_compliance


def test_an_override_changes_a_copy_of_the_object_and_keeps_its_class():
    given = MyConfig(integral_gain=1.0)
    scenario = load_scenario({"controller": given}, overrides={"controller.integral_gain": 2.5})
    assert type(scenario.controller) is MyConfig
    assert scenario.controller.integral_gain == 2.5
    assert given.integral_gain == 1.0


def test_a_change_inside_of_a_given_station_keeps_its_parts():
    station = StationConfig(environment=StiffEnvironment(), stiffness_scale=2.0)
    scenario = load_scenario({"station": station}, overrides={"station.environment.damping": 3.0})
    assert type(scenario.station.environment) is StiffEnvironment
    assert (scenario.station.environment.stiffness, scenario.station.environment.damping) == (7e3, 3.0)
    assert scenario.station.stiffness_scale == 2.0


def test_an_override_within_a_part_given_as_a_tag_in_text_keeps_the_tag():
    for text in ("!ForceEstimator", "ForceEstimator"):
        scenario = load_scenario({"loop": "motion", "estimator": text}, overrides={"estimator.gain": 40.0})
        assert type(scenario.estimator) is ForceEstimatorConfig
        assert scenario.estimator.gain == 40.0


def test_an_analysis_of_the_users_is_called(tmp_path):
    mine = MyAnalysis()
    result = fc.run(MotionScenario(duration=0.02, analysis=mine))
    assert mine.seen == [6]
    assert result.metrics["default"]["samples"] == 6.0


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (object(), r"controller = <object object at .*>: must be a tag, or an object with the method add_to"),
        (MyConfig, r"controller = <class .*>: must be an object, not a class"),
    ],
)
def test_an_object_that_does_not_fit_is_refused(value, text):
    with pytest.raises(fc.BadInputError, match=text):
        load_scenario({"controller": value})


def test_an_object_of_the_wrong_class_is_refused_at_a_place_for_one_class():
    with pytest.raises(fc.BadInputError, match=r"station = .*: must be a mapping, or an object of class StationConfig"):
        load_scenario({"station": EnvironmentConfig()})


def test_the_run_directory_names_the_class_of_a_users_object(tmp_path):
    scenario = Scenario(duration=0.02, controller=MyConfig(integral_gain=1.25))
    fc.run(scenario, out=tmp_path / "run")
    text = (tmp_path / "run" / "scenario.yaml").read_text()
    assert "!Import" in text
    assert f"{__name__}:MyConfig" in text
    assert "1.25" in text
    again = load_scenario(tmp_path / "run" / "scenario.yaml")
    assert names(fc.build(again).diagram) == names(fc.build(scenario).diagram)
