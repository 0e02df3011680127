"""Largest and smallest, also of truth values and where something is no number; definite matrices."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from forcectl.framework.kernels import is_definite, largest, smallest


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
