"""Constraints as parts of a scenario: every shipped tag holds, in both controllers that take constraints."""

from functools import cache
from typing import Any

import numpy as np
import pytest

import forcectl as fc
from forcectl.framework.yaml_tree import parse
from forcectl.robot.arms_motion import ArmsMotion
from forcectl.robot.model import RobotModel

REACHING = """
preset: ideal
station: {robot: yumi, tool: null, fidelity: Multibody, time_step: 0.002,
          drive: !JointInterface {}, sensors: {joints: !JointReadings {}}, environment: !Parts {}}
duration: 1.2
"""
UP = "tasks: {a: !ArmTask {arm: left, coordinates: [x, y, z], targets: [{time: 0.02, value: [0.2, 0.25, 0.4]}]}}"


def scenario(constraints: str, tasks: str = UP) -> Any:
    text = f"{REACHING}\ncontroller: !ReactiveReaching {{{tasks}, link_distance: 0, constraints: {constraints}}}"
    return fc.load_scenario(parse(text, "test"))


@cache
def known_robot() -> RobotModel:
    return fc.build(scenario("[]")).setting.truth.known_robot()


def heights(made: Any) -> np.ndarray:
    """Height of the left TCP on its commanded way [m]."""
    robot, log = known_robot(), fc.run(made).log
    context, n = robot.create_context(), robot.num_joints
    q = log["joint_position_command"].values
    return np.array([ArmsMotion(robot, context, each, np.zeros(n)).arm("left").position[2] for each in q[::5]])


Z = "task: !ArmTask {arm: left, coordinates: [z]}"
LIMIT = 0.33


@pytest.mark.slow
@pytest.mark.parametrize(
    ("constraints", "highest"),
    [
        ("[]", 0.4),
        (f"[!Wall {{arm: left, point: [0, 0, {LIMIT}], normal: [0, 0, -1]}}]", LIMIT),
        (f"[!Range {{{Z}, upper: [{LIMIT}], gamma: -1.0}}]", LIMIT),
        (f"[!Range {{{Z}, lower: [null], upper: [{LIMIT}]}}]", LIMIT),
        # At rest 0.01 m off plus the speed it may not see over twice the braking: 0.02 + 0.01^2/4 = 0.020025.
        (
            f"[!Robust {{of: !Range {{{Z}, upper: [{LIMIT}]}}, braking: 2.0, measurement_error: [0.02, 0.01]}}]",
            LIMIT - 0.020065,
        ),
    ],
)
def test_a_constraint_stops_the_arm(constraints: str, highest: float) -> None:
    assert heights(scenario(constraints)).max() == pytest.approx(highest, abs=3e-5)


@pytest.mark.slow
def test_a_speed_limit_holds() -> None:
    speed = np.diff(heights(scenario(f"[!SpeedLimit {{{Z}, limit: [0.05]}}]"))) / 0.02
    assert np.abs(speed).max() == pytest.approx(0.05, rel=1e-3)


PRESSING = """
preset: ideal
station: {robot: yumi, tool: force_probe, fidelity: Multibody, drive: !JointInterface {},
          sensors: {joints: !JointReadings {}, force: !WristForce {bandwidth: 300.0, noise_std: 0.0}},
          environment: !Surface {arm: left, stiffness: 1450.0}}
controller: !ReactiveReaching
  link_distance: 0
  tasks:
    left: !ArmTask {arm: left, coordinates: [x, y, z]}
    right: !ArmTask {arm: right}
  constraints:
    - !ForceBand {task: !ArmTask {arm: left, coordinates: [z]}, force: [0.2, 0.5], stiffness: [1300.0, 1600.0],
                  braking: 0.05, measurement_error: [0.06, 0.0015]}
duration: 0.8
"""


