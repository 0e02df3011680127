"""Tuning from a recorded experiment: gains, a report on them, a prediction of the loop, a scenario that runs it.

controller.yaml  a scenario with the controller `!Vrft`, for `forcectl run`
summary.json     gains in both forms, fit report, warnings
figures/         experiment and prediction, SVG and PNG
"""

from __future__ import annotations

import contextlib
import math
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from forcectl.errors import BadInputError, invalid
from forcectl.framework.reader import Reader
from forcectl.framework.yaml_tree import Tagged, dump, parse
from forcectl.runs.claims.claim import Place, claimed
from forcectl.runs.directory import SUMMARY, write_file, write_json
from forcectl.runs.records.record_checks import (
    check_against_model,
    check_contact,
    check_rate,
    check_repeated,
    check_signs,
    check_stiffness,
    suspicions,
)
from forcectl.runs.records.recorded import LONG_REST, NAMES, Recorded, read_record
from forcectl.runs.tuning_report import summary
from forcectl.tuning.controller_basis import ControllerBasis, continuous_pid, discrete_pid, fir
from forcectl.tuning.fit import VrftFit
from forcectl.tuning.motor_positions import INPUTS, STICKS, disagreement, motor_record
from forcectl.tuning.reference_model import ReferenceModelConfig
from forcectl.tuning.vrft import fit_vrft

CONTROLLER = "controller.yaml"
_CONTROL_PERIOD = 0.002  # [s] of the shipped station
_SOFTEST = 1.0  # [m/N] largest compliance of a robot
_OTHER_UNIT = 10.0  # factor between commanded and recorded motor displacements that shows another unit
_SAME = 0.05  # largest relative difference of a stated compliance from the one that the record shows
_HYSTERESIS = 0.1  # largest relative difference of the static gains of plant model and rests


