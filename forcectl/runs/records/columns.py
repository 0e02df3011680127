"""Columns of numbers with names and units, read from a CSV file or from the log of a run.

A CSV file has a header of the form `time [s], displacement [mm], force [N]`, in any order, with commas, semicolons or
tabs between. Between semicolons or tabs numbers may have decimal commas. A log is NetCDF as `forcectl run` writes it:
each variable over `time` with the attribute `units`.
"""

from __future__ import annotations

import csv
import os
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from forcectl.arrays import Array
from forcectl.errors import BadInputError, show, unknown
from forcectl.framework.files.text_file import table_text

_HEADER = re.compile(r"^\s*(?P<name>.*?)\s*(?:[\[(]\s*(?P<unit>[^\])]*?)\s*[\])])?\s*$")
_SEPARATORS = {";": "semicolons", "\t": "tabs", ",": "commas"}
_OPTIONS = {"displacement": ", or say with --input which it is", "force": ", or say with --output which it is"}
_NETCDF = (".nc", ".nc4", ".h5", ".hdf5", ".cdf")


@dataclass(frozen=True)
class Column:
    """One quantity: its name as written, its unit ("" when none is given) and its values (k,).

    Attributes:
        fault: place of the first cell that is not a number, "" if there is none. Such and empty cells are NaN.
    """

    name: str
    unit: str
    values: Array
    fault: str = ""

    @property
    def label(self) -> str:
        """Name and unit, as in a header."""
        return f"{self.name} [{self.unit}]" if self.unit else self.name


@dataclass(frozen=True)
class Columns:
    """A table: the file's name, its columns by lower-case name, and what a row is called in messages."""

    origin: str
    columns: dict[str, Column]
    row: Callable[[int], str]

    def wrong(self, text: str, row: int, column: Column | None = None) -> BadInputError:
        """The error about a row, or about a cell of it."""
        place = f"{self.origin} {self.row(row)}"
        return BadInputError(f"{place}: {text}" if column is None else f"{place}, column {column.label}: {text}")

    def find(self, wanted: str | None, names: Sequence[str], kind: str) -> Column:
        """The column called `wanted`, or else the first of `names` that there is.

        Raises:
            BadInputError: there is none (the message names those that there are), or a cell of it is no number.
        """
        found = next((name for name in names if name in self.columns), None) if wanted is None else _key(wanted)
        if found is None:
            there = ", ".join(column.label for column in self.columns.values())
            choices, option = " or ".join(names[:3]), _OPTIONS.get(kind, "")
            between = "" if len(self.columns) > 1 else f"; between cells must be {', '.join(_SEPARATORS.values())}"
            raise BadInputError(
                f"{self.origin} has no column of {kind}: has {there}; name one {choices}{option}{between}"
            )
        if found not in self.columns:
            known = [column.name for column in self.columns.values()]
            raise BadInputError(f"{self.origin}: {unknown(f'column of {kind}', wanted, known)}")
        column = self.columns[found]
        if column.fault:
            raise BadInputError(f"{self.origin} {column.fault}")
        return column


def read_columns(path: Path, variant: str | None = None) -> Columns:
    """All columns of a file.

    Args:
        path: CSV, or NetCDF by its suffix.
        variant: which one of a log of several.

    Raises:
        BadInputError: the file cannot be read, has no header or no rows, or a row has too many or too few cells.
    """
    if not os.path.isfile(path):
        kind = "is a folder" if os.path.isdir(path) else "does not exist"
        raise BadInputError(f"data file {show(str(path))} {kind}: must be a CSV file or a log.nc")
    if path.suffix.lower() in _NETCDF:
        return _read_log(path, variant)
    if variant is not None:
        raise BadInputError(f"--variant {variant!r}: must be left out, {path.name} is not the log of a run")
    return _read_csv(path)


def _key(name: str) -> str:
    return re.sub(r"[\s-]+", "_", name.strip().lower())


