"""Every slot says in one line that something does not fit: a class, an object, and what its methods return."""

from typing import Any

import numpy as np
import pytest
from pydrake.systems.primitives import Gain

import forcectl as fc
from forcectl.errors import ForcectlError
from forcectl.framework.yaml_tree import Tagged, parse
from forcectl.motion.references import StepConfig
from forcectl.plant.sensors.joint_sensors import ReadingFault
from forcectl.scenario.catalog import CONTRACTS, SLOTS
from forcectl.tasks.coordinates import ArmTask

REACH = """
preset: ideal
station: {robot: yumi, tool: null, fidelity: Multibody, time_step: 0.002,
          drive: !JointInterface {}, sensors: {joints: !JointReadings {}}, environment: !Parts {}}
controller: !ReactiveReaching {}
"""
RECURSIVE = "controller: !RecursiveVrft {}"
# Where each slot is: a scenario around it, the key, and whether that is a list.
PLACES: dict[str, tuple[str, str, bool]] = {
    "controller": ("{}", "controller", False),
    "reference": ("{}", "reference", False),
    "motion": ("controller: !InvarianceRobot {}", "motion", False),
    "estimator": ("{}", "estimators.a", False),
    "signal": ("{}", "signals.measured_force", False),
    "analysis": ("{}", "analyses.a", False),
    "fidelity": ("{}", "station.fidelity", False),
    "drive": ("{}", "station.drive", False),
    "sensor": ("{}", "station.sensors.force", False),
    "environment": ("station: {fidelity: Kinematic}", "station.environment", False),
    "surface": ("{}", "station.environment.surface.heights.a", False),
    "load": ("station: {fidelity: Multibody}", "station.loads", True),
    "fault": (REACH, "station.faults", True),
    "excitation": (RECURSIVE, "controller.excitation", False),
    "task": (REACH, "controller.tasks.a", False),
    "constraint": (REACH, "controller.constraints", True),
    "null_space": (REACH, "controller.null_space", False),
    "potential": (REACH + "  \n", "controller.null_space", True),
}


class Nothing:
    """Has every method that a slot asks for; none returns anything."""

    first_stiffness = 1e4
    has_dynamics = constant_jacobian = False
    targets = ()

    def __getattr__(self, name: str) -> Any:
        if name in {method for methods in CONTRACTS.values() for method in methods}:
            return lambda *arguments, **named: None
        raise AttributeError(name)


def scenario(slot: str, part: Any) -> tuple[dict[str, Any], dict[str, Any]]:
    """A scenario and its overrides, with a part in a slot."""
    text, key, listed = PLACES[slot]
    value = [part] if listed else part
    if slot == "potential":
        value = Tagged({"potentials": value}, "Evasive")
    return parse(text, "test"), {key: value, "duration": 0.05}


def refusal(slot: str, part: Any) -> str:
    base, overrides = scenario(slot, part)
    with pytest.raises(ForcectlError) as caught:
        fc.run(base, overrides=overrides)
    text = str(caught.value)
    assert "\n" not in text
    return text


def test_every_slot_is_tried() -> None:
    assert set(PLACES) == set(SLOTS) == set(CONTRACTS)


@pytest.mark.parametrize("slot", PLACES)
def test_a_class_that_does_not_fit_is_refused(slot: str) -> None:
    key = PLACES[slot][1]
    path = f"{__name__}:TestNothingFits"
    assert f"{key}" in refusal(slot, Tagged({"path": path}, "Import"))
    assert f"fills the slot {slot}" in refusal(slot, Tagged({"path": path}, "Import"))


class TestNothingFits:
    """Without any method of a slot."""

    @pytest.mark.parametrize("slot", PLACES)
    def test_an_object_without_the_methods_is_refused(self, slot: str) -> None:
        assert PLACES[slot][1] in refusal(slot, object())


RETURNED = {
    "controller": "controller: add_to must return a Drake system, not NoneType",
    "reference": "reference: largest_force must return a number, not NoneType",
    "motion": "motion: add_to must return a Drake system, not NoneType",
    "estimator": "estimators.a: add_to must return a Drake system, not NoneType",
    "signal": "signals.measured_force: choose must return an output port, not NoneType",
    "analysis": "analyses.a: metrics must return a mapping, not NoneType",
    "fidelity": "station.fidelity: build must return a Diagram, not NoneType",
    "drive": "station.drive: add_to must return a Drake system, not NoneType",
    "sensor": "station.sensors.force: add_to must return a Drake system, not NoneType",
    "environment": "station.environment: add_to must return a Drake system, not NoneType",
    "surface": "heights.a: heights(s) must return finite numbers of shape (20001,), like s, not shape ()",
    "load": "station.loads.0: cannot be built: AttributeError",
    "fault": "station.faults.0: fault must return a ReadingFault, not NoneType",
    "excitation": "controller.excitation: cannot be built: TypeError",
    "task": "controller.tasks.a: task must return an ArmTask, not NoneType",
    "constraint": "controller.constraints.0: constraint must return an object with relative_degree",
    "null_space": "controller.null_space: criterion must return an object with cost(motion, period), not NoneType",
    "potential": "controller.null_space.potentials.0: potentials must return a list, not NoneType",
}


@pytest.mark.parametrize("slot", PLACES)
def test_what_methods_return_is_looked_at(slot: str) -> None:
    assert RETURNED[slot] in refusal(slot, Nothing())


