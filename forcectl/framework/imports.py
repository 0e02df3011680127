"""Objects of the user's, named by their import path."""

from __future__ import annotations

import importlib
import sys
from pathlib import Path
from typing import Any

from forcectl.errors import BadInputError, invalid, one_line, unknown

_ALLOWED = "of a module of your own or of an installed package, not of Python's standard library"


def import_object(path: str, field_name: str = "path") -> Any:
    """The object behind "package.module:name"; modules in the working directory are found too.

    Nothing of Python's standard library, also not where another module passes it on: a scenario would otherwise be a
    program, `os:system` with parameters.

    Raises:
        BadInputError: the path has another form, it leads to the standard library, or the module or the name in it
            does not exist.
    """
    module_name, colon, name = path.partition(":")
    if not (colon and name.isidentifier() and all(part.isidentifier() for part in module_name.split("."))):
        raise invalid(field_name, path, 'an import path such as "package.module:Name"')
    if _standard(module_name):
        raise invalid(field_name, path, _ALLOWED)
    here = str(Path.cwd())
    added = here not in sys.path
    if added:  # an installed command does not look into the working directory by itself
        sys.path.append(here)
    try:
        module = importlib.import_module(module_name)
    except Exception as error:  # whatever the user's module does while it is imported
        raise BadInputError(f" = {path!r}: must be importable, but: {one_line(error)}", key=field_name) from error
    finally:
        if added:
            sys.path.remove(here)
    if not hasattr(module, name):
        known = [each for each in vars(module) if not each.startswith("_")]
        raise BadInputError(f" = {path!r}: {unknown(f'name in {module_name}', name, known)}", key=field_name)
    found = getattr(module, name)
    if callable(found) and _standard(getattr(found, "__module__", None) or type(found).__module__):
        raise invalid(field_name, path, _ALLOWED)
    return found


def _standard(module_name: str) -> bool:
    return module_name.partition(".")[0] in sys.stdlib_module_names
