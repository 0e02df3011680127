"""The last error handler: an unexpected error is one line on the command line, not Python's traceback."""

from __future__ import annotations

import os
import sys
import traceback
from pathlib import Path

from forcectl.errors import one_line

DEBUG = "--debug"
VARIABLE = "FORCECTL_DEBUG"  # environment variable: raise the error; tests set it, so that no bug passes unseen
_LONGEST = 300  # [characters] of the text of an error
_ROOT = Path(__file__).parents[1]


def take_debug() -> bool:
    """Remove `--debug` from the arguments of this process, before a `--`; returns whether it was there."""
    words = sys.argv[1:]
    before = words[: words.index("--")] if "--" in words else words
    sys.argv[1:] = [word for word in before if word != DEBUG] + words[len(before) :]
    return DEBUG in before


def caught(error: BaseException) -> int:
    """Print an unexpected error in one line; returns the exit code.

    Raises:
        BaseException: the error itself, if the environment variable `VARIABLE` is set.
    """
    if os.environ.get(VARIABLE):
        raise error
    print(f"error: unexpected {one_line(error, _LONGEST)} ({_place(error)}); traceback with {DEBUG}", file=sys.stderr)
    return 1


def whole(error: BaseException) -> None:
    """Print the traceback of an error, with what caused it."""
    traceback.print_exception(error, file=sys.stderr)


def _place(error: BaseException) -> str:
    """Where an error was raised: the innermost line within forcectl, or else the innermost of all."""
    frames = traceback.extract_tb(error.__traceback__)
    own = [frame for frame in frames if _ROOT in Path(frame.filename).parents]
    if not frames:
        return "place unknown"
    frame = (own or frames)[-1]
    name = Path(frame.filename)
    return f"{name.relative_to(_ROOT.parent) if own else name.name}:{frame.lineno}"
