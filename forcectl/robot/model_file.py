"""Model files as Drake parses them, with one-line errors."""

from __future__ import annotations

import json
import logging
import os
import re
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import ModelInstanceIndex

from forcectl.errors import BadInputError, unknown
from forcectl.models import add_packages
from forcectl.robot.ranges import ConditionalFault
from forcectl.robot.sdf import wrong_sdf
from forcectl.robot.urdf import Urdf, read_urdf

_LITERAL = "<literal-string>.urdf"  # Drake's name for a text that is no file


@dataclass(frozen=True)
class ModelFile:
    """A file with one model.

    Attributes:
        path: of the file.
        name: of the model.
        bodies: names of its bodies.
        urdf: content of a URDF file; empty for others.
        conditional_faults: errors that matter only where their joint or link moves.
        remarks: warnings of Drake, each once.
    """

    path: Path
    name: str
    bodies: tuple[str, ...]
    urdf: Urdf
    conditional_faults: tuple[ConditionalFault, ...]
    remarks: tuple[str, ...]

    @classmethod
    def read(cls, path: Path, everything: bool = True) -> ModelFile:
        """Read the file once.

        Args:
            path: of the file.
            everything: whether conditional faults are errors, too; otherwise the caller handles them.

        Raises:
            BadInputError: it cannot be used.
        """
        if not os.path.isfile(path):
            raise BadInputError(f"model = {path.name!r}: there is no such file in folder {str(path.parent)!r}")
        suffix = path.suffix.lower()
        urdf = read_urdf(path) if suffix == ".urdf" else Urdf()
        problems, conditional_faults = wrong_sdf(path) if suffix == ".sdf" else (urdf.problems, urdf.conditional_faults)
        if problems := [*problems, *(each.text for each in conditional_faults if everything)]:
            raise BadInputError(f"{path.name}: cannot be read: {'; '.join(problems)}")
        name, bodies, remarks = _only_model(path, urdf)
        return cls(path, name, bodies, urdf, tuple(conditional_faults), remarks)


@lru_cache(maxsize=64)
def _only_model(path: Path, urdf: Urdf) -> tuple[str, tuple[str, ...], tuple[str, ...]]:
    """Name and bodies of the model of a file, and Drake's warnings.

    An unchanged URDF file has the same `Urdf` object, so it is not parsed again.
    """
    plant = MultibodyPlant(time_step=0.0)
    instances, remarks = add_models(plant, path, urdf)
    if len(instances) != 1:
        raise BadInputError(f"{path.name} holds {len(instances)} models: must hold exactly one")
    bodies = tuple(plant.get_body(index).name() for index in plant.GetBodyIndices(instances[0]))
    return plant.GetModelInstanceName(instances[0]), bodies, remarks


def add_models(plant: MultibodyPlant, path: Path, urdf: Urdf) -> tuple[list[ModelInstanceIndex], tuple[str, ...]]:
    """Parse a model file by itself; returns its models and Drake's warnings.

    Raises:
        BadInputError: it cannot be read.
    """
    parser = Parser(plant)
    add_packages(parser.package_map())
    sources = {_LITERAL if urdf.text else str(path): _Source(path.name, urdf.lines)}
    with _readable(path.name, sources) as remarks:
        added: list[ModelInstanceIndex] = (
            parser.AddModelsFromString(urdf.text, "urdf") if urdf.text else parser.AddModels(path)
        )
    return added, tuple(dict.fromkeys(remarks))


Bodies = list[str]  # by their full names, model::body


def all_bodies(name: str, model: ModelFile) -> Bodies:
    """All bodies of a model that is added under this name."""
    return [f"{name}::{body}" for body in model.bodies]


def some_bodies(model: ModelFile, links: Iterable[str], key: str) -> Bodies:
    """Some bodies of a model, listed at this key.

    Raises:
        BadInputError: there is no such body.
    """
    for i, link in enumerate(links):
        if link not in model.bodies:
            raise unknown(f"link of {model.name}", link, model.bodies).at(f"{key}.{i}")
    return [f"{model.name}::{link}" for link in links]


