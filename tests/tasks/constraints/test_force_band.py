"""The force band: a spring of any stiffness in the interval, whatever is commanded, stays within it."""

import itertools
from typing import Any

import numpy as np
import pytest

from forcectl.errors import BadInputError
from forcectl.robot.robot_motion import RobotMotion
from forcectl.tasks.constraints.force_band import ForceBand
from forcectl.tasks.constraints.robust import Errors
from forcectl.tasks.coordinates import ArmTask
from tests.examples.reactive_examples import arm_tasks, at, reactive_controller, two_arms

TS, LOW, HIGH, SOFT, STIFF = 0.004, 0.2, 0.5, 1300.0, 1600.0
Z = ArmTask("left", ["z"])


def band(braking: float, **changes: Any) -> ForceBand:
    settings = {"force": [LOW, HIGH], "stiffness": [SOFT, STIFF], "period": TS} | changes
    return ForceBand(Z, braking=braking, **settings)


def forces(
    law: ForceBand, stiffness: float, wanted: float, error: float = 0.0, start: float = 0.35, seconds: float = 4.0
) -> np.ndarray:
    """True forces of a spring against a coordinate that is commanded to accelerate, as far as the band allows."""
    rng = np.random.default_rng(0)
    x, v, found = -start / stiffness, 0.0, []
    for _ in range(int(seconds / TS)):
        F = -stiffness * x if x < 0 else 0.0
        found.append(F)
        lower, upper = law.accelerations(F + error * rng.choice([-1.0, 1.0]), v)
        assert lower <= upper
        a = min(max(wanted, lower), upper)
        x, v = x + TS * v + TS**2 / 2 * a, v + TS * a
    return np.array(found)


@pytest.mark.parametrize("stiffness", [1300.0, 1450.0, 1600.0])
@pytest.mark.parametrize("braking", [0.005, 0.05, 0.5])
@pytest.mark.parametrize("wanted", [-20.0, 20.0])
@pytest.mark.parametrize("error", [0.0, 0.02])
def test_the_force_stays_in_the_band(stiffness: float, braking: float, wanted: float, error: float) -> None:
    """The 36 cases in which (6.21)* was checked: pushing and pulling, the printed band and stiffnesses."""
    law = band(braking, measurement_error=Errors(error))
    pressed = forces(law, stiffness, wanted, error)
    assert pressed.min() >= LOW - 1e-9
    assert pressed.max() <= HIGH + 1e-9
    # It is used: the force comes to the limit but for the errors, twice, and what a tick takes.
    left = HIGH - pressed[-1] if wanted < 0 else pressed[-1] - LOW
    assert left <= 2 * error + stiffness * braking * TS**2 / 2 + 0.005


@pytest.mark.parametrize("braking", [0.05, 0.5])
@pytest.mark.parametrize("wanted", [-20.0, 0.0, 20.0])
def test_it_finds_contact_and_comes_back_from_outside(braking: float, wanted: float) -> None:
    """From the air, as fast as the smallest force can be braked to, and from twice the largest force."""
    for stiffness, start in itertools.product((SOFT, STIFF), (0.0, 1.0)):
        pressed = forces(band(braking), stiffness, wanted, start=start, seconds=1.5)
        inside = np.argmax((pressed >= LOW - 1e-9) & (pressed <= HIGH + 1e-9))
        assert 0 < inside * TS < 0.3
        assert pressed[inside:].min() >= LOW - 1e-9
        assert pressed[inside:].max() <= HIGH + 1e-9


