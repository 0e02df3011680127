"""The text of a URDF file: its tree with lines, its numbers, and the packages that its addresses name."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from xml.etree import ElementTree
from xml.parsers import expat

Element = ElementTree.Element

_LARGEST = 1e9  # in SI units, of what is no limit
_UP = 4  # folders above the model that are looked through for a package
# Attributes that are numbers, and how many.
NUMBERS = {
    "origin": {"xyz": 3, "rpy": 3},
    "axis": {"xyz": 3},
    "mass": {"value": 1},
    "inertia": dict.fromkeys(("ixx", "iyy", "izz", "ixy", "ixz", "iyz"), 1),
    "limit": dict.fromkeys(("lower", "upper", "effort", "velocity"), 1),
    "dynamics": {"damping": 1, "friction": 1},
    "mimic": {"multiplier": 1, "offset": 1},
    "box": {"size": 3},
    "cylinder": {"radius": 1, "length": 1},
    "capsule": {"radius": 1, "length": 1},
    "sphere": {"radius": 1},
    "mesh": {"scale": 3},
}


def parse_xml(data: bytes, lines: dict[int, int]) -> Element:
    """The tree of a file; prefixes of names are left as they are, for many files do not declare them.

    Args:
        data: of the file.
        lines: filled with the line of each element by its id.
    """
    builder, parser = ElementTree.TreeBuilder(), expat.ParserCreate()

    def start(tag: str, attributes: dict[str, str]) -> None:
        lines[id(builder.start(tag, attributes))] = parser.CurrentLineNumber

    parser.StartElementHandler, parser.EndElementHandler = start, builder.end
    parser.CharacterDataHandler = builder.data
    parser.Parse(data, True)
    return builder.close()


def wrong_numbers(root: Element, lines: dict[int, int]) -> Iterator[str]:
    """Attributes that are not the numbers they should be, in words."""
    for element in root.iter():
        for name, count in NUMBERS.get(element.tag.rpartition(":")[2], {}).items():
            text = element.get(name)
            if text is None:
                continue
            allowed = f"a number up to {_LARGEST:g}" if count == 1 else f"{count} numbers up to {_LARGEST:g}"
            limit = element.tag == "limit"  # which may be infinite
            numbers = numbers_in(text)
            if numbers is None or len(numbers) != count or not (limit or max(map(abs, numbers)) <= _LARGEST):
                yield f"line {lines[id(element)]}: {element.tag} {name} = {text!r}: must be {allowed}"
            elif element.tag in ("box", "cylinder", "capsule", "sphere") and min(numbers) <= 0:
                yield f"line {lines[id(element)]}: {element.tag} {name} = {text!r}: must be above zero"


def numbers_in(text: str) -> list[float] | None:
    """The numbers of a text; None for anything else, and for one that is no number."""
    try:
        numbers = [float(part) for part in text.split()]
    except ValueError:
        return None
    return None if any(map(math.isnan, numbers)) else numbers


def package_folders(folder: Path, name: str) -> Iterator[Path]:
    """Where a package may be: a folder of its name, or whose package.xml names it, beside or above a model.

    Last the model's own folder and the one above, whatever they are called: a package that was copied.
    """
    above = [folder, *list(folder.parents)[:_UP]]
    for place in above:
        yield place / name
        if place.name == name or _package_name(place) == name:
            yield place
    yield from above[:2]


def _package_name(folder: Path) -> str:
    if not (folder / "package.xml").is_file():  # a pipe would be waited for
        return ""
    try:
        text = ElementTree.parse(folder / "package.xml").findtext("name")
    except (OSError, ElementTree.ParseError):
        return ""
    return (text or "").strip()
