"""Objects given from Python are used themselves, whatever is done with the scenario that holds them."""

from dataclasses import dataclass, field

import pytest
from pydrake.systems.framework import Diagram, LeafSystem

import forcectl as fc
from forcectl.diagrams.drives.position_drive import PositionDriveConfig
from forcectl.diagrams.fidelities.light import KinematicFidelity, LightStation
from forcectl.diagrams.sensors import WristForceConfig
from forcectl.diagrams.signals import FromConfig
from forcectl.diagrams.station import StationConfig
from forcectl.estimation.force_estimator_config import ForceEstimatorConfig
from forcectl.force.integral import IntegralConfig
from forcectl.force.vrft.experiment import RecursiveVrftConfig
from forcectl.framework.yaml_tree import dump, parse
from forcectl.motion.excitation import TrapezoidalMovesConfig
from forcectl.motion.joint_path import JointMovesConfig
from forcectl.motion.loads import LoadConfig
from forcectl.motion.references import StepConfig
from forcectl.motion.tangential import TangentialMotionConfig
from forcectl.plant.contact.compliant_contact import EnvironmentConfig
from forcectl.plant.contact.surface import SurfaceConfig, WaveConfig
from forcectl.plant.sensors.joint_sensors import ReadingFaultConfig
from forcectl.runs.result import StoppedRunError
from forcectl.scenario.catalog import SLOTS
from forcectl.scenario.scenario import Scenario, load_scenario, resolved_tree
from forcectl.tasks.constraints.parts import WallConfig
from forcectl.tasks.controllers.reaching import ReactiveReachingConfig
from forcectl.tasks.null_space_parts import EvasiveConfig, JointSpeedConfig, LinkPotentialConfig
from forcectl.tasks.task_parts import ArmTaskConfig
from tests.examples.stations import free


@dataclass(kw_only=True)
class MyConfig(IntegralConfig):
    """Not a tag of ours."""

    added = 0

    def add_to(self, builder, model):
        type(self).added += 1
        law = super().add_to(builder, model)
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

    def add_to(self, builder, model):
        block = super().add_to(builder, model)
        block.set_name("my_estimator")
        return block


@dataclass(kw_only=True)
class MyMoves(JointMovesConfig):
    """A motion controller of the user's."""

    def add_to(self, builder, model):
        block = super().add_to(builder, model)
        block.set_name("my_moves")
        return block


@dataclass(kw_only=True)
class MyTangential(TangentialMotionConfig):
    """A motion of the user's."""

    def add_to(self, builder, *rest):
        block = super().add_to(builder, *rest)
        block.set_name("my_motion")
        return block


class Spring(LeafSystem):
    """A linear spring that pulls, too."""

    def __init__(self):
        super().__init__()
        depth = self.DeclareVectorInputPort("displacement", 1)
        self.DeclareVectorOutputPort(
            "contact_force",
            1,
            lambda context, output: output.SetAtIndex(0, -4e3 * depth.Eval(context).item()),
            prerequisites_of_calc={depth.ticket()},
        )


class MySurface:
    """A surface of the user's, from nothing of ours."""

    first_stiffness = 4e3

    def add_to(self, builder, size, period, *, robot_compliance):
        return builder.AddNamedSystem("my_surface", Spring())


@dataclass
class MyAnalysis:
    """An analysis of the user's."""

    seen: list = field(default_factory=list)

    def metrics(self, log, model):
        self.seen.append(log.sizes["time"])
        return {"samples": float(log.sizes["time"])}

    def figures(self, log, model, title):
        return {}


def names(system: Diagram, path: str = "") -> list[str]:
    found = []
    for block in system.GetSystems():
        found.append(f"{path}{block.get_name()}:{type(block).__name__}")
        if isinstance(block, Diagram):
            found += names(block, f"{path}{block.get_name()}/")
    return found


@dataclass(kw_only=True)
class MyDrive(PositionDriveConfig):
    """A drive of the user's."""

    def add_to(self, builder, site):
        block = super().add_to(builder, site)
        block.set_name("my_drive")
        return block


@dataclass(kw_only=True)
class MySensor(WristForceConfig):
    """A sensor of the user's."""

    def add_to(self, builder, site):
        block = super().add_to(builder, site)
        block.set_name("my_sensor")
        return block


@dataclass(kw_only=True)
class MyFidelity(KinematicFidelity):
    """A fidelity of the user's."""

    def build(self, workcell, seed):
        return MyStation(workcell, seed)


class MyStation(LightStation):
    """What it builds."""