def parse_models(
    plant: MultibodyPlant, models: dict[str, ModelFile], filters: list[tuple[Bodies, Bodies]]
) -> dict[str, ModelInstanceIndex]:
    """Add models under the names given; `filters` are pairs of groups of bodies never checked against each other.

    All are parsed at once: Drake refuses a collision filter between models that were not parsed together.
    """
    parser = Parser(plant)
    add_packages(parser.package_map())
    directives: list[dict[str, Any]] = []
    sources: dict[str, _Source] = {}
    with TemporaryDirectory() as copies:
        for name, model in models.items():
            folder = model.path.parent
            if model.urdf.text:
                folder = Path(copies, name)
                folder.mkdir()
                (folder / model.path.name).write_text(model.urdf.text, encoding="utf-8")
            sources[str(folder / model.path.name)] = _Source(model.path.name, model.urdf.lines)
            parser.package_map().Add(f"folder_of_{name}", str(folder))
            directives.append({"add_model": {"name": name, "file": f"package://folder_of_{name}/{model.path.name}"}})
        for i, sides in enumerate(filters):
            names = [f"filter_{i}_a", f"filter_{i}_b"]
            for own, other, members in zip(names, reversed(names), sides, strict=True):
                entry = {"name": own, "members": members, "ignored_collision_filter_groups": [other]}
                directives += [{"add_collision_filter_group": entry}] if all(sides) else []
        files = " or ".join(dict.fromkeys(model.path.name for model in models.values()))
        with _readable(files, sources) as remarks:
            parser.AddModelsFromString(json.dumps({"directives": directives}), "dmd.yaml")
    # Drake's SDF parser only warns, and continues with other numbers. Included files are checked only here.
    if wrong := next((text for text in remarks if re.search("invalid inertia|'mass > 0' failed", text)), None):
        allowed = "must have masses above zero, and moments of inertia that a body has"
        raise BadInputError(f"{files}: cannot be used: {wrong}: {allowed}")
    return {name: plant.GetModelInstanceByName(name) for name in models}


@dataclass(frozen=True)
class _Source:
    """The user's file behind a text that Drake parses.

    Attributes:
        name: of the file.
        lines: see `Urdf`; empty where the text is that of the file.
    """

    name: str
    lines: dict[int, int]

    def line(self, number: int) -> int:
        """The line of the file for a line of the text, or that of the element before it."""
        before = [each for each in self.lines if each <= number]
        return self.lines[max(before)] if before else number


@contextmanager
def _readable(files: str, sources: dict[str, _Source]) -> Iterator[list[str]]:
    """Raise Drake's errors about these files as BadInputError in one line, and collect its warnings without printing.

    Failed preconditions of Drake are raised as SystemExit.

    Args:
        files: names of the user's files.
        sources: the user's file by the name that Drake has for the text.
    """
    logger, remarks = logging.getLogger("drake"), list[str]()

    def gather(record: logging.LogRecord) -> bool:
        remarks.append(_plain(record.getMessage()))
        return False

    logger.addFilter(gather)
    try:
        yield remarks
    except (RuntimeError, ValueError, SystemExit) as error:
        text = _located(_plain(str(error)), sources)
        if "MuJoCo parser currently only supports mesh" in text:
            text = f"{text.partition(' See http')[0].rstrip('.')}; only a URDF of the robot may have other meshes"
        raise BadInputError(f"{files}: cannot be read: {text}") from error
    finally:
        logger.removeFilter(gather)


def _located(text: str, sources: dict[str, _Source]) -> str:
    """A message of Drake with file and line of the user in place of those of a copy."""
    for parsed, source in sources.items():
        file = f"{source.name}: " if len(sources) > 1 else ""
        for number in re.findall(rf"{re.escape(parsed)}:(\d+):", text):
            text = re.sub(rf"{re.escape(parsed)}:{number}:( error:)?", f"{file}line {source.line(int(number))}:", text)
        text = text.replace(parsed, source.name)
    return text


def _plain(text: str) -> str:
    """One line, without locations in Drake's own sources."""
    return re.sub(r"^(\S*: )?warning: |Failure at \S+ in ", "", " ".join(text.split()))