@dataclass(frozen=True)
class Tuned:
    """A tuned controller: its reference model, the record and the fit, and the directory with the results.

    Attributes:
        compensated: whether the robot's compliance was fed back in the experiment.
        input: "command" or "motor", which the controller is tuned on, see `forcectl.tuning.motor_positions`.
        other: the fit on the other input; None where the motors were not recorded.
    """

    config: ReferenceModelConfig
    record: Recorded
    fit: VrftFit
    compensated: bool
    directory: Path | None  # None when nothing was written
    input: str = "command"
    other: VrftFit | None = None

    def __repr__(self) -> str:
        names, units = self.fit.basis.names, self.fit.basis.units
        gains = [f"{one} = {gain:.4g} {unit}" for one, gain, unit in zip(names, self.fit.gains, units, strict=True)]
        parts = gains if self.fit.pid is not None else [f"{len(gains)} FIR coefficients"]
        warned = [f"{n} warning{'s' * (n != 1)}" for n in [len(self.warnings)] if n]
        place = [f"in {self.directory}"] if self.directory else []
        return f"<controller tuned on {self.record.origin!r}: {', '.join([*parts, *warned, *place])}>"

    @property
    def bandwidth(self) -> float:
        """Bandwidth of the first-order reference model that was given, or that approximates another one [rad/s]."""
        asked = self.config.bandwidth if self.config.order == 1 else None
        return asked if asked is not None else _round(self.fit.model.bandwidth)

    @property
    def controller(self) -> Tagged:
        """The scenario part `!Vrft`."""
        part = Tagged({"proportional_gain": 0.0, "integral_gain": 0.0, "derivative_gain": 0.0}, "Vrft")
        pid = self.fit.pid
        if pid is None:
            part["fir"] = self.fit.gains.tolist()
        else:
            part["proportional_gain"], part["integral_gain"] = pid.proportional, pid.integral
            part["derivative_gain"], part["derivative_filter"] = pid.derivative, pid.derivative_time
        part["robot_compliance_error"] = 1.0 if self.compensated else 0.0
        part["reference_bandwidth"] = self.bandwidth
        return part

    @property
    def scenario(self) -> Tagged:
        """The controller in a loop with a contact as stiff as that of the record."""
        station = Tagged({"environment": Tagged({"stiffness": _round(self.stiffness)})})
        if not self.compensated:
            # Without the feedback of (4.12) the record does not separate robot and environment.
            station["elastic_joints"] = False
        horizon = self.fit.predicted_step.size * self.fit.model.period
        return Tagged(
            {
                "title": f"VRFT controller tuned on {self.record.origin}",
                "source": "forcectl tune vrft",
                "station": station,
                "controller": self.controller,
                "reference": Tagged({"force": self.step}, "Step"),
                "reference_model": self.bandwidth,
                "duration": _round(min(max(horizon, 1.0), 600.0)),
            }
        )

    @property
    def stiffness(self) -> float:
        """Contact stiffness: of the plant model, or of the rests between moves if the model does not fit [N/m]."""
        shown, model = self.record.gain_at_rest, self.fit.plant.static_gain
        return -shown if shown is not None and abs(model - shown) > _HYSTERESIS * abs(shown) else -model

    @property
    def step(self) -> float:
        """A step of the reference within the recorded forces [N]."""
        return _round(max(0.8 * float(self.record.y.max()), 1.0), 2)

    @property
    def by_input(self) -> dict[str, dict[str, float]]:
        """The gains of VRFT by input, commands and motor positions as far as recorded, and by name of the gain."""
        fits = {self.input: self.fit}
        if self.other is not None:
            fits[next(name for name in INPUTS if name != self.input)] = self.other
        return {
            name: dict(zip(fits[name].basis.names, _own_gains(fits[name]).tolist(), strict=True))
            for name in INPUTS
            if name in fits
        }

    def summary(self) -> dict[str, Any]:
        """The content of `summary.json`."""
        return summary(self.fit, self.record, self.warnings) | {"inputs": self.by_input}

    @property
    def stick(self) -> float | None:
        """Relative difference of K_P on commands from that on motor positions; None where one is unknown."""
        if self.other is None or self.fit.pid is None:
            return None
        of_command, of_motor = (self.fit, self.other) if self.input == "command" else (self.other, self.fit)
        return disagreement(*(_own_gains(fit)[0] for fit in (of_command, of_motor)))

    @property
    def warnings(self) -> tuple[str, ...]:
        """Warnings about the fit and the record."""
        own, of_model = [], -self.fit.plant.static_gain
        differs = self.stick
        if differs is not None and differs > STICKS:
            own.append(
                f"K_P on commands and on motor positions differ by {100 * differs:.0f} %: drives stuck in the record "
                "(stick-slip); enlarge the moves until K_P stops changing, or take --learn-from motor"
            )
        if self.stiffness != of_model:
            own.append(
                f"the plant model is {of_model:.4g} N/m stiff and the contact at rest {self.stiffness:.4g} N/m "
                "(friction?): the latter is written to the station"
            )
        if self.other is None and self.record.motor_fault:
            own.append(f"no comparison with VRFT on motor positions: {self.record.motor_fault}")
        if self.record.resting < LONG_REST:
            own.append("the record does not begin with a rest: its first sample is used as the values at rest")
        if self.fit.pid is None and not math.isclose(self.record.period, _CONTROL_PERIOD, rel_tol=1e-3):
            own.append(
                f"FIR coefficients are for the period of the record, {self.record.period:g} s, and the station runs at "
                f"{_CONTROL_PERIOD:g} s: set station.period"
            )
        return (*self.fit.warnings, *suspicions(self.record), *own)


