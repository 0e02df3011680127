"""Recorded experiments: input and output in SI units as deviations from rest, checked before they are used."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from forcectl.analysis.stretches import stretches
from forcectl.arrays import Array
from forcectl.conventions import unit_of
from forcectl.errors import BadInputError
from forcectl.runs.records.columns import Column, Columns, read_columns

# Factor from a unit to that of SI, per quantity.
UNITS = {
    "time": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "µs": 1e-6, "μs": 1e-6, "min": 60.0},
    "displacement": {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6, "µm": 1e-6, "μm": 1e-6, "in": 0.0254},
    "force": {"N": 1.0, "kN": 1e3, "mN": 1e-3, "daN": 10.0, "lbf": 4.4482216152605, "kgf": 9.80665},
}
# Names of columns that are searched for, in order of preference. u_hat of the open-loop scheme is
# `controller_output` in logs of forcectl.
COMPENSATED_INPUTS = ("controller_output", "u_hat", "u")
NAMES = {
    "time": ("time", "t"),
    "displacement": (*COMPENSATED_INPUTS, "displacement", "displacement_command", "dx_bar", "dx", "position"),
    "displacement of the motors": ("motor_displacement", "contact_displacement", "x_m"),
    "force": ("force", "measured_force", "contact_force", "f", "y"),
}
_OWN_UNITS = {"controller_output": "m"}

_JITTER = 0.05  # largest deviation of a sampling interval, as a share of the period
_FEWEST, _MOST = 100, 5_000_000  # rows
_AT_REST = (1e-9, 1e-3)  # largest change of an input at rest, as a share of its range: commanded, measured
LONG_REST = 20  # [samples] of a sufficient rest at the beginning
_REST = 0.3  # [s] shortest pause in which the force can follow
_SMALLEST_MOVE = 1e-5  # [m] smallest range of the displacement in a record
# An outlier differs from both neighbours by more than this share of the force's range; if more than this share of
# rows do, it is noise.
_ALONE, _FEW = 0.3, 0.01
_FOLLOWED = 0.15  # largest change of the force in the later half of a rest, as a share of its range
_LARGEST = {"displacement": 1.0, "force": 1e4}  # [m], [N], largest plausible measurement of a robot that presses
_LONGEST = 1e10  # [s], some 300 years: times may count from 1970
_SHORTEST_PERIOD = 1e-6  # [s]
_BEYOND = 0.05  # displacement at a constant force that shows saturation, as a share of its range
_STUCK = 10  # [samples] beyond that displacement, at least
_SAME = 1e-6  # largest change of a saturated force, as a share of its range


@dataclass(frozen=True)
class Recorded:
    """A recorded experiment.

    Attributes:
        origin: file name.
        input_name, output_name, time_name: as written in it.
        period: Ts [s].
        u, y: displacement [m] and force [N] minus their values at rest, shape (k,).
        u_rest, y_rest: those values.
        resting: number of samples at the beginning that those values are from.
        motor: x_m, displacement of the motors minus that at rest, shape (k,) [m]; None where it was not recorded.
        fed_back: C_R_hat of (4.12), computed from u_hat and dx_bar [m/N]; None where not both were recorded.
        motor_name: of the column of `motor`, as written.
        motor_fault: why a column that VRFT on motor positions needs cannot be used; "" where nothing is wrong with it.
    """

    origin: str
    input_name: str
    output_name: str
    period: float
    u: Array
    y: Array
    u_rest: float
    y_rest: float
    resting: int
    motor: Array | None = None
    fed_back: float | None = None
    time_name: str = "time"
    motor_name: str = ""
    motor_fault: str = ""

    @property
    def time(self) -> Array:
        """Time since the first sample, shape (k,) [s]."""
        return self.period * np.arange(self.u.size, dtype=float)

    @property
    def rests(self) -> list[slice]:
        """Where the input rests, long enough for the force to follow."""
        moves = np.flatnonzero(np.abs(np.diff(self.u)) > _AT_REST[1] * np.ptp(self.u) / LONG_REST)
        begins, ends = np.concatenate([[-1], moves]), np.concatenate([moves, [self.u.size - 1]])
        long = (ends - begins) * self.period >= _REST
        return [
            slice(begin + 1, end + 1) for begin, end in zip(begins[long].tolist(), ends[long].tolist(), strict=True)
        ]

    def later(self, rest: slice) -> tuple[float, float]:
        """Mean force [N] and its rate [N/s] in the later half of a rest."""
        part = slice((rest.start + rest.stop) // 2, rest.stop)
        rate = np.polynomial.polynomial.polyfit(self.time[part], self.y[part], 1)[1]
        return float(self.y[part].mean()), float(rate)

    def settled_rests(self, share: float) -> list[slice]:
        """Rests in the later half of which the force moves by at most that share of its range."""
        most = share * float(np.ptp(self.y))
        halves = [(rest, 0.5 * self.period * (rest.stop - rest.start)) for rest in self.rests]
        return [rest for rest, half in halves if half * abs(self.later(rest)[1]) <= most]

    @property
    def gain_at_rest(self) -> float | None:
        """Force per displacement where the input rests between moves [N/m]; None with fewer than two such places."""
        ends = np.array([rest.stop - 1 for rest in self.settled_rests(_FOLLOWED)], dtype=int)
        ends = ends[np.abs(self.u[ends]) > _BEYOND * np.ptp(self.u)]
        if ends.size < 2:
            return None
        return float(self.u[ends] @ self.y[ends] / (self.u[ends] @ self.u[ends]))


def read_record(
    path: str | Path,
    *,
    input_column: str | None = None,
    output_column: str | None = None,
    variant: str | None = None,
    flip_input: bool = False,
) -> Recorded:
    """Read an experiment from a CSV file or the log of a run.

    Args:
        path: the file.
        input_column, output_column: names of displacement and force where they are not found by name.
        variant: which one of a log of several.
        flip_input: count displacements into the surface as negative, though the file has them positive.

    Raises:
        BadInputError: one line that names the row or column and what to do; see `forcectl.runs.records.columns`, and
            units, sampling, gaps, values that are missing, constant input, saturated force, too few rows.
    """
    table = read_columns(Path(os.path.expanduser(path)), variant)
    time = table.find(None, NAMES["time"], "time")
    moved = table.find(input_column, NAMES["displacement"], "displacement")
    force = table.find(output_column, NAMES["force"], "force")
    if moved is force:
        raise BadInputError(f"{table.origin}: column {moved.label} cannot be both displacement and force")
    columns = {"time": time, "displacement": moved, "force": force}
    factors = {quantity: _factor(table, column, quantity) for quantity, column in columns.items()}
    if time.values.size < _FEWEST:
        raise BadInputError(
            f"{table.origin} has {time.values.size} rows: must have at least {_FEWEST}; "
            "record the experiment from rest to rest"
        )
    if time.values.size > _MOST:
        raise BadInputError(
            f"{table.origin} has {time.values.size} rows: must have at most {_MOST}; cut the record or sample slower"
        )
    for column in columns.values():
        _check_finite(table, column)
    period = _check_sampling(table, time.values * factors["time"])
    for quantity in _LARGEST:
        _check_size(table, columns[quantity], factors[quantity], quantity)
    u, y = moved.values * factors["displacement"] * (-1 if flip_input else 1), force.values * factors["force"]
    for column, values, what in ((moved, u, "the experiment must move it"), (force, y, "is there contact?")):
        if values.min() == values.max():
            raise BadInputError(
                f"{table.origin}: column {column.label} is constant at {column.values[0]:g} in all rows: {what}"
            )
    if (moves := float(np.ptp(u))) < _SMALLEST_MOVE:
        raise BadInputError(
            f"{table.origin}: column {moved.label} moves by {moves:.3g} m in all: must be at least "
            f"{_SMALLEST_MOVE:g} m; correct the unit, or record larger moves"
        )
    _check_readings(table, force, y)
    _check_saturation(table, force, u, y)
    rests = [int(np.argmax(np.abs(u - u[0]) > share * np.ptp(u))) for share in _AT_REST]
    resting = rests[0] if rests[0] >= LONG_REST else rests[1]
    y_rest = float(y[:resting].mean())
    return Recorded(
        table.origin,
        moved.label,
        force.label,
        period,
        u - u[0],
        y - y_rest,
        float(u[0]),
        y_rest,
        resting,
        time_name=time.label,
        **_motors(table, u, y, resting, -1 if flip_input else 1),
    )


def _motors(table: Columns, u: Array, y: Array, resting: int, sign: int) -> dict[str, Any]:
    """The attributes of `Recorded` about motors: x_m from rest [m], C_R_hat [m/N] from u_hat - dx_bar = C_R_hat F."""
    found, faults = {}, []
    motors = [name for name in NAMES["displacement of the motors"] if name in table.columns]
    for name in (*motors, "displacement_command"):
        if name in table.columns:
            column = table.find(name, (), "displacement of the motors")
            bad = np.flatnonzero(~np.isfinite(column.values))
            if bad.size:
                faults.append(str(table.wrong(f"empty or not a number ({bad.size} such rows)", int(bad[0]), column)))
            elif np.ptp(column.values) == 0:
                constant = f"is constant at {column.values[0]:g} in all rows"
                faults.append(f"{table.origin}: column {column.label} {constant}")
            else:
                found[name] = sign * column.values * _factor(table, column, "displacement")
    used = next((name for name in motors if name in found), None)
    motor = None if used is None else found[used] - found[used][:resting].mean()
    command = found.get("displacement_command")
    fed_back = None if command is None else max(float((u - command) @ y / (y @ y)), 0.0)
    name = "" if used is None else table.columns[used].label
    fault = faults[0] if motors and faults else ""
    return {"motor": motor, "fed_back": fed_back, "motor_name": name, "motor_fault": fault}


def _factor(table: Columns, column: Column, quantity: str) -> float:
    known, what = UNITS[quantity], f"{table.origin}: column {column.name!r} has"
    # A log of a run without a unit has the unit that belongs to the name.
    is_log = table.row(0).startswith("sample")
    unit = column.unit or (_OWN_UNITS.get(column.name, unit_of(column.name)) if is_log else "")
    if not unit:
        example = {"time": "s", "displacement": "mm", "force": "N"}[quantity]
        raise BadInputError(f"{what} no unit: write it in the header, as in '{column.name} [{example}]'")
    if unit not in known:
        raise BadInputError(f"{what} the unit {unit!r}: must be one of {quantity}, {', '.join(known)}")
    return known[unit]


def _check_finite(table: Columns, column: Column) -> None:
    bad = np.flatnonzero(~np.isfinite(column.values))
    if bad.size:
        text = f"empty or not a number ({bad.size} such rows); fill it in, or cut the record before it"
        raise table.wrong(text, int(bad[0]), column)


def _check_size(table: Columns, column: Column, factor: float, quantity: str) -> None:
    largest = _LARGEST[quantity] / factor
    bad = np.flatnonzero(np.abs(column.values) > largest)
    if bad.size:
        k = int(bad[0])
        most = f"must be at most {largest:g} {column.unit or unit_of(column.name)}; correct the row or the unit"
        raise table.wrong(f"{column.values[k]:g} is implausible as a {quantity}: {most}", k, column)


def _check_sampling(table: Columns, time: Array) -> float:
    """The sampling period [s]; refuses irregular times."""
    bad = np.flatnonzero(np.abs(time) > _LONGEST)
    if bad.size:
        most = f"must be at most {_LONGEST:g} s; correct the row or the unit"
        raise table.wrong(f"a time of {time[bad[0]]:g} s is implausible: {most}", int(bad[0]))
    steps = np.diff(time)
    period = float(np.median(steps))
    if 0 < period < _SHORTEST_PERIOD:
        raise BadInputError(
            f"{table.origin}: a period of {period:g} s is implausible: must be at least {_SHORTEST_PERIOD:g} s; "
            "correct the unit of the time"
        )
    wrong = np.flatnonzero(steps <= 0)
    if wrong.size:
        k = int(wrong[0])
        what = "the same time as" if steps[k] == 0 else "an earlier time than"
        raise table.wrong(f"{what} {table.row(k)}, {time[k + 1]:.9g} s: remove the row, or sort them", k + 1)
    late = np.flatnonzero(steps > 1.5 * period)
    if late.size:
        k = int(late[0])
        missing = max(round(steps[k] / period) - 1, 1)
        raise table.wrong(
            f"{missing} {'row is' if missing == 1 else 'rows are'} missing before it, {steps[k]:.6g} s after "
            f"{table.row(k)} at a period of {period:.6g} s ({late.size} such gaps); record without gaps, or cut the "
            "record there",
            k + 1,
        )
    uneven = np.flatnonzero(np.abs(steps - period) > _JITTER * period)
    if uneven.size:
        k = int(uneven[0])
        regular = f"sampling must be regular within {100 * _JITTER:g} %; resample the record"
        raise table.wrong(f"{steps[k]:.6g} s after {table.row(k)}, the others {period:.6g} s: {regular}", k + 1)
    return float((time[-1] - time[0]) / (time.size - 1))


def _check_readings(table: Columns, column: Column, y: Array) -> None:
    """Refuse a force with single outliers."""
    before, after = y[1:-1] - y[:-2], y[1:-1] - y[2:]
    alone = np.flatnonzero((before * after > 0) & (np.minimum(np.abs(before), np.abs(after)) > _ALONE * np.ptp(y)))
    if 0 < alone.size <= _FEW * y.size:
        k = int(alone[0]) + 1
        raise table.wrong(
            f"{column.values[k]:g} is an outlier between {column.values[k - 1]:g} and {column.values[k + 1]:g} "
            f"({alone.size} such rows): must be a force that changes from row to row by less; correct the row",
            k,
            column,
        )


def _check_saturation(table: Columns, column: Column, u: Array, y: Array) -> None:
    """Refuse a force that stays at its largest or smallest value while the input moves on."""
    sign = np.sign(np.sum((u - u.mean()) * (y - y.mean()))) or 1.0
    for toward in (1.0, -1.0):
        extreme = (toward * y).max()
        for part in stretches(toward * y >= extreme - _SAME * np.ptp(y)):
            on = toward * sign * (u[part] - u[part.start]) > _BEYOND * np.ptp(u)
            if on.sum() >= _STUCK:
                k = int(part.start + np.argmax(on))
                why = "the sensor is saturated" if toward > 0 else "contact is lost or the sensor is saturated"
                raise table.wrong(
                    f"is constant at {column.values[k]:g} from {table.row(part.start)} to {table.row(part.stop - 1)} "
                    f"while the displacement changes: {why}; record smaller moves in contact",
                    k,
                    column,
                )
