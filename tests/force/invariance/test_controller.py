"""The robot's invariance controller: like the scalar law, within its limits, and safe whatever happens to it."""

import math
from typing import Any

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator

from forcectl.errors import BadInputError
from forcectl.force.invariance.force_law import InvarianceForceLaw
from forcectl.force.invariance.regulated_output import RegulatedCoordinate
from forcectl.motion.tangential import TangentialMotionConfig
from forcectl.qp.named_program import Coefficients, NamedProgram
from forcectl.qp.quadratic_program import Status
from forcectl.qp.solvers import Solver, make_solver
from forcectl.robot.robot_motion import RobotMotion
from forcectl.tasks.constraints.base import CartesianWall
from tests.examples.robot_controller_runs import (
    COMPLIANCE,
    PERIOD,
    N,
    accelerations,
    assert_smooth,
    drive,
    limits,
    make,
    robot_plant_model,
    tips,
    turns,
)

pytestmark = pytest.mark.slow

STEP = 15.0 * COMPLIANCE  # depth of 15 N [m]
SIDE = np.array([0.0, 1.0, 0.0])


# --- the law ----------------------------------------------------------------------------------------------------------


def steps_and_ramps(k: int) -> float:
    if k < 400:
        return 15.0
    return 5.0 if k < 700 else 5.0 + 10 * math.sin(0.004 * (k - 700)) + 0.02 * (k - 700)


def scalar_law(ticks: int) -> np.ndarray:
    law = InvarianceForceLaw(1, gamma=-0.1, compliance=COMPLIANCE, period=PERIOD)
    context = law.CreateDefaultContext()
    simulator = Simulator(law, context)
    law.GetInputPort("measured_force").FixValue(context, [0.0])
    found = []
    for k in range(ticks):
        if k:
            simulator.AdvanceTo(k * PERIOD)
        law.GetInputPort("desired_force").FixValue(context, [steps_and_ramps(k)])
        if k == 0:
            simulator.Initialize()
        found.append(law.GetOutputPort("displacement_command").Eval(context).item())
    return np.array(found)


@pytest.mark.parametrize(("fidelity", "tolerance"), [("OneDimensional", 1e-12), ("Kinematic", 2e-9)])
def test_along_the_normal_it_is_the_scalar_law(fidelity: str, tolerance: float) -> None:
    log = drive(make(fidelity), 1200, desired=steps_and_ramps)
    np.testing.assert_allclose(log["displacement_command"], scalar_law(1200), atol=tolerance)
    assert not log["status"].any()
    if fidelity == "Kinematic":  # the tool moves as the command says, and stays on its line
        moved = tips(log)
        np.testing.assert_allclose(moved[:, 2], log["displacement_command"], atol=1e-10)
        np.testing.assert_allclose(moved[:, :2], 0.0, atol=1e-6)


def test_the_force_is_reached_without_overshoot_while_the_tool_moves_along_the_surface() -> None:
    def circle(k: int) -> np.ndarray:
        return np.array([0.2 * math.sin(0.004 * k), 0.05 * math.sin(0.006 * k), 0.0, 0.0, 0.0, 0.0])

    log = drive(make(), 800, reference=circle)
    assert_smooth(log)
    assert log["displacement_command"].min() > -STEP - 1e-8
    np.testing.assert_allclose(log["displacement_command"][300:], -STEP, atol=1e-7)
    assert np.ptp(tips(log)[:, 1]) > 0.15


def test_the_path_in_the_unconstrained_directions_is_followed() -> None:
    model = robot_plant_model()
    path = TangentialMotionConfig(distance=0.03, speed=0.02).trajectory(model.robot, model.start, model.n)

    def reference(k: int) -> np.ndarray:
        return path.value(min(k * PERIOD, path.end_time())).ravel()

    log = drive(make(), 1100, reference=reference)
    for tick in (200, 500, 900, 1099):
        place, wanted = (
            RobotMotion(model.robot, model.robot.create_context(), q, np.zeros(N))
            for q in (log["joint_position_command"][tick], model.start + reference(tick))
        )
        np.testing.assert_allclose(place.position[:2], wanted.position[:2], atol=2e-6)
        np.testing.assert_allclose(place.rotation, wanted.rotation, atol=1e-5)
    assert log["displacement_command"].min() > -STEP - 1e-9
    assert tips(log)[-1, 0] == pytest.approx(0.03, abs=1e-6)


