"""Scenario part `!ReactiveReaching` and its analysis: a short run on the station, and what is refused."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydrake.systems.framework import Diagram, DiagramBuilder
from pydrake.systems.primitives import TrajectorySource

import forcectl as fc
from forcectl.analysis.reaching import ReachAnalysis
from forcectl.analysis.tables.motion_tables import REACH_METRICS, is_motion_metric
from forcectl.diagrams.model import plant_model
from forcectl.diagrams.workcell import describe
from forcectl.errors import BadInputError
from forcectl.force.invariance.robot import JointLimitConfig
from forcectl.framework.euler_angles import EulerAngles
from forcectl.framework.rotation_vector import RotationVector
from forcectl.framework.yaml_tree import parse
from forcectl.motion.references import held_trajectory
from forcectl.plant.contact.obstacle import ObstacleConfig
from forcectl.plant.plant_model import PlantModel
from forcectl.runs.result import RunResult
from forcectl.scenario.scenario import Scenario, load_scenario
from forcectl.tasks.constraints.parts import SpeedLimitConfig, WallConfig
from forcectl.tasks.controllers.base import ModeConfig
from forcectl.tasks.controllers.reaching import RandomMovesConfig, ReachConfig, ReactiveReachingConfig, task_space
from forcectl.tasks.coordinates import ArmTask
from forcectl.tasks.null_space_parts import (
    ConstraintPotentialConfig,
    EvasiveConfig,
    JointLimitPotentialConfig,
    JointSpeedConfig,
    LinkPotentialConfig,
    SmallMassPotentialConfig,
)
from forcectl.tasks.reactive_motion import MotionLimitsConfig
from forcectl.tasks.task_parts import ArmTaskConfig, start_motion
from forcectl.testing import assert_memory_released
from tests.examples.reactive_examples import at, two_arms
from tests.examples.robot_folders import write_planar_robot
from tests.examples.stations import free


class Nothing:
    """Has the methods of both slots, but makes nothing that can be used."""

    def criterion(self, setting: Any) -> Any:
        return setting

    def potentials(self, setting: Any) -> Any:
        return [3]


LEFT = {"arm": "left", "position": [0.20, 0.25, 0.25]}
SHORT = """
preset: ideal
station:
  fidelity: Multibody
  robot: yumi
  tool: null
  time_step: 0.002
  drive: !JointInterface {}
  sensors: {joints: !JointReadings {}}
  environment: !Parts {}
controller: !ReactiveReaching
  targets:
    - {arm: left, position: [0.1, 0.3, 0.3]}
    - {arm: right, position: [0.20, -0.25, 0.20], turn_deg: [0.0, 0.0, 20.0]}
    - {arm: left, position: [0.20, 0.25, 0.25], time: 0.2}