def _read_csv(path: Path) -> Columns:
    try:
        text = table_text(path)
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "it is not UTF-8 text"
        raise BadInputError(f"cannot read {path.name}: {reason}") from None
    lines = [(n, line) for n, line in enumerate(text.splitlines(), start=1) if line.strip() and line[0] != "#"]
    if not lines:
        raise BadInputError(f"{path.name} is empty: must have a header and rows")
    separator = _separator(*[line for _, line in lines[:2]])
    header = [part.strip() for part in _cells(lines[0][1], separator)]
    if all(_number(part) is not None for part in header):
        raise BadInputError(
            f"{path.name} has no header: its first row must name columns and units, as in "
            "time [s], displacement [mm], force [N]"
        )
    rows = lines[1:]
    if not rows:
        raise BadInputError(f"{path.name} has a header and no rows")
    table = [_cells(line, separator) for _, line in rows]
    decimal_comma = separator != "," and not any("." in cell and _number(cell) is not None for cell in table[0])
    numbers = [number for number, _ in rows]
    for number, row in zip(numbers, table, strict=True):
        if len(row) != len(header):
            wanted = f"must have {len(header)}, as the header, with {_SEPARATORS[separator]} between"
            if separator == "," and row is table[0]:
                wanted += "; numbers with decimal commas need semicolons or tabs between"
            raise BadInputError(f"{path.name} row {number} has {len(row)} cells: {wanted}")
    columns: dict[str, Column] = {}
    for part, cells in zip(header, zip(*table, strict=True), strict=True):
        found = _HEADER.match(part)
        name, unit = (found["name"], found["unit"] or "") if found else (part, "")
        if _key(name) in columns:
            raise BadInputError(f"{path.name} has two columns called {name!r}: rename one")
        values = [_number(cell.replace(",", ".") if decimal_comma else cell) for cell in cells]
        wrong = next((k for k, value in enumerate(values) if value is None and cells[k].strip()), None)
        shown = "" if wrong is None else repr(cells[wrong].strip()[:40])
        fault = "" if wrong is None else f"row {numbers[wrong]}, column {part}: {shown} must be a number"
        columns[_key(name)] = Column(name, unit, np.array(values, dtype=float), fault)
    return Columns(path.name, columns, lambda k: f"row {numbers[k]}")


def _separator(header: str, row: str = "") -> str:
    """The first one that gives header and first row as many cells, else the most frequent one of the header."""
    fits = [each for each in _SEPARATORS if len(_cells(header, each)) == len(_cells(row, each)) > 1]
    return fits[0] if fits else max(_SEPARATORS, key=header.count)


def _cells(line: str, separator: str) -> list[str]:
    try:
        return next(csv.reader([line], delimiter=separator))
    except csv.Error:  # a cell of more than 100 000 characters
        return [line]


def _number(text: str) -> float | None:
    try:
        return None if "_" in text or not text.isascii() else float(text)  # Python reads digits of any script
    except ValueError:
        return None


def _read_log(path: Path, variant: str | None) -> Columns:
    from forcectl.runs.logs import read_netcdf

    log = read_netcdf(path)
    if "variant" in log.dims:
        names = [str(name) for name in log["variant"].values]
        if variant is None:
            known = ", ".join(names)
            raise BadInputError(f"{path.name} has several variants: say which with --variant, one of: {known}")
        if variant not in names:
            raise unknown(f"variant of {path.name}", variant, names)
        log = log.isel(variant=names.index(variant)).dropna("time", how="all")
    elif variant not in (None, str(log.coords["variant"].item() if "variant" in log.coords else "")):
        raise BadInputError(f"--variant {variant!r}: must be left out, {path.name} has one variant only")
    if "time" not in log.dims:
        raise BadInputError(f"{path.name} has no dimension 'time': must be the log of a run")
    columns = {}
    for name in map(str, (name for name in ["time", *log.data_vars] if name in log.variables)):
        if log[name].dims != ("time",):
            continue
        unit, kind = str(log[name].attrs.get("units", "")), log[name].dtype
        if np.issubdtype(kind, np.number):
            columns[_key(name)] = Column(name, unit, np.asarray(log[name].values, dtype=float))
        else:
            fault = f"variable {name} has values of type {kind}: must be numbers"
            columns[_key(name)] = Column(name, unit, np.full(log.sizes["time"], np.nan), fault)
    return Columns(path.name, columns, lambda k: f"sample {k}")