@pytest.mark.slow
def test_every_corner_that_may_come_next_is_in_the_invariant_set() -> None:
    """(6.18)-(6.20) by enumeration: Phi of all corners of stiffness, errors and model with both allowed extremes."""
    rng, gamma = np.random.default_rng(1), 0.05
    seen, missed = Errors(0.01, 2e-4), Errors(1e-3, 2e-5)
    law = band(gamma, measurement_error=seen, model_error=missed)
    gamma_F, checked = SOFT * gamma, 0

    def phi(F: float, slope: float, drift: float) -> float:
        braking = gamma_F - drift
        up, down = max(slope + missed.value / TS, 0.0), min(slope - missed.value / TS, 0.0)
        return max(F - HIGH + up**2 / (2 * braking), LOW - F + down**2 / (2 * braking))

    for F, v in zip(rng.uniform(LOW, HIGH, 4000), rng.uniform(-0.004, 0.004, 4000), strict=True):
        corners = list(itertools.product((SOFT, STIFF), (-1, 1), (-1, 1), (-1, 1), (-1, 1)))
        slack = gamma_F * TS**2 / 8
        drift = STIFF * missed.rate / TS
        inside = all(
            phi(F + i * seen.value, -K * (v + j * seen.rate), drift) <= -slack - 2 * K * gamma * TS**2
            for K, i, j, _, _ in corners
        )
        if not inside:
            continue
        checked += 1
        lower, upper = law.accelerations(F, v)
        for a, (K, i, j, k, m) in itertools.product((lower, min(upper, 20.0)), corners):
            after = F + i * seen.value - K * (TS * (v + j * seen.rate) + TS**2 / 2 * a) + k * missed.value
            slope = -K * (v + j * seen.rate + TS * a + m * missed.rate)
            assert phi(after, slope, drift) <= 1e-9
    assert checked > 300


def test_of_two_limits_that_cannot_both_be_kept_the_largest_force_is() -> None:
    """A band as wide as a reading may be off: the largest force is kept as if there were no smallest one."""
    rng, error = np.random.default_rng(2), Errors(0.01)
    narrow = band(0.5, force=[0.47, HIGH], measurement_error=error)
    alone = band(0.5, force=[0.0, HIGH], measurement_error=error)
    conflicts = 0
    for force, speed in zip(rng.uniform(0.45, 0.55, 1000), 2e-3 * rng.standard_normal(1000), strict=True):
        lower, upper = narrow.accelerations(force, speed)
        assert lower == alone.accelerations(force, speed)[0]
        assert lower <= upper
        conflicts += lower == upper
    assert conflicts > 50


def test_its_rows_are_the_accelerations_of_the_coordinate() -> None:
    law = band(0.05)
    motion = at(two_arms().parameters.default_posture, 0.02 * np.ones(14))
    motion.forces = {law: 0.49}
    state = Z.state(motion)
    _, _, row, bias = law.evaluate(motion)
    lower, upper = law.accelerations(0.49, state.rate.item())
    u = np.linalg.pinv(state.jacobian) @ (np.array([lower]) - state.bias)
    np.testing.assert_allclose(row @ u + bias, [0.0, lower - upper], atol=1e-12)


def test_a_controller_reads_one_force_for_each() -> None:
    right = ArmTask("right", ["z"])
    two = [band(0.05), ForceBand(right, [0.5, 1.0], [1e3, 1e3], 0.1)]
    assert reactive_controller(constraints=two).GetInputPort("measured_force").size() == 2
    assert not reactive_controller().HasInputPort("measured_force")


def test_other_controllers_refuse_it() -> None:
    motion = at(two_arms().parameters.default_posture)
    with pytest.raises(BadInputError, match="force band: must be in a reactive controller"):
        band(0.05).evaluate(motion)
    with pytest.raises(BadInputError, match="force band: must be in a reactive controller"):
        band(0.05).evaluate(RobotMotion(two_arms(), two_arms().create_context(), motion.q, motion.v))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"force": [0.5, 0.2]}, r"force = \[0\.5, 0\.2\]: must be the smaller one first"),
        ({"force": [-0.1, 0.2]}, "force"),
        ({"stiffness": [1600.0, 1300.0]}, r"stiffness = \[1600\.0, 1300\.0\]: must be the smaller one first"),
        ({"stiffness": [0.0, 1300.0]}, "stiffness"),
        ({"braking": 0.0}, "braking"),
        ({"measurement_error": Errors(0.2)}, r"force = \[0\.2, 0\.5\]: must be more than 0\.4.* N apart"),
        ({"model_error": Errors(0.0, 0.1)}, r"model_error\.rate"),
    ],
)
def test_bad_values_are_refused(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(BadInputError, match=message):
        band(**{"braking": 0.05} | changes)


def test_a_task_of_several_coordinates_is_refused() -> None:
    turned = ArmTask("left", ["psi"], orientation=arm_tasks()[0].orientation)
    for task in (arm_tasks()[0], turned):
        with pytest.raises(BadInputError, match=r"task: coordinates .*: must be one of x, y, z"):
            ForceBand(task, [0.2, 0.5], [1.0, 1.0], 0.1)
