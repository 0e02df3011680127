"""Robust constraints: no error within its bounds, however it is chosen, leads out of the robustly invariant set."""

import itertools
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from forcectl.errors import BadInputError
from forcectl.robot.model import JointLimits
from forcectl.tasks.constraints.base import CartesianWall, ConstraintSet
from forcectl.tasks.constraints.joint_bounds import bounded_acceleration
from forcectl.tasks.constraints.robust import Errors, RobustConstraint

TS, GAMMA = 0.004, 2.0
SEEN, MISSED = Errors(2e-4, 3e-3), Errors(1e-5, 1e-3)
A, B = np.array([[1.0, TS], [0.0, 1.0]]), np.array([TS**2 / 2, TS])


class Batch:
    """k outputs as rows, each with an acceleration of its own."""

    relative_degree = 2

    def evaluate(self, motion: Any) -> Any:
        k = len(motion.y)
        return motion.y, motion.rate, np.eye(k), np.zeros(k)


def robust(**changes: Any) -> RobustConstraint:
    settings = {"measurement_error": SEEN, "model_error": MISSED, "period": TS} | changes
    return RobustConstraint(Batch(), GAMMA, **settings)


def phi(pi: np.ndarray, missed: Errors = MISSED) -> np.ndarray:
    """The robustly invariant set is phi <= 0; pi of shape (2, k), limit 0."""
    w = np.maximum(pi[1] + missed.value / TS, 0.0)
    return pi[0] + w * w / (2 * (GAMMA - missed.rate / TS))


def signs(kind: str, rng: np.random.Generator, size: int) -> np.ndarray:
    """Of both components of an error in each batch element, within +-1, at one tick."""
    if kind == "random":
        return rng.uniform(-1, 1, (2, size))
    if kind == "corners":
        return rng.choice([-1.0, 1.0], (2, size))
    return {"up": np.ones((2, size)), "down": -np.ones((2, size))}[kind]


def furthest(
    measured: str, model: str, *, elements: int, ticks: int, seed: int = 0, push: str = "hard", constraint: Any = None
) -> tuple[float, float]:
    """The largest p, and the largest phi, of many batch elements that are driven against the limit."""
    rng, law = np.random.default_rng(seed), constraint or robust().bound
    D, V = (np.array([[errors.value], [errors.rate]]) for errors in (SEEN, MISSED))
    pi = np.stack([-rng.uniform(0.0, 0.05, elements), rng.uniform(-0.5, 0.3, elements)])
    pi = pi[:, phi(pi) <= 0]
    k, worst = pi.shape[1], -np.inf
    set_left = -np.inf
    for _ in range(ticks):
        y, rate = pi - D * signs(measured, rng, k)
        wanted = np.full(k, 50.0) if push == "hard" else rng.uniform(-2 * GAMMA, 10.0, k)
        a = np.minimum(wanted, law(y, rate))
        pi = A @ pi + np.outer(B, a) + V * signs(model, rng, k)
        worst, set_left = max(worst, pi[0].max()), max(set_left, phi(pi).max())
    return worst, set_left


@pytest.mark.parametrize("measured", ["random", "corners", "up", "down"])
@pytest.mark.parametrize("model", ["random", "corners", "up", "down"])
def test_no_error_leads_out_of_the_set(measured: str, model: str) -> None:
    for push in ("hard", "random"):
        worst, left = furthest(measured, model, elements=700, ticks=120, push=push)
        assert worst <= 1e-12
        assert left <= 1e-12


@pytest.mark.slow
def test_ten_thousand_random_draws_never_leave_the_set() -> None:
    """1e4 batch elements from states in the set, each with its own draw of both errors at every tick."""
    for push in ("hard", "random"):
        worst, left = furthest("random", "random", elements=14_000, ticks=200, seed=1, push=push)
        assert worst <= 1e-12
        assert left <= 1e-12


