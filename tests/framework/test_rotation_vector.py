"""Rotation vectors against scipy and finite differences."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from forcectl.errors import BadInputError
from forcectl.framework.rotation_vector import RotationVector


def random(seed: int, angle: float) -> tuple[RotationVector, np.ndarray, np.ndarray, np.ndarray]:
    """Coordinates about a random base, phi of that length, and two random angular vectors."""
    rng = np.random.default_rng(seed)
    phi = rng.normal(size=3)
    phi *= angle / np.linalg.norm(phi)
    base = Rotation.random(random_state=seed).as_matrix()
    return RotationVector(base), phi, rng.normal(size=3), rng.normal(size=3)


@settings(max_examples=50, deadline=None)
@given(st.integers(0, 10**6), st.sampled_from([0.0, 1e-9, 1e-4, 0.9e-3, 1.1e-3, 0.5, 2.0, 3.1]))
def test_value_is_that_of_the_rotation(seed: int, angle: float) -> None:
    coordinates, phi, w, _ = random(seed, angle)
    np.testing.assert_allclose(coordinates.state(coordinates.rotation(phi), w).value, phi, atol=1e-9)
    expected = Rotation.from_rotvec(phi).as_matrix() @ coordinates.rotation(np.zeros(3))
    np.testing.assert_allclose(coordinates.rotation(phi), expected, atol=1e-12)


@settings(max_examples=50, deadline=None)
@given(st.integers(0, 10**6), st.sampled_from([0.0, 1e-4, 0.9e-3, 1.1e-3, 0.5, 2.0, 3.0]))
def test_rates_and_bias_are_the_derivatives(seed: int, angle: float) -> None:
    coordinates, phi, w, dw = random(seed, angle)
    R, h = coordinates.rotation(phi), 1e-4

    def at(t: float) -> tuple[np.ndarray, np.ndarray]:
        """phi and phi' after turning for a time t at w + dw t, to third order."""
        turned = w * t + 0.5 * dw * t**2 + np.cross(dw, w) * t**3 / 12
        state = coordinates.state(Rotation.from_rotvec(turned).as_matrix() @ R, w + dw * t)
        return state.value, state.rates @ (w + dw * t)

    now = coordinates.state(R, w)
    (ahead, fast), (back, slow) = at(h), at(-h)
    np.testing.assert_allclose(now.rates @ w, (ahead - back) / (2 * h), atol=1e-5)
    np.testing.assert_allclose(now.rates @ dw + now.bias, (fast - slow) / (2 * h), atol=1e-4)


def test_half_a_turn_has_finite_coordinates() -> None:
    for axis in np.vstack([np.eye(3), -np.eye(3)]):
        state = RotationVector().state(Rotation.from_rotvec(np.pi * axis).as_matrix(), np.ones(3))
        assert np.linalg.norm(state.value) == pytest.approx(np.pi)
        assert np.isfinite(state.rates).all()
        assert np.isfinite(state.bias).all()


@pytest.mark.parametrize("base", [np.eye(2), -np.eye(3), 2 * np.eye(3), np.full((3, 3), np.nan)])
def test_a_base_that_is_no_rotation_is_refused(base: np.ndarray) -> None:
    with pytest.raises(BadInputError, match="base"):
        RotationVector(base)