def free_robot(**changes):
    station = free(robot="yumi/left", tool=None)
    return {"station": station, "controller": JointMovesConfig(), "duration": 0.02} | changes


def pressing(**station):
    return {"station": StationConfig(**station), "duration": 0.02}


# Each slot: a scenario with an object of the user's, and a name that only its blocks have.
CASES = {
    "controller": ({"controller": MyConfig(), "duration": 0.02}, "mine"),
    "joint controller": (free_robot(controller=MyMoves()), "my_moves"),
    "reference": ({"reference": MyStep(), "duration": 0.02}, "my_step"),
    "motion": ({"motion": MyTangential(), "duration": 0.02}, "my_motion"),
    "estimator": (free_robot(estimators={"mine": MyEstimator()}), "my_estimator"),
    "drive": (pressing(drive=MyDrive()), "my_drive"),
    "sensor": (pressing(sensors={"mine": MySensor()}), "my_sensor"),
    "fidelity": (pressing(fidelity=MyFidelity()), "MyStation"),
    "environment": (pressing(fidelity="OneDimensional", environment=MySurface()), "my_surface"),
}


class Asked:
    """A part of the user's that says what a shipped one says, and counts how often it is asked.

    Args:
        part: the shipped one.
        method: or attribute that a station or controller in the making asks for.
    """

    def __init__(self, part, method):
        self.part, self.method, self.asked = part, method, 0

    def __getattr__(self, name):
        if name == self.__dict__.get("method"):
            self.asked += 1
        return getattr(self.__dict__["part"], name)


def reaching(**parts):
    return free_robot(controller=ReactiveReachingConfig(**parts))


WALL = WallConfig(arm="left", point=[0, 0, 0.01], normal=[0, 0, 1])
# Each further slot: a part, and a scenario with it. They add no block of a name of their own.
FURTHER = {
    "surface": (
        Asked(WaveConfig(), "heights"),
        lambda part: (
            pressing(environment=EnvironmentConfig(surface=SurfaceConfig(heights={"mine": part})))
            | {"motion": TangentialMotionConfig(distance=1e-4)}
        ),
    ),
    "signal": (Asked(FromConfig(part="station"), "choose"), lambda part: {"signals": {"measured_force": part}}),
    "load": (
        Asked(LoadConfig(wrenches=[[0.0, 0.0, 0.0, 1.0, 0.0, 0.0]]), "body"),
        lambda part: free_robot(station=free(robot="yumi/left", tool=None, loads=[part])),
    ),
    "fault": (
        Asked(ReadingFaultConfig(start=1.0), "fault"),
        lambda part: free_robot(station=free(robot="yumi/left", tool=None, faults=[part])),
    ),
    "excitation": (
        Asked(TrapezoidalMovesConfig(), "add_to"),
        lambda part: {"controller": RecursiveVrftConfig(excitation=part)},
    ),
    "task": (Asked(ArmTaskConfig(arm="left"), "task"), lambda part: reaching(tasks={"mine": part})),
    "constraint": (Asked(WALL, "constraint"), lambda part: reaching(constraints=[part])),
    "null_space": (Asked(JointSpeedConfig(), "criterion"), lambda part: reaching(null_space=part)),
    "potential": (
        Asked(LinkPotentialConfig(), "potentials"),
        lambda part: reaching(null_space=EvasiveConfig(potentials=[part])),
    ),
}


def test_every_slot_is_tried():
    assert {*CASES, *FURTHER, "analysis"} - {"joint controller"} == set(SLOTS)


@pytest.mark.parametrize("slot", FURTHER)
def test_every_way_to_build_asks_the_users_object(slot):
    part, make = FURTHER[slot]
    parts = make(part) | {"duration": 0.02}
    ways = [
        lambda: fc.build(Scenario(**parts)).diagram,
        lambda: fc.run(Scenario(**parts)).diagram,
        lambda: fc.run({"duration": 0.02}, overrides=parts).diagram,
        lambda: fc.build(load_scenario(parts)).diagram,
    ]
    built = []
    for way in ways:
        before = part.asked
        built.append(names(way()))
        assert part.asked > before
    assert all(blocks == built[0] for blocks in built)


@pytest.mark.parametrize("slot", CASES)
def test_every_way_to_build_makes_the_same_blocks_of_a_users_object(slot):
    parts, block = CASES[slot]
    built = names(fc.build(Scenario(**parts)).diagram)
    assert any(block in name.split("/")[-1].split(":") for name in built)
    assert names(fc.run(Scenario(**parts)).diagram) == built
    assert names(fc.run({"duration": 0.02}, overrides=parts).diagram) == built
    assert names(fc.build(load_scenario(parts)).diagram) == built


