"""Import of code that a scenario, a sweep or a command names: "package.module:Name". Nothing else imports such code.

A scenario is data. It may name classes, but only of modules that its user trusts: those in the folder of the scenario
file, forcectl's own, those of installed packages with entry points of forcectl, and those named by the user. Modules of
Python's standard library are never allowed. All this is checked on the text, before anything is imported.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cache
from importlib import import_module, invalidate_caches
from importlib.machinery import ModuleSpec, PathFinder
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from forcectl.errors import BadInputError, invalid, raised, show, unknown

OPTION = "--allow-imports"
_NAMED = 12  # largest number of a module's names in a message
_OWN = "forcectl"
_STANDARD = "of a module of your own or of an installed package, not of Python's standard library"
_OF_PYTHON = ("__main__", "__builtins__", "sitecustomize", "usercustomize")  # modules that Python imports at start-up
_beside: dict[str, Path] = {}  # modules loaded from the folder of a scenario, and that folder


@dataclass(frozen=True)
class Imports:
    """The modules that may be imported.

    Attributes:
        folder: folder whose modules are allowed, unless an installed module has the same name; None: no folder.
        names: further modules and packages, in the scenario's folder, installed or in the working directory.
        every: whether all modules but the standard library are allowed, as for a path in a command.
    """

    folder: Path | None = None
    names: tuple[str, ...] = ()
    every: bool = False

    def check(self, path: Any, key: str) -> str:
        """Check that the object at an import path may be imported, without importing it. Returns its module's name.

        Raises:
            BadInputError: the path is malformed, or names the standard library or a module that is not allowed.
        """
        module, colon, name = path.partition(":") if isinstance(path, str) else ("", "", "")
        if not (colon and name.isidentifier() and all(part.isidentifier() for part in module.split("."))):
            raise invalid(key, path, 'an import path such as "package.module:Name"')
        if _is_standard(module):
            raise invalid(key, path, _STANDARD)
        if not self._allows(module):
            top = module.partition(".")[0]
            if PathFinder.find_spec(top, self._path()) is None:
                raise BadInputError(f" = {show(path)}: must be importable, but: No module named {top!r}", key=key)
            raise invalid(key, path, self._allowed_words(module))
        self._check_found_within(module, name, key)
        return str(module)

    def _check_found_within(self, module: str, name: str, key: str) -> None:
        """Refuse a submodule that does not exist, before an import would run its package."""
        around, *rest = module.split(".")
        loaded = sys.modules.get(around)
        spec = PathFinder.find_spec(around, self._path()) or (loaded.__spec__ if loaded else find_spec(around))
        if module in sys.modules or spec is None:
            return
        for part in rest:
            if (spec := _within(spec, around, part)) is None:
                hint = f"; write {f'{around}:{name}'!r}" if part == "py" else ""
                why = f"No module {part!r} in {around!r}{hint}"
                raise BadInputError(f" = {show(f'{module}:{name}')}: must be importable, but: {why}", key=key)
            around = f"{around}.{part}"

    def check_found(self, names: Iterable[str], key: str) -> None:
        """Refuse names of modules that cannot be found. Only the top-level package is searched, nothing is imported.

        Args:
            names: names of modules that a user allows.
            key: dotted key of the names, for the message.

        Raises:
            BadInputError: there is no such module.
        """
        invalidate_caches()  # the module may have just been written
        for name in names:
            top = name.partition(".")[0]
            found = top in sys.modules or PathFinder.find_spec(top, self._path()) or find_spec(top)
            if not found:
                where = "installed, beside the file that is run or in the working directory"
                raise BadInputError(f" = {show(name)}: must be {where}, but: No module named {top!r}", key=key)

    def load(self, path: Any, key: str) -> Any:
        """Import the object at an import path; it is not called.

        Raises:
            BadInputError: as in `check`; the module cannot be imported or has no such name; or the object is defined in
                a module that is not allowed, and only imported by the named one.
        """
        module, name = self.check(path, key), path.partition(":")[2]
        try:
            loaded = self._imported(module)
            if not hasattr(loaded, name):
                public = {each: thing for each, thing in vars(loaded).items() if not each.startswith("_")}
                top = module.partition(".")[0]  # names that the package defines itself
                own = [each for each in public if str(getattr(public[each], "__module__", "")).partition(".")[0] == top]
                known = sorted(own or public)
                raise BadInputError(f" = {show(path)}: {unknown(f'name in {module}', name, known, _NAMED)}", key=key)
            found = getattr(loaded, name)
        except (BadInputError, KeyboardInterrupt):
            raise
        except BaseException as error:  # the module may raise anything
            raise BadInputError(f" = {show(path)}: must be importable, but: {raised(error)}", key=key) from error
        home = str(getattr(found, "__module__", None) or type(found).__module__) if callable(found) else module
        if _is_standard(home):
            raise invalid(key, path, _STANDARD)
        if not self._allows(home):
            raise invalid(key, path, f"defined in a module that is allowed, not in {home}: {self._allowed_words(home)}")
        return found

    def _allows(self, module: str) -> bool:
        top = module.partition(".")[0]
        named = any(f"{module}.".startswith(f"{name}.") for name in self.names)
        return self.every or named or top in (_OWN, *announcing()) or self._beside(top)

    def _beside(self, top: str) -> bool:
        """Whether a module is in the scenario's folder, and an import would find that one."""
        invalidate_caches()  # the module may have just been written
        if self.folder is None or (spec := PathFinder.find_spec(top, [str(self.folder.resolve())])) is None:
            return False
        files = _files(spec)
        if (loaded := sys.modules.get(top)) is not None and _beside.get(top) != self._home():
            spec = getattr(loaded, "__spec__", None)
            return top in _beside or (spec is not None and _files(spec) == files)
        # A folder without __init__.py ranks after a module in any later folder.
        found = PathFinder.find_spec(top, self._path())
        return found is not None and _files(found) == files

    def _home(self) -> Path | None:
        return None if self.folder is None else self.folder.resolve()

    def _path(self) -> list[str]:
        """Search path of modules: installed ones, then the scenario's folder, then the working directory."""
        return list(dict.fromkeys([*sys.path, *(str(f) for f in (self._home(), Path.cwd()) if f is not None)]))

    def _imported(self, module: str) -> Any:
        """Import a module, also from the scenario's folder and the working directory."""
        top, home = module.partition(".")[0], self._home()
        if _beside.get(top, home) != home:  # of another scenario
            for name in [each for each in sys.modules if f"{each}.".startswith(f"{top}.")]:
                del sys.modules[name]
            del _beside[top]
        new = top not in sys.modules
        folders = [each for each in self._path() if each not in sys.path]
        sys.path.extend(folders)  # an installed command does not search there by default
        try:
            found = import_module(module)
        finally:
            for folder in folders:
                sys.path.remove(folder)
        if new and home is not None and (spec := found.__spec__) and any(home in f.parents for f in _files(spec)):
            _beside[top] = home
        return found

    def _allowed_words(self, module: str) -> str:
        top = module.partition(".")[0]
        where = "" if self.folder is None else "beside the file that is run (and no installed one of that name), "
        return f"of a module {where}of a package that announces parts of forcectl, or named by {OPTION} {top}"


