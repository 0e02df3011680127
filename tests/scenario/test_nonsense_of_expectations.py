"""Expectations that nothing can meet, and the same said twice in different ways."""

import pytest

from forcectl.errors import BadInputError
from forcectl.scenario.scenario import build, load_scenario

# What `expect` says, and what is wrong with it.
LINES = [
    ("metric: overshoot_pct, maximum: 0, strict: true", "maximum = 0.0: must be above 0 where strict = true, as over"),
    ("metric: overshoot_pct, published: 3, tolerance: {}", "tolerance is zero: must have absolute or relative above 0"),
    ("metric: settling_time_2pct_s, minimum: 30", "minimum = 30.0: must be at most 5 s, as duration = 5 s"),
    (
        "metric: rise_time_s, published: 300, tolerance: {relative: 0.1}",
        "published = 300.0: must be at most 5 s, as",
    ),
    ("metric: peak_force_N, minimum: 90000", "minimum = 90000.0: must be at most 800 N, at which a run is stopped"),
]


@pytest.mark.parametrize(("line", "message"), LINES)
def test_what_no_run_can_give_is_not_expected(tmp_path, line, message):
    file = tmp_path / "own.yaml"
    file.write_text(f"expect:\n  - {{target: a, {line}}}\n")
    with pytest.raises(BadInputError) as caught:
        build(file, fidelity="OneDimensional")
    assert str(caught.value).startswith(f"own.yaml:2: expect.0.{message}")


def test_a_count_may_be_expected_exactly_and_a_time_up_to_the_end(tmp_path):
    lines = ["metric: touches_2pct, published: 1, tolerance: {}", "metric: rise_time_s, minimum: 5"]
    file = tmp_path / "own.yaml"
    file.write_text("expect:\n" + "".join(f"  - {{target: {line[8:12]}, {line}}}\n" for line in lines))
    build(file, fidelity="OneDimensional")


def test_two_lines_that_ask_the_same_are_one(tmp_path):
    line = "metric: overshoot_pct, maximum: 3"
    file = tmp_path / "own.yaml"
    file.write_text(f"expect:\n  - {{target: a, {line}}}\n  - {{target: b, {line}}}\n")
    with pytest.raises(BadInputError, match=r"^own\.yaml:3: expect\.1\.target = 'b': must be an expectation that"):
        load_scenario(file)


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"seed": 1}, "seed = 1: must be left out, or 2, the value of the argument seed"),
        ({"station.fidelity": "Kinematic"}, "station.fidelity = 'Kinematic': must be left out, or 'OneDimensional'"),
    ],
)
def test_a_key_and_the_argument_for_it_do_not_contradict_each_other(given, said):
    with pytest.raises(BadInputError) as caught:
        load_scenario("fig_2_8", overrides=given, seed=2, fidelity="OneDimensional")
    assert str(caught.value).startswith(said)
    assert load_scenario("fig_2_8", overrides={"seed": 2}, seed=2).seed == 2


def test_an_override_does_not_replace_one_before_it():
    whole, one = {"reference": {"force": 4.0}}, {"reference.force": 3.0}
    with pytest.raises(BadInputError, match=r"^overrides\.reference replaces what reference\.force sets before it"):
        load_scenario("fig_2_8", overrides=one | whole)
    assert load_scenario("fig_2_8", overrides=whole | one).reference.force == 3.0


def test_nothing_begins_in_the_last_thousandth_of_a_run(tmp_path):
    file = tmp_path / "own.yaml"
    file.write_text("duration: 5\nreference: !Step {start_time: 4.9999}\n")
    with pytest.raises(BadInputError, match=r"reference\.start_time = 4\.9999: must be below duration = 5 s"):
        load_scenario(file)


def test_a_noise_that_the_sensor_hides_is_no_fault(tmp_path):
    file = tmp_path / "own.yaml"
    file.write_text("station: {sensors: {force: {faults: [{kind: noise, value: 0.0004}]}}}\n")
    with pytest.raises(BadInputError, match=r"faults\.0\.value = 0\.0004: must be at least 0\.0005 N: the sensor's"):
        load_scenario(file)


@pytest.mark.slow
def test_the_margins_of_a_loop_with_a_long_delay_are_not_looked_for(forcectl):
    settings = ("station.sensors.force.delay=0.6", "controller.integral_gain=0.5")
    shown = [word for each in settings for word in ("--set", each)]
    code, out, _ = forcectl("check", "fig_2_8", "--fidelity", "OneDimensional", *shown)
    assert code == 0
    assert "stable; its delay is too long to compute margins" in out
