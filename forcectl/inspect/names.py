"""Names for the blocks of a diagram: the given ones, and readable ones for blocks without a given name."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence

from pydrake.systems.framework import System

_AUTOMATIC = re.compile(r"@[0-9a-f]{16}$")  # of Drake: drake/systems/Gain@000055d5c0ffee00


def type_name(system: System) -> str:
    """Class name without module, template arguments and scalar type."""
    name = type(system).__name__
    if name in ("LeafSystem", "System", "Diagram"):  # a C++ class without a Python binding
        name = system.GetSystemType().rpartition("::")[2]
    return re.split(r"[<\[𝓣]", name)[0].strip("_")


def type_in_words(value: object) -> str:
    """Class name for a message about a wrong type, such as `Diagram of AutoDiffXd, where double is needed`."""
    name, _, scalar = type(value).__name__.partition("_𝓣")
    return f"{name} of {scalar[:-1]}, where double is needed" if scalar else name


def is_automatic(name: str) -> bool:
    """Whether a system's name was made by Drake, or is empty."""
    return not name or name == "_" or bool(_AUTOMATIC.search(name))


def own_name(system: System) -> str:
    """The system's name, or the name of its type when it has none."""
    name = str(system.get_name())
    return type_name(system) if is_automatic(name) else name


def block_names(systems: Sequence[System]) -> list[str]:
    """Unique names of the blocks of one diagram.

    A given name is kept. A block without one has the name of its type, `Gain`, with a number where that is not unique:
    `Gain 1`, `Gain 2`.
    """
    taken = {str(system.get_name()) for system in systems if not is_automatic(system.get_name())}
    total = Counter(type_name(system) for system in systems if is_automatic(system.get_name()))
    numbers = Counter[str]()
    names = []
    for system in systems:
        name = own_name(system)
        if is_automatic(system.get_name()) and (total[name] > 1 or name in taken):
            kind = name
            while name == kind or name in taken:
                numbers[kind] += 1
                name = f"{kind} {numbers[kind]}"
        names.append(name)
    return names
