"""What a tuned loop will do: the predicted loop, and what the record itself says of it."""

import numpy as np
import pytest
from scipy.signal import lfilter

from forcectl.tuning.controller_basis import continuous_pid, discrete_pid, fir
from forcectl.tuning.plant_model import IdentifiedPlant, identify_plants
from forcectl.tuning.prediction import RecordCheck, closed_loop
from forcectl.tuning.reference_model import first_order
from tests.examples.vrft_records import TS, contact, loop_step, trapezoidal_moves

U = trapezoidal_moves()
GAINS = np.array([-4e-5, -8e-7, -1e-4])
MODEL = first_order(1.5, TS)


def plant_of(numerator, denominator):
    """A plant model that is the plant."""
    delay = int(np.argmax(numerator != 0))
    return IdentifiedPlant(numerator[delay:], denominator, delay, TS, 1.0, 0.0)


@pytest.mark.slow
def test_the_loop_is_predicted():
    numerator, denominator = contact(5.9e3, (75.4, 75.4, 12.6, 12.6), 20)
    plant = min(identify_plants(U, lfilter(numerator, denominator, U), TS), key=lambda p: p.criterion)
    loop = closed_loop(plant, discrete_pid(TS), GAINS)
    assert loop.stable
    np.testing.assert_allclose(loop.step(2000), loop_step(GAINS, numerator, denominator, 2000), atol=1e-3)


@pytest.mark.parametrize("delay", [20, 900])
def test_a_loop_that_diverges_is_predicted_to(delay):
    plant = plant_of(*contact(5.9e3, (12.6, 12.6), delay))
    for basis, gains, stable in (
        (discrete_pid(TS), [-1e-3, -1e-4, 0.0], False),
        (discrete_pid(TS), [4e-5, 5e-7, 0.0], False),  # wrong sign
        (discrete_pid(TS), [0.0, -2e-8, 0.0], True),
        (fir(1, TS), [-4e-5], True),
    ):
        loop = closed_loop(plant, basis, gains)
        assert loop.stable == stable
        assert np.isfinite(loop.step(20_000)).all() == stable


def simulated(plant, basis, gains, reference):
    """u and y of the loop of a plant, any function of the inputs so far, and a controller."""
    over, under = basis.transfer(gains)
    u, y, e = np.zeros(reference.size), np.zeros(reference.size), np.zeros(reference.size)
    for k in range(reference.size):
        y[k] = plant(u, k)
        e[k] = reference[k] - y[k]
        size = min(k + 1, over.size)
        u[k] = over[:size] @ e[k::-1][:size] - under[1:size] @ u[k - 1 :: -1][: size - 1] if k else over[0] * e[0]
    return u, y


@pytest.mark.parametrize("basis", [discrete_pid(TS), continuous_pid(TS)])
def test_the_fictitious_reference_is_the_one_that_made_the_record_in_closed_loop(basis):
    """For a plant that is not linear, too: a spring that hardens behind a delay, with some play."""
    gains = np.array([-2e-5, -4e-7, -2e-5])
    gains = gains if basis.form == "discrete PID" else gains * [1.0, 1 / TS, TS]
    reference = np.concatenate([np.zeros(50), np.full(1000, 10.0), np.full(500, 4.0)])
    place = [0.0]

    def plant(u, k):
        asked = u[k - 5] if k >= 5 else 0.0
        place[0] = min(max(place[0], asked - 2e-5), asked + 2e-5)
        return -5e3 * place[0] * (1 + 100 * abs(place[0]))

    u, y = simulated(plant, basis, gains, reference)
    check = RecordCheck(u, y, MODEL, basis)
    begin = int(np.argmax(u != 0))
    np.testing.assert_allclose(check.reference(gains), reference[begin:], atol=1e-9)
    wanted = MODEL.response(reference)
    missed = np.linalg.norm((y - wanted)[begin:]) / np.linalg.norm((reference - wanted)[begin:])
    assert check.mismatch(gains) == pytest.approx(missed, rel=1e-6)


