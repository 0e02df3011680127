"""Gains refined on a plant model come nearest to the reference model's step response."""

import numpy as np
import pytest
from scipy.optimize import minimize

from forcectl.tuning.controller_basis import continuous_pid, discrete_pid, fir
from forcectl.tuning.plant_model import IdentifiedPlant
from forcectl.tuning.prediction import closed_loop
from forcectl.tuning.reference_model import first_order
from forcectl.tuning.refinement import nearest_gains
from tests.examples.vrft_records import TS, contact


def plant(stiffness, bandwidths, delay):
    numerator, denominator = contact(stiffness, bandwidths, delay)
    return IdentifiedPlant(numerator[delay:], denominator, delay, TS, 1.0, 0.0)


def missed(model, basis, gains, wanted):
    with np.errstate(all="ignore"):
        value = np.linalg.norm(closed_loop(model, basis, gains).step(wanted.size) - wanted)
    return float(value) if np.isfinite(value) else 1e9


@pytest.mark.parametrize("basis", [discrete_pid(TS), continuous_pid(TS)])
@pytest.mark.parametrize("start", [(-1e-5, -1e-8, 0.0), (-1e-2, -1e-3, -1e-3)])
def test_no_search_without_derivatives_finds_better_ones(basis, start):
    model, wanted = plant(5.9e3, (12.6, 12.6, 75.4), 15), first_order(3.0, TS).response(np.ones(1500))
    scale = [1.0, 1.0, 1.0] if basis.form == "discrete PID" else [1.0, 1 / TS, TS]
    gains = nearest_gains(model, basis, np.array(start) * scale, wanted)
    found = missed(model, basis, gains, wanted)
    sizes = np.abs(gains)
    searched = minimize(
        lambda x: missed(model, basis, x * sizes, wanted),
        np.sign(gains),
        method="Nelder-Mead",
        options={"maxiter": 400, "xatol": 1e-5, "fatol": 1e-9},
    )
    assert found <= 1.01 * searched.fun
    assert found < 0.1 * np.linalg.norm(1 - wanted)


def test_a_model_that_can_be_met_is_met():
    """A lag and a delay of one sample: a PI controller makes it exactly first order."""
    model, reference = plant(1e4, (20.0,), 1), first_order(2.0, TS)
    basis = discrete_pid(TS).only("K_P", "K_I")
    wanted = reference.response(np.ones(2000))
    gains = nearest_gains(model, basis, np.array([-1e-5, -1e-8]), wanted)
    assert missed(model, basis, gains, wanted) < 1e-3 * np.linalg.norm(1 - wanted)


def test_any_linear_basis_can_be_refined():
    model, wanted = plant(1e3, (20.0,), 1), 0.5 * first_order(20.0, TS).response(np.ones(500))
    basis, start = fir(3, TS), np.array([-1e-4, 0.0, 0.0])
    gains = nearest_gains(model, basis, start, wanted)
    assert missed(model, basis, gains, wanted) < 0.5 * missed(model, basis, start, wanted)