analyses: {reaching: !Reaching {}}
duration: 1.6
"""


@pytest.fixture(scope="module")
def result(tmp_path_factory: pytest.TempPathFactory) -> RunResult:
    """Both arms reach; the left one is sent elsewhere on its way."""
    path = tmp_path_factory.mktemp("reaching") / "short.yaml"
    path.write_text(SHORT, encoding="utf-8")
    return fc.run(path)


def model(**station: Any) -> PlantModel:
    return plant_model(describe(free(tool=None, **station)))


def build(obstacles: Sequence[ObstacleConfig] = (), **changes: Any) -> Any:
    return ReactiveReachingConfig(**changes).add_to(DiagramBuilder(), model(obstacles=obstacles))


@pytest.mark.slow
def test_on_the_station_both_arms_get_there_within_all_limits(result: RunResult) -> None:
    (found,) = result.metrics.values()
    metrics = {name: value for name, value in found.items() if value is not None}
    assert metrics["reach_offset_mm"] < 0.5
    assert metrics["reach_angle_deg"] < 0.1
    assert metrics["retargets"] == 1
    assert 0.3 < metrics["time_reached_s"] < 1.4
    assert metrics["left.reached"] == metrics["right.reached"] == metrics["reached"] == 1
    assert metrics["stalled"] == 0
    # The left arm is sent elsewhere at 0.2 s, and is the last.
    assert metrics["left.time_reached_s"] == pytest.approx(metrics["time_reached_s"])
    assert metrics["speed_limit_excess_rad_s"] == 0
    assert metrics["jerk_share_1_s"] <= 50 * (1 + 1e-6)
    assert metrics["reversals_at_rest_1_s"] <= 2
    assert metrics["constraint_excess"] == 0
    assert metrics["holding_share"] == 0
    assert metrics["acceleration_share"] <= 1 + 1e-6
    assert metrics["link_distance_mm"] > 9
    assert metrics["reflected_mass_kg"] > 0.1
    assert result.findings == {"default": []}
    assert set(REACH_METRICS) <= set(metrics)
    assert all(is_motion_metric(name) for name in REACH_METRICS)


@pytest.mark.slow
def test_the_targets_are_in_the_log_and_taken_at_their_time(result: RunResult) -> None:
    log = result.log
    target, time = log["task_target"].values, log["time"].values
    np.testing.assert_allclose(target[0, :3], [0.1, 0.3, 0.3])
    np.testing.assert_allclose(target[time > 0.201][0, :3], LEFT["position"])
    np.testing.assert_allclose(target[:, 11], np.radians(20.0))


@pytest.mark.slow
def test_a_loop_that_is_dropped_gives_its_memory_back() -> None:
    def loop() -> Diagram:
        controller = ReactiveReachingConfig(targets=[ReachConfig(**LEFT)])
        return Scenario(station=free(tool=None, time_step=0.002), controller=controller).build().diagram

    assert assert_memory_released(loop, duration=0.02, builds=3, allowed_kb=500.0).checked_references


def test_a_target_that_no_arm_could_reach_is_refused() -> None:
    with pytest.raises(BadInputError, match=r"targets\.0\.position = .*must be within 10 m or rad of the start"):
        build(targets=[ReachConfig(arm="left", position=[100.0, 0.3, 0.3])])
    with pytest.raises(BadInputError, match="times the length of the arm"):  # 10 m from the start, not from 0
        build(targets=[ReachConfig(arm="left", position=[-10.005, 0.3, 0.3])])


def test_a_speed_margin_of_everything_is_refused() -> None:
    with pytest.raises(BadInputError, match=r"speed_margin.*below 1"):
        build(speed_margin=1.0)


def test_an_arm_without_a_target_stays() -> None:
    made = build(targets=[ReachConfig(**LEFT)])
    context = made.CreateDefaultContext()
    for name in ("joint_position", "joint_velocity"):
        made.GetInputPort(name).FixValue(context, model().start)
    start = made.GetOutputPort("task_position").Eval(context)
    target = made.GetOutputPort("task_target").Eval(context)
    np.testing.assert_array_equal(target[6:], start[6:])
    np.testing.assert_array_equal(target[:3], LEFT["position"])


@pytest.mark.parametrize(
    "null_space",
    [
        JointSpeedConfig(time_constant=0.1),
        EvasiveConfig(potentials=[JointLimitPotentialConfig(), LinkPotentialConfig()]),
        EvasiveConfig(potentials=[SmallMassPotentialConfig(arm="left", direction=[1.0, 0.0, 0.0])]),
        EvasiveConfig(
            potentials=[ConstraintPotentialConfig(constraint=WallConfig(point=[0, 0, 0], normal=[0, 0, 1], arm="left"))]
        ),
    ],
)
def test_every_null_space_criterion_can_be_chosen(null_space: Any) -> None:
    made = build(null_space=null_space, targets=[ReachConfig(**LEFT)])
    context = made.CreateDefaultContext()
    for name in ("joint_position", "joint_velocity"):
        made.GetInputPort(name).FixValue(context, model().start)
    assert made.GetOutputPort("status").Eval(context)[0] == 0
    assert made.GetOutputPort("levels_solved").Eval(context)[0] == 2


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"targets": [ReachConfig(arm="middle", position=[0, 0, 0])]}, "targets.0.arm: unknown arm 'middle'"),
        (
            {"targets": [ReachConfig(**LEFT), ReachConfig(arm="left", position=[5, 0, 0], time=1.0)]},
            r"targets\.1\.position = \[5.*: must be within 1\.\d+ m, 1.5 times the length of the arm, of.* away",
        ),
        (
            {"targets": [ReachConfig(**LEFT)], "obstacles": [ObstacleConfig(position=LEFT["position"])]},
            r"targets\.0\.position = \[0\.2.*: must be outside of the box 'box_1' of size",
        ),
        ({"constraints": [WallConfig(arm="middle", point=[0, 0, 0], normal=[0, 0, 1])]}, "unknown arm 'middle'"),
        ({"constraints": [WallConfig(arm="left", point=[0, 0, 2], normal=[0, 0, 1])]}, "violated in the start"),
        ({"link_distance": 0.5}, "violated in the start"),
        (
            {"link_distance": 0.0, "null_space": EvasiveConfig(potentials=[LinkPotentialConfig()])},
            "above zero to keep away from links",
        ),
        ({"null_space": EvasiveConfig(potentials=[SmallMassPotentialConfig(arm="middle")])}, "unknown arm 'middle'"),
        ({"null_space": Nothing()}, r"null_space: criterion must return an object with cost\(motion, period\)"),
        ({"null_space": EvasiveConfig(potentials=[Nothing()])}, "potential int lacks speed"),
    ],
)
def test_what_does_not_fit_the_robot_is_refused(changes: dict[str, Any], said: str) -> None:
    with pytest.raises(BadInputError, match=said):
        build(**changes)


def test_the_links_keep_away_from_the_boxes_of_the_station() -> None:
    """A box around the tip of an arm at the start is one that it is too near to."""
    robot = model().known_robot()
    context = robot.create_context()
    robot.set_positions(context, model().start)
    box = ObstacleConfig(position=robot.tip_position(context).tolist(), size=[0.05, 0.05, 0.05])
    with pytest.raises(BadInputError, match="violated in the start"):
        build(obstacles=[box])


@pytest.mark.parametrize(
    ("kind", "values", "said"),
    [
        (ReachConfig, {"arm": "left", "position": [0.0, 0.0]}, "position"),
        (ReachConfig, {"arm": "left", "position": [0.0, 0.0, np.nan]}, "position"),
        (ReachConfig, {"arm": "left", "position": [0, 0, 0], "turn_deg": [180.0, 0.0, 0.0]}, "less than 180"),
        (ReachConfig, {"arm": "left", "position": [0, 0, 0], "time": -1.0}, "time"),
        (MotionLimitsConfig, {"speed": 0.0}, "speed"),
        (MotionLimitsConfig, {"speed": 75.0}, "speed = 75.0: must be above 0 and at most 10"),
        (MotionLimitsConfig, {"turn_speed": 90.0}, "turn_speed = 90.0: must be above 0 and at most 30"),
        (JointLimitConfig, {"velocity": [180.0]}, "velocity.0 = 180.0: must be positive and at most 30"),
        (SpeedLimitConfig, {"task": None, "limit": [1e-9]}, "limit.0 = 1e-09: must be from 0.0001 to 100"),
        (MotionLimitsConfig, {"turn_jerk": np.inf}, "jerk"),
        (EvasiveConfig, {"potentials": []}, "potentials"),
        (JointSpeedConfig, {"time_constant": -1.0}, "time_constant = -1.0"),
        (SmallMassPotentialConfig, {"direction": [0, 0, 0]}, "direction"),
        (ReactiveReachingConfig, {"link_distance": -0.1}, "link_distance"),
        (ReachAnalysis, {"every": 0}, "every"),
        (ReachAnalysis, {"mass_direction": [0.0]}, "mass_direction"),
    ],
)
def test_bad_values_are_refused_by_name(kind: Any, values: dict[str, Any], said: str) -> None:
    with pytest.raises(BadInputError, match=said):
        kind(**values)


def test_tasks_of_an_arm_may_be_more_than_a_pose_by_priority_or_in_modes() -> None:
    tasks = {"pose": ArmTaskConfig(arm="left"), "height": ArmTaskConfig(arm="left", coordinates=["z"], priority=2)}
    build(targets=[], tasks=tasks)
    tasks["height"] = ArmTaskConfig(arm="left", coordinates=["z"])
    build(targets=[], tasks=tasks, modes=[ModeConfig(tasks=[name]) for name in tasks])
    with pytest.raises(BadInputError, match=r"^tasks\.height is the last of tasks of the left arm with 7 coordinates"):
        build(targets=[], tasks=tasks)


FEW = """
station:
  {robot: FOLDER, tool: null, drive: !JointInterface {}, sensors: {joints: !JointReadings {}}, environment: !Parts {}}
