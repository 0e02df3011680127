"""The exceptions forcectl raises for its users::

    ForcectlError
      BadInputError      something the user wrote cannot be used (command line exit code 2)
      RunFailedError     a simulation had to stop (exit code 1)

A message is one line: the field or file, the value, and what is allowed.
"""

from __future__ import annotations

import copy
import difflib
import math
import sys
import traceback
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

_LIBRARIES = frozenset({"forcectl", "pydrake", "numpy", "scipy", "xarray", "pandas", "matplotlib"})


class ForcectlError(Exception):
    """Base of all errors that forcectl raises for its users."""


class BadInputError(ForcectlError, ValueError):
    """A scenario, a parameter, a file or an argument that cannot be used: `where: key text`.

    Args:
        text: what is wrong. A text that begins with a space is appended to the key as it is, another one after a colon.
        key: dotted key of the value; "" for none.
        field: name of the key in a text that does not begin with it.
        value: the value that was given.
        allowed: what the value must be.

    Attributes:
        where: file and line, or option, of the value; "" where that is not known.
    """

    def __init__(self, text: str, *, key: str = "", field: str = "", value: Any = None, allowed: str = ""):
        super().__init__(text)
        self.text, self.key, self.field, self.value, self.allowed = text, key, key or field, value, allowed
        self.where = ""

    def __str__(self) -> str:
        text = f"{self.key}{'' if self.text.startswith(' ') else ': '}{self.text}" if self.key else self.text.strip()
        return f"{self.where}: {text}" if self.where else text

    def __repr__(self) -> str:
        return f"{type(self).__name__}({str(self)!r})"

    def at(self, key: str, where: str = "") -> BadInputError:
        """The same error with its full key and the origin of the value: file and line, or option."""
        other = copy.copy(self)
        other.key, other.field, other.where = key, key, where
        return other


class RunFailedError(ForcectlError, RuntimeError):
    """A simulation that had to stop; the log up to that time is kept."""


def show(value: object) -> str:
    """A value for a message, in one line; of more than 60 characters those in the middle are left out."""
    try:
        text = " ".join(repr(value).split())
    except (RecursionError, ValueError):
        text = f"a {type(value).__name__} too large to print"
    return text if len(text) <= 60 else f"{text[:28]}...{text[-29:]}"


def bound(value: float, rounded: Callable[[float], int], digits: int = 3) -> str:
    """A bound as text for a message, rounded so that the shown number is itself allowed.

    Args:
        value: the bound, positive.
        rounded: `math.floor` for an upper bound, `math.ceil` for a lower one.
        digits: significant digits that are shown.
    """
    unit = 10.0 ** (math.floor(math.log10(value)) + 1 - digits)
    return f"{rounded(value / unit) * unit:.{digits}g}"


def one_line(error: BaseException, longest: int | None = None) -> str:
    """Class and text of any exception in one line, cut after `longest` characters where that is given."""
    try:
        text = str(error)
    except Exception as another:  # an exception class of the user
        text = f"its text raises {type(another).__name__}"
    text = " ".join(f"{type(error).__name__}: {text}".split())
    return text if longest is None or len(text) <= longest else f"{text[:longest]}..."


def place_in_code(error: BaseException) -> str:
    """Where a user's code raised an exception, such as " (my_law.py:14)"; "" where no user code is involved."""
    found = ""
    for frame, line in traceback.walk_tb(error.__traceback__):
        top = str(frame.f_globals.get("__name__", "")).partition(".")[0]
        if top not in _LIBRARIES and top not in sys.stdlib_module_names:
            found = f" ({Path(frame.f_code.co_filename).name}:{line})"
    return found


def raised(error: BaseException, longest: int | None = None) -> str:
    """What a user's code raised, as `one_line`, and where, as `place_in_code`."""
    return f"{one_line(error, longest)}{place_in_code(error)}"


def invalid(key: str, value: object, allowed: str) -> BadInputError:
    """The error for a value that is not allowed: `key = value: must be ...`."""
    return BadInputError(f" = {show(value)}: must be {allowed}", key=key, value=value, allowed=allowed)


def invalid_entries(key: str, values: Sequence[Any], right: Sequence[bool], allowed: str) -> BadInputError:
    """The error for a list with entries that are not allowed: `key.1 = value, key.4 = value: must be ...`."""
    if not any(right):
        return invalid(key, values, allowed)
    (first, value), *others = [(i, values[i]) for i, ok in enumerate(right) if not ok]
    more = "".join(f", {key}.{i} = {show(other)}" for i, other in others)
    text = f" = {show(value)}{more}: must be {allowed}"
    return BadInputError(text, key=f"{key}.{first}", value=value, allowed=allowed)


def check_distinct(key: str, names: Sequence[object]) -> None:
    """Refuse a list that holds an entry twice.

    Args:
        key: key of the list.
        names: entries of the list.

    Raises:
        BadInputError: about the second of two equal entries.
    """
    for i, name in enumerate(names):
        if name in names[:i]:
            raise invalid(f"{key}.{i}", name, "another one than those before it")


def unknown(kind: str, name: object, known: Iterable[str], most: int | None = None) -> BadInputError:
    """The error for an unknown name, with the most similar known one.

    Args:
        kind: what the name stands for, such as "preset"; also the name of the key, where there is one.
        name: the name that was given.
        known: all known names.
        most: largest number of known names in the message; of more, the most similar ones. None: all are listed.
    """
    names = [str(k) for k in known]
    lower = {k.lower(): k for k in names}
    near = difflib.get_close_matches(str(name).lower(), lower, n=1, cutoff=0.5)
    hint = f"did you mean {lower[near[0]]!r}? " if near else ""
    listed = ", ".join(each or "''" for each in names)
    allowed = f"one of {listed}"
    if most is not None and len(names) > most:
        nearest = difflib.get_close_matches(str(name), names, n=most, cutoff=0.0)
        text = f"unknown {kind} {show(name)}: {hint}known: {', '.join(nearest)} and {len(names) - most} more"
    else:
        text = f"unknown {kind} {show(name)}: {hint}known: {listed}"
    field = kind.partition(" (")[0].partition(" of ")[0].replace(" ", "_")
    return BadInputError(text, field=field, value=name, allowed=allowed)


@contextmanager
def about(part: object) -> Iterator[None]:
    """A context: errors raised in it are about keys of this part of a configuration, or of a part inside it."""
    try:
        yield
    except BaseException as error:  # Drake's failed preconditions arrive as SystemExit
        parts_of(error).append(part)
        raise


def parts_of(error: BaseException) -> list[object]:
    """The parts of a configuration that an error is about, see `about`; innermost first."""
    return error.__dict__.setdefault("parts", [])