def test_every_corner_of_the_reachable_set_stays_in_the_set() -> None:
    """(5.25), (5.26) by enumeration: true states in the set, all corners of both boxes, the largest allowed p''."""
    rng, law = np.random.default_rng(2), robust().bound
    pi = np.stack([-rng.uniform(0.0, 0.02, 20_000), rng.uniform(-0.3, 0.3, 20_000)])
    pi = pi[:, phi(pi) <= -GAMMA * TS**2 / 8]  # the sampled set is smaller by that
    for dp, dv, vp, vv in itertools.product((-1, 1), repeat=4):
        y, rate = pi - np.array([[dp * SEEN.value], [dv * SEEN.rate]])
        a = law(y, rate)
        assert (a >= -GAMMA - 1e-12).all()
        after = A @ pi + np.outer(B, a) + np.array([[vp * MISSED.value], [vv * MISSED.rate]])
        assert phi(after).max() <= 1e-12


def test_it_brakes_no_earlier_than_the_thesis() -> None:
    """Where all corners with p'' = +-gamma_p are inside, (5.27) leaves u free up to gamma_p: so does the bound.

    But for states that may be outside now and are on their way in: it lets them stop as hard as they surely can.
    """
    rng, law = np.random.default_rng(3), robust().bound
    pi = np.stack([-rng.uniform(0.0, 0.02, 5000), rng.uniform(-0.3, 0.3, 5000)])
    worst = np.full(5000, -np.inf)
    for dp, dv, vp, vv, side in itertools.product((-1, 1), repeat=5):
        delta, v = np.array([[dp * SEEN.value], [dv * SEEN.rate]]), np.array([[vp * MISSED.value], [vv * MISSED.rate]])
        worst = np.maximum(worst, phi(A @ (pi + delta) + np.outer(B, np.full(5000, side * GAMMA)) + v))
    free = worst < -GAMMA * TS**2 / 8 - TS * MISSED.rate / 2  # the sampled set, and v_v counted from the tick's start
    assert 1000 < free.sum() < 4500
    allowed = np.where(pi[0] + SEEN.value > 0, GAMMA - 2 * MISSED.rate / TS, GAMMA)
    assert (law(*pi) - allowed)[free].min() >= -1e-12


def test_without_the_fix_for_a_lasting_model_error_the_limit_is_passed() -> None:
    """What the set is for: corners that count v once pass the limit by up to a millimetre, plain rows by more."""

    def as_printed(y: np.ndarray, rate: np.ndarray) -> np.ndarray:
        corner = A @ (np.stack([y, rate]) + np.array([[SEEN.value], [SEEN.rate]])) + np.outer(B, np.full(len(y), GAMMA))
        corner += np.array([[MISSED.value], [MISSED.rate]])
        outside = corner[0] + np.maximum(corner[1], 0.0) ** 2 / (2 * GAMMA) >= 0
        return np.where(outside, -GAMMA, GAMMA)

    def plain(y: np.ndarray, rate: np.ndarray) -> np.ndarray:
        return np.array(
            [bounded_acceleration(*pair, -GAMMA, TS) for pair in zip(y.tolist(), rate.tolist(), strict=True)]
        )

    assert furthest("down", "up", elements=200, ticks=120, constraint=as_printed)[0] > 1e-4
    assert furthest("random", "up", elements=200, ticks=120, constraint=plain)[0] > 1e-4


BOUNDS = st.floats(0.0, 1.0)