controller: !ReactiveReaching {link_distance: 0.0, targets: [{arm: arm, position: [0.4, 0.1, 0.0]}]}
"""


def test_a_pose_is_too_much_for_an_arm_of_few_joints(tmp_path: Path) -> None:
    scenario = parse(FEW.replace("FOLDER", str(write_planar_robot(tmp_path))), "test")
    with pytest.raises(
        BadInputError, match=r"controller\.tasks\.arm .* 6 coordinates .* at most 3, one per joint: give"
    ):
        fc.build(load_scenario(scenario))
    task = parse("!ArmTask {arm: arm, coordinates: [x, y, psi]}", "task")
    fc.build(load_scenario(scenario, overrides={"controller.targets": [], "controller.tasks": {"hand": task}}))


def test_arms_may_be_sent_to_the_same_place_one_after_the_other_or_where_links_may_touch() -> None:
    both = [ReachConfig(arm=arm, position=[0.4, 0.0, 0.3], time=time) for arm, time in (("left", 0.0), ("right", 1.0))]
    ReactiveReachingConfig(targets=both)
    ReactiveReachingConfig(targets=[replace(each, time=0.0) for each in both], link_distance=0.0)


def test_random_moves_are_within_their_extent_and_of_their_seed() -> None:
    start = start_motion(model())
    moves = RandomMovesConfig(count=30, every=0.5, start=0.2, extent=[0.03, 0.0, 0.1], seed=4)
    found = moves.targets(start)
    assert [each.time for each in found[::2]] == pytest.approx(0.2 + 0.5 * np.arange(30))
    assert [each.arm for each in found[:2]] == list(start.arm_names)
    for arm in start.arm_names:
        away = np.array([each.position for each in found if each.arm == arm]) - start.arm(arm).position
        assert (np.abs(away) <= np.array([0.03, 1e-12, 0.1])).all()
        assert (np.abs(away).max(axis=0)[[0, 2]] > 0.8 * np.array([0.03, 0.1])).all()
    assert found == moves.targets(start)
    assert found != RandomMovesConfig(count=30, every=0.5, start=0.2, extent=[0.03, 0.0, 0.1], seed=5).targets(start)


def test_random_moves_beside_targets_are_refused() -> None:
    with pytest.raises(BadInputError, match=r"random_moves\.count = 3: must be 0 beside targets or tasks"):
        ReactiveReachingConfig(
            targets=[ReachConfig(arm="left", position=[0, 0, 0])], random_moves=RandomMovesConfig(count=3)
        )


class Switch:
    """Puts out the signal `mode`: 1 from a time on."""

    def add_to(self, builder: DiagramBuilder, model: PlantModel) -> Diagram:
        inner = DiagramBuilder()
        step = inner.AddNamedSystem("step", TrajectorySource(held_trajectory([0.0, 0.4], np.array([[0.0, 1.0]]))))
        inner.ExportOutput(step.get_output_port(), "mode")
        return builder.AddNamedSystem("switch", inner.Build())


MODES = """
  link_distance: 0.01
  tasks:
    left: !ArmTask {arm: left, coordinates: [x, y, z], targets: [{time: 0.02, value: [0.2, 0.25, 0.3]}]}
    right: !ArmTask {arm: right, coordinates: [x, y, z]}
  modes:
    - {tasks: [right]}
    - constraints: [!Range {task: !ArmTask {arm: left, coordinates: [z]}, upper: [0.25]}]
      touching: [[left_link_7, right_link_7]]
      null_space: [!Evasive {potentials: [!AwayFromLinks {}]}]