@pytest.mark.parametrize("slot", ["controller", "reference", "motion", "estimator", "drive", "sensor", "environment"])
def test_a_system_that_is_not_added_is_told_of_the_part(slot: str) -> None:
    class Built(Nothing):
        first_stiffness = 1e4

        def add_to(self, *arguments: Any, **named: Any) -> Gain:
            return Gain(1.0, 1)

        def largest_force(self) -> float:
            return 5.0

    assert "add_to must return a system that it has added to the builder it is given" in refusal(slot, Built())


@pytest.mark.parametrize("needs", [["contact_force"], "contact_force"])
def test_needs_that_are_no_mapping_are_told_of_the_analysis(needs: Any) -> None:
    part = Nothing()
    part.needs = needs  # type: ignore[attr-defined]
    assert f"analyses.a.needs = {needs!r}: must be a mapping" in refusal("analysis", part)


class Fault:
    """Says that the readings fail so."""

    def __init__(self, *values: Any):
        self.values = values

    def fault(self, joints: Any) -> ReadingFault:
        return ReadingFault(*self.values)


@pytest.mark.parametrize(
    ("values", "told"),
    [
        (("melted", 0.0, 1.0, 0), "station.faults.0.kind: unknown kind 'melted'"),
        (("nan", float("nan"), 1.0, 0), "station.faults.0.start = nan: must be a finite number"),
        (("frozen", 1.0, 0.5, 0), "station.faults.0.end = 0.5: must be after start = 1 s"),
        (("frozen", 0.0, float("nan"), 0), "station.faults.0.end = nan: must be after start = 0 s"),
        (("frozen", 0.0, 1.0, 99), "station.faults.0.joint = 99: must be from 0 to 13"),
        (("frozen", 0.0, 1.0, "left_joint_1"), "station.faults.0.joint = 'left_joint_1': must be from 0 to 13"),
    ],
)
def test_what_a_fault_cannot_be_is_told_of_the_fault(values: Any, told: str) -> None:
    assert told in refusal("fault", Fault(*values))


class Height:
    """A task, without targets."""

    def task(self, start: Any) -> ArmTask:
        return ArmTask("left", ["z"])


@pytest.mark.parametrize("targets", [None, [(0.0, [0.1])], 3.0])
def test_targets_that_are_none_are_told_of_the_task(targets: Any) -> None:
    part = Height()
    if targets is not None:
        part.targets = targets  # type: ignore[attr-defined]
    assert f"controller.tasks.a.targets = {targets!r}: must be a list of TaskTargetConfig" in refusal("task", part)


class Load:
    """Acts with what it is given."""

    def __init__(self, wrench: Any, arm: str = ""):
        self.wrench = lambda time: wrench
        self.arm, self.body = arm, ""


@pytest.mark.parametrize("robot", ["comau_smart_six", "yumi"])
@pytest.mark.parametrize("wrench", [[float("nan")] * 6, [0.0] * 3, [[0.0]] * 6, "up", None])
def test_a_load_that_is_no_wrench_is_told_of_the_load(wrench: Any, robot: str) -> None:
    base, overrides = scenario("load", Load(wrench))
    if robot == "yumi":
        base = parse(REACH, "test")
    with pytest.raises(ForcectlError) as caught:
        fc.run(base, overrides=overrides)
    assert "station.loads.0: wrench(time) must return six finite numbers, not" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_an_arm_that_is_not_there_is_told_of_the_load() -> None:
    assert "station.loads.0.arm: unknown arm 'left': known: arm" in refusal("load", Load([0.0] * 6, arm="left"))


@pytest.mark.parametrize("stiffness", [None, "stiff", 0.0, -1.0, True, float("nan"), [1e4]])
def test_a_stiffness_that_is_none_is_told_of_the_environment(stiffness: Any) -> None:
    part = Nothing()
    part.first_stiffness = stiffness
    told = refusal("environment", part)
    assert f"station.environment.first_stiffness = {stiffness!r}: must be a positive number" in told


class Asks(StepConfig):
    """A reference that says something else of its largest force."""

    largest = 0.0

    def largest_force(self) -> float:
        return self.largest


@pytest.mark.parametrize("largest", [-1.0, -float("inf"), float("nan")])
def test_a_reference_asks_for_no_negative_force(largest: float) -> None:
    reference = Asks(force=5.0)
    reference.largest = largest
    told = f"reference: largest_force must return a finite force that is not negative, not {largest:g} N"
    assert told in refusal("reference", reference)


def test_a_largest_force_beyond_the_range_is_told_of_the_reference_unless_it_is_its_key() -> None:
    reference = Asks(force=5.0)
    reference.largest = 500.0
    told = "reference: its largest force is 500 N: must be at most the sensor's range, 400 N"
    assert told in refusal("reference", reference)
    assert "reference.force = 500.0: must be at most the sensor's range" in refusal(
        "reference", StepConfig(force=500.0)
    )


@pytest.mark.parametrize("number", [np.int64, np.float32, int])
def test_a_largest_force_may_be_any_number(number: Any) -> None:
    reference = Asks(force=5.0)
    reference.largest = number(5)
    fc.build({"station": {"fidelity": "OneDimensional"}, "reference": reference})


@pytest.mark.parametrize(
    ("answer", "told"),
    [
        (KeyError("force"), "analyses.a: metrics raised KeyError: 'force' (test_slot_contracts.py:"),
        ({"peak": "high"}, "analyses.a: metric peak = 'high': must be a number or None"),
    ],
)
def test_an_analysis_that_goes_wrong_is_named(answer: Any, told: str) -> None:
    class Analysis:
        def metrics(self, log: Any, setting: Any) -> Any:
            if isinstance(answer, Exception):
                raise answer
            return answer

        def figures(self, log: Any, setting: Any, title: str) -> Any:
            return {}

    assert told in refusal("analysis", Analysis())
