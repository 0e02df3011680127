"""Logs: what a diagram recorded, as labelled data, and as a NetCDF file.

One variant is a dataset over `time` with the scalar coordinate `variant`; several are stacked along the dimension
`variant`. Vector signals have a second dimension with the names of their components, such as `rub.force_x` of the
wrench on a task `rub`, see `forcectl.diagrams.components`. Every variable has the attributes `units` and `long_name`,
one whose components have several units also `component_units`, one for each with blanks between them. A variable whose
values are codes, such as the number of a mode, also has `flag_values` and, with blanks between the names,
`flag_meanings` (CF conventions, section 3.5), and `flag_reasons`, a line `name: reason` for each code that has a
reason, such as a failure of a state machine. `comment` explains a signal of the conventions. The attributes of the
dataset name the scenario and the versions it was made with, see `described`.
"""

from __future__ import annotations

import contextlib
import json
import sys
import warnings
from collections.abc import Mapping, Sequence
from enum import IntEnum
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

import forcectl
from forcectl.analysis.force_metrics import model_response
from forcectl.arrays import Array
from forcectl.conventions import SIGNALS, TRUTH, unit_of
from forcectl.diagrams.derived import Derived
from forcectl.errors import BadInputError, one_line
from forcectl.force.guard.limits import Cause, Reaction
from forcectl.framework.files.netcdf_file import check_netcdf
from forcectl.qp.quadratic_program import Status
from forcectl.runs.directory import write_file
from forcectl.scenario.scenario import Scenario


def _counted(numbers: type[IntEnum]) -> str:
    return ", ".join(f"{number.value} {number.name.lower()}" for number in numbers)


# Comments on signals that are not in the conventions; each digit of a status has a meaning of its own.
_COMMENTS = {
    "status": f"hundreds, reaction of the guard: {_counted(Reaction)}; tens, its cause: {_counted(Cause)}; "
    f"ones, status of the controller: {_counted(Status)}",
    "wrench_deviation": "standard deviations of the estimated wrenches, in the axes of each TCP",
}
_MEANINGS = {"governor_status": tuple(number.name.lower() for number in Status)}


class ChunkedLog:
    """Samples of a run, moved out of the diagram's log in chunks, so that each is checked and copied once."""

    def __init__(self) -> None:
        self._times: list[Array] = []
        self._data: list[Array] = []

    def take(self, log: Any) -> tuple[Array, Array]:
        """Move everything out of a Drake `VectorLog`; returns the new times (k,) [s] and values (n, k)."""
        # A chunk may begin with the sample that the last one ended with.
        times, data = log.sample_times().copy(), log.data().copy()
        log.Clear()
        if self._times and times.size and self._times[-1].size and times[0] <= self._times[-1][-1]:
            times, data = times[1:], data[:, 1:]
        self._times.append(times)
        self._data.append(data)
        return times, data

    def cut(self, when: float) -> None:
        """Drop the samples after the time `when` [s], which lies in the last chunk."""
        keep = self._times[-1] <= when
        self._times[-1], self._data[-1] = self._times[-1][keep], self._data[-1][:, keep]

    def samples(self) -> tuple[Array, Array]:
        """All times (k,) [s] and values (n, k) so far."""
        return np.concatenate(self._times), np.concatenate(self._data, axis=1)


