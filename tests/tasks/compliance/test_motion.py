"""Two arms that press a part of one into one of the other: by the whole controller, on springs between their hands."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from pydrake.multibody.math import SpatialForce
from pydrake.systems.analysis import Simulator

from forcectl.errors import BadInputError
from forcectl.framework.rotation_vector import RotationVector
from forcectl.tasks.compliance.motion import CompliantMotion
from forcectl.tasks.compliance.parts import AdmittanceGainsConfig, ReferenceConfig, mode_references
from forcectl.tasks.compliance.task_force import TaskForce
from forcectl.tasks.coordinates import ArmTask
from forcectl.tasks.modes import Mode
from forcectl.tasks.reactive_controller import ReactiveController
from forcectl.tasks.reactive_motion import MotionLimitsConfig
from forcectl.tasks.relative_task import RelativeMotion, RelativeTask
from forcectl.tasks.task_frame import TaskFrame
from tests.examples.reactive_examples import at, two_arms

PERIOD = 0.004
Q = two_arms().parameters.default_posture
MOUTH, TIP = TaskFrame([0.0, 0.0, 0.05]), TaskFrame([0.0, 0.0, 0.05])


def poses(q: np.ndarray) -> RelativeMotion:
    motion = at(q)
    return RelativeMotion(MOUTH.motion(motion.arm("left")), TIP.motion(motion.arm("right")))


START = poses(Q)
TASKS = {
    "lead": ArmTask("left", ["x", "y", "z"]),
    "peg": RelativeTask(
        "left",
        "right",
        ["x", "y", "z", "phi", "theta"],
        RotationVector(START.rotation),
        leader_frame=MOUTH,
        follower_frame=TIP,
    ),
}
INSERT: dict[str, Any] = {name: {"comply": True} for name in ("x", "y", "phi", "theta")} | {"z": {"velocity": -0.05}}
PUSH = INSERT | {"z": {"comply": True, "force": 5.0, "damping": 60.0, "speed_limit": [-0.03, 0.02]}}


def references(peg: dict[str, Any]) -> Any:
    said = {"peg": {name: ReferenceConfig(**each) for name, each in peg.items()}}
    return mode_references(said, TASKS, gains=AdmittanceGainsConfig(), limits=MotionLimitsConfig(), period=PERIOD)


def motion(*modes: dict[str, Any], forces: bool = True) -> CompliantMotion:
    tasks = list(TASKS.values())
    controller = ReactiveController(two_arms(), tasks, modes=[Mode() for _ in modes], period=PERIOD)
    return CompliantMotion(
        controller, [references(each) for each in modes], TaskForce(two_arms(), tasks) if forces else None
    )


# Of the springs: the sides act below the mouth, the bottom at the end.
CENTRE = np.add(START.position, [0.003, -0.002, -0.02])
SIDES, BOTTOM = 800.0, 2000.0


def force(p: np.ndarray) -> np.ndarray:
    """On the tip, in the axes of the leader."""
    below = p[2] < START.position[2] - 0.01
    sides = SIDES * (CENTRE - p)[:2] if below else np.zeros(2)
    return np.array([*sides, BOTTOM * max(CENTRE[2] - p[2], 0.0)])


def wrenches(q: np.ndarray) -> np.ndarray:
    """What both arms feel, each at its TCP in the world."""
    now = at(q)
    leader, follower = now.arm("left"), now.arm("right")
    tip = TIP.motion(follower).position
    f = leader.rotation @ force(poses(q).position)
    felt = []
    for arm, sign in ((leader, -1.0), (follower, 1.0)):
        felt.append(SpatialForce(np.zeros(3), sign * f).Shift(arm.position - tip).get_coeffs())
    return np.concatenate(felt)


def test_a_peg_goes_to_the_bottom_centres_itself_and_presses_with_the_desired_force():
    """The joints are where they were commanded a tick before. The mode changes where the bottom is felt."""
    block = motion(INSERT, PUSH)
    simulator = Simulator(block)
    context = simulator.get_mutable_context()
    names = (
        "joint_position_command",
        "joint_velocity_command",
        "task_wrench",
        "task_displacement",
        "status",
        "holding",
    )
    log: dict[str, list[np.ndarray]] = {name: [] for name in names}
    q, mode, touched = Q, 0.0, 0
    for tick in range(450):
        block.GetInputPort("joint_position").FixValue(context, q)
        block.GetInputPort("joint_velocity").FixValue(context, np.zeros(14))
        block.GetInputPort("estimated_wrench").FixValue(context, wrenches(q))
        if mode == 0.0 and force(poses(q).position)[2] > 3.0:
            mode, touched = 1.0, tick
        block.GetInputPort("mode").FixValue(context, [mode])
        for name in names:
            log[name].append(block.GetOutputPort(name).Eval(context))
        q = log["joint_position_command"][-1]
        simulator.AdvanceTo(PERIOD * (tick + 1))
    end = poses(q)
    assert 60 < touched < 140
    assert force(end.position)[2] == pytest.approx(5.0, abs=0.01)
    assert np.abs(force(end.position)[:2]).max() < 0.05  # from 2.4 N
    np.testing.assert_allclose(log["task_wrench"][-1][9:], force(end.position), atol=0.01)
    np.testing.assert_allclose(end.rotation[2], START.rotation[2], atol=1e-3)  # turns about the leader's z are free
    position, speed = np.array(log["joint_position_command"]), np.array(log["joint_velocity_command"])
    np.testing.assert_allclose(np.diff(position, axis=0), 0.5 * PERIOD * (speed[1:] + speed[:-1]), atol=1e-12)
    jerk = np.diff(speed, 2, axis=0) / PERIOD / two_arms().limits.acceleration
    assert np.abs(jerk).max() <= PERIOD / 0.02 + 1e-9
    assert not np.any(log["status"])
    assert not np.any(log["holding"])


def test_nothing_complies_without_forces():
    assert not motion({"z": {"velocity": -0.05}}, forces=False).HasInputPort("estimated_wrench")
    with pytest.raises(BadInputError, match="without forces along the tasks"):
        motion(INSERT, forces=False)


def test_every_mode_of_the_controller_has_references():
    controller = ReactiveController(two_arms(), list(TASKS.values()), modes=[Mode(), Mode()], period=PERIOD)
    with pytest.raises(BadInputError, match="references: 1 of them: must be 2"):
        CompliantMotion(controller, [references({})])