@pytest.mark.slow
@settings(max_examples=25)
@given(BOUNDS, BOUNDS, BOUNDS, BOUNDS, st.floats(0.5, 20.0), st.sampled_from([0.004, 0.01]))
def test_it_comes_to_rest_at_the_distance_stated(
    dp: float, dv: float, vp: float, vv: float, gamma: float, period: float
) -> None:
    """... and an adversary who uses all of the bounds gets it to the limit, not beyond."""
    seen, missed = Errors(1e-3 * dp, 1e-2 * dv), Errors(1e-5 * vp, 0.3 * vv * gamma * period)
    law = RobustConstraint(Batch(), gamma, measurement_error=seen, model_error=missed, period=period).bound
    p, rate, p_bad, rate_bad = np.array([-0.05]), np.zeros(1), np.array([-0.05]), np.zeros(1)
    for _ in range(int(2.0 / period)):
        a = np.minimum(law(p, rate), gamma)
        p, rate = p + period * rate + period**2 / 2 * a, rate + period * a
        a = np.minimum(law(p_bad - seen.value, rate_bad - seen.rate), gamma)
        p_bad = p_bad + period * rate_bad + period**2 / 2 * a + missed.value
        rate_bad = rate_bad + period * a + missed.rate
        assert p_bad[0] <= 1e-12
    least = gamma - missed.rate / period
    w = seen.rate + missed.value / period
    stated = seen.value + period * (w + missed.rate / 2) + (w + missed.rate) ** 2 / (2 * least)
    assert stated - 1e-9 <= -p[0] <= stated + least * period**2 / 8 + 1e-9
    assert rate[0] == pytest.approx(0.0, abs=1e-9)


def test_rows_have_their_own_bounds_and_keep_weight_and_margin() -> None:
    class Soft(Batch):
        slack_weight = 100.0
        margin = 0.01
        companions = (Batch(),)
        row_names = ("first", "second")

    two = RobustConstraint(Soft(), GAMMA, measurement_error=Errors([0.0, 0.1]), period=TS)
    motion = SimpleNamespace(y=np.array([-0.2, -0.1]), rate=np.zeros(2))
    _, _, row, bias = two.evaluate(motion)  # type: ignore[arg-type]
    exact = RobustConstraint(Batch(), GAMMA, period=TS).bound([-0.19, 0.01], [0.0, 0.0])
    np.testing.assert_allclose(bias, -exact)
    np.testing.assert_array_equal(row, np.eye(2))
    assert two.slack_weight == 100.0  # type: ignore[attr-defined]
    assert two.companions is Soft.companions  # type: ignore[attr-defined]
    assert two.row_names is Soft.row_names  # type: ignore[attr-defined]


def test_it_takes_part_in_a_set_of_constraints() -> None:
    wall = RobustConstraint(CartesianWall([0, 0, 0], [0, 0, 1]), 1.0, measurement_error=Errors(0.01), period=TS)
    J = np.vstack([np.zeros((3, 3)), np.eye(3)])
    motion = SimpleNamespace(
        q=np.zeros(3), v=np.zeros(3), position=np.array([0, 0, 0.01]), jacobian=J, bias=np.zeros(6)
    )
    every = np.ones(3)
    limits = JointLimits(-every, every, every, every, every)
    together = ConstraintSet([wall], limits, motion, TS, -1.0)  # type: ignore[arg-type]
    rows = together.rows(motion, np.zeros(0))  # type: ignore[arg-type]
    assert rows.direct == 1
    np.testing.assert_array_equal(rows.matrix, [[0, 0, -1]])
    assert rows.limit[0] == pytest.approx(0.0, abs=1e-9)


def test_numbers_that_are_none_stay_none() -> None:
    assert np.isnan(robust().bound(np.nan, 0.0))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"model_error": Errors(0.0, GAMMA * TS)}, r"model_error\.rate = 0\.008: must be below gamma_p \* period"),
        ({"model_error": Errors([0.0, -1.0])}, r"model_error\.value = .*: must be finite and at least zero"),
        ({"measurement_error": Errors(np.nan)}, r"measurement_error\.value = nan"),
        ({"measurement_error": Errors("much")}, r"measurement_error\.value = 'much'"),
        ({"period": 0.0}, "period"),
    ],
)
def test_bounds_that_contradict_are_refused(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(BadInputError, match=message):
        robust(**changes)


def test_only_constraints_of_relative_degree_2_are_made_robust() -> None:
    with pytest.raises(BadInputError, match="gamma_p"):
        RobustConstraint(Batch(), -1.0)
    with pytest.raises(BadInputError, match="lacks relative_degree or evaluate"):
        RobustConstraint(object(), 1.0)  # type: ignore[arg-type]
    with pytest.raises(BadInputError, match=r"relative_degree of the constraint to make robust = 0: must be 2"):
        RobustConstraint(robust(), 1.0)
