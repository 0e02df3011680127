"""What is said to be in the way of targets that are not reached."""

import numpy as np
import pytest
import xarray as xr

import forcectl as fc
from forcectl.analysis.findings.targets import in_the_way
from forcectl.diagrams import describe
from forcectl.framework.yaml_tree import parse
from forcectl.plant.contact.obstacle import ObstacleConfig
from tests.examples import stations

BOX = ObstacleConfig(size=[0.2, 0.2, 0.2], position=[0.5, 0.0, 0.1])
BOTH = stations.setting(describe(stations.free(obstacles=[BOX])))
ROBOT = BOTH.truth.known_robot()


def at(q: np.ndarray, near_singular: float = 0.0, arms: tuple[str, ...] = ("left", "right")) -> str:
    """What is in the way in this posture, in the second of two samples."""
    values = {"joint_position_command": (("time", "joint"), np.array([BOTH.truth.start, q]))}
    values |= {"near_singular": ("time", np.array([0.0, near_singular]))}
    return in_the_way(xr.Dataset(values, coords={"time": [0.0, 0.004]}), BOTH, 1, arms)


def test_a_joint_at_its_position_limit_is_named_if_it_is_of_the_arm():
    limits, free = ROBOT.limits, at(BOTH.truth.start)
    assert "limit" not in free
    for k, end in ((3, limits.position_upper), (12, limits.position_lower)):
        q = BOTH.truth.start.copy()
        q[k] = end[k]
        name, arm, other = ROBOT.parts.joints[k].name(), *(("left", "right") if k < 7 else ("right", "left"))
        assert at(q, arms=(arm,)).startswith(f"{name} is at its position limit")
        assert "limit" not in at(q, arms=(other,))
        q[k] -= np.sign(end[k]) * 0.1
        assert "limit" not in at(q)


def test_a_posture_near_a_singularity_is_told():
    assert at(BOTH.truth.start, near_singular=1.0).endswith("the tasks are near a singularity")


REACH = """
preset: ideal
station:
  robot: yumi
  tool: yumi_gripper
  time_step: 0.002
  drive: !JointInterface {}
  sensors: {joints: !JointReadings {}}
  environment: !Parts {parts: {crate: !Box {size: [0.2, 0.2, 0.4], position: [0.45, 0, 0.2]}}}
controller: !ReactiveReaching
  targets: [{arm: left, position: POSITION}]
duration: 3.2
"""


@pytest.mark.slow
@pytest.mark.parametrize(
    ("position", "what"),
    [
        ("[0.45, 0.115, 0.2]", "base/left_yumi_gripper::housing and crate are 10.1 mm apart"),  # beside the box
        ("[0.1, -0.2, 0.12]", "robot_base/yumi::plinth_top and base/left_yumi_gripper::housing are 10.1 mm apart"),
        ("[0.9, 0.4, 0.25]", "no longer decreases: the tasks are near a singularity"),  # beyond the arm
    ],
)
def test_a_stalled_target_is_told_with_what_is_in_the_way(position: str, what: str):
    (one,) = fc.run(fc.load_scenario(parse(REACH.replace("POSITION", position), "far.yaml"))).findings["default"]
    assert one.kind == "target_stalled"
    assert one.text.endswith(what)