@pytest.mark.parametrize("fidelity", ["OneDimensional", "Kinematic", "Multibody"])
def test_a_subclass_of_an_environment_is_kept(fidelity):
    station = StationConfig(fidelity=fidelity, environment=StiffEnvironment())
    scenario = load_scenario({"station": station, "duration": 0.02})
    assert scenario.station.environment is station.environment
    loop, expected = (fc.build(each) for each in (scenario, Scenario(station=station)))
    assert loop.workcell.contact.environment_compliance == expected.workcell.contact.environment_compliance == 1 / 7e3
    assert names(loop.diagram) == names(expected.diagram)


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
        scenario = load_scenario({"estimators": {"a": text}}, overrides={"estimators.a.gain": 40.0})
        assert type(scenario.estimators["a"]) is ForceEstimatorConfig
        assert scenario.estimators["a"].gain == 40.0


def test_an_analysis_of_the_users_is_called(tmp_path):
    mine = MyAnalysis()
    result = fc.run(Scenario(duration=0.02, analyses={"mine": mine}))
    assert mine.seen == [11]
    assert result.metrics["default"]["samples"] == 11.0


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


@pytest.mark.slow
def test_the_run_directory_names_the_class_of_a_users_object(tmp_path, without_pictures):
    scenario = Scenario(duration=0.02, controller=MyConfig(integral_gain=1.25))
    fc.run(scenario, out=tmp_path / "run")
    text = (tmp_path / "run" / "scenario.yaml").read_text()
    assert "!Import" in text
    assert f"{__name__}:MyConfig" in text
    assert "1.25" in text
    again = load_scenario(tmp_path / "run" / "scenario.yaml", allow_imports=["tests"])
    assert names(fc.build(again).diagram) == names(fc.build(scenario).diagram)


@dataclass
class Other(MyAnalysis):
    """A second analysis of the user's, with keys of its own."""

    share: float = 0.5


def test_variants_with_different_classes_of_the_user_can_be_run_again():
    mine = {"a": {}, "b": {"analyses.mine": Other(share=0.25)}}
    tree = {"analyses": {"mine": MyAnalysis(seen=[1])}, "variants": mine}
    text = dump(resolved_tree({name: load_scenario(tree, name) for name in mine}))
    again = {name: load_scenario(parse(text, "own"), name, allow_imports=["tests"]).analyses["mine"] for name in mine}
    assert again == {"a": MyAnalysis(seen=[1]), "b": Other(share=0.25)}


@pytest.mark.parametrize("method", ["metrics", "figures"])
def test_an_analysis_that_raises_is_one_line(method, tmp_path, request):
    if method == "metrics":
        request.getfixturevalue("without_pictures")

    @dataclass
    class Raises(MyAnalysis):
        pass

    setattr(Raises, method, lambda *_: {}["no such signal"])
    where = r" \(test_objects\.py:\d+\); .*log .* in .*run\.failed$"
    said = rf"analyses\.mine: {method} raised KeyError: 'no such signal'{where}"
    with pytest.raises(StoppedRunError, match=said) as caught:
        fc.run(Scenario(duration=0.02, analyses={"mine": Raises()}), out=tmp_path / "run")
    assert caught.value.directory == tmp_path / "run.failed"
    assert (caught.value.directory / "log.nc").exists()
    assert caught.value.log["contact_force"].size == 11


def test_a_loaded_variant_is_what_runs_with_all_that_was_changed_in_it():
    variants = {"soft": {"controller.integral_gain": 1.0}, "stiff": {"controller.integral_gain": 2.0}}
    lines = [{"target": name, "metric": "peak_force_N", "variant": name, "maximum": 50.0} for name in variants]
    plan = {"station": {"fidelity": "OneDimensional"}, "duration": 0.1, "variants": variants, "expect": lines}
    assert list(fc.run(plan).metrics) == ["soft", "stiff"]
    for given, name in ((None, "soft"), ("stiff", "stiff")):
        scenario = load_scenario(plan, variant=given)
        scenario.controller.integral_gain = 3.0
        result = fc.run(scenario)
        assert list(result.metrics) == [name]
        assert [verdict.target for verdict in result.verdicts] == [name]
        wanted = fc.run(plan | {"variants": {name: {"controller.integral_gain": 3.0}}, "expect": []})
        assert result.log.equals(wanted.log)