def test_an_integral_law_is_corrected_where_it_would_overshoot() -> None:
    # Behind a sensor that lags by 0.1 s, K_I = 10 overshoots by itself.
    forces: list[float] = []

    def lagging(k: int, dx: float) -> float:
        forces.append(forces[-1] + 0.02 * (-dx / COMPLIANCE - forces[-1]) if forces else 0.0)
        return forces[-1]

    log = drive(make(nominal_gain=10.0, gamma=-1.0), 1000, measured=lagging)
    assert_smooth(log)
    command = log["displacement_command"]
    # Far from the constraint it is the integral law, dx' = -K_I C (F_bar - F), with the speed changing within the tick.
    wanted = -10.0 * COMPLIANCE * (15.0 - np.array(forces))
    np.testing.assert_allclose(np.diff(command)[4:12] / PERIOD, 0.5 * (wanted[4:12] + wanted[5:13]), rtol=1e-3)
    assert command.min() > -STEP - 1e-8
    assert command[-1] == pytest.approx(-STEP, rel=1e-3)
    assert max(forces) > 14.9


@pytest.mark.parametrize(("metric", "least", "most"), [("task", 0.0, 1e-6), ("joint", 1e-4, 1e-3)])
def test_a_correction_in_the_task_metric_moves_the_tool_along_the_normal_alone(
    metric: str, least: float, most: float
) -> None:
    forces = [0.0]

    def lagging(k: int, dx: float) -> float:
        forces.append(forces[-1] + 0.02 * (-dx / COMPLIANCE - forces[-1]))
        return forces[-1]

    moved = tips(drive(make(nominal_gain=3.0, gamma=-0.01, metric=metric), 700, measured=lagging))
    assert moved[-1, 2] == pytest.approx(-STEP, rel=1e-6)
    assert least <= np.linalg.norm(moved[:, :2], axis=1).max() < most


def test_a_second_regulated_output_reaches_its_set_point_without_overshoot_beside_the_force() -> None:
    log = drive(make(outputs=[RegulatedCoordinate(SIDE, 0.004, -0.05)]), 900)
    moved = tips(log)
    assert moved[:, 2].min() > -STEP - 1e-8
    assert moved[:, 1].max() < 0.004 + 1e-8
    np.testing.assert_allclose(moved[-1], [0.0, 0.004, -STEP], atol=1e-7)
    # Each as fast as alone: rest to rest in 2 sqrt(d/|gamma|), and a few ticks.
    for axis, distance, gamma in ((2, STEP, 0.1), (1, 0.004, 0.05)):
        away = np.abs(moved[:, axis] - moved[-1, axis]) > 0.02 * distance
        assert np.flatnonzero(away)[-1] * PERIOD < 2 * math.sqrt(distance / gamma)


def test_a_second_regulated_output_keeps_its_own_acceleration_beside_a_corrected_integral_law() -> None:
    for place in (0.01, -0.01):  # from either side of the set point
        log = drive(make(nominal_gain=3.0, outputs=[RegulatedCoordinate(SIDE, place, -0.05)]), 700)
        moved = tips(log)
        assert np.abs(np.diff(moved[:, 1], n=2)).max() < 0.0501 * PERIOD**2
        assert moved[-1, 1] == pytest.approx(place, abs=1e-7)
        assert moved[:, 2].min() > -STEP - 1e-8


