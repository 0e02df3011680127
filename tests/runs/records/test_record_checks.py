"""Records that no controller can be tuned on: what is wrong is said by file and column, and sound ones pass."""

import re
from contextlib import nullcontext

import numpy as np
import pytest
from scipy.signal import lfilter

from forcectl.errors import BadInputError
from forcectl.runs.records.record_checks import check_signs, lead, suspicions
from forcectl.runs.records.recorded import read_record
from forcectl.runs.tune import tune_vrft
from forcectl.tuning.controller_basis import continuous_pid, fir
from forcectl.tuning.reference_model import first_order
from forcectl.tuning.vrft import fit_vrft
from tests.examples.vrft_records import TS
from tests.runs.records.test_recorded import TIME, U, Y, good, write

pytestmark = pytest.mark.usefixtures("plants_identified_once")
NOISE = 0.5 * np.random.default_rng(0).normal(size=Y.size)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("columns", "words"),
    [
        (good(**{"force [N]": 0.05 - Y, "displacement [m]": -U}), r"force \[N\] is -\d.* to 0.05 N: pressing must be"),
        (good(**{"force [N]": Y - 26.0}), r"force \[N\] is -26 to -\d.* N: pressing must be a positive force"),
        (good(**{"force [N]": 1e-3 * Y}), r"its contact has 5\.9 N/m: must be from 100 to 1e\+08 N/m; is displacement"),
        (good(**{"force [N]": np.roll(Y, -250) + NOISE}), r"force \[N\] moves 0\.[34]\d* s before displacement \[m\]"),
        (good(**{"force [N]": Y[::-1] + NOISE, "displacement [m]": U[::-1]}), r"force \[N\] moves 0\.1\d* s before"),
        (good(**{"force [N]": np.roll(Y, 1300)}), r"force \[N\] moves [12]\.\d s after displacement \[m\]: must"),
        (good(**{"time [s]": 1e3 * TIME}), r"sampled every 2 s: must be at most 0\.667 s .*is time \[s\] in another"),
    ],
)  # fmt: skip
def test_a_record_that_cannot_be_one_is_refused_in_one_line(tmp_path, columns, words):
    with pytest.raises(BadInputError, match=rf"^data\.csv: {words}") as caught:
        tune_vrft(write(tmp_path, columns), 1.5)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("basis", [continuous_pid(TS), fir(5, TS)])
def test_a_controller_of_the_wrong_sign_is_refused(tmp_path, sign, basis):
    fit = fit_vrft(U, sign * Y, first_order(1.5, TS), basis, refine=False)
    record = read_record(write(tmp_path, good()))
    if sign > 0:
        check_signs(record, fit)
        return
    with pytest.raises(
        BadInputError, match=r"^data\.csv: (K_I|sum of the FIR coefficients) = .*: must be at most 0, or"
    ):
        check_signs(record, fit)


@pytest.mark.slow
@pytest.mark.parametrize(("damping", "sound"), [(100.0, True), (1000.0, False)])
def test_a_proportional_gain_of_the_wrong_sign_is_that_of_a_force_that_leads(tmp_path, damping, sound):
    """Damping leads, too, but by less than the lags of a robot."""
    force = -5e3 * U - damping * np.gradient(U, TS)
    fit = fit_vrft(U, force, first_order(1.5, TS), continuous_pid(TS), refine=False)
    record = read_record(write(tmp_path, good(**{"force [N]": force})))
    assert fit.pid.proportional > 0
    with nullcontext() if sound else pytest.raises(BadInputError, match=r"^data\.csv: K_P = .* m/N: must be at most "):
        check_signs(record, fit)


@pytest.mark.slow
@pytest.mark.parametrize(
    "force",
    [
        Y - 10.0,  # the offset of a sensor
        Y + NOISE,
        -5e3 * U - 150 * np.gradient(U, TS),  # a surface with damping
        -5e3 * (U - 0.3 * lfilter([TS], [1.0, TS - 1.0], U)),  # one that relaxes
        -150.0 * U,  # foam
    ],
)
def test_sound_records_pass(tmp_path, force):
    tuned = tune_vrft(write(tmp_path, good(**{"force [N]": force})), 1.5)
    assert tuned.fit.pid.integral < 0


@pytest.mark.parametrize("period", [0.1, 0.2, 0.3, 1.0, 3.0])
@pytest.mark.parametrize("delay", [0.02, 0.12, 0.28])
def test_sines_do_not_lead_whatever_their_delay(tmp_path, period, delay):
    """What comes late in a period comes early in the next one."""
    u, later = (1e-3 * (np.cos(2 * np.pi * time / period) - 1) for time in (TIME, TIME - delay))
    record = read_record(write(tmp_path, good(**{"displacement [m]": u, "force [N]": -5e3 * later})))
    assert lead(record) == 0


@pytest.mark.parametrize(("shift", "told"), [(600, r"1\.[23]\d* s after"), (-200, r"0\.[12]\d* s before")])
def test_a_force_that_comes_late_is_not_taken_for_one_that_meets_the_next_step_early(tmp_path, shift, told):
    u, time = np.zeros(4500), TS * np.arange(4500)
    for begin, depth in ((0.5, 1e-3), (3.2, 2e-3), (5.0, -1e-3)):
        u -= depth * np.clip((time - begin) / 0.1, 0.0, 1.0)
    lag = np.exp(-TS / 0.16)
    force = lfilter([(1 - lag) ** 2], [1.0, -2 * lag, lag**2], -5.9e3 * u)
    moved = np.interp(time - TS * shift, time, force) + 0.02 * np.random.default_rng(0).normal(size=time.size)
    columns = {"time [s]": time, "displacement [m]": u, "force [N]": moved}
    with pytest.raises(BadInputError, match=rf"force \[N\] moves {told} displacement"):
        tune_vrft(write(tmp_path, columns), 1.5)


SOUND = Y - Y.min() + 2.0  # [N] all of it in contact
SMALL = 0.1 * NOISE


@pytest.mark.parametrize(
    ("force", "words"),
    [
        (SOUND + SMALL, None),
        (SOUND + 4 * NOISE, None),
        (np.minimum(SOUND, 0.85 * SOUND.max()) + SMALL, "at rest is not linear in .*sensor saturated"),
        (np.maximum(SOUND - 0.2 * SOUND.max(), 0.0) + SMALL, "at rest is not linear in .*contact is lost"),
        (SOUND + SMALL + 0.05 * TIME, "drifts by 0.05. N/s"),
        (SOUND + SMALL - 0.05 * TIME, "drifts by -0.0.* N/s"),
    ],
)
def test_noise_hides_neither_a_saturated_sensor_nor_lost_contact_nor_drift(tmp_path, force, words):
    found = list(suspicions(read_record(write(tmp_path, good(**{"force [N]": force})))))
    assert len(found) == (words is not None), found
    if words is not None:
        assert re.search(words, found[0])


def test_rests_too_short_for_the_force_to_follow_say_nothing_of_the_stiffness(tmp_path):
    """A lag of 0.4 s and rests of 0.5 s: the force at their ends is a quarter short."""
    u = -1e-3 * np.concatenate([np.zeros(500), np.repeat([2.0, 0.0] * 4, 250)])
    decay = np.exp(-TS / 0.4)
    y = 2.0 + lfilter([0.0, (1 - decay) * 1e4], [1.0, -decay], -u) + SMALL[: u.size]
    columns = {"time [s]": TS * np.arange(u.size), "displacement [m]": u, "force [N]": y}
    assert tune_vrft(write(tmp_path, columns), 1.5).stiffness == pytest.approx(1e4, rel=0.01)