"""


def of_modes(modes: str) -> Any:
    text = SHORT.split("controller:")[0] + f"controller: !ReactiveReaching{modes}duration: 1.2\n"
    made = fc.load_scenario(parse(text, "test"))
    made.estimators["switch"] = Switch()
    return made


@pytest.mark.slow
def test_modes_of_a_scenario_switch_with_their_signal() -> None:
    log = fc.run(of_modes(MODES)).log
    height = np.array([at(q).arm("left").position[2] for q in log["joint_position_command"].values[::5]])
    before, time = height[0], log["time"].values[::5]
    assert np.abs(height[time < 0.39] - before).max() < 1e-3  # the left arm has no task
    assert height.max() == pytest.approx(0.25, abs=1e-5)  # then it has, up to the limit
    assert log["status"].values.max() == 0
    assert log["levels_solved"].values.min() == 2


@pytest.mark.parametrize(
    ("changed", "told"),
    [
        (("[right]", "[middle]"), "modes.0.tasks: unknown task 'middle'"),
        (("right_link_7", "hand"), "unknown shape 'hand'"),
        (("[left_link_7, right_link_7]", "[left_link_7]"), "touching.0 = ['left_link_7']: must be two names of shapes"),
        (
            ("[[left_link_7, right_link_7]]", "[[left_link_7, right_link_7], [right_link_7, left_link_7]]"),
            "touching.1 = ['left_link_7', 'right_link_7']: must be another",
        ),
        (("upper: [0.25]", "upper: [1, 2]"), "modes.1.constraints.0.upper has shape (2,)"),
        (
            ("null_space: [", "null_space: [!JointSpeed {}, "),
            "modes.1.null_space = ['JointSpeedConfig', 'EvasiveConfig']",
        ),
    ],
)
def test_a_mode_that_does_not_fit_is_told_in_one_line(changed: tuple[str, str], told: str) -> None:
    with pytest.raises(BadInputError) as caught:
        fc.build(of_modes(MODES.replace(*changed)))
    assert told in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_name_of_a_box_and_of_a_shape_says_neither() -> None:
    made = of_modes(MODES)
    made.station.environment.parts["right_link_7"] = ObstacleConfig(size=[0.1, 0.1, 0.1], position=[0.0, 0.0, -1.0])
    with pytest.raises(BadInputError, match=r"touching.0 = .*: 'right_link_7' is a box and a shape of the robot"):
        fc.build(made)


def test_the_signal_of_the_modes_must_be_there() -> None:
    made = of_modes(MODES)
    made.estimators.clear()
    with pytest.raises(BadInputError, match=r"reads mode .*, which no part outputs"):
        fc.build(made)


@pytest.mark.parametrize(("orientation", "most"), [(RotationVector(), np.pi), (EulerAngles(), 2 * np.pi)])
def test_a_rotation_vector_has_no_values_beyond_half_a_turn(orientation: Any, most: float) -> None:
    robot, task = two_arms(), ArmTask("left", ["z", "psi"], orientation)
    assert task_space(robot, task, robot.parameters.default_posture)["psi"] == (-most, most)