def to_dataset(
    times: Array,
    values: Array,
    signals: Mapping[str, Any],
    variant: str,
    model_bandwidth: float | None = None,
    derived: Mapping[str, Derived] | None = None,
) -> xr.Dataset:
    """The log of one variant.

    Args:
        times: of the samples, (k,) [s].
        values: samples, (n, k).
        signals: by name, each a `LoggedSignal`.
        variant: name of the variant.
        model_bandwidth: of the reference model [rad/s]; adds its response `model_force` [N].
        derived: further signals by name.
    """
    variables: dict[str, tuple[tuple[str, ...], Array, dict[str, Any]]] = {}
    coordinates: dict[str, Any] = {"time": ("time", times, {"units": "s", "long_name": "time"}), "variant": variant}
    for name, signal in signals.items():
        rows = values[signal.rows]
        attributes = _attributes(name, signal)
        if any(signal.reasons):
            lines = [
                f"{name}: {reason}" for name, reason in zip(signal.meanings, signal.reasons, strict=True) if reason
            ]
            attributes["flag_reasons"] = "\n".join(lines)
        if signal.labels is None:
            variables[name] = (("time",), rows[0].copy(), attributes)
        else:
            coordinates[signal.dimension] = list(signal.labels)
            variables[name] = (("time", signal.dimension), rows.T.copy(), attributes)
    for name, each in (derived or {}).items():
        dimensions = ("time", each.dimension)[: each.samples.ndim]
        variables[name] = (dimensions, each.samples, _attributes(name, each, each.comment))
        if each.labels:
            coordinates[each.dimension] = list(each.labels)
    if model_bandwidth is not None:
        dimensions, desired, _ = variables["desired_force"]
        columns = np.atleast_2d(desired.T)
        first = np.broadcast_to(variables["contact_force"][1][:1].ravel() if times.size else 0.0, len(columns))
        responses = [model_response(times, d, model_bandwidth, float(f)) for d, f in zip(columns, first, strict=True)]
        attributes = {
            "units": unit_of("model_force"),
            "long_name": "reference model",
            "bandwidth_rad_s": model_bandwidth,
        }
        variables["model_force"] = (dimensions, np.array(responses).T.reshape(desired.shape), attributes)
    return xr.Dataset(variables, coordinates)


def _attributes(name: str, signal: Any, comment: str = "") -> dict[str, Any]:
    """Attributes of a signal.

    Args:
        name: of the signal.
        signal: its `unit`, the `units` of its components where they differ, and the `meanings` of its values where
            they are codes.
        comment: explanation; empty: the one that belongs to the name.
    """
    attributes = {"units": signal.unit, "long_name": name.replace("_", " ")}
    if len(set(signal.units)) > 1:
        attributes["component_units"] = " ".join(each.replace(" ", ".") for each in signal.units)
    known = SIGNALS[name].meaning if name in SIGNALS else _COMMENTS.get(name, "")
    if comment or known:
        attributes["comment"] = comment or known
    if meanings := signal.meanings or _MEANINGS.get(name, ()):
        attributes |= {"flag_values": np.arange(len(meanings), dtype=float), "flag_meanings": " ".join(meanings)}
    return attributes


def stack(logs: Sequence[xr.Dataset]) -> xr.Dataset:
    """The logs of several variants as one, over (variant, time); shorter ones are filled up with NaN.

    Where they have different components, such as tasks, all stand in the order of their first appearance.
    """
    if len(logs) == 1:
        return logs[0]
    components = {str(name): list[Any]() for log in logs for name in log.indexes if name != "time"}
    for name, labels in components.items():
        labels += dict.fromkeys(label for log in logs if name in log.indexes for label in log[name].values)
    return xr.concat(
        [log.reindex({name: all_ for name, all_ in components.items() if name in log.indexes}) for log in logs],
        dim="variant",
        join="outer",
        data_vars="all",
        coords="minimal",
        compat="override",
        combine_attrs=_first_attributes,
    )


def described(
    log: xr.Dataset, name: str, scenario: Scenario, how: str = "", gains: Mapping[str, Any] | None = None
) -> xr.Dataset:
    """A log with the attributes of its file (CF conventions, section 2.6), without dates: the same run, the same file.

    Args:
        log: of one variant or of several.
        name: of the scenario.
        scenario: of the first variant.
        how: it ended, if not after its duration; "" otherwise.
        gains: found by experiments before the run, by variant and law; the attribute `gains`, as JSON.
    """
    found = {"gains": json.dumps(gains)} if gains else {}
    drake = metadata.version("drake")
    history = f"forcectl run {name}, fidelity {scenario.fidelity}, seed {scenario.seed}"
    return log.assign_attrs(
        Conventions="CF-1.11",
        title=scenario.title or name,
        source=f"simulation with forcectl {forcectl.__version__} and Drake {drake}",
        history=f"{history}; {how}" if how else history,
        references=scenario.source or "none",
        scenario=name,
        fidelity=scenario.fidelity,
        preset=scenario.preset,
        seed=scenario.seed,
        forcectl_version=forcectl.__version__,
        drake_version=drake,
        **found,
    )


