"""The text of a URDF file: its tree with line numbers, checks of its elements, materials, and folders of packages."""

from __future__ import annotations

from collections.abc import Iterator
from copy import deepcopy
from pathlib import Path
from xml.etree import ElementTree
from xml.parsers import expat

from forcectl.robot.ranges import NUMBERS, POSITION, TURN, NumberRange

Element = ElementTree.Element
_Looks = tuple[dict[str, str], ...]  # the attributes of what a material holds

_UP = 4  # number of folders above the model that are searched for a package
_SHAPES = ("box", "cylinder", "sphere", "mesh", "capsule", "drake:capsule", "drake:ellipsoid")
# Children of which an element may have one: further ones would be ignored.
_ONCE = {
    "link": ("inertial",),
    "inertial": ("origin", "mass", "inertia"),
    "joint": ("parent", "child", "origin", "axis", "limit", "dynamics", "mimic"),
    "visual": ("origin", "geometry"),
    "collision": ("origin", "geometry"),
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


def lines_of_copy(root: Element, lines: dict[int, int], copy: str) -> dict[int, int]:
    """The line of the file for each line of its copy in which an element begins.

    Args:
        root: tree of the file, as it was written to the copy.
        lines: line in the file of each element by its id; elements that were added have none.
        copy: its text.
    """
    found: dict[int, int] = {}
    of_copy: dict[int, int] = {}
    for element, copied in zip(root.iter(), parse_xml(copy.encode(), of_copy).iter(), strict=True):
        if id(element) in lines:
            found.setdefault(of_copy[id(copied)], lines[id(element)])
    return found


def wrong_elements(root: Element, lines: dict[int, int]) -> Iterator[str]:
    """Messages about attributes out of range, geometry without one shape, and repeated elements."""
    of_masses = root.findall(".//inertial/origin")
    parts = [part for part in root if part.tag != "gazebo"]  # which holds SDF, for other programs
    for element in (each for part in parts for each in part.iter()):
        at, tag = f"line {lines[id(element)]}", element.tag.rpartition(":")[2]
        allowed_of = NUMBERS.get(tag, {})
        if tag == "origin":
            allowed_of = {"xyz": NumberRange(3) if element in of_masses else POSITION, "rpy": TURN}
        if tag == "frame":
            allowed_of = {"xyz": POSITION, "rpy": TURN}
        for name, allowed in allowed_of.items():
            text = element.get(name)
            if text is not None and not allowed.holds(text):
                yield f"{at}: {element.tag} {name} = {text!r}: must be {allowed.words()}"
        for name in _ONCE.get(tag, ()):
            for again in element.findall(name)[1:]:
                yield f"line {lines[id(again)]}: {tag} has another <{name}>: must have one"
        if tag == "geometry" and len([each for each in element if each.tag in _SHAPES]) != 1:
            held = ", ".join(f"<{each.tag}>" for each in element) or "nothing"
            yield f"{at}: geometry holds {held}: must hold one of {', '.join(_SHAPES)}"


def order_materials(root: Element) -> Iterator[str]:
    """Change the materials of a file for Drake; yields what was changed.

    Definitions below `<robot>` come first, wherever they stand, then those in links, in the order of the file.
    A further colour of the same name gets a name of its own. The first use of a name that is defined later in the file
    gets a copy of its colour. A name that is never defined is left out.

    Args:
        root: the `<robot>`; changed in place.
    """
    visuals = [visual for visual in root.findall("link/visual") if visual.find("material") is not None]
    everywhere = [(root, each) for each in root.findall("material")]
    everywhere += [(visual, each) for visual in visuals for each in visual.findall("material")]
    looks: dict[str, tuple[_Looks, Element]] = {}
    for i, (_, material) in enumerate(everywhere):
        name, own = material.get("name", ""), tuple(each.attrib for each in material)
        if own and looks.setdefault(name, (own, material))[0] != own:
            material.set("name", f"{name}_{i}")
            yield f"material {name}: another colour of the same name"
    defined: set[str] = set()
    for parent, material in everywhere:
        name = material.get("name", "")
        if not len(material) and name not in defined:
            if name in looks:
                material.extend(deepcopy(each) for each in looks[name][1])
                yield f"material {name}: used before it is defined"
            else:
                parent.remove(material)
                yield f"material {name}: has no colour, left out"
                continue
        defined.add(name)


def package_folders(folder: Path, name: str) -> Iterator[Path]:
    """Possible folders of a package: with its name, or named so by a package.xml, beside or above a model.

    Last come the model's own folder and the one above, with any name, for packages that were copied.
    """
    above = [folder, *list(folder.parents)[:_UP]]
    for place in above:
        yield place / name
        if place.name == name or _package_name(place) == name:
            yield place
    yield from above[:2]


def _package_name(folder: Path) -> str:
    if not (folder / "package.xml").is_file():  # opening a pipe would block
        return ""
    try:
        text = ElementTree.parse(folder / "package.xml").findtext("name")
    except (OSError, ElementTree.ParseError):
        return ""
    return (text or "").strip()