@pytest.mark.slow
@pytest.mark.parametrize(("stiffness", "depth"), [(1600.0, -0.01), (1300.0, 0.01)])
def test_a_force_band_holds_on_a_spring(stiffness: float, depth: float) -> None:
    """With servos, friction that sticks and a sensor that reads in steps of 0.05 N; 16 N, or no contact, are asked."""
    targets = f"{{time: 0.05, value: [0.1493, 0.1409, {0.1172 + depth}]}}"
    changes = {
        "controller.tasks.left.targets": [parse(targets, "test")],
        "station.environment.stiffness": stiffness,
    }
    made = fc.load_scenario(parse(PRESSING, "test"), overrides=changes)
    log = fc.run(made).log
    force = log["contact_force"].values.ravel()
    entered = int(np.argmax(force >= 0.2))
    assert 0 < log["time"].values[entered] < 0.2
    assert force[entered:].min() >= 0.2
    assert force.max() <= 0.5
    assert log["status"].values.max() == 0


def test_link_distances_are_rows_of_their_own() -> None:
    def rows(constraints: str) -> int:
        block = fc.build(scenario(constraints)).diagram
        for name in ("controller", "reactive_reaching", "motion", "controller"):
            block = block.GetSubsystemByName(name)
        return int(block.num_rows)

    assert rows("[!LinkDistance {minimum: 0.005}]") > rows("[]")


@pytest.mark.parametrize(
    ("constraints", "told"),
    [
        ("[!Wall {arm: middle, point: [0, 0, 0], normal: [0, 0, 1]}]", "unknown arm 'middle'"),
        ("[!Wall {arm: left, point: [0, 0, 2], normal: [0, 0, 1]}]", "violated in the start posture"),
        ("[!Range {upper: [1]}]", "constraints.0.task is missing: must be a part"),
        (f"[!Range {{{Z}}}]", "at least one limit must be finite"),
        (f"[!Range {{{Z}, upper: [1, 2]}}]", "constraints.0.upper has shape (2,): must be one number"),
        (f"[!Range {{{Z}, upper: [1], gamma: 1}}]", "constraints.0.gamma = 1.0: must be below zero"),
        (f"[!SpeedLimit {{{Z}, limit: [0]}}]", "limit"),
        ("[!LinkDistance {minimum: 0}]", "constraints.0.minimum = 0.0: must be positive"),
        ("[!LinkDistance {minimum: 0.5}]", "violated in the start posture"),
        (f"[!Robust {{of: !SpeedLimit {{{Z}, limit: [1]}}, braking: 2}}]", "must be 2"),
        (f"[!Robust {{of: !Range {{{Z}, upper: [1]}}, braking: 0}}]", "constraints.0.braking = 0.0: must be positive"),
        (f"[!Robust {{of: !Range {{{Z}, upper: [1]}}, braking: 1, model_error: [0, 1]}}]", "model_error.rate"),
        (f"[!Robust {{of: !Range {{{Z}, upper: [1]}}, braking: 1, model_error: [0]}}]", "must be two numbers"),
        (f"[!ForceBand {{{Z}, force: [0.2, 0.5], stiffness: [1e3, 1e3], braking: 0.1}}]", "reads measured_force"),
        (f"[!ForceBand {{{Z}, force: [0.5], stiffness: [1e3, 1e3], braking: 0.1}}]", "must be two numbers"),
        (f"[!ForceBand {{{Z}, force: [0.5, 0.2], stiffness: [1e3, 1e3], braking: 0.1}}]", "the smaller one first"),
        ("[!Robust {of: 3, braking: 2}]", "constraints.0.of = 3: must be a part: one of !Wall"),
        ("[!Robust {of: !Step {}, braking: 2}]", "constraints.0.of: unknown tag '!Step'"),
    ],
)
def test_a_constraint_that_does_not_fit_is_told_in_one_line(constraints: str, told: str) -> None:
    with pytest.raises(fc.BadInputError) as caught:
        fc.build(scenario(constraints))
    assert told in str(caught.value)
    assert "\n" not in str(caught.value)


def test_what_a_part_makes_must_be_a_constraint() -> None:
    class Nothing:
        def constraint(self, model: Any) -> Any:
            return 3

    made = scenario("[]")
    made.controller.constraints.append(Nothing())
    with pytest.raises(
        fc.BadInputError, match=r"constraints\.0: constraint must return an object with relative_degree"
    ):
        fc.build(made)