@pytest.mark.parametrize("angle", [0.05, -0.05])
def test_an_angle_of_the_tool_is_a_second_regulated_output(angle: float) -> None:
    """(3.37): the tool turns about y and rests there without overshoot; its tip and the force are as without it."""
    log = drive(make(outputs=[RegulatedCoordinate(SIDE, angle, -0.2, turns=True)]), 900)
    moved, turned = tips(log), turns(log)
    assert np.abs(turned[:, 1]).max() < 0.05 + 1e-6
    np.testing.assert_allclose(turned[-1], [0.0, angle, 0.0], atol=1e-5)
    assert moved[:, 2].min() > -STEP - 1e-7
    np.testing.assert_allclose(moved[-1], [0.0, 0.0, -STEP], atol=1e-6)


def test_a_compliance_input_moves_the_set_point() -> None:
    log = drive(make(compliance=None), 900, compliance=lambda k: COMPLIANCE * (0.8 if k < 400 else 1.0))
    assert log["displacement_command"][390] == pytest.approx(-0.8 * STEP, rel=1e-6)
    assert log["displacement_command"][-1] == pytest.approx(-STEP, rel=1e-6)
    assert log["displacement_command"].min() > -STEP - 1e-9


# --- limits -----------------------------------------------------------------------------------------------------------


def test_joint_limits_hold_against_a_reference_beyond_them() -> None:
    model = robot_plant_model()
    tight = limits(
        position_upper=model.start + np.array([0.15, 0.1, 0.5, 0.5, 0.5, 0.5]),
        velocity=np.full(N, 0.6),
        acceleration=np.full(N, 8.0),
    )
    log = drive(
        make(limits=tight), 1200, reference=lambda k: np.array([0.4, 0.2, 0.0, 0.0, 0.0, 0.3]) * math.sin(0.01 * k)
    )
    assert_smooth(log, tight)
    q = log["joint_position_command"]
    assert q[:, 0].max() > tight.position_upper[0] - 1e-3  # it was needed
    assert not log["constraint_violation"].any()


def test_torques_stay_within_limits_by_the_model() -> None:
    model = robot_plant_model()
    weak = limits(torque=np.array([40.0, 400.0, 200.0, 30.0, 30.0, 30.0]))
    log = drive(
        make(limits=weak), 800, reference=lambda k: np.array([0.6, 0.0, 0.0, 0.0, 0.0, 0.0]) * math.sin(0.01 * k)
    )
    v, u = accelerations(log, model.start)
    q = np.vstack([model.start, log["joint_position_command"]])[:-1]
    before = np.vstack([np.zeros(N), v])[:-1]
    context = model.robot.create_context()
    states = zip(q, before, u, strict=True)
    torque = np.array([RobotMotion(model.robot, context, *state).torque(row) for *state, row in states])
    assert np.abs(torque[:, 0]).max() == pytest.approx(40.0, rel=1e-3)
    assert (np.abs(torque) <= weak.torque * (1 + 1e-6) + 1e-4).all()
    assert log["constraint_violation"].max() < 1e-6


def test_the_maximum_force_holds_with_a_compliance_believed_twice_too_large() -> None:
    log = drive(make(compliance=2 * COMPLIANCE, maximum_force=18.0), 800)  # it would end at 30 N
    assert -log["displacement_command"].min() / COMPLIANCE < 18.0 + 1e-3
    assert -log["displacement_command"][-1] / COMPLIANCE == pytest.approx(18.0, abs=0.05)
    log = drive(make(maximum_force=10.0), 400, desired=15.0)
    assert log["displacement_command"].min() == pytest.approx(-10.0 * COMPLIANCE, abs=1e-9)


# --- what may happen to it --------------------------------------------------------------------------------------------

BAD = [(port, math.nan) for port in ("desired", "measured", "reference", "compliance")]
BAD += [("measured", math.inf), ("reference", -math.inf)]


