"""Guarded moves to a surface in front of controllers of joints: from the first touch to the force, and back."""

from typing import Any

import numpy as np
import pytest
from pydrake.systems.framework import DiagramBuilder

import forcectl as fc
from forcectl.errors import BadInputError
from forcectl.force.approach import ApproachConfig, ApproachMode
from forcectl.force.invariance.robot import InvarianceRobotConfig
from forcectl.framework.yaml_tree import Tagged
from forcectl.testing import run_diagram
from tests.examples.robot_controller_runs import robot_plant_model

pytestmark = pytest.mark.slow

APPROACH, TOUCH, CONTACT, LEAVE, GAVE_UP = map(float, ApproachMode)
INVARIANCE = Tagged({"gamma": -0.1}, "InvarianceRobot")
CORRECTED = Tagged({"nominal_gain": 3.0}, "InvarianceRobot")
ADAPTIVE = Tagged({"adaptation": {}}, "InvarianceRobot")
STEP = Tagged({"force": 15.0}, "Step")


def scenario(
    fidelity: str,
    law: Tagged,
    stiffness: float = 1e4,
    speed: float = 0.02,
    surface: dict[str, Any] | None = None,
    **overrides: Any,
) -> dict[str, Any]:
    """`overrides` of keys of the move, of `reference`, `guard` and `duration`."""
    tops = {key: overrides.pop(key) for key in ("reference", "guard", "duration") if key in overrides}
    environment = {"stiffness": stiffness, "surface": surface or {"gap": 0.01}}
    return {
        "station": {"fidelity": fidelity, "environment": Tagged(environment, "Surface")},
        "controller": Tagged({"law": law, "speed": speed, **overrides}, "Approach"),
        "reference": STEP,
        "analyses": {"touch": Tagged({}, "TouchDown")},
        **tops,
    }


def signals(result: Any, *names: str) -> list[np.ndarray]:
    return [result.log[name].values.squeeze() for name in names]


def metrics(result: Any) -> dict[str, float]:
    (found,) = result.metrics.values()
    return dict(found)


def way(mode: np.ndarray) -> list[float]:
    """The modes one after the other."""
    return mode[np.append(True, np.diff(mode) != 0)].tolist()


def assert_contact(result: Any) -> None:
    """The law is in charge from the hand-over on, which moves nothing, and the tool stays on the surface."""
    mode, force, command = signals(result, "approach_mode", "contact_force", "displacement_command")
    assert way(mode) == [APPROACH, TOUCH, CONTACT]
    taken = int(np.argmax(mode == CONTACT))
    assert abs(command[taken] - command[taken - 1]) < 1e-5
    assert (force[taken + 250 :] > 0.0).all()
    assert metrics(result)["constraint_violations"] == 0
    assert metrics(result)["touch_s"] > 0.0


@pytest.mark.parametrize(
    ("fidelity", "law", "stiffness", "speed"),
    [
        ("OneDimensional", CORRECTED, 1e4, 0.02),
        ("OneDimensional", ADAPTIVE, 1e5, 0.005),
        ("Kinematic", ADAPTIVE, 1e4, 0.05),
        ("Multibody", ADAPTIVE, 1e4, 0.05),
        ("Multibody", ADAPTIVE, 1e5, 0.02),
    ],
)
def test_from_the_first_touch_to_the_reference(fidelity: str, law: Tagged, stiffness: float, speed: float) -> None:
    result = fc.run(scenario(fidelity, law, stiffness, speed, duration=5.0))
    assert_contact(result)
    assert float(result.log["contact_force"][-1]) == pytest.approx(15.0, rel=0.05)


@pytest.mark.parametrize("speed", [0.005, 0.05])
@pytest.mark.parametrize(("law", "scalar"), [(INVARIANCE, "Invariance"), (CORRECTED, "InvarianceControl")])
def test_behind_the_move_it_is_the_scalar_law(law: Tagged, scalar: str, speed: float) -> None:
    """Without an integral [57] keeps the force of the second touch as an error, and so does the scalar law."""
    joints = fc.run(scenario("OneDimensional", law, 1e4, speed, duration=4.0))
    assert_contact(joints)
    own = Tagged({"gamma": -0.1}, scalar)
    expected = fc.run(scenario("OneDimensional", own, 1e4, speed, duration=4.0))
    for name in ("impact_peak_N", "largest_force_N", "hand_over_s"):
        assert metrics(joints)[name] == pytest.approx(metrics(expected)[name], rel=0.02), name
    # The step back of 5 mm is spread over some ticks, as the joints can follow it: the hand-over may be two later.
    both = [signals(each, "contact_force", "approach_mode") for each in (joints, expected)]
    force, other = (force[mode == CONTACT] for force, mode in both)
    ticks = min(len(force), len(other))
    assert max(len(force), len(other)) <= ticks + 2
    np.testing.assert_allclose(force[:ticks], other[:ticks], atol=0.3)


def test_the_surface_is_touched_and_pressed_on() -> None:
    result = fc.run(
        scenario(
            "OneDimensional", INVARIANCE, 1e4, 0.02, surface={"gap": 0.001}, patience=0.3, rise_time=0.0, duration=1.4
        )
    )
    assert_contact(result)
    assert metrics(result)["impact_peak_N"] == pytest.approx(12.2, abs=0.3)  # that of any law, docs/which_law.md
    assert 10.0 < float(result.log["contact_force"][-1]) < 18.0


