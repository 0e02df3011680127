"""Frames fixed to the hands of two arms, against Drake frames that are part of the plant, and finite differences."""

from types import SimpleNamespace

import numpy as np
import pytest
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import FixedOffsetFrame, JacobianWrtVariable

from forcectl.errors import BadInputError
from forcectl.framework.euler_angles import EulerAngles, rotation_of
from forcectl.robot.arms_motion import ArmsMotion
from forcectl.tasks.relative_task import RelativeMotion, RelativeTask
from forcectl.tasks.task_frame import TaskFrame
from forcectl.tasks.task_parts import ArmTaskConfig, RelativeTaskConfig
from tests.examples.block_examples_estimation import add_chain
from tests.examples.reactive_examples import at, two_arms

PLACES = {name: (p, rotation_of(a)) for name, p, a in (
    ("left", np.array([0.05, -0.02, 0.11]), [0.3, -0.7, 1.9]),
    ("right", np.array([-0.03, 0.08, 0.06]), [2.0, 0.4, -0.6]),
)}  # fmt: skip


@pytest.fixture(scope="module")
def plant() -> MultibodyPlant:
    """Two chains, with a frame fixed to the last link of each."""
    plant = MultibodyPlant(0.0)
    for name, base in (("left", RigidTransform([0.0, 0.4, 0.0])), ("right", RigidTransform())):
        add_chain(plant, name, 6, base)
        last, (p, R) = plant.GetBodyByName(f"{name}_link_6"), PLACES[name]
        plant.AddFrame(FixedOffsetFrame(f"{name}_tip", last.body_frame(), RigidTransform(RotationMatrix(R), p)))
    plant.Finalize()
    return plant


def motion_of(plant, context, frame):
    """A body's motion in the world by Drake."""
    world, v = plant.world_frame(), plant.GetVelocities(context)
    asked = (JacobianWrtVariable.kV, frame, np.zeros(3), world, world)
    J, X = plant.CalcJacobianSpatialVelocity(context, *asked), frame.CalcPoseInWorld(context)
    bias = plant.CalcBiasSpatialAcceleration(context, *asked).get_coeffs()
    rotation = X.rotation().matrix()
    return SimpleNamespace(position=X.translation(), rotation=rotation, jacobian=J, velocity=J @ v, bias=bias)


def assert_same(ours, theirs):
    for name in ("position", "rotation", "velocity", "jacobian", "bias"):
        np.testing.assert_allclose(getattr(ours, name), getattr(theirs, name), rtol=1e-9, atol=1e-9, err_msg=name)


def test_fixed_frames_move_as_those_of_the_plant(plant):
    rng, context = np.random.default_rng(1), plant.CreateDefaultContext()
    for _ in range(10):
        plant.SetPositions(context, rng.uniform(-2, 2, 12))
        plant.SetVelocities(context, rng.uniform(-3, 3, 12))
        tips = {}
        for name, place in PLACES.items():
            body = motion_of(plant, context, plant.GetFrameByName(f"{name}_link_6"))
            tips[name] = TaskFrame(*place).motion(body)
            assert_same(tips[name], motion_of(plant, context, plant.GetFrameByName(f"{name}_tip")))
        leader, follower = (plant.GetFrameByName(f"{name}_tip") for name in PLACES)
        asked = (JacobianWrtVariable.kV, follower, np.zeros(3), leader, leader)
        relative = RelativeMotion(tips["left"], tips["right"])
        X = plant.CalcRelativeTransform(context, leader, follower)
        np.testing.assert_allclose(relative.position, X.translation(), atol=1e-12)
        np.testing.assert_allclose(relative.rotation, X.rotation().matrix(), atol=1e-12)
        np.testing.assert_allclose(relative.jacobian, plant.CalcJacobianSpatialVelocity(context, *asked), atol=1e-12)
        bias = plant.CalcBiasSpatialAcceleration(context, *asked).get_coeffs()
        np.testing.assert_allclose(relative.bias, bias, rtol=1e-9, atol=1e-9)


def test_the_task_of_a_plunger_in_a_tube_moves_as_it_says():
    """By finite differences of its coordinates, along a motion of all joints."""
    frames = {name: TaskFrame(*place) for name, place in PLACES.items()}
    task = RelativeTask(
        "left",
        "right",
        ["x", "y", "z", "phi", "theta"],
        EulerAngles(about=[0.0, 0.0, 0.0]),
        follower_frame=frames["right"],
        leader_frame=frames["left"],
    )
    rng, h, checked = np.random.default_rng(2), 1e-5, 0
    start = two_arms().parameters.default_posture
    for _ in range(12):
        q, v, u = start + rng.uniform(-0.3, 0.3, 14), rng.uniform(-0.5, 0.5, 14), rng.normal(size=14)
        here, after, before = (task.state(at(q + t * v + t**2 / 2 * u, v + t * u)) for t in (0.0, h, -h))
        if abs(np.cos(here.value[4])) < 0.3 or np.abs(after.value - before.value).max() > 1e-2:
            continue  # beside the singularity, or a turn apart
        checked += 1
        np.testing.assert_allclose(here.rate, (after.value - before.value) / (2 * h), rtol=1e-6, atol=1e-7)
        total = here.jacobian @ u + here.bias
        np.testing.assert_allclose(total, (after.rate - before.rate) / (2 * h), rtol=1e-5, atol=1e-5)
    assert checked >= 6


def test_parts_of_a_scenario_place_the_frames():
    start = at(two_arms().parameters.default_posture)
    tip = start.arm("right")
    point = ArmTaskConfig(arm="right", frame_position=[0.0, 0.0, 0.1], frame_rotation_deg=[0.0, 0.0, 90.0]).task(start)
    np.testing.assert_allclose(point.state(start).value[:3], tip.position + 0.1 * tip.rotation[:, 2], atol=1e-12)
    turned = point.tool(start).rotation
    np.testing.assert_allclose(turned, tip.rotation @ [[0, -1, 0], [1, 0, 0], [0, 0, 1]], atol=1e-12)
    names = {"leader": "left", "follower": "right"}
    mouth = RelativeTaskConfig(**names, leader_position=[0.0, 0.0, 0.05], coordinates=["z"])
    plain = RelativeTaskConfig(**names, coordinates=["z"])
    both = [config.task(start).state(start).value.item() for config in (mouth, plain)]
    assert both[0] == pytest.approx(both[1] - 0.05, abs=1e-12)


def test_a_task_without_a_frame_is_that_of_the_tcp_itself():
    start = at(two_arms().parameters.default_posture)
    assert isinstance(start, ArmsMotion)
    assert ArmTaskConfig(arm="left").task(start).tool(start) is start.arm("left")


def test_bad_frames_are_refused():
    with pytest.raises(BadInputError, match="position"):
        TaskFrame([0.0, np.nan, 0.0])
    with pytest.raises(BadInputError, match=r"^rotation = "):
        TaskFrame(rotation=2 * np.eye(3))