@pytest.mark.parametrize(("port", "bad"), BAD)
def test_an_input_that_is_no_number_brakes_and_holds_and_the_law_goes_on_after_it(port: str, bad: float) -> None:
    def during(k: int, value: Any) -> Any:
        return bad if 60 <= k < 200 else value

    inputs: dict[str, Any] = {
        "desired": lambda k: during(k, 15.0) if port == "desired" else 15.0,
        "measured": lambda k, dx: during(k, -dx / COMPLIANCE) if port == "measured" else -dx / COMPLIANCE,
        "reference": lambda k: np.full(N, during(k, 0.0)) if port == "reference" else np.zeros(N),
        "compliance": lambda k: during(k, COMPLIANCE) if port == "compliance" else COMPLIANCE,
    }
    log = drive(make(compliance=None, maximum_force=20.0), 500, **inputs)
    assert_smooth(log)
    assert (log["status"][60:200] == Status.NOT_FINITE).all()
    assert not log["status"][:60].any()
    assert not log["status"][200:].any()
    np.testing.assert_allclose(log["displacement_command"][100:200], log["displacement_command"][100], atol=1e-12)
    assert -STEP < log["displacement_command"][100] < 0
    assert log["displacement_command"][-1] == pytest.approx(-STEP, rel=1e-6)
    assert log["displacement_command"].min() > -20.0 * COMPLIANCE


class Failing:
    """A solver that fails in some ticks, in one of several ways."""

    def __init__(self, solver: Solver, how: str):
        self._solver, self._how, self._tick = solver, how, 0

    def __call__(self, program: NamedProgram, numbers: Coefficients) -> tuple[Any, bool]:
        self._tick += 1
        if not 60 < self._tick <= 200:
            return self._solver(program, numbers)
        if self._how == "raises":
            raise RuntimeError("no")
        n = len(numbers.gradient)
        return {"gives up": None, "NaN": np.full(n, np.nan), "far off": np.full(n, 1e9)}[self._how], False


@pytest.mark.parametrize("how", ["raises", "gives up", "NaN", "far off"])
def test_a_solver_that_fails_leaves_a_robot_that_stands_still(how: str) -> None:
    controller = make(solver=Failing(make_solver("daqp"), how), maximum_force=20.0)
    log = drive(controller, 500)
    assert_smooth(log)
    failed = log["status"] == Status.SOLVER_FAILED
    assert failed.sum() > 50
    held = log["displacement_command"][np.flatnonzero(failed)[-10:]]
    np.testing.assert_allclose(held, held[0], atol=1e-12)
    assert log["displacement_command"].min() > -STEP - 1e-8
    assert log["displacement_command"][-1] == pytest.approx(-STEP, rel=1e-6)


class Closing:
    """A user's limits that contradict each other once the tool is deeper than 1 mm."""

    relative_degree = 1

    def evaluate(self, motion: RobotMotion) -> Any:
        deep = motion.contact.displacement < -1e-3
        row = motion.contact.row
        return ([0.0, 0.0] if deep else [-1.0, -1.0]), 0.0, [row, -row], [1.0, 1.0]


def test_limits_that_contradict_each_other_brake_and_hold() -> None:
    log = drive(make(constraints=[Closing()], maximum_force=20.0), 400)
    assert_smooth(log)
    assert log["status"][-1] == Status.INFEASIBLE
    assert -1.2e-3 < log["displacement_command"][-1] < -1e-3
    assert np.ptp(log["displacement_command"][-100:]) < 1e-12


class Breaking:
    """A user's constraint that raises, or is no number, for a while."""

    relative_degree = 2

    def __init__(self, how: str):
        self._how, self._calls = how, 0

    def evaluate(self, motion: RobotMotion) -> Any:
        self._calls += 1
        if 60 < self._calls < 200:
            if self._how == "raises":
                raise ValueError("no")
            return math.nan, math.nan, motion.jacobian[3], 0.0
        return -1.0, 0.0, motion.jacobian[3], 0.0


@pytest.mark.parametrize("how", ["raises", "NaN"])
def test_a_users_constraint_that_breaks_brakes_and_holds(how: str) -> None:
    log = drive(make(constraints=[Breaking(how)]), 500)
    assert_smooth(log)
    assert (log["status"] == Status.NOT_FINITE).sum() > 100
    assert log["displacement_command"][-1] == pytest.approx(-STEP, rel=1e-6)


