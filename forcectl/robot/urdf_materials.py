"""Materials of a URDF file, in a form that Drake reads: defined before their use, with one colour to a name."""

from __future__ import annotations

from collections.abc import Iterator
from copy import deepcopy
from xml.etree import ElementTree

Element = ElementTree.Element
_Looks = tuple[dict[str, str], ...]


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
