"""Two arms that press a part of one into one of the other: by the whole controller, on springs between their hands."""

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
from forcectl.tasks.constraints.task_limits import TaskRange
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


def motion(*modes: dict[str, Any], forces: bool = True, **options: Any) -> CompliantMotion:
    tasks = list(TASKS.values())
    controller = ReactiveController(two_arms(), tasks, modes=[Mode() for _ in modes], period=PERIOD, **options)
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


def run(block: CompliantMotion, ticks: int, mode: Any, felt: Any = lambda q: np.zeros(12)) -> dict[str, np.ndarray]:
    """Outputs over time, of joints that are where they were commanded a tick before.

    Args:
        mode: its number, of the tick and the joint positions.
        felt: wrenches, of the joint positions.
    """
    simulator = Simulator(block)
    context, q = simulator.get_mutable_context(), Q
    log: dict[str, list[np.ndarray]] = {}
    for tick in range(ticks):
        inputs = {"joint_position": q, "joint_velocity": np.zeros(14), "estimated_wrench": felt(q)}
        for name, value in (inputs | {"mode": [mode(tick, q)]}).items():
            block.GetInputPort(name).FixValue(context, value)
        for i in range(block.num_output_ports()):
            port = block.get_output_port(i)
            log.setdefault(port.get_name(), []).append(port.Eval(context))
        q = log["joint_position_command"][-1]
        simulator.AdvanceTo(PERIOD * (tick + 1))
    return {name: np.array(values) for name, values in log.items()}


def assert_smooth(log: dict[str, np.ndarray]) -> None:
    """Speeds are the integral of accelerations that change no faster than to their limit in 20 ms; nothing failed."""
    position, speed = log["joint_position_command"], log["joint_velocity_command"]
    np.testing.assert_allclose(np.diff(position, axis=0), 0.5 * PERIOD * (speed[1:] + speed[:-1]), atol=1e-12)
    jerk = np.diff(speed, 2, axis=0) / PERIOD / two_arms().limits.acceleration
    assert np.abs(jerk).max() <= PERIOD / 0.02 + 1e-9
    assert not log["status"].any()
    assert not log["holding"].any()


@pytest.mark.slow
def test_a_peg_goes_to_the_bottom_centres_itself_and_presses_with_the_desired_force():
    """The mode changes where the bottom is felt."""
    touched = []

    def mode(tick: int, q: np.ndarray) -> float:
        if not touched and force(poses(q).position)[2] > 3.0:
            touched.append(tick)
        return float(bool(touched))

    log = run(motion(INSERT, PUSH), 300, mode, wrenches)
    end = poses(log["joint_position_command"][-1])
    assert 60 < touched[0] < 140
    assert force(end.position)[2] == pytest.approx(5.0, abs=0.01)
    assert np.abs(force(end.position)[:2]).max() < 0.05  # from 2.4 N
    np.testing.assert_allclose(log["task_wrench"][-1][9:], force(end.position), atol=0.01)
    np.testing.assert_allclose(end.rotation[2], START.rotation[2], atol=1e-3)  # turns about the leader's z are free
    assert_smooth(log)


@pytest.mark.slow
@pytest.mark.parametrize("comply", [True, False])
def test_what_is_blocked_turns_back_at_once(comply):
    """A limit of the task keeps it from going on; the generator of what complies goes on without it."""
    lower = np.array([-np.inf, -np.inf, START.position[2] - 0.01, -np.inf, -np.inf])
    wall = TaskRange(TASKS["peg"], lower=lower)
    block = motion(INSERT | {"z": {"velocity": -0.075, "comply": comply}}, {"z": {"by": 0.005}}, constraints=[wall])
    log = run(block, 225, lambda tick, q: float(tick >= 150))
    z = [poses(q).position[2] - START.position[2] for q in log["joint_position_command"][[149, 175, -1]]]
    assert z[0] == pytest.approx(-0.01, abs=1e-5)
    # 0.1 s after the switch; 67 ms of it the jerk of 20 m/s^3 takes for the 1 mm that the reference is ahead.
    assert z[1] > z[0] + 1e-5
    assert z[2] == pytest.approx(z[0] + 0.005, abs=1.1e-3)
    assert (log["task_displacement"][149, 5] > 0.02) == comply
    assert_smooth(log)


def test_nothing_complies_without_forces():
    assert not motion({"z": {"velocity": -0.05}}, forces=False).HasInputPort("estimated_wrench")
    with pytest.raises(BadInputError, match="must be false unless the forces along the tasks are given"):
        motion(INSERT, forces=False)


def test_every_mode_of_the_controller_has_references():
    controller = ReactiveController(two_arms(), list(TASKS.values()), modes=[Mode(), Mode()], period=PERIOD)
    with pytest.raises(BadInputError, match="references: 1 of them: must be 2"):
        CompliantMotion(controller, [references({})])
