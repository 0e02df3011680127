"""A user's own diagram, named by the import path of a function."""

from __future__ import annotations

from pydrake.systems.framework import System

from forcectl.errors import BadInputError, invalid
from forcectl.framework.imports import import_object


def call_for_diagram(path: str) -> System:
    """The diagram, or single block, that the function at "package.module:function" returns without arguments.

    Args:
        path: of the function.

    Raises:
        BadInputError: there is no such function, it raises, or it returns something else.
    """
    function = import_object(path, "diagram")
    if not callable(function):
        raise invalid("diagram", path, "a function that returns a Drake Diagram")
    try:
        diagram = function()
    except Exception as error:  # whatever the user's function does
        reason = " ".join(f"{type(error).__name__}: {error}".split())
        raise BadInputError(f" = {path!r}: must return a Drake Diagram, but raised {reason}", key="diagram") from error
    if not isinstance(diagram, System):
        raise BadInputError(f" = {path!r}: must return a Drake Diagram, not {type(diagram).__name__}", key="diagram")
    return diagram
