"""`gains_from`: which experiment finds the gains of a law, and what is refused."""

import pytest

import forcectl as fc
from forcectl.errors import BadInputError
from forcectl.force.integral import IntegralConfig
from forcectl.force.per_arm import PerArmConfig
from forcectl.scenario.gains import FoundGains, asks_for_gains, gains_lines, identifications, text_of, with_gains
from forcectl.scenario.scenario import load_scenario

VALUES = {"proportional_gain": -1e-5, "integral_gain": -2e-5, "derivative_gain": 0.0}


def asking(**changes):
    return load_scenario("table_4_2", "plastic", changes)


def test_the_experiment_runs_on_the_station_the_model_and_the_seed_of_the_run():
    changes = {"station.environment.stiffness": 7e4, "model.robot_compliance": 1.1, "station.fidelity": "Kinematic"}
    scenario = asking(seed=5, **changes)
    (one,) = identifications(scenario, scenario.experiment)
    own = load_scenario("fig_4_8")
    for part in ("station", "model", "seed"):
        assert getattr(one.scenario, part) == getattr(scenario, part)
    for part in ("controller", "reference", "duration", "motion"):
        assert getattr(one.scenario, part) == getattr(own, part)
    assert (one.key, one.experiment, one.scale) == ("controller", "fig_4_8", 1.0)
    assert one.names == tuple(VALUES)


def test_a_law_within_another_and_one_for_another_bandwidth():
    scenario = load_scenario("fig_4_14", "plastic, governed", {"controller.law.reference_bandwidth": 3.0})
    (one,) = identifications(scenario, scenario.experiment)
    assert (one.key, one.scale) == ("controller.law", 2.0)
    tuned = with_gains(scenario, [FoundGains(one.key, one.experiment, VALUES)])
    assert [getattr(tuned.controller.law, name) for name in VALUES] == list(VALUES.values())
    assert tuned.controller.delay == scenario.controller.delay
    assert asks_for_gains(scenario)
    assert not asks_for_gains(tuned)
    assert gains_lines(scenario) == ["gains of controller.law: fig_4_8 finds them on this station before each run"]
    assert gains_lines(tuned) == []


def test_each_of_several_laws_gets_its_own():
    laws = {"left": asking().controller, "right": IntegralConfig()}
    scenario = load_scenario({"controller": PerArmConfig(laws=laws)})
    tuned = with_gains(scenario, [FoundGains("controller.laws.left", "fig_4_8", VALUES)])
    assert tuned.controller.laws["left"].integral_gain == -2e-5
    assert tuned.controller.laws["right"] == IntegralConfig()


def test_a_variant_of_the_experiment_is_named():
    scenario = load_scenario("vrft_motor", "plastic")
    (one,) = identifications(scenario, scenario.experiment)
    assert one.scenario.controller.input == "motor"
    assert one.experiment == "fig_4_8_motor (motor positions)"


def test_words_and_expectations_do_not_count_in_what_a_log_depends_on():
    scenario = asking()
    assert text_of(asking(title="another", description="other words")) == text_of(scenario)
    assert text_of(asking(seed=1)) != text_of(scenario)


@pytest.mark.parametrize(("changes", "text"), [
    ({"controller.gains_from": "fig_4_9"}, "= 'fig_4_9': unknown scenario 'fig_4_9': did you mean 'fig_4_8'?"),
    ({"controller.gains_from": "fig_2_8"}, "= 'fig_2_8': finds no gains: must be an experiment whose controller does"),
    ({"controller.gains_from": "table_4_1"}, "= 'table_4_1': finds no gains"),
    ({"controller.gains_variant": "steel"}, "= 'fig_4_8': unknown variant of fig_4_8.yaml 'steel': known: aluminium"),
])  # fmt: skip
def test_what_cannot_be_used_is_refused_in_a_line(changes, text):
    with pytest.raises(BadInputError, match=r"^(override|table_4_2\.yaml:\d+): controller\.gains_from ") as error:
        asking(**changes)
    assert text in str(error.value)
    assert "\n" not in str(error.value)


def test_a_law_without_gains_has_no_such_key():
    with pytest.raises(BadInputError, match="unknown key 'gains_from'"):
        load_scenario("fig_2_8", overrides={"controller.gains_from": "fig_4_8"})


def test_a_ring_is_refused(tmp_path):
    for name, other in (("a", "b"), ("b", "a")):
        (tmp_path / f"{name}.yaml").write_text(f"controller: !Vrft {{gains_from: {other}.yaml}}\n")
    with pytest.raises(BadInputError, match=r"a\.yaml:1: controller\.gains_from .* must not lead back to itself: .*b"):
        load_scenario(tmp_path / "a.yaml")


def test_gains_with_a_prefilter_are_for_one_bandwidth(tmp_path):
    (tmp_path / "find.yaml").write_text("controller: !RecursiveVrft {reference_bandwidth: 1.5}\n")
    (tmp_path / "use.yaml").write_text("controller: !Vrft {gains_from: find.yaml, reference_bandwidth: 3.0}\n")
    with pytest.raises(BadInputError, match=r"reference_bandwidth = 3\.0: must be 1\.5, the experiment's own"):
        load_scenario(tmp_path / "use.yaml")


def test_gains_that_the_law_has_no_key_for_are_refused(tmp_path, monkeypatch):
    monkeypatch.setattr("forcectl.force.vrft.experiment.RecursiveVrftConfig.finds_gains", ("fir_0",))
    with pytest.raises(BadInputError, match="'fig_4_8': finds fir_0: the law has no key for it"):
        asking()


def test_gains_that_the_law_does_not_allow_are_refused():
    with pytest.raises(BadInputError, match=r"gains of fig_4_8: controller\.integral_gain = 1\.0: must be at most 0"):
        with_gains(asking(), [FoundGains("controller", "fig_4_8", VALUES | {"integral_gain": 1.0})])


def test_the_graph_and_the_check_do_not_run_the_experiment(monkeypatch):
    monkeypatch.setattr("forcectl.runs.simulate.found_gains", None)
    assert fc.check("table_4_2", fidelity="OneDimensional").ok
