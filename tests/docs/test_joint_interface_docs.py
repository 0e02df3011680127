"""docs/joint_interface.md says what is true."""

import re

import numpy as np
import pytest

import forcectl as fc
from forcectl.framework.yaml_tree import parse
from tests.examples.joint_interface_runs import torque_elsewhere
from tests.examples.pages import blocks, page_text

PAGE = page_text("joint_interface.md")
WATCHED, SENSORLESS, USABLE = blocks(PAGE, "yaml")


@pytest.mark.slow
def test_the_loads_of_the_first_example_are_estimated():
    log = fc.run(parse(WATCHED, "watched.yaml")).log
    held = log.sel(time=slice(0.25, 0.38), wrench_component="left_force_z")
    np.testing.assert_allclose(held["applied_wrench"], -20.0)
    assert abs(float(held["estimated_wrench"].mean()) + 20.0) < 4.0


@pytest.mark.slow
def test_the_second_example_presses_without_a_sensor():
    """Both the estimate and the true force come near 10 N; friction at a tenth is what lies between them."""
    log = fc.run(parse(SENSORLESS, "sensorless.yaml")).log
    assert abs(float(log["measured_force"][-1]) - 10.0) < 0.5
    assert abs(float(log["contact_force"][-1]) - 10.0) < 2.5


@pytest.mark.slow
def test_the_third_example_has_errors_and_what_they_rest_on():
    (found,) = fc.run(parse(USABLE, "usable.yaml"), overrides={"analyses.errors.begin": 0.3}).metrics.values()
    assert found["force_error_z_95_N"] < 2.0  # while both arms begin to move
    assert found["friction_off_pct"] == pytest.approx(5.0)
    assert found["coulomb_share"] == pytest.approx(0.05, abs=0.005)


def test_the_figures_of_usable_forces_are_those_of_the_experiment():
    from forcectl.scenario.catalog import find_scenario

    rows = {"posture 1": "friction 5 % off, posture 1", "posture 2": "posture 2", "posture 3": "posture 3"}
    rows["2 N held, the wrists turn by 90 degrees"] = "friction 5 % off, 2 N held, the wrists turn by 90 degrees"
    shown = {
        line.split("|")[1].strip(): re.findall(r"[\d.]+", line.split("|", 2)[2])
        for line in PAGE.splitlines()
        if "|" in line
    }
    places = {"force_error_z_95_N": 0, "force_error_z_99_N": 1, "force_error_xy_95_N": 2, "moment_error_z_99_Nm": 5}
    judged = 0
    for line in find_scenario("usable_forces").tree["expect"]:
        if line["variant"] in rows and line["metric"] in places:
            number = shown[rows[line["variant"]]][places[line["metric"]]]
            assert float(number) == pytest.approx(line["expected"], abs=0.006 if places[line["metric"]] < 4 else 6e-4)
            judged += 1
    assert judged == 15


def test_the_figures_in_the_table_are_those_of_the_experiment():
    """What the page says is what the experiment expects, to the digits it says it with."""
    from forcectl.scenario.catalog import find_scenario

    expected = {line["target"]: line.get("expected") for line in find_scenario("force_estimation").tree["expect"]}
    for target, shown in (
        ("5 N static, 10 poses and 6 directions", "4.2 %"),
        ("friction 30 % off, tared, 5 N static", "4.1 %"),
        ("at rest, torque hidden, by Coulomb's friction", "0.95 tau_C"),
        ("fast motion, nothing acts", "2.2 N"),
        ("fast motion, friction 30 % off, nothing acts", "0.4 N"),
        ("sliding contact, mean force", "1.9 %"),
    ):
        number = float(shown.split()[0])
        assert abs(expected[target] - number) <= 0.05 * max(number, 1.0)
        assert shown in PAGE


def test_what_10_n_on_a_link_show_by_kinematics():
    from forcectl.scenario.catalog import find_scenario

    usable = find_scenario("usable_forces").tree
    others = [usable["variants"][f"posture {i}"]["station.posture_deg"] for i in (2, 3)]
    postures = [torque_elsewhere(posture) for posture in (usable["station"]["posture_deg"], *others)]
    table = PAGE.split("| pushed | along")[1].split("\n\n")[0].splitlines()[2:]
    assert len(table) == 6
    for line in table:
        pushed, *cells = (cell.strip() for cell in line.strip("|").split("|"))
        link = int(pushed.rpartition("link_")[2].strip("`"))
        found = 10.0 * np.array([each[side, link] for each in postures for side in ("left", "right")])
        for cell, low, high in zip(cells, found.min(axis=0), found.max(axis=0), strict=True):
            shown = [float(number) for number in cell.split(" to ")]
            np.testing.assert_allclose(shown, [low, high][-len(shown) :], atol=0.0051)