def test_regulated_outputs_give_way_before_limits_do() -> None:
    # A wall of the force: no deeper than 2 mm, where 3 mm are asked for. Then one that pushes back.
    model = robot_plant_model()
    context = model.robot.create_context()
    model.robot.set_positions(context, model.start)
    floor = CartesianWall(model.robot.tip_position(context) - [0.0, 0.0, 2e-3], [0.0, 0.0, 1.0], -0.1)
    log = drive(make(constraints=[floor]), 400)
    assert_smooth(log)
    assert log["displacement_command"].min() == pytest.approx(-2e-3, abs=1e-8)
    assert not log["status"].any()
    assert log["constraint_violation"].max() < 1e-8


def test_an_output_out_of_reach_gives_way_before_the_force_does() -> None:
    # 5 m behind the tool, at 2 m/s^2: within a second the joints can no longer serve both.
    log = drive(make(outputs=[RegulatedCoordinate(np.array([1.0, 0.0, 0.0]), -5.0, -2.0)]), 1250)
    assert log["slack"].max() > 0.0
    assert log["displacement_command"].min() > -STEP * 1.001


def test_lost_contact_is_told_and_the_command_stays_where_it_is() -> None:
    log = drive(make(maximum_force=20.0), 900, measured=lambda k, dx: 0.0 if 400 <= k < 600 else -dx / COMPLIANCE)
    assert_smooth(log)
    assert log["contact_lost"][400:600].all()
    assert not log["contact_lost"][:400].any()
    assert not log["contact_lost"][600:].any()
    assert log["displacement_command"].min() > -STEP - 1e-8


@pytest.mark.parametrize("joint", [2, 4])
def test_a_singular_posture_on_the_way_is_told_and_passed_smoothly(joint: int) -> None:
    direction = {2: 1.2e-3, 4: -1.6e-3}[joint]

    def towards_singular(k: int) -> np.ndarray:
        return np.eye(N)[joint] * direction * min(k, 1200)

    log = drive(make(), 1300, reference=towards_singular)
    assert_smooth(log)
    assert log["near_singular"].any()
    assert not log["near_singular"][:100].any()
    assert log["displacement_command"].min() > -1.05 * STEP


def test_a_reference_that_jumps_is_reached_within_the_limits_with_the_force_kept() -> None:
    log = drive(make(), 1200, reference=lambda k: np.array([0.5, 0.3, 0.0, 0.0, 0.0, 1.0]) * (k >= 300))
    assert_smooth(log)
    assert log["displacement_command"].min() > -STEP - 1e-5
    np.testing.assert_allclose(log["displacement_command"][300:], -STEP, atol=1e-4)
    assert np.ptp(log["joint_position_command"][-50:], axis=0).max() < 1e-3


# --- bad input --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"gamma": 0.1}, "gamma = 0.1: must be below zero"),
        ({"gamma": math.nan}, "gamma"),
        ({"upper_acceleration": 0.0}, "upper_acceleration"),
        ({"compliance": 0.0}, "compliance"),
        ({"maximum_force": 0.0}, "maximum_force"),
        ({"nominal_gain": -1.0}, "nominal_gain"),
        ({"metric": "tasks"}, "metric = 'tasks': must be one of task, joint"),
        ({"constraint_gamma": 1.0}, "constraint_gamma"),
        ({"tracking_bandwidth": 0.0}, "tracking_bandwidth"),
        ({"tracking_acceleration": 0.0}, "tracking_acceleration"),
        ({"period": 0.0}, "period"),
        ({"outputs": [RegulatedCoordinate(np.array([0.0, 0.6, 0.8]), 0.01, -0.1)]}, "perpendicular to the normal"),
        ({"outputs": [RegulatedCoordinate(SIDE, 0.01, 0.1)]}, r"outputs\.gamma = 0.1: must be below zero"),
    ],
)
def test_bad_values_are_refused_by_name(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(BadInputError, match=message):
        make(**changes)
