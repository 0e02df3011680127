"""The exceptions forcectl raises for its users.

    ForcectlError
      BadInputError      something the user wrote cannot be used (command line exit code 2)
      RunFailedError     a simulation had to stop (exit code 1)

A message is one line and names the field or file, the value and what is allowed.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable


class ForcectlError(Exception):
    """Base of every error a forcectl user is expected to meet."""


class BadInputError(ForcectlError, ValueError):
    """A scenario, a parameter, a file or an argument that cannot be used."""


class RunFailedError(ForcectlError, RuntimeError):
    """A simulation that had to stop; the log up to that time is kept."""


def invalid(field: str, value: object, allowed: str) -> BadInputError:
    """The error for a value that is not allowed: `field = value: must be ...`."""
    return BadInputError(f"{field} = {value!r}: must be {allowed}")


def unknown(kind: str, name: str, known: Iterable[str]) -> BadInputError:
    """The error for a name that does not exist, with the nearest ones that do."""
    names = sorted(str(k) for k in known)
    near = difflib.get_close_matches(name, names, n=1, cutoff=0.5)
    hint = f"did you mean {near[0]!r}? " if near else ""
    return BadInputError(f"unknown {kind} {name!r}: {hint}known: {', '.join(names)}")
