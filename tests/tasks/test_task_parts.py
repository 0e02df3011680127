"""Tasks as parts of a scenario: coordinates of an arm, or of one arm in another."""

import numpy as np
import pytest

import forcectl as fc
from forcectl.analysis.reaching import ReachAnalysis
from forcectl.framework.euler_angles import angles_of
from forcectl.framework.yaml_tree import parse
from forcectl.robot.arms_motion import ArmsMotion
from forcectl.tasks.relative_task import RelativeMotion

CELL = """
preset: ideal
station: {robot: yumi, tool: yumi_gripper, fidelity: Multibody, drive: !JointInterface {},
          sensors: {joints: !JointReadings {}}, environment: !Parts {}}
duration: 2.0
"""


def scenario(controller):
    return fc.load_scenario(parse(f"{CELL}\ncontroller: !ReactiveReaching {controller}", "test"))


@pytest.mark.slow
def test_a_follower_keeps_its_pose_in_the_leaders_frame():
    tasks = """{tasks: {
        lead: !ArmTask {arm: left, targets: [{time: 0.1, value: [0.36, 0.2, 0.25, 0.2, 0.0, 0.0]}]},
        follow: !RelativeTask {leader: left, follower: right, orientation: euler_angles}},
        link_distance: 0}"""  # nothing but the tasks
    result = fc.run(scenario(tasks))
    setting = fc.build(scenario(tasks)).setting
    robot = setting.truth.known_robot()
    poses = []
    for q in result.log["joint_position_command"].values[[0, -1]]:
        motion = ArmsMotion(robot, robot.create_context(), q, np.zeros(14))
        poses.append(RelativeMotion(motion.arm("left"), motion.arm("right")))
        lead = motion.arm("left").position
    assert result.log["reached"].values[-1] == 1.0
    np.testing.assert_allclose(lead, [0.36, 0.2, 0.25], atol=1e-4)
    np.testing.assert_allclose(poses[1].position, poses[0].position, atol=1e-4)
    np.testing.assert_allclose(poses[1].rotation, poses[0].rotation, atol=1e-3)
    np.testing.assert_allclose(result.log["task_position"].values[0, 9:], angles_of(poses[0].rotation), atol=1e-3)


@pytest.mark.slow
def test_targets_as_tasks_are_the_same_run_as_targets_of_poses():
    turned = np.radians([10.0, 0.0, 0.0]).tolist()
    poses = "{targets: [{arm: left, time: 0.1, position: [0.3, 0.2, 0.25], turn_deg: [10, 0, 0]}]}"
    tasks = f"""{{tasks: {{
        left: !ArmTask {{arm: left, targets: [{{time: 0.1, value: {[0.3, 0.2, 0.25, *turned]}}}]}},
        right: !ArmTask {{arm: right}}}}}}"""
    ours, theirs = (fc.run(scenario(each), overrides={"duration": 0.6}).log for each in (tasks, poses))
    assert np.ptp(ours["joint_position"].values, axis=0).max() > 0.01
    np.testing.assert_array_equal(ours["joint_position"].values, theirs["joint_position"].values)


@pytest.mark.parametrize(
    ("tasks", "told"),
    [
        ("{a: !ArmTask {arm: middle}}", "middle"),
        ("{a: !ArmTask {arm: left, coordinates: [x, w]}}", "w"),
        ("{a: !ArmTask {arm: left, orientation: quaternion}}", "controller.tasks.a.orientation: unknown orientation"),
        ("{a: !ArmTask {arm: left, coordinates: [z], targets: [{value: [1, 2]}]}}", "tasks.a.targets.0.value has 2"),
        ("{a: !ArmTask {arm: left, coordinates: [z, psi], targets: [{value: [0.2, 3.2]}]}}", "less than half a turn"),
        ("{a: !ArmTask {arm: left, targets: [{value: [.nan]}]}}", "controller.tasks.a.targets.0.value"),
        ("{a: !RelativeTask {leader: left, follower: left}}", "another arm than the leader"),
        ("{a: !Step {}}", "controller.tasks.a"),
        ("{a: 3}", "controller.tasks.a"),
    ],
)
def test_a_task_that_does_not_fit_is_told_in_one_line(tasks, told):
    with pytest.raises(fc.BadInputError) as caught:
        fc.build(scenario(f"{{tasks: {tasks}}}"))
    assert told in str(caught.value)
    assert "\n" not in str(caught.value)


def test_targets_beside_tasks_are_refused():
    both = "{targets: [{arm: left, position: [0.3, 0.2, 0.2]}], tasks: {a: !ArmTask {arm: left}}}"
    with pytest.raises(fc.BadInputError, match="targets of their own"):
        scenario(both)


def test_the_reaching_analysis_is_of_whole_poses_only():
    tasks = scenario("{tasks: {a: !ArmTask {arm: left, coordinates: [x, y, z]}}}")
    tasks.analyses["reaching"] = ReachAnalysis()
    assert "reach_offset_mm" not in fc.run(tasks, overrides={"duration": 0.1}).metrics["default"]
