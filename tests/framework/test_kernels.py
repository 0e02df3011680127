"""Largest and smallest, also of truth values and where something is no number; definite matrices."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from forcectl.framework.kernels import (
    all_finite,
    cross,
    cross_matrix,
    free_optimum,
    is_definite,
    keeps,
    largest,
    left_free,
    smallest,
)


@given(st.lists(st.floats(allow_nan=False), min_size=1, max_size=20))
def test_they_are_those_of_the_list(values: list[float]) -> None:
    array = np.array(values)
    assert largest(array) == max(values)
    assert smallest(array) == min(values)
    assert type(largest(array)) is float


@pytest.mark.parametrize("place", [0, 1, 2])
def test_what_is_no_number_is_not_lost(place: int) -> None:
    array = np.array([1.0, 2.0, 3.0])
    array[place] = np.nan
    assert math.isnan(largest(array))
    assert math.isnan(smallest(array))


@pytest.mark.parametrize("truth", [[True, False], [True, True], [False, False]])
def test_of_truth_values_they_are_any_and_all(truth: list[bool]) -> None:
    assert largest(np.array(truth)) is any(truth)
    assert smallest(np.array(truth)) is all(truth)


@pytest.mark.parametrize("least", [-1e-9, 1e-9, 0.3])
def test_a_matrix_is_definite_if_its_eigenvalues_are_positive(least: float) -> None:
    Q, _ = np.linalg.qr(np.random.default_rng(2).normal(size=(6, 6)))
    assert is_definite(Q @ np.diag([least, 1.0, 2.0, 3.0, 4.0, 5.0]) @ Q.T) == (least > 0)


@given(st.lists(st.floats(), max_size=6), st.lists(st.floats(), max_size=6))
def test_arrays_are_finite_if_all_their_elements_are(a: list[float], b: list[float]) -> None:
    assert all_finite(np.array(a), np.array(b)) == bool(np.isfinite(a).all() and np.isfinite(b).all())


def test_vector_products_are_those_of_numpy() -> None:
    for a, b in np.random.default_rng(0).normal(size=(5, 2, 3)):
        np.testing.assert_allclose(cross(a, b), np.cross(a, b), rtol=1e-15, atol=1e-15)
        np.testing.assert_allclose(cross_matrix(a) @ b, np.cross(a, b), rtol=1e-14, atol=1e-15)


@given(st.integers(0, 10**6), st.sampled_from([-1e-9, 0.0, 0.3]), st.booleans())
def test_rows_and_bounds_are_kept_if_none_is_missed_by_more_than_the_tolerance(
    seed: int, tolerance: float, broken: bool
) -> None:
    random = np.random.default_rng(seed)
    u, matrix, upper = random.normal(size=3), random.normal(size=(4, 3)), random.normal(size=4) + 2.0
    lower, higher = u - random.uniform(-0.3, 1.0, 3), u + random.uniform(-0.3, 1.0, 3)
    if broken:
        upper[2] = np.nan
    plain = (
        (matrix @ u <= upper + tolerance).all() and (u <= higher + tolerance).all() and (u >= lower - tolerance).all()
    )
    assert keeps(u, matrix @ u, upper, lower, higher, tolerance) == plain


@given(st.integers(0, 10**6))
def test_the_free_optimum_is_the_minimum_where_it_keeps_off_all_rows(seed: int) -> None:
    random = np.random.default_rng(seed)
    root, gradient, matrix = random.normal(size=(3, 3)), random.normal(size=3), random.normal(size=(4, 3))
    hessian, upper, wide = root @ root.T + np.eye(3), random.normal(size=4) + 1.0, np.full(3, 5.0)
    plain = -np.linalg.solve(hessian, gradient)
    found = free_optimum(hessian, gradient, matrix, upper, -wide, wide)
    inside = (matrix @ plain < upper - 1e-9).all() and (np.abs(plain) < wide).all()
    assert (found is not None) == inside
    if found is not None:
        np.testing.assert_allclose(found, plain, atol=1e-12)


@pytest.mark.parametrize("rank", [6, 4])
def test_columns_that_rows_leave_free_are_orthonormal_and_left_free(rank: int) -> None:
    rows = np.random.default_rng(3).normal(size=(6, 7))
    rows[rank:] = rows[: 6 - rank]
    free = left_free(rows, np.eye(7)[:, 6:])
    assert free is not None
    np.testing.assert_allclose(free.T @ free, np.eye(1), atol=1e-14)
    np.testing.assert_allclose(rows @ free, 0.0, atol=1e-13)
    if rank == 6:  # there is one such column but for its sign
        np.testing.assert_allclose(np.abs(free), np.abs(np.linalg.svd(rows)[2][6:].T), atol=1e-13)