def tune_vrft(
    data: str | Path,
    reference_model: str | float | ReferenceModelConfig,
    *,
    form: str = "continuous",
    prefilter: bool = True,
    refine: bool = True,
    second: str | Path | None = None,
    input_column: str | None = None,
    output_column: str | None = None,
    variant: str | None = None,
    flip_input: bool = False,
    compensated: bool | None = None,
    learn_from: str = "command",
    robot_compliance: float | None = None,
    out: Place | None = None,
    force: bool = False,
) -> Tuned:
    """Tune a controller from a recorded experiment and write it.

    Args:
        data: CSV file or log.nc.
        reference_model: bandwidth [rad/s], or the text of a mapping with the keys of `ReferenceModelConfig`.
        form: "continuous" or "discrete" PID, either with ":pi" without K_D, or "fir:N" with N coefficients.
        prefilter: filter the data with L = M (1 - M).
        refine: take better gains than those of VRFT where a plant model identified from the record is good enough;
            see `fit_vrft`.
        second: record of a second, equal experiment, used as instrument.
        input_column, output_column, variant, flip_input: see `read_record`.
        compensated: whether the compliance of the robot was fed back in the experiment (4.12); None: yes,
            unless the name of the input is `displacement_command`.
        learn_from: "command", as in the thesis, or "motor", the positions of the motors, which friction does not spoil.
        robot_compliance: C_R_hat that was fed back [m/N]; None: from the columns of u_hat and dx_bar. For "motor".
        out: directory to write, reserved for this process from now on. None writes nothing.
        force: replace an earlier result there.

    Raises:
        BadInputError: data, model or directory cannot be used; nothing was written.
        StorageError: the directory cannot be written any more.
    """
    config = reference_model_config(reference_model)
    _basis(form, 1.0)
    if robot_compliance is not None and not 0.0 <= robot_compliance <= _SOFTEST:
        raise invalid("robot_compliance", robot_compliance, f"from 0 to {_SOFTEST:g} m/N")
    if learn_from not in INPUTS:
        raise invalid("learn_from", learn_from, f"one of {', '.join(INPUTS)}")
    read = partial(
        read_record, input_column=input_column, output_column=output_column, variant=variant, flip_input=flip_input
    )
    with contextlib.nullcontext() if out is None else claimed(out, force) as claim:
        record = read(data)
        if robot_compliance is not None and record.motor is None:
            text = "has no motor positions, which --robot-compliance needs: leave it out"
            raise BadInputError(f"{record.origin} {text}")
        check_rate(record, config)
        model, basis = config.model(record.period), _basis(form, record.period)
        check_against_model(record, model)
        instrument = None if second is None else _instrument(record, read(second))
        if compensated is None:
            compensated = record.input_name.split(" ")[0].lower() != "displacement_command"
        on_motor = _on_motor(record, compensated, robot_compliance)
        if learn_from == "motor":
            _check_motor(record, on_motor, instrument)

        def fitted(one: Recorded, refine: bool, instrument: np.ndarray | None = None) -> VrftFit:
            return fit_vrft(one.u, one.y, model, basis, prefilter=prefilter, instrument=instrument, refine=refine)

        if on_motor is None or learn_from == "command":
            fit = fitted(record, refine, instrument)
            other = None if on_motor is None else fitted(on_motor, False)
        else:
            fit, other = fitted(on_motor, refine), fitted(record, False)
        check_contact(record, fit)
        tuned = Tuned(config, record, fit, compensated, None, learn_from, other)
        check_stiffness(record, tuned.stiffness)
        check_signs(record, fit)
        if claim is None:
            return tuned
        return replace(tuned, directory=claim.write(lambda folder: _write(tuned, folder)))


def _instrument(record: Recorded, again: Recorded) -> np.ndarray:
    """The force of a second, equal experiment.

    Raises:
        BadInputError: the second experiment is not equal.
    """
    if again.u.size != record.u.size or not math.isclose(again.period, record.period, rel_tol=1e-3):
        raise BadInputError(
            f"{again.origin} has {again.u.size} samples at {again.period:g} s: must have {record.u.size} at "
            f"{record.period:g} s, as {record.origin}"
        )
    check_repeated(record, again)
    return again.y


def _check_motor(record: Recorded, on_motor: Recorded | None, instrument: np.ndarray | None) -> None:
    """Refuse VRFT on motor positions that were not recorded, or with an instrument."""
    if on_motor is None:
        if record.motor_fault:
            raise BadInputError(f"{record.motor_fault}: VRFT on motor positions needs this column; correct it")
        what = "no column of the motors' displacement" if record.motor is None else "not both of u_hat and dx_bar"
        raise BadInputError(
            f"{record.origin} has {what}: must have a column {' or '.join(NAMES['displacement of the motors'][:2])}, "
            "and displacement_command beside controller_output (or --robot-compliance)"
        )
    if instrument is not None:
        raise BadInputError("--second is for VRFT on commands: leave it out with --learn-from motor")