def test_the_model_error_is_what_the_prediction_misses_on_the_fictitious_reference():
    numerator, denominator = contact(5.9e3, (12.6, 20.0), 20)
    wrong = plant_of(*contact(5.5e3, (12.6,), 40))
    y = lfilter(numerator, denominator, U)
    basis = discrete_pid(TS)
    check = RecordCheck(U, y, MODEL, basis)
    reference = check.reference(GAINS)
    loop = closed_loop(wrong, basis, GAINS)
    begin = int(np.argmax(U != 0))
    missed = y[begin:] - lfilter(loop.above, loop.closed, reference)
    expected = np.linalg.norm(missed) / np.linalg.norm(reference - MODEL.response(reference))
    assert check.error(wrong, GAINS) == pytest.approx(expected, rel=1e-3)
    assert check.error(plant_of(numerator, denominator), GAINS) < 1e-9


def test_white_noise_is_no_error_of_the_model():
    numerator, denominator = contact(5.9e3, (12.6, 20.0), 20)
    y = lfilter(numerator, denominator, U)
    noisy = y + 0.3 * np.random.default_rng(0).normal(size=y.size)
    true, wrong = plant_of(numerator, denominator), plant_of(*contact(5.5e3, (12.6,), 40))
    basis = discrete_pid(TS)
    clean, check = RecordCheck(U, y, MODEL, basis), RecordCheck(U, noisy, MODEL, basis)
    assert check.error(true, GAINS) < 0.01
    assert check.error(wrong, GAINS) == pytest.approx(clean.error(wrong, GAINS), rel=0.1)


def test_without_a_stable_inverse_there_is_no_fictitious_reference():
    y = lfilter(*contact(5.9e3, (12.6,), 5), U)
    for basis, gains in ((fir(2, TS), [-1e-5, -2e-5]), (discrete_pid(TS), [0.0, -1e-7, 1e-4])):
        check = RecordCheck(U, y, MODEL, basis)
        assert check.mismatch(gains) is None
        assert np.isfinite(
            check.error(plant_of(*contact(5.8e3, (12.6,), 5)), np.asarray(gains) * [1.0, 0.1, 0.0][: len(gains)])
        )


@pytest.mark.slow
def test_where_residuals_are_not_noise_a_lower_order_is_believed():
    plant, basis = contact(5.9e3, (12.6, 20.0, 30.0), 20), discrete_pid(TS)

    def orders(y):
        plants = identify_plants(U, y, TS)
        likely = min(plants, key=lambda p: p.criterion).order
        return RecordCheck(U, y, MODEL, basis).chosen(plants, GAINS).order, likely

    noisy = lfilter(*plant, U) + 0.01 * np.random.default_rng(1).normal(size=U.size)
    believed, likely = orders(noisy)
    assert believed == likely >= 2
    stuck, place = np.empty(U.size), 0.0
    for k, asked in enumerate(U.tolist()):
        place = min(max(place, asked - 2e-4), asked + 2e-4)  # play
        stuck[k] = place
    believed, likely = orders(lfilter(*plant, stuck))
    assert believed < likely


@pytest.mark.slow
def test_an_instability_that_only_the_true_order_shows_is_believed():
    """A resonance that the smooth moves hardly show: a lag fits them to a thousandth and predicts a sound loop."""
    lag, pole = np.exp(-4.0 * TS), np.exp(complex(-3.0, 120.0) * TS)
    below = np.convolve([1.0, -lag], np.poly([pole, pole.conjugate()]).real)
    plant = IdentifiedPlant(np.array([-5e3 * below.sum()]), below, 3, TS, 1.0, 0.0)
    basis, gains = discrete_pid(TS), np.array([-8e-4, -6e-6, 0.0])
    assert not closed_loop(plant, basis, gains).stable
    y = plant.response(U)
    plants = identify_plants(U, y, TS)
    assert closed_loop(plants[0], basis, gains).stable
    assert plants[0].explained > 0.999
    assert not closed_loop(RecordCheck(U, y, MODEL, basis).chosen(plants, gains), basis, gains).stable
