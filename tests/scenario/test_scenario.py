"""Scenarios: where values come from, which wins, and what a resolved scenario says."""

import sys
import textwrap
from pathlib import Path
from typing import Any

import pytest

import forcectl as fc
from forcectl.diagrams.station import SHIPPED_FIDELITIES
from forcectl.errors import BadInputError
from forcectl.force.adaptive_integral import AdaptiveIntegralConfig
from forcectl.force.integral import IntegralConfig
from forcectl.framework.yaml_tree import Tagged, dump, parse
from forcectl.motion.references import SequenceConfig, StepConfig
from forcectl.scenario import catalog
from forcectl.scenario.layers import ONLY_VARIANT, select_variants
from forcectl.scenario.scenario import as_file, build, load_scenario, resolve, resolved_tree
from tests.examples.experiment_runs import fidelities_of


def write(folder, text, name="own.yaml"):
    path = folder / name
    path.write_text(textwrap.dedent(text), encoding="utf-8")
    return path


EXPERIMENTS = [
    (name, fidelity)
    for name in catalog.list_experiments()
    for fidelity in (fidelities_of(name) if "reference" in catalog.find_scenario(name).tree else ["Multibody"])
]


@pytest.mark.parametrize(("name", "fidelity"), EXPERIMENTS)
def test_every_shipped_experiment_loads_and_builds_on_every_fidelity(name, fidelity):
    """Every variant loads, and one is built on each fidelity: with others it is simulated, or built below."""
    file = as_file(name)
    scenarios = [resolve(file, variant, {"station.fidelity": fidelity}) for variant in select_variants(file)]
    for scenario in scenarios:
        assert scenario.title
        assert scenario.source
        assert scenario.expect
    turns = [other for experiment, other in EXPERIMENTS if experiment == name]
    assert build(scenarios[turns.index(fidelity) % len(scenarios)]).diagram is not None


# On the fidelities that an experiment names, every variant of it is simulated: see tests/runs/test_reproduce.py.
NOT_NAMED = [
    (name, fidelity)
    for name, fidelity in EXPERIMENTS
    if fidelity not in catalog.find_scenario(name).tree.get("fidelities", ["OneDimensional"])
]


@pytest.mark.slow
@pytest.mark.parametrize(("name", "fidelity"), NOT_NAMED)
def test_every_variant_builds_on_the_fidelities_that_are_not_named(name, fidelity):
    file = as_file(name)
    for variant in select_variants(file):
        assert build(resolve(file, variant, {"station.fidelity": fidelity})).diagram is not None


@pytest.mark.parametrize("preset", catalog.list_presets())
def test_every_preset_says_what_it_changes_and_builds(preset):
    assert catalog.find_preset(preset).tree["description"]
    scenario = load_scenario("fig_2_8", overrides={"preset": preset})
    assert scenario.description == as_file("fig_2_8").tree["description"]
    assert build(scenario).diagram is not None


def test_names_that_need_no_drake_agree_with_the_code():
    assert list(catalog.SLOTS["fidelity"]) == list(SHIPPED_FIDELITIES)


def test_keys_of_the_acceptance_list_exist_with_these_names():
    overrides = {
        "station.environment.stiffness": 1e4,
        "station.environment.damping": 5.0,
        "station.sensors.force.bandwidth": 20.0,
        "station.sensors.force.noise_std": 0.01,
        "station.sensors.force.delay": 0.004,
        "controller.integral_gain": 2.0,
        "controller.compliance_error": 1.1,
        "reference.force": 12.0,
        "duration": 3.0,
        "seed": 9,
    }
    scenario = load_scenario("fig_2_8", overrides=overrides)
    for key, value in overrides.items():
        found = scenario
        for part in key.split("."):
            found = found[part] if isinstance(found, dict) else getattr(found, part)
        assert found == value


def test_order_defaults_preset_scenario_variant_overrides(tmp_path):
    path = write(
        tmp_path,
        """
        preset: linear
        station: {sensors: {force: {quantum: 0.5}}}
        variants:
          a: {}
          b: {station.sensors.force.quantum: 0.6, seed: 3}
        """,
    )
    a, b = load_scenario(path, "a"), load_scenario(path, "b")
    forced = load_scenario(path, "b", {"station.sensors.force.quantum": 0.7})
    assert a.station.sensors["force"].bandwidth == 12.6  # default
    assert a.station.sensors["force"].noise_std == 0.0  # preset
    assert a.station.sensors["force"].quantum == 0.5  # scenario over preset
    assert (b.station.sensors["force"].quantum, b.seed) == (0.6, 3)  # variant over scenario
    assert forced.station.sensors["force"].quantum == 0.7  # override over variant
    assert load_scenario(path, "a", {"preset": "friction"}).station.sensors["force"].noise_std == 0.05


