"""Names that a package imports on first use. They are listed once, in its stub `__init__.pyi`::

    __getattr__, __dir__ = lazy_names(__name__, __file__)

`dir(package)` lists them, editors and type checkers read the stub, and importing the package does not import its
modules.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Callable
from functools import cache
from importlib import import_module
from typing import Any


def lazy_names(package: str, file: str) -> tuple[Callable[[str], Any], Callable[[], list[str]]]:
    """`__getattr__` and `__dir__` of a package with a stub.

    A name of the stub that is also the name of a module of the package stands for that module.

    Args:
        package: its `__name__`.
        file: its `__file__`.
    """

    @cache
    def modules() -> dict[str, str]:
        with open(file.removesuffix(".py") + ".pyi", encoding="utf-8") as stub:
            lines = re.findall(r"^from ([\w.]+) import \(?\s*(\w+) as \2\b", stub.read(), re.MULTILINE)
        return {name: module for module, name in lines}

    def get(name: str) -> Any:
        if name == "__all__":
            return list(modules())
        if name.startswith("_") or name not in modules():
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        value = getattr(import_module(modules()[name]), name)
        return sys.modules.get(f"{package}.{name}", value)

    return get, lambda: sorted(modules())
