"""Records with motor positions that cannot be used: refused or reported, and never the source of gains."""

import numpy as np
import pytest

from forcectl.errors import BadInputError
from forcectl.runs.tune import tune_vrft
from tests.examples.vrft_records import TS
from tests.runs.records.test_recorded import write
from tests.tuning.test_motor_positions import C_R, MOVES, record

pytestmark = [pytest.mark.usefixtures("plants_identified_once"), pytest.mark.slow]


def motor_csv(folder, motor=None, command=None):
    """The record of drives that stick, with other motor positions or commands where given."""
    force, recorded = record(2e-5)
    columns = {
        "time [s]": TS * np.arange(MOVES.size),
        "force [N]": force,
        "u_hat [m]": MOVES,
        "displacement_command [m]": MOVES - C_R * force if command is None else command,
        "motor_displacement [m]": recorded if motor is None else motor,
    }
    return write(folder, columns, name="motors.csv")


def tuned(path, **options):
    return tune_vrft(path, 1.5, refine=False, **options)


def test_an_empty_cell_is_named_by_row_and_not_passed_over(tmp_path):
    motor = record(2e-5)[1].copy()
    motor[[500, 600]] = np.nan
    path, words = motor_csv(tmp_path, motor), r"motors\.csv row 502, column motor_displacement \[m\]: .*\(2 such rows\)"
    with pytest.raises(BadInputError, match=f"{words}: VRFT on motor positions needs this column; correct it"):
        tuned(path, learn_from="motor")
    (text,) = (text for text in tuned(path).warnings if "motor positions" in text)
    assert text.startswith("no comparison with VRFT on motor positions: motors.csv row 502")
    path.write_text(path.read_text().replace("motor_displacement [m]", "torque [Nm]"))  # a column of something else
    assert not any("motor positions" in text for text in tuned(path).warnings)


def test_a_command_that_is_constant_is_named(tmp_path):
    path = motor_csv(tmp_path, command=np.full(MOVES.size, 0.1))
    with pytest.raises(BadInputError, match=r"column displacement_command \[m\] is constant at 0\.1 in all rows"):
        tuned(path, learn_from="motor")


@pytest.mark.parametrize(("factor", "shown"), [(1e3, "9.."), (1e-3, "0.0009.*"), (-1.0, "-0.9.*")])
@pytest.mark.parametrize("learn_from", ["command", "motor"])
def test_another_unit_or_sign_is_refused(tmp_path, factor, shown, learn_from):
    path = motor_csv(tmp_path, factor * record(2e-5)[1])
    words = rf"motor_displacement \[m\] moves {shown} times as far as was commanded: must be 0\.1 to 10 times"
    with pytest.raises(BadInputError, match=words):
        tuned(path, learn_from=learn_from)


def test_a_compliance_that_the_record_contradicts_is_refused(tmp_path):
    path = motor_csv(tmp_path)
    with pytest.raises(BadInputError, match=r"robot_compliance = 1e-05: must be that of u_hat and dx_bar .* 3e-05 m/N"):
        tuned(path, learn_from="motor", robot_compliance=1e-5)
    own, given = tuned(path, learn_from="motor"), tuned(path, learn_from="motor", robot_compliance=C_R)
    np.testing.assert_allclose(given.fit.gains, own.fit.gains, rtol=1e-6)