def _first_attributes(attributes: Sequence[dict[str, Any]], context: Any = None) -> dict[str, Any]:
    """The attributes of the first variant, without meanings of values if these differ between variants."""
    first, *others = attributes
    same = all(each.get("flag_meanings") == first.get("flag_meanings") for each in others)
    return {name: value for name, value in first.items() if same or not name.startswith("flag_")}


def prepare_to_write() -> None:
    """Import all that `write_netcdf` needs, so that writing after Ctrl-C is not delayed by half a second."""
    xr.Dataset().to_netcdf(engine="h5netcdf")


def write_netcdf(dataset: xr.Dataset, path: Path) -> None:
    """Write a log; the same log gives the same file."""
    packed = {"zlib": True, "complevel": 1, "shuffle": True}  # shuffled: an eighth smaller, and faster
    encoding = {name: packed for name in dataset.data_vars if dataset[name].ndim}
    # Written in memory first: on a full disk HDF5 ends the process without an error, when it closes the file.
    dask = sys.modules.get("dask")
    # On a worker of Dask xarray would ask the scheduler for a lock on the memory, which cannot be sent there.
    with dask.config.set(scheduler="synchronous") if dask else contextlib.nullcontext():
        # A copy: where the write fails, the exception would keep a view of xarray's memory, which then cannot be freed.
        content = bytes(dataset.to_netcdf(engine="h5netcdf", encoding=encoding))
    write_file(path, content)


def read_netcdf(path: str | Path) -> xr.Dataset:
    """Read a log into memory.

    Raises:
        BadInputError: the file cannot be read, is not NetCDF, is damaged, is too large or refers to other files.
    """
    hook, sys.unraisablehook = sys.unraisablehook, lambda lost: None  # half a file that h5netcdf fails to close
    try:
        try:
            check_netcdf(Path(path))
            # Phony dimensions let a file without dimensions be opened, so that a message can say what is missing.
            with (
                warnings.catch_warnings(action="ignore"),
                xr.open_dataset(path, engine="h5netcdf", phony_dims="access") as dataset,
            ):
                return dataset.load()
        except (BadInputError, MemoryError):
            raise
        except Exception as error:  # of HDF5, h5netcdf or xarray: bytes that are wrong raise anything
            reason = one_line(error)[:120]
    finally:
        sys.unraisablehook = hook
    raise BadInputError(f"cannot read {Path(path).name} as NetCDF: {reason}")


def first_fault(
    times: Array, values: Array, signals: Mapping[str, Any], limits: Mapping[str, float], *, faulty: bool = False
) -> tuple[str, float, float] | None:
    """The first sample that is not finite or exceeds its limit: (signal, time [s], value), or None.

    Args:
        times: of the samples, (k,) [s].
        values: samples, (n, k).
        signals: name -> rows.
        limits: name -> largest absolute value; every signal must be finite.
        faulty: sensor faults are simulated. Then only commands and true signals of the simulation must be finite; the
            others may be NaN, and a measured force also infinite.
    """
    found = []
    for name, signal in signals.items():
        rows = values[signal.rows]
        bad = ~np.isfinite(rows) | (np.abs(rows) > limits.get(name, np.inf))
        if faulty and not (name in TRUTH or name.endswith("_command")):
            bad &= np.isfinite(rows) if name == "measured_force" else ~np.isnan(rows)
        if bad.any():
            k = int(np.argmax(bad.any(axis=0)))
            found.append((name, float(times[k]), float(rows[bad[:, k], k][0])))
    return min(found, key=lambda fault: fault[1], default=None)