def test_a_surface_that_goes_away_is_found_again() -> None:
    surface = {"gap": 0.002, "moves": [{"start": 1.5, "distance": -0.006, "duration": 0.05}]}
    result = fc.run(scenario("OneDimensional", CORRECTED, 1e4, surface=surface, touch_speed=0.01, duration=5.0))
    mode, force = signals(result, "approach_mode", "contact_force")
    assert way(mode) == [APPROACH, TOUCH, CONTACT, TOUCH, CONTACT]
    assert force.max() < 20.0
    assert force[-1] == pytest.approx(15.0, abs=2.0)


def test_a_desired_force_of_zero_leaves_the_surface_and_another_one_comes_back() -> None:
    reference = Tagged({"times": [0.0, 1.5, 2.5], "forces": [15.0, 0.0, 10.0]}, "Sequence")
    result = fc.run(
        scenario("OneDimensional", INVARIANCE, surface={"gap": 0.002}, reference=reference, patience=0.3, duration=4.5)
    )
    mode, force, move = signals(result, "approach_mode", "contact_force", "approach_displacement")
    time = result.log["time"].values
    assert way(mode) == [APPROACH, TOUCH, CONTACT, LEAVE, APPROACH, TOUCH, CONTACT]
    left = (time > 2.2) & (time < 2.5)
    assert (force[left] == 0.0).all()
    np.testing.assert_allclose(move[left], move[np.argmax(mode == LEAVE) - 1] + 0.01, atol=1e-9)
    assert force[-1] == pytest.approx(10.0, abs=2.5)


def test_without_a_surface_it_gives_up_and_rests() -> None:
    surface = {"gap": 0.002, "moves": [{"start": 0.0, "distance": -0.05, "duration": 0.1}]}
    move = {"speed": 0.01, "patience": 0.3, "timeout": 0.3, "rise_time": 0.0}
    result = fc.run(scenario("Kinematic", INVARIANCE, surface=surface, duration=0.6, **move))
    mode, joints, move = signals(result, "approach_mode", "joint_position_command", "approach_displacement")
    assert way(mode) == [APPROACH, GAVE_UP]
    assert move[-1] == pytest.approx(-0.003, abs=5e-5)
    np.testing.assert_allclose(joints[-50:], np.broadcast_to(joints[-1], (50, 6)), atol=1e-9)


def test_a_wall_in_front_of_the_surface_ends_the_move() -> None:
    model = robot_plant_model()
    height = float(model.robot.tip_position(model.robot.context_at(model.start))[2])
    wall = Tagged({"point": [0.0, 0.0, height - 0.002], "normal": [0.0, 0.0, 1.0]}, "Wall")
    law = Tagged({"constraints": [wall]}, "InvarianceRobot")
    move = {"patience": 0.2, "timeout": 0.2, "rise_time": 0.0}
    result = fc.run(scenario("Kinematic", law, surface={"gap": 0.004}, duration=0.4, **move))
    mode, force, dx = signals(result, "approach_mode", "contact_force", "displacement_command")
    assert way(mode) == [APPROACH, GAVE_UP]
    assert not force.any()
    assert -0.002 - 1e-9 < dx.min() < -0.00199
    assert metrics(result)["constraint_violations"] == 0


@pytest.mark.parametrize(
    ("fidelity", "stiffness", "speed"), [("OneDimensional", 1e5, 0.030), ("Multibody", 1e4, 0.106)]
)
def test_the_guard_keeps_its_largest_force_at_the_first_touch(fidelity: str, stiffness: float, speed: float) -> None:
    guard = {"maximum_force": 30.0, "stiffness_margin": 1.0}
    base = scenario(fidelity, INVARIANCE, stiffness, speed, {"gap": 0.3 * speed}, guard=guard, duration=0.8)
    assert 20.0 < float(fc.run(base).log["contact_force"].max()) < 30.0
    faster = scenario(fidelity, INVARIANCE, stiffness, 1.1 * speed, guard=guard)
    with pytest.raises(BadInputError, match=r"controller.speed = .* m/s: the first touch comes to .* at most "):
        fc.build(faster)


def test_a_largest_force_of_the_law_is_kept_after_the_hand_over() -> None:
    law = Tagged({"maximum_force": 12.0, "gamma": -1.0}, "InvarianceRobot")
    result = fc.run(scenario("OneDimensional", law, speed=0.05, duration=3.0))
    mode, force = signals(result, "approach_mode", "contact_force")
    assert way(mode) == [APPROACH, TOUCH, CONTACT]
    assert 11.0 < force[mode == CONTACT].max() < 12.1


def test_a_loss_is_looked_for_with_the_joints_at_rest_in_the_law() -> None:
    """The way of the modes, from forces over time."""

    def force(t: float) -> float:
        return 5.0 if 0.2 < t < 0.5 or t > 1.2 else 0.0

    config = ApproachConfig(law=InvarianceRobotConfig(), patience=0.1, touch_speed=0.004, rise_time=0.0)
    law = config.add_to(DiagramBuilder(), robot_plant_model())
    start = robot_plant_model().start
    inputs = {"desired_force": 15.0, "measured_force": force, "unconstrained_reference": np.zeros(6)}
    inputs |= {"motor_position": start, "motor_velocity": np.zeros(6)}
    log = run_diagram(law, 1.5, period=0.002, inputs=inputs)
    assert way(log["approach_mode"][:, 0]) == [APPROACH, TOUCH, CONTACT, TOUCH, CONTACT]
    lost = (log.time > 0.62) & (log.time < 1.2)
    np.testing.assert_allclose(np.diff(log["approach_displacement"][lost, 0]), -0.004 * 0.002, atol=1e-9)
    own = log["displacement_command"] - log["approach_displacement"]
    assert abs(own[log.time < 0.3]).max() < 1e-7
    # The law goes back to where the move has brought the tool.
    assert own[np.argmax(log.time > 0.6)] < -1e-3
    assert abs(own[np.argmax(log.time > 1.19)]) < 1e-7