def _on_motor(record: Recorded, compensated: bool, robot_compliance: float | None) -> Recorded | None:
    """The record for VRFT on motor positions; None where the motors or the compliance fed back are unknown."""
    shown = record.fed_back
    if robot_compliance is not None and shown and not math.isclose(robot_compliance, shown, rel_tol=_SAME):
        allowed = f"that of u_hat and dx_bar in the record, {shown:.4g} m/N; leave it out"
        raise invalid("robot_compliance", robot_compliance, allowed)
    fed_back = robot_compliance if robot_compliance is not None else shown if compensated else 0.0
    if record.motor is None or fed_back is None:
        return None
    commanded = record.u - fed_back * record.y
    moved = float(record.motor @ commanded / (commanded @ commanded))
    if not 1 / _OTHER_UNIT <= moved <= _OTHER_UNIT:
        raise BadInputError(
            f"{record.origin}: {record.motor_name} moves {moved:.3g} times as far as was commanded: must be "
            f"{1 / _OTHER_UNIT:g} to {_OTHER_UNIT:g} times; has it another unit or sign?"
        )
    u, y = motor_record(record.motor, record.y, robot_compliance=fed_back, period=record.period)
    return replace(record, u=u, y=y)


def _own_gains(fit: VrftFit) -> np.ndarray:
    """The gains of VRFT, before any refinement."""
    return fit.gains if fit.vrft_gains is None else fit.vrft_gains


def reference_model_config(text: str | float | ReferenceModelConfig) -> ReferenceModelConfig:
    """The reference model behind `1.5` (bandwidth [rad/s]) or `{bandwidth: 1.5, order: 2}`.

    Raises:
        BadInputError: neither, or a key that does not exist.
    """
    if isinstance(text, ReferenceModelConfig):
        return text
    tree = parse(text, "--reference-model") if isinstance(text, str) else text
    if isinstance(tree, int | float) and not isinstance(tree, bool):
        tree = Tagged({"bandwidth": tree})
    if not isinstance(tree, Tagged) or tree.tag:
        raise BadInputError(
            f"--reference-model {text!r}: must be a bandwidth [rad/s] or a mapping such as {{bandwidth: 1.5, order: 2}}"
        )
    return Reader(lambda key: "--reference-model").dataclass(ReferenceModelConfig, tree, "")


def _basis(form: str, period: float) -> ControllerBasis:
    kind, _, part = form.partition(":")
    if kind == "fir" and part.isdecimal() and int(part) > 0:
        return fir(int(part), period)
    if kind not in ("continuous", "discrete") or form not in (kind, f"{kind}:pi"):
        raise invalid("form", form, "continuous, discrete, continuous:pi, discrete:pi or fir:N, as in fir:10")
    basis = continuous_pid(period) if kind == "continuous" else discrete_pid(period)
    return basis.only("K_P", "K_I") if part else basis


def _write(tuned: Tuned, folder: Path) -> None:
    of_both = "of robot and contact together: the joints are rigid"
    remark = "of the contact in the record" if tuned.compensated else of_both
    others = "robot, drives and sensor are the default ones"
    text = f"# station: the stiffness is that {remark}; {others}\n{dump(tuned.scenario)}"
    write_file(folder / CONTROLLER, text.encode())
    write_json(folder / SUMMARY, tuned.summary())
    _write_figures(tuned, folder / "figures")


def _round(value: float, digits: int = 4) -> float:
    return float(f"{value:.{digits}g}")


def _write_figures(tuned: Tuned, folder: Path) -> None:
    # Matplotlib takes half a second to import.
    from forcectl.figures.force import save
    from forcectl.figures.tuning import experiment_figure, prediction_figure

    folder.mkdir()
    fit, record = tuned.fit, tuned.record
    shown = slice(None, None, max(record.u.size // 20_000, 1))  # a figure cannot show more
    force, of_model = record.y + record.y_rest, fit.plant.response(record.u) + record.y_rest
    title = f"{record.origin}: the plant model explains {100 * fit.plant.explained:.1f} % of the force"
    displacement = record.u + record.u_rest
    figure = experiment_figure(record.time[shown], displacement[shown], force[shown], of_model[shown], title)
    save(figure, folder / "experiment")
    step, time = tuned.step, fit.model.period * np.arange(fit.predicted_step.size, dtype=float)
    title = f"Step of {step:g} N, predicted with the plant model identified from {record.origin}"
    save(prediction_figure(time, step * fit.predicted_step, step * fit.model_step, title), folder / "prediction")
