"""The robots, tools and environments shipped with forcectl, and where to find them.

A robot is a folder with one URDF or SDF and one `*.control.yaml` (see `forcectl.robot.parameters`); a tool is a folder
with one URDF or SDF and one `*.tool.yaml`. A user's own folder works wherever a shipped name does. Every shipped folder
has a `package.xml`, so that `package://comau_smart_six/...` works after `add_packages`.

The name or path of a robot with several arms means all of them; "yumi/left" means its left arm alone.
"""

from __future__ import annotations

import os
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

from forcectl.errors import BadInputError, unknown

if TYPE_CHECKING:
    from pydrake.multibody.parsing import PackageMap

ROBOT_PARAMETERS = "*.control.yaml"
TOOL_PARAMETERS = "*.tool.yaml"
_REMOTE = "drake_models"


def models_folder() -> Path:
    """The folder that holds the shipped models."""
    return Path(__file__).parent


def list_robots() -> list[str]:
    """Names of the shipped robots, sorted."""
    return _folders_with(ROBOT_PARAMETERS)


def list_tools() -> list[str]:
    """Names of the shipped tools, sorted."""
    return _folders_with(TOOL_PARAMETERS)


def robot_folder(name_or_path: str | Path) -> Path:
    """The folder of a shipped robot (by name) or of a user's own (by path).

    Raises:
        BadInputError: neither a shipped name nor a folder.
    """
    return _folder("robot", name_or_path, list_robots())


def robot_and_arm(name_or_path: str | Path) -> tuple[Path, str | None]:
    """The folder of a robot and, where the last part of the name is not a folder, the name of the arm that is meant.

    Raises:
        BadInputError: neither a robot nor "robot/arm".
    """
    whole = str(name_or_path)
    robot, _, arm = whole.rpartition("/")
    known = robot in list_robots() or (robot != "" and any(_path(robot).glob(ROBOT_PARAMETERS)))
    if arm and known and whole not in list_robots() and not os.path.isdir(_path(whole)):
        return robot_folder(robot), arm
    return robot_folder(name_or_path), None


def found_beside(folder: Path, name: str) -> str:
    """The name of a robot, "robot/arm" or a tool, as the path where it is a folder in this one that is not shipped."""
    first, robot = name.partition("/")[0], name.rpartition("/")[0]
    if not name or first in _folders_with("package.xml"):
        return name
    there = os.path.isdir(folder / name) or (robot != "" and any((folder / robot).glob(ROBOT_PARAMETERS)))
    return str(folder / name) if there else name


def _path(name: str | Path) -> Path:
    return Path(os.path.expanduser(name))


def tool_folder(name_or_path: str | Path) -> Path:
    """The folder of a shipped tool (by name) or of a user's own (by path).

    Raises:
        BadInputError: neither a shipped name nor a folder.
    """
    return _folder("tool", name_or_path, list_tools())


def parameter_file(folder: Path, pattern: str) -> Path:
    """The one file in `folder` that matches `pattern` (`ROBOT_PARAMETERS` or `TOOL_PARAMETERS`).

    Raises:
        BadInputError: no such file, or more than one.
    """
    found = sorted(folder.glob(pattern))
    if len(found) != 1:
        names = ", ".join(file.name for file in found) or "none"
        raise BadInputError(f"folder {str(folder)!r} must hold exactly one {pattern} file, found: {names}")
    return found[0]


def add_packages(package_map: PackageMap) -> None:
    """Make `package://<folder>/...` known for every shipped folder that `package_map` does not hold yet.

    The package that Drake would download is forgotten: nothing is fetched from a network.
    """
    if package_map.Contains(_REMOTE):
        package_map.Remove(_REMOTE)
    for xml in _shipped("package.xml"):
        if not package_map.Contains(xml.parent.name):
            package_map.AddPackageXml(xml)


def _folders_with(pattern: str) -> list[str]:
    return sorted({file.parent.name for file in _shipped(pattern)})


@cache
def _shipped(pattern: str) -> list[Path]:
    """The files of that name in the shipped folders, sorted; every robot that is loaded asks for them."""
    return sorted(models_folder().glob(f"*/{pattern}"))


def _folder(kind: str, name_or_path: str | Path, shipped: list[str]) -> Path:
    if str(name_or_path) in shipped:
        return models_folder() / name_or_path
    # An empty string would otherwise mean the current directory.
    path = _path(name_or_path)
    if str(name_or_path) and os.path.isdir(path):
        return path
    error = unknown(f"{kind} (neither shipped nor a folder)", str(name_or_path), shipped)
    if not path.is_absolute():
        error.text += f"; folders are looked for beside the scenario's file, and in {str(Path.cwd())!r}"
    raise error
