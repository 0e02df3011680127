"""Two columns of a CSV file written by hand or by a spreadsheet: a value over time or over position."""

from __future__ import annotations

import csv
import math
from pathlib import Path

import numpy as np

from forcectl.arrays import Array
from forcectl.errors import BadInputError, invalid, show
from forcectl.framework.files.text_file import table_text


def read_series(path: str, along: str, value: str) -> tuple[Array, Array]:
    """The columns `along`, increasing, and `value`, each of shape (k,), k >= 2. Other columns are ignored.

    Raises:
        BadInputError: about `path`: a missing file or column, no number, too few rows, or not increasing.
    """
    file = Path(path)
    if not file.is_file():
        raise invalid("path", path, f"an existing CSV file with the columns {along} and {value}")
    try:
        text = table_text(file)
    except (OSError, UnicodeDecodeError):
        raise invalid("path", path, "a readable CSV file in UTF-8, of up to 1 GB") from None
    table = csv.DictReader(text.splitlines(), skipinitialspace=True)
    columns = [name for name in table.fieldnames or () if name]
    if twice := next((name for name in columns if columns.count(name) > 1), None):
        raise BadInputError(f" = {show(path)} has the column {show(twice)} twice: must have it once", key="path")
    if not {along, value} <= set(table.fieldnames or ()):
        named = {name.partition("[")[0].strip() for name in columns}
        bare = ", named without a unit: they are in SI units" if {along, value} <= named else ""
        wanted = f"must have {along} and {value}{bare}"
        raise BadInputError(f" = {show(path)} has columns {show(table.fieldnames)}: {wanted}", key="path")
    rows: list[tuple[float, float]] = []
    for number, row in enumerate(table, start=2):
        if None in row:
            more = f"{len(columns)} columns, as in its first line"
            raise BadInputError(f" = {show(path)} line {number} has more: must have {more}", key="path")
        try:
            pair = float(row[along]), float(row[value])
        except (TypeError, ValueError):
            pair = (math.nan, math.nan)
        written = row[along] + row[value] if all(map(math.isfinite, pair)) else "_"
        if "_" in written or not written.isascii():  # Python also accepts underscores, and digits of other scripts
            given = f"{along} = {show(row[along])}, {value} = {show(row[value])}"
            raise BadInputError(f" = {show(path)} line {number}: {given}: must be finite numbers", key="path")
        if rows and not pair[0] > rows[-1][0]:
            last = f"{along} = {pair[0]:g}: must be above the last one, strictly increasing"
            raise BadInputError(f" = {show(path)} line {number}: {last}", key="path")
        rows.append(pair)
    if len(rows) < 2:
        raise BadInputError(f" = {show(path)} has {len(rows)} rows: must have at least 2", key="path")
    first, second = np.array(rows).T
    return first, second


def check_steepest(path: str, along: Array, values: Array, steepest: float, *, free: float, allowed: str) -> None:
    """Refuse a series that is too steep between two points for linear interpolation.

    Args:
        path: path of the file.
        along: shape (k,), increasing.
        values: shape (k,).
        steepest: largest change of `values` per unit of `along`.
        free: change between two points that is allowed at any slope.
        allowed: allowed values in words.

    Raises:
        BadInputError: about `path`.
    """
    changes = np.abs(np.diff(values))
    steep = changes > np.maximum(free, steepest * np.diff(along))
    if steep.any():
        k = int(steep.argmax())
        given = f"changes by {changes[k]:.3g} m from {along[k]:g} to {along[k + 1]:g}"
        raise BadInputError(f" = {show(path)} {given}: must be {allowed}", key="path")


def check_meets(path: str, positions: Array, length: float) -> None:
    """Refuse a series of positions that does not overlap with a path.

    Args:
        path: path of the file.
        positions: positions along the path, increasing, shape (k,) [m].
        length: length of the path to either side of its start [m].

    Raises:
        BadInputError: about `path`.
    """
    first, last = positions[0], positions[-1]
    if first >= length or last <= -length:
        given = f" = {path!r}: positions from {first:g} to {last:g} m"
        raise BadInputError(f"{given}: must overlap the path, from {-length:g} to {length:g} m", key="path")
