"""The report on a fit: complete, plain and strict JSON."""

import io
import json

import numpy as np
import pytest
from rich.console import Console
from scipy.signal import lfilter

from forcectl.runs.records.recorded import Recorded
from forcectl.runs.tuning_report import gains_table, report_lines, summary
from forcectl.tuning.controller_basis import continuous_pid, discrete_pid, fir
from forcectl.tuning.reference_model import first_order
from forcectl.tuning.vrft import fit_vrft
from tests.examples.vrft_records import TS, contact, trapezoidal_moves

pytestmark = pytest.mark.usefixtures("plants_identified_once")

U = trapezoidal_moves()
Y = lfilter(*contact(5.9e3, (75.4, 12.6, 12.6), 3), U)
RECORD = Recorded("data.csv", "displacement [m]", "force [N]", TS, U, Y, 0.0, 0.0, 100)


@pytest.mark.parametrize("basis", [continuous_pid(TS), discrete_pid(TS), fir(4, TS)])
@pytest.mark.parametrize("bandwidth", [1.5, 80.0])
def test_every_fit_can_be_told(basis, bandwidth):
    fit = fit_vrft(U, Y, first_order(bandwidth, TS), basis)
    text = "\n".join(report_lines(fit, RECORD))
    assert "data: displacement [m] to force [N], 9300 samples at 0.002 s" in text
    assert ("discrete form" in text) == (basis.form == "continuous PID")
    assert ("continuous form" in text) == (basis.form == "discrete PID")
    told = json.loads(json.dumps(summary(fit, RECORD, fit.warnings), allow_nan=False))
    for name, gain in zip(basis.names, fit.gains, strict=True):
        assert told["controller"]["gains"][name]["value"] == gain
    assert told["prediction"]["stable"] == fit.stable
    assert told["warnings"] == list(fit.warnings)
    console = Console(width=120, record=True, file=io.StringIO())
    console.print(gains_table(fit))
    shown = console.export_text()
    assert all(name in shown for name in basis.names)


@pytest.mark.slow
def test_a_loop_predicted_to_be_unstable_is_called_so():
    late = lfilter(*contact(5.9e3, (12.6, 12.6), 40), U)
    fit = fit_vrft(U, late, first_order(30.0, TS), discrete_pid(TS))
    assert not np.isfinite(fit.model_mismatch)
    assert report_lines(fit, RECORD)[-2].endswith("the loop is unstable")
    told = summary(fit, RECORD, fit.warnings)["prediction"]
    assert (told["model_mismatch"], told["stable"], told["out_of_reach"]) == (None, False, True)
