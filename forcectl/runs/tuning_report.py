"""The report on a tuned controller: a table and lines in the terminal, and the same with more as plain values."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from rich.table import Table

from forcectl.runs.records.recorded import Recorded
from forcectl.runs.terminal.listing import new_table
from forcectl.tuning.fit import OUT_OF_REACH, VrftFit
from forcectl.tuning.identifiability import HIGHEST


def gains_table(fit: VrftFit) -> Table:
    """The gains with their standard errors; refined gains have none."""
    table = new_table(f"{fit.basis.form} controller", "gain", "unit")
    table.columns[1].no_wrap = True
    for column in ("value", "standard error", "noise share"):
        table.add_column(column, justify="right", no_wrap=True)
    for i, (name, unit) in enumerate(zip(fit.basis.names, fit.basis.units, strict=True)):
        share = "not known" if fit.noise_share is None else f"{100 * fit.noise_share[i]:.1f} %"
        error = "refined" if fit.vrft_gains is not None else f"{fit.standard_errors[i]:.2g}"
        table.add_row(name, unit.replace("[", r"\["), f"{fit.gains[i]:.6g}", error, share)
    return table


def report_lines(fit: VrftFit, record: Recorded) -> list[str]:
    """Data, gains in the other form, fit and prediction, a line each."""
    lines = [f"data: {record.input_name} to {record.output_name}, {record.u.size} samples at {record.period:.6g} s"]
    if fit.pid is not None and fit.basis.form == "discrete PID":
        gains = fit.pid.proportional, fit.pid.integral, fit.pid.derivative
        lines.append("continuous form: K_P {:.6g} m/N, K_I {:.6g} m/(N s), K_D {:.6g} m s/N".format(*gains))
    elif fit.pid is not None:
        lines.append("discrete form: K_P {:.6g}, K_I Ts {:.6g}, K_D/Ts {:.6g} m/N".format(*fit.pid.discrete))
    noise = "unknown (never at rest)" if fit.noise_rms is None else f"{fit.noise_rms:.2g} N rms at rest"
    more = " or more" if fit.excitation_order >= HIGHEST else ""
    lines.append(
        f"fit: R^2 {fit.r_squared:.6f}, residual {fit.residual_rms:.3g} m, condition {fit.condition_number:.3g}, "
        f"excitation order {fit.excitation_order}{more}, noise {noise}"
    )
    if fit.vrft_gains is not None:
        before = ", ".join(f"{name} {gain:.6g}" for name, gain in zip(fit.basis.names, fit.vrft_gains, strict=True))
        lines.append(f"refined on the plant model; VRFT alone: {before}")
    verdict = "the loop is unstable"
    if fit.stable:
        nearer = ", though other gains come closer to it" if fit.out_of_reach else ""
        reach = f"within reach, up to {100 * OUT_OF_REACH:g} %{nearer}"
        reach = "out of reach" if fit.expected_mismatch > OUT_OF_REACH else reach
        missed = f"the loop misses the reference model by {100 * fit.model_mismatch:.1f} % ({reach})"
        verdict = f"{missed}, overshoot {_overshoot(fit):.1f} %"
    lines.append(
        f"predicted with a plant model from the same record, of order {fit.plant.order} with a delay of "
        f"{fit.plant.delay * fit.plant.period:.3g} s, which explains {100 * fit.plant.explained:.2f} % of the force: "
        f"{verdict}"
    )
    off = f"{100 * fit.model_error:.1f} %" if math.isfinite(fit.model_error) else "an unbounded amount"
    check = f"checked on the record: in the loop the plant model is off by {off}"
    if (read := _finite(fit.record_mismatch)) is not None:
        check += (
            f"; computed from the record without a model, the loop misses the reference model by {100 * read:.1f} %"
        )
    return [*lines, check]


def inputs_lines(by_input: Mapping[str, Mapping[str, float]], stick: float | None) -> list[str]:
    """The gains of VRFT on commands and on motor positions, where there are both."""
    if len(by_input) < 2:
        return []
    texts = {
        name: ", ".join(f"{gain} {value:.6g}" for gain, value in gains.items()) for name, gains in by_input.items()
    }
    difference = "" if stick is None else f"; K_P differs by {100 * stick:.1f} %"
    return [f"VRFT on commands: {texts['command']}; on motor positions: {texts['motor']}{difference}"]


def _overshoot(fit: VrftFit) -> float:
    return max(0.0, 100 * float(fit.predicted_step.max() - 1))


def summary(fit: VrftFit, record: Recorded, warnings: Sequence[str]) -> dict[str, Any]:
    """The report as plain values: numbers that do not exist are null."""
    pid = fit.pid

    def by_gain(values: Iterable[Any] | None) -> dict[str, Any] | None:
        return None if values is None else dict(zip(fit.basis.names, values, strict=True))

    gains = zip(fit.gains.tolist(), fit.standard_errors.tolist(), fit.basis.units, strict=True)
    return {
        "data": {
            "file": record.origin,
            "displacement": record.input_name,
            "force": record.output_name,
            "samples": int(record.u.size),
            "period_s": record.period,
            "displacement_at_rest_m": record.u_rest,
            "force_at_rest_N": record.y_rest,
        },
        "reference_model": {
            "numerator": fit.model.numerator.tolist(),
            "denominator": fit.model.denominator.tolist(),
            "bandwidth_rad_s": fit.model.bandwidth,
        },
        "controller": {
            "form": fit.basis.form,
            "gains": by_gain(
                {"value": gain, "standard_error": _finite(error), "unit": unit} for gain, error, unit in gains
            ),
            "continuous": pid
            and {"K_P": pid.proportional, "K_I": pid.integral, "K_D": pid.derivative, "T_D": pid.derivative_time},
            "discrete": pid and dict(zip(("K_P", "K_I Ts", "K_D/Ts"), pid.discrete, strict=True)),
        },
        "fit": {
            "prefiltered": fit.prefiltered,
            "instrumented": fit.instrumented,
            "refined": fit.vrft_gains is not None,
            "vrft_gains": by_gain(None if fit.vrft_gains is None else fit.vrft_gains.tolist()),
            "r_squared": fit.r_squared,
            "residual_rms_m": fit.residual_rms,
            "condition_number": _finite(fit.condition_number),
            "excitation_order": fit.excitation_order,
            "noise_rms_N": fit.noise_rms,
            "noise_share": by_gain(None if fit.noise_share is None else fit.noise_share.tolist()),
        },
        "prediction": {
            "from": "plant model identified from the same record (output error)",
            "plant_order": fit.plant.order,
            "plant_delay_s": fit.plant.delay * fit.plant.period,
            "plant_explains": fit.plant.explained,
            "plant_static_gain_N_m": fit.plant.static_gain,
            "model_mismatch": _finite(fit.model_mismatch),
            "model_error": _finite(fit.model_error),
            "trusted": fit.trusted,
            "record_mismatch": _finite(fit.record_mismatch),
            "best_mismatch": _finite(fit.best_mismatch),
            "out_of_reach": fit.out_of_reach,
            "stable": fit.stable,
            "overshoot_pct": _overshoot(fit) if fit.stable else None,
            "largest_difference": float(np.abs(fit.predicted_step - fit.model_step).max()) if fit.stable else None,
        },
        "warnings": list(warnings),
    }


def _finite(value: float | None) -> float | None:
    return value if value is not None and math.isfinite(value) else None