def test_slots_take_tags_and_overrides_keep_or_change_them():
    assert isinstance(load_scenario("fig_2_8").controller, IntegralConfig)
    adaptive = load_scenario({"controller": parse("!AdaptiveIntegral {integral_gain: 2}", "f")})
    assert adaptive.controller == AdaptiveIntegralConfig(integral_gain=2.0)
    changed = load_scenario(
        "fig_2_8", overrides={"controller": parse("!AdaptiveIntegral", "f"), "controller.dead_zone": 1}
    )
    assert changed.controller == AdaptiveIntegralConfig(dead_zone=1.0)
    assert load_scenario("fig_2_8", overrides={"controller": "AdaptiveIntegral"}).controller == AdaptiveIntegralConfig()
    sequence = load_scenario(
        "fig_2_8", overrides={"reference": parse("!Sequence {times: [0, 1], forces: [5, 9]}", "f")}
    )
    assert sequence.reference == SequenceConfig(times=[0.0, 1.0], forces=[5.0, 9.0])
    assert load_scenario({}).reference == StepConfig()


def test_of_several_variants_the_first_is_loaded():
    assert load_scenario("fig_2_7") == load_scenario("fig_2_7", "K_I = 1.5 1/s")
    assert select_variants(as_file("fig_2_8")) == [ONLY_VARIANT]


def test_the_resolved_scenario_is_complete_and_means_the_same(tmp_path):
    file = as_file("fig_2_7")
    changes = {"preset": "linear", "station.environment.stiffness": 8e3}
    scenarios = {name: resolve(file, name, changes) for name in select_variants(file)}
    text = dump(resolved_tree(scenarios))
    again = as_file(write(tmp_path, text))
    assert "null" not in text.partition("expect:")[2]
    assert again.tree["station"]["sensors"]["force"]["noise_std"] == 0.0
    for name, scenario in scenarios.items():
        other = resolve(again, name)
        for part in ("station", "controller", "reference", "duration", "seed", "expect", "fidelities"):
            assert getattr(other, part) == getattr(scenario, part), (name, part)
    assert dump(resolved_tree({name: resolve(again, name) for name in scenarios})) == text


def test_a_variant_that_changes_the_preset_or_the_controller_resolves(tmp_path):
    path = write(
        tmp_path,
        """
        variants:
          plain: {}
          ideal: {preset: ideal}
          adaptive: {controller: !AdaptiveIntegral {integral_gain: 2.0}}
        """,
    )
    file = as_file(path)
    scenarios = {name: resolve(file, name) for name in select_variants(file)}
    again = as_file(write(tmp_path, dump(resolved_tree(scenarios)), "again.yaml"))
    for name, scenario in scenarios.items():
        other = resolve(again, name)
        assert (other.station, other.controller) == (scenario.station, scenario.controller)


@pytest.mark.parametrize(
    ("first", "other"),
    [
        ({"preset": "linear", "station.sensors.force": None}, {}),
        ({"preset": "linear", "station.sensors.force": None}, {"preset": "friction", "station.sensors.force": {}}),
        ({"preset": "ideal"}, {"preset": "linear", "station.sensors.force": None}),
    ],
)
def test_the_resolved_scenario_has_the_presets_that_ran_and_nothing_more_of_them(first, other):
    file = as_file({"variants": {"first": first, "other": other}})
    scenarios = {name: resolve(file, name) for name in select_variants(file)}
    again = as_file(parse(dump(resolved_tree(scenarios)), "again.yaml"))
    for name, scenario in scenarios.items():
        found = resolve(again, name)
        assert (found.preset, found.station) == (scenario.preset, scenario.station)