def allowed_names(names: Iterable[str], key: str) -> tuple[str, ...]:
    """Names of modules that a user allows, checked.

    Raises:
        BadInputError: a name is no name of a module, or belongs to the standard library.
    """
    if isinstance(names, str) or not all(isinstance(name, str) for name in names):
        raise invalid(key, names, "a list of names of modules")
    for name in names:
        if not all(part.isidentifier() for part in name.split(".")):
            raise invalid(key, name, "the name of a module, such as my_lab")
        if _is_standard(name):
            raise invalid(key, name, _STANDARD.replace("of a module", "a module", 1))
    return tuple(names)


@cache
def announcing() -> Mapping[str, str]:
    """Modules of installed packages with entry points of forcectl, and a tag of each. Cached per process."""
    from importlib.metadata import entry_points

    points = [point for group in entry_points().groups if group.startswith("forcectl.") for point in _points(group)]
    return {value.partition(":")[0].partition(".")[0]: f"{group}: !{tag}" for group, tag, value in sorted(points)}


def _points(group: str) -> list[tuple[str, str, str]]:
    from importlib.metadata import entry_points

    return [(group.removeprefix("forcectl."), point.name, point.value) for point in entry_points(group=group)]


def _within(spec: ModuleSpec, package: str, name: str) -> ModuleSpec | None:
    """The spec of a module in a package; None where there is none. Nothing is run."""
    if spec.submodule_search_locations is None:
        return None
    folders = list(spec.submodule_search_locations)
    others = (finder.find_spec(f"{package}.{name}", folders) for finder in sys.meta_path)  # for editable installations
    return PathFinder.find_spec(name, folders) or next(filter(None, others), None)


def _files(spec: ModuleSpec) -> list[Path]:
    """The file of a module; for a namespace package an `__init__.py` in each of its folders."""
    if spec.has_location and spec.origin:
        return [Path(spec.origin).resolve()]
    return [Path(folder).resolve() / "__init__.py" for folder in spec.submodule_search_locations or ()]


def _is_standard(module: str) -> bool:
    return module.partition(".")[0] in (*sys.stdlib_module_names, *_OF_PYTHON)


def settings_file() -> Path:
    """Path of the user's settings for all scenarios, which need not exist; see `forcectl.scenario.user_settings`."""
    folder = os.environ.get("XDG_CONFIG_HOME", "")
    home = Path(folder) if os.path.isabs(folder) else Path(os.path.expanduser("~"), ".config")
    return home / "forcectl" / "settings.yaml"
