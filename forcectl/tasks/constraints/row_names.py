"""Names of the rows of constraints in the program of a controller."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence

from forcectl.robot.robot_motion import RobotMotion


def label(constraint: object) -> str:
    """Name of a constraint, without a number."""
    words = re.sub(r"(?<=[a-z0-9])(?=[A-Z])", " ", type(constraint).__name__.strip("_")).lower()
    return str(getattr(constraint, "label", words))


def row_names(constraints: Sequence[tuple[object, int]]) -> list[list[str]]:
    """Names of the rows of constraints with these numbers of rows: "wall 1", "speed limit 2: upper left x"."""
    names, met = [], Counter[str]()
    for constraint, rows in constraints:
        kind = label(constraint)
        met[kind] += 1
        own = getattr(constraint, "row_names", None)
        if own is None or len(own) != rows:
            own = [f"row {i + 1}" for i in range(rows)]
        whole = f"{kind} {met[kind]}"
        names.append([whole] if rows == 1 else [f"{whole}: {name}" for name in own])
    return names


def with_rows_at(names: Sequence[str], places: Sequence[tuple[object, slice]], motion: RobotMotion) -> list[str]:
    """The names of rows, completed by `rows_at` of their constraints.

    Args:
        names: of all rows.
        places: constraints, each with the slice of its rows.
        motion: at which the rows were evaluated.
    """
    said = list(names)
    for constraint, place in places:
        if (rows_at := getattr(constraint, "rows_at", None)) is not None:
            said[place] = [f"{name}, {what}" for name, what in zip(names[place], rows_at(motion), strict=True)]
    return said