def test_a_part_that_is_added_by_its_dotted_key_stands_beside_the_default_ones(tmp_path):
    added = {"station.sensors.joints": "!JointReadings"}
    path = write(tmp_path, "variants: {plain: {}, joints: {station.sensors.joints: !JointReadings {}}}")
    for sensors in (
        load_scenario({}, overrides=added).station.sensors,
        load_scenario(path, "joints").station.sensors,
        load_scenario({"preset": "ideal"}, overrides=added).station.sensors,
    ):
        assert [*sensors] == ["force", "joints"]
    # Parts that a file gives are all there are.
    whole = {"station": {"sensors": {"contact": Tagged({"on": ["force_probe"], "by": ["world"]}, "ContactTruth")}}}
    assert [*load_scenario(whole, overrides=added).station.sensors] == ["contact", "joints"]
    of_variant = {"variants": {"one": {"station.sensors": whole["station"]["sensors"]}}}
    assert [*load_scenario(of_variant, "one", overrides=added).station.sensors] == ["contact", "joints"]


def test_one_variant_resolves_with_only_the_expectations_about_it():
    file = as_file("fig_2_7")
    name = "K_I = 3 1/s"
    tree = resolved_tree({name: resolve(file, name)})
    assert list(tree["variants"]) == [name]
    assert [e["target"] for e in tree["expect"]] == ["F2.7 overshoot, K_I = 3"]


def test_one_variant_is_built_with_only_the_expectations_about_it(tmp_path):
    """Metrics beyond the run are refused with the place of their line in the file."""
    text = """\
        duration: 2
        variants: {one: {}, two: {seed: 1}}
        expect:
          - {target: a, metric: overshoot_pct, variant: one, maximum: 9}
          - {target: b, metric: settling_time_2pct_s, variant: two, minimum: %s}"""
    assert load_scenario(write(tmp_path, text % 1.0), "two").build()
    with pytest.raises(BadInputError, match=r"expect\.1\.minimum = 30\.0: must be at most 2 s, as duration"):
        load_scenario(write(tmp_path, text % 30.0), "two").build()


def test_one_variant_resolves_without_distances_from_others():
    file = as_file("fig_3_4")
    tree = resolved_tree({"invariance control [56]": resolve(file, "invariance control [56]")})
    assert "distance_to" not in dump(tree["expect"])
    assert load_scenario(tree).expect


def test_private_root_keys_hold_anchors(tmp_path):
    path = write(tmp_path, "_soft: &soft {stiffness: 1.0e3}\nstation: {environment: *soft}\n")
    assert load_scenario(path).station.environment.stiffness == 1e3


OWN_CONTROLLER = """
from dataclasses import dataclass
from forcectl.force.integral import IntegralConfig, IntegralForceLaw

@dataclass
class Proportional:
    gain: float = 1.0

    def add_to(self, builder, model):
        compliance = model.total_compliance
        law = IntegralForceLaw(model.size, integral_gain=self.gain, compliance=compliance, period=model.period)
        return builder.AddNamedSystem("own_law", law)

class NotAController:
    pass

class Raises:
    def add_to(self, builder, model):
        return model.no_such_parameter

class ReturnsNothing:
    def add_to(self, builder, model):
        pass
"""


@pytest.fixture
def own_module(tmp_path, monkeypatch):
    (tmp_path / "own_laws.py").write_text(OWN_CONTROLLER)
    monkeypatch.chdir(tmp_path)
    yield "own_laws"
    sys.modules.pop("own_laws", None)


def test_a_controller_of_the_users_own_by_import_path(own_module, tmp_path):
    path = write(tmp_path, "controller: !Import {path: 'own_laws:Proportional', parameters: {gain: 2.5}}\n")
    loop = build(load_scenario(path))
    assert loop.diagram.GetSubsystemByName("controller").GetSubsystemByName("own_law") is not None
    assert loop.reference_model_bandwidth is None
    assert str(tmp_path) not in sys.path


@pytest.mark.parametrize(
    ("controller", "message"),
    [
        ("{path: 'own_laws:Proportionel'}", "did you mean 'Proportional'?"),
        ("{path: 'own_laws:NotAController'}", "must be a class that fills the slot controller, with add_to"),
        ("{path: 'own_lows:Proportional'}", "No module named 'own_lows'"),
        ("{path: own_laws}", 'must be an import path such as "package.module:Name"'),
        (
            "{path: 'own_laws:Proportional', parameters: {gian: 2}}",
            "controller.parameters.gian: unknown key 'gian': did you mean",
        ),
        (
            "{path: 'own_laws:Proportional', parameters: {gain: x}}",
            "controller.parameters.gain = 'x': must be a number",
        ),
    ],
)
def test_a_wrong_import_is_one_line(own_module, tmp_path, controller, message):
    path = write(tmp_path, f"controller: !Import {controller}\n")
    with pytest.raises(BadInputError) as caught:
        load_scenario(path)
    assert message in str(caught.value)
    assert "own.yaml" in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("Raises", "own.yaml:1: controller: cannot be built: AttributeError: "),
        ("ReturnsNothing", "add_to must return a Drake system, not NoneType"),
    ],
)
def test_a_controller_that_cannot_be_added_is_one_line(own_module, tmp_path, name, message):
    path = write(tmp_path, f"controller: !Import {{path: 'own_laws:{name}'}}\n")
    with pytest.raises(BadInputError) as caught:
        fc.run(path)
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


def test_an_estimator_that_cannot_be_added_is_told_as_the_estimator(own_module, tmp_path):
    path = tmp_path / "motion.yaml"
    path.write_text("estimators: {mine: !Import {path: 'own_laws:Raises'}}\n")
    match = r"motion.yaml:1: estimators\.mine: cannot be built: AttributeError.*\(own_laws.py:\d+\)$"
    with pytest.raises(BadInputError, match=match):
        fc.run(path)


def test_a_reference_model_of_a_loop_without_a_desired_force_is_refused():
    station = {
        "robot": "yumi",
        "drive": "!JointInterface",
        "sensors": {"joints": "!JointReadings"},
        "environment": "!Parts",
    }
    scenario = {"station": station, "controller": "!JointMoves", "reference_model": 4.0}
    with pytest.raises(BadInputError, match=r"reference_model = 4\.0: must be left out where nothing takes a desired"):
        fc.run(scenario)


def test_a_default_that_does_not_fit_stands_where_the_part_around_it_does(tmp_path):
    path = tmp_path / "mine.yaml"
    path.write_text("duration: 1.0\nstation:\n  robot: yumi/left\n  posture_deg: []\n", encoding="utf-8")
    with pytest.raises(
        BadInputError, match=r"^mine\.yaml:2: station\.drive\.position_loop\.delay = 0\.002: must be zero"
    ):
        fc.run(path)


def in_itself() -> dict[str, Any]:
    tree: dict[str, Any] = {}
    tree["station"] = tree
    return tree


@pytest.mark.parametrize(
    ("scenario", "arguments", "line"),
    [
        ({}, {"overrides": [1]}, r"overrides = \[1\]: must be a mapping of dotted keys to values"),
        ({}, {"overrides": "duration=1"}, "overrides = 'duration=1': must be a mapping of dotted keys to values"),
        ({}, {"variant": ["default"]}, r"variant = \['default'\]: must be the name of a variant or None"),
        (in_itself(), {}, "mappings and lists must be nested at most 100 levels deep"),
        (
            {},
            {"overrides": {"variants.a.duration": 3}},
            "override: variants.a.duration: variants are those of",
        ),
        ({"station": []}, {"fidelity": "Kinematic"}, r"scenario: station = \[\]: must be a mapping"),
        (
            "peg_in_hole",
            {"overrides": {"controller.modes": {}}},
            "override: controller.modes = {}: must be a mapping with keys: an empty one changes nothing",
        ),
        ({"variants": {"a": {"expect": []}}}, {}, "variants.a has expect of its own: must not"),
        ({"variants": {"a": {"fidelities": ["Kinematic"]}}}, {}, "variants.a has fidelities of its own: must not"),
        (
            {"variants": {"a": {"controller": {"integral_gain": 3}, "controller.integral_gain": 2}}},
            {},
            "variants.a.controller.integral_gain stands twice: must stand once",
        ),
    ],
)
def test_what_would_be_passed_over_is_refused(scenario: Any, arguments: dict[str, Any], line: str) -> None:
    with pytest.raises(BadInputError, match=line):
        load_scenario(scenario, **arguments)


def test_an_empty_mapping_leaves_out_default_parts() -> None:
    assert load_scenario({}, overrides={"station.sensors": {}}).station.sensors == {}


def test_an_override_of_something_else_in_a_part_is_not_where_its_mistakes_are_from(tmp_path: Path) -> None:
    path = tmp_path / "own.yaml"
    path.write_text("duration: 0.1\nstation:\n  time_step: 0.0007\n")
    with pytest.raises(BadInputError, match=r"own.yaml:2: station.period = 0.002: must be zero or a whole multiple"):
        build(path, fidelity="Kinematic")
    with pytest.raises(BadInputError, match=r"override: station.period"):
        build(path, overrides={"station.period": 0.002})
