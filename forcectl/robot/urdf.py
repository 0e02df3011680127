"""Public URDF files: checks, and the corrected text that Drake parses instead.

The file itself is never changed. Parts that Drake cannot use, or would model in another way than a robot with drives,
are replaced or removed in a copy of the text:

- collision meshes other than .obj, .vtk, .gltf: replaced by the box or capsule around them (`forcectl.robot.meshes`);
- visual meshes: removed if missing, .stl ones replaced by the box or capsule around them;
- `<mimic>`: removed, because a joint that mimics is held, see `forcectl.robot.parts`;
- `<dynamics>`: removed; damping and friction of a joint are those of its drive, see `forcectl.robot.assumptions`;
- transmissions of joints without a torque limit, and gear ratios: removed, see `forcectl.robot.parts` for both;
- transmissions without a joint that moves: removed;
- materials: defined before their use, and one name for each colour;
- inertias of links with zero mass: removed (in a link that moves they are refused);
- slightly impossible inertias: replaced by possible ones (very impossible ones are refused in a link that moves);
- addresses of packages: replaced by the files they name, see `package_folders`.
"""

from __future__ import annotations

import math
import os
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path
from xml.etree import ElementTree
from xml.parsers import expat

import numpy as np
from pydrake.math import RollPitchYaw

from forcectl.models import models_folder
from forcectl.robot.meshes import Enclosure, mesh_enclosure
from forcectl.robot.ranges import (
    GEAR_RATIO,
    LIMITS,
    NEGATIVE,
    NUMBERS,
    ConditionalFault,
    inertia_matrix,
    is_axis,
    numbers_in,
    wrong_body,
    wrong_friction,
    wrong_limits,
)
from forcectl.robot.urdf_text import lines_of_copy, order_materials, package_folders, parse_xml, wrong_elements

Element = ElementTree.Element

_BY_DRAKE = (".obj", ".vtk", ".gltf")
_ENTRIES = ([0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2])  # of an inertia, in the order below
_MOVING = ("revolute", "continuous", "prismatic")


@dataclass(frozen=True)
class UrdfJoint:
    """A joint that moves, with the values of the file; units are SI.

    Attributes:
        kind: revolute, continuous or prismatic.
        effort, velocity: limits; infinite where the file gives none, or 0.
        damping, friction: of `<dynamics>`.
        reduction: gear ratio of its transmission; 1 where it has none.
        mimics: joint whose position this one follows, factor and offset; None for a joint of its own.
    """

    kind: str
    effort: float = math.inf
    velocity: float = math.inf
    damping: float = 0.0
    friction: float = 0.0
    reduction: float = 1.0
    mimics: tuple[str, float, float] | None = None


@dataclass(eq=False)
class Urdf:
    """The content of a URDF file; the same object as long as the file does not change.

    Attributes:
        text: corrected text, to parse in place of the file; "" where the file can be parsed itself.
        lines: line of the file for each line of `text` in which an element begins.
        joints: those that move, by name.
        problems: errors that make the file unusable.
        conditional_faults: errors that matter only where their joint or link moves.
        notes: what was replaced or left out.
        missing_shapes: collision shapes that were left out without a substitute.
    """

    text: str = ""
    lines: dict[int, int] = field(default_factory=dict)
    joints: dict[str, UrdfJoint] = field(default_factory=dict)
    problems: list[str] = field(default_factory=list)
    conditional_faults: list[ConditionalFault] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    missing_shapes: list[str] = field(default_factory=list)


def read_urdf(path: Path) -> Urdf:
    """Read a URDF file; whatever is wrong with it is in `Urdf.problems`."""
    try:
        return _read(path.resolve(), path.stat().st_mtime_ns)
    except OSError as error:
        return Urdf(problems=[f"cannot be read: {error.strerror}"])


@lru_cache(maxsize=64)
def _read(path: Path, _changed: int) -> Urdf:
    found, lines = Urdf(), dict[int, int]()
    try:
        root = parse_xml(path.read_bytes(), lines)
    except expat.ExpatError as error:
        found.problems.append(f"not valid XML: {error}")
        return found
    if root.tag != "robot":
        found.problems.append(f"its root is <{root.tag}>: must be <robot>")
    if any(element.tag.startswith("xacro:") for element in root.iter()):
        found.problems.append("holds xacro macros: expand them first, `xacro FILE.xacro > FILE.urdf`")
    found.problems += wrong_elements(root, lines)
    if not found.problems:
        _Rewriting(path, root, lines, found).run()
    return found


class _Rewriting:
    """Fills a `Urdf` from the tree of its file, and changes the tree."""

    def __init__(self, path: Path, root: Element, lines: dict[int, int], found: Urdf):
        self._path, self._root, self._lines, self._found = path, root, lines, found
        self._changed, self._driven = False, set[str]()

    def run(self) -> None:
        self._check_tree()
        moving = [joint for joint in self._root.findall("joint") if joint.get("type") in _MOVING]
        self._moved = {child.get("link"): joint.get("name", "") for joint in moving for child in joint.findall("child")}
        for link in self._root.findall("link"):
            self._inertia(link)
            for kind in ("visual", "collision"):
                for shape in link.findall(kind):
                    self._shape(link, shape)
        for joint in self._root.findall("joint"):
            self._joint(joint)
        for changed in order_materials(self._root):
            self._changed = True
            if changed.endswith("left out"):
                self._found.notes.append(changed)
        for transmission in self._root.findall("transmission"):
            self._transmission(transmission)
        if self._changed:  # the copy lies in another folder
            for mesh in self._root.iter("mesh"):
                address = mesh.get("filename", "")
                mesh.set("filename", address if "://" in address else str(self._path.parent / address))
        if self._changed and not self._found.problems:
            self._found.text = ElementTree.tostring(self._root, encoding="unicode")
            self._found.lines = lines_of_copy(self._root, self._lines, self._found.text)

    def _problem(self, element: Element, text: str) -> None:
        self._found.problems.append(f"line {self._lines[id(element)]}: {text}")

    def _fault(self, element: Element, text: str, joint: str = "", link: str = "", key: str = "") -> None:
        line = f"line {self._lines[id(element)]}"
        self._found.conditional_faults.append(ConditionalFault(f"{line}: {text}", joint, link, key))

    def _remove(self, parent: Element, child: Element) -> None:
        parent.remove(child)
        self._changed = True

    def _check_tree(self) -> None:
        """Links and joints are one tree."""
        parents: dict[str, str] = {}
        for kind in ("link", "joint"):
            seen: set[str] = set()
            for element in self._root.findall(kind):
                name = element.get("name", "")
                if not name or name in seen:
                    self._problem(element, f"{kind} {name!r}: must have a name of its own")
                seen.add(name)
        links = {link.get("name", "") for link in self._root.findall("link")}
        links |= {"world"} & {parent.get("link", "") for parent in self._root.findall("joint/parent")}
        if not links:
            self._found.problems.append("holds no link")
        for joint in self._root.findall("joint"):
            ends = {}
            for end in ("parent", "child"):
                named = joint.find(end)
                ends[end] = named.get("link", "") if named is not None else ""
                if ends[end] not in links:
                    self._problem(joint, f"joint {joint.get('name')!r}: {end} {ends[end]!r}: there is no such link")
            if ends["parent"] == ends["child"]:
                self._problem(
                    joint, f"joint {joint.get('name')!r}: child {ends['child']!r}: must be another link than its parent"
                )
            if ends["child"] in parents:
                self._problem(joint, f"link {ends['child']!r} is the child of two joints: must be a tree")
            parents[ends["child"]] = ends["parent"]
        roots = sorted(links - set(parents))
        if len(roots) != 1 and links and not self._found.problems:
            shown = ", ".join(roots) or "none, its joints form a loop"
            self._found.problems.append(f"links without a parent: {shown}: must be one")
        rooted = set(roots)
        while more := {child for child, parent in parents.items() if parent in rooted} - rooted:
            rooted |= more
        if (looped := sorted(set(parents) - rooted)) and not self._found.problems:
            self._found.problems.append(f"joints form a loop through {', '.join(looped)}: must be a tree")

    def _inertia(self, link: Element) -> None:
        for inertial in link.findall("inertial"):
            mass_element, inertia = inertial.find("mass"), inertial.find("inertia")
            mass = float(mass_element.get("value", "0")) if mass_element is not None else 0.0
            read = {name: float(inertia.get(name, "0")) for name in NUMBERS["inertia"]} if inertia is not None else {}
            inertias = inertia_matrix(read) if read else np.zeros((3, 3))
            moments, name = np.linalg.eigvalsh(inertias), link.get("name", "")
            moved = name in self._moved
            wrong = wrong_body(mass, inertias, _centre(inertial), moved and mass_element is not None)
            if moved and read and mass > 0 and not moments.any():
                wrong = "inertia is zero: must be above zero in a link that moves"
            if wrong and (mass < 0 or (np.diag(inertias) < NEGATIVE).any()):
                self._problem(link, f"link {name!r}: {wrong}")
                continue
            if wrong:  # a held finger may have no mass: it is then fixed to the hand
                empty = moved and (mass == 0 or not moments.any())
                about = {"joint": self._moved[name]} if empty else {"link": name}
                self._fault(link, f"link {name!r}: {wrong}", **about)
            if mass == 0:
                self._remove(link, inertial)
                if moments.any():
                    self._found.notes.append(f"link {name}: inertia without a mass, left out")
            elif moments[0] < 0 or moments[2] > (1 + 1e-6) * (moments[0] + moments[1]) + 1e-12:
                self._raise_moments(inertia, inertias)
                self._found.notes.append(f"link {name}: inertia of no physical body; its smaller moments are raised")

    def _raise_moments(self, inertia: Element | None, inertias: np.ndarray) -> None:
        """Raise the smaller moments to the least that are possible with the largest one."""
        moments, axes = np.linalg.eigh(inertias)
        moments = np.maximum(moments, 0.0)
        moments[:2] += max(0.0, 0.5 * (moments[2] - moments[0] - moments[1]) * (1 + 1e-6))
        M = axes @ np.diag(moments) @ axes.T
        if inertia is not None:
            for name, value in zip(NUMBERS["inertia"], M[_ENTRIES], strict=True):
                inertia.set(name, repr(float(value)))
        self._changed = True

    def _shape(self, link: Element, shape: Element) -> None:
        mesh = shape.find("geometry/mesh")
        if mesh is None:
            return
        visual, address = shape.tag == "visual", mesh.get("filename", "")
        what = f"link {link.get('name')}: {shape.tag} mesh {address}"
        file = self._file(address)
        if file is None:
            self._remove(link, shape)
            self._found.notes.append(f"{what}: not found, {'not drawn' if visual else 'left out'}")
            if not visual:
                self._found.missing_shapes.append(f"{what}: not found")
            return
        if "://" in address and not file.is_relative_to(models_folder()):
            mesh.set("filename", str(file))
            self._changed = True
        suffix = file.suffix.lower()
        by_drake = suffix in _BY_DRAKE or (visual and suffix != ".stl")
        if by_drake and (visual or suffix != ".obj"):
            return
        scale = np.array(numbers_in(mesh.get("scale", "")) or [1.0, 1.0, 1.0])
        try:
            around = mesh_enclosure(file, scale)
        except (ValueError, OSError) as error:
            self._remove(link, shape)
            self._found.notes.append(f"{what}: {' '.join(str(error).split())}, left out")
            if not visual:
                self._found.missing_shapes.append(f"{what}: {' '.join(str(error).split())}")
            return
        if by_drake:  # read only to check its size
            return
        _put(shape, around)
        self._changed = True
        if not visual:
            kind = "capsule" if around.radius else "box"
            self._found.notes.append(f"{what}: replaced by the {kind} around it")

    def _file(self, address: str) -> Path | None:
        """The file that an address names, None if there is none."""
        scheme, separator, rest = address.partition("://")
        if not separator:
            file = self._path.parent / address
            return file if file.is_file() else None
        if scheme == "file":
            return Path(rest) if os.path.isfile(Path(rest)) else None
        package, _, inside = rest.lstrip("/").partition("/")
        for root in package_folders(self._path.parent, package):
            if os.path.isfile(root / inside):
                return root / inside
        return None

    def _joint(self, joint: Element) -> None:
        name, kind = joint.get("name", ""), joint.get("type", "")
        if kind not in (*_MOVING, "fixed"):
            allowed = f"one of {', '.join(_MOVING)}, fixed"
            drives = "; a base that moves is not simulated, make it fixed" if kind in ("planar", "floating") else ""
            self._problem(joint, f"joint {name!r}: type = {kind!r}: must be {allowed}{drives}")
        mimic = joint.find("mimic")
        if mimic is not None:
            self._remove(joint, mimic)
        if kind not in _MOVING:
            return
        axis, limit = joint.find("axis"), joint.find("limit")
        if limit is None and kind != "continuous" and mimic is None:
            self._fault(joint, f"joint {name!r} has no <limit>: must have one, or be of type continuous", name)
        if axis is not None and not is_axis(numbers_in(axis.get("xyz", "1 0 0")) or [1.0]):
            self._problem(joint, f"joint {name!r}: axis is zero: must be a direction")
        values = {each: float(limit.get(each, "0")) for each in LIMITS} if limit is not None else {}
        if values and values["lower"] > values["upper"]:
            low, high = values["lower"], values["upper"]
            self._problem(joint, f"joint {name!r}: limit from {low:g} to {high:g}: lower must not be above upper")
        for each in ("effort", "velocity"):
            if values.get(each, 0.0) < 0:
                self._problem(joint, f"joint {name!r}: {each} = {values[each]:g}: must not be negative")
            if limit is not None and limit.get(each) is not None and values[each] == 0:
                self._found.notes.append(f"joint {name}: {each} = 0: counts as not known")
        counting = values if kind != "continuous" else {each: values[each] for each in ("effort", "velocity") if values}
        for text, key in wrong_limits(counting, turns=kind != "prismatic"):
            self._fault(joint, f"joint {name!r}: {text}", name, key=key)
        dynamics = joint.find("dynamics")
        friction = (
            {each: float(dynamics.get(each, "0")) for each in NUMBERS["dynamics"]} if dynamics is not None else {}
        )
        for text in wrong_friction(friction):
            self._fault(joint, f"joint {name!r}: {text}", name)
        if any(friction.values()) and dynamics is not None:
            self._remove(joint, dynamics)
        mimics = None
        if mimic is not None:
            mimics = (mimic.get("joint", ""), float(mimic.get("multiplier", "1")), float(mimic.get("offset", "0")))
            if mimics[0] not in {each.get("name") for each in self._root.findall("joint")}:
                self._fault(joint, f"joint {name!r}: mimics {mimics[0]!r}: there is no such joint", name)
                mimics = None
        # Zero means "not known" in public models: taken literally, no joint could move.
        effort, velocity = (values.get(each, 0.0) or math.inf for each in ("effort", "velocity"))
        endless = [each for each, value in values.items() if not math.isfinite(value)]
        if limit is not None:
            for each in [*endless, *(["velocity"] if velocity == math.inf else [])]:
                self._changed |= limit.attrib.pop(each, None) is not None
        self._found.joints[name] = UrdfJoint(kind, effort, velocity, mimics=mimics, **friction)

    def _transmission(self, transmission: Element) -> None:
        names = [each.get("name", "") for each in transmission.findall("joint")]
        for name in names:
            if name in self._driven:
                self._problem(transmission, f"joint {name!r} is in another transmission: must be in one")
            self._driven.add(name)
        joints = {name: self._found.joints[name] for name in names if name in self._found.joints}
        for part in (transmission, *transmission.findall("actuator"), *transmission.findall("joint")):
            for reduction in part.findall("mechanicalReduction"):
                text = (reduction.text or "").strip()
                if not GEAR_RATIO.holds(text):
                    self._problem(reduction, f"mechanicalReduction = {text!r}: must be {GEAR_RATIO.words()}")
                    continue
                ratio = float(text)
                self._found.joints |= {name: replace(joint, reduction=ratio) for name, joint in joints.items()}
                self._remove(part, reduction)
        if names and not joints:
            self._found.notes.append(f"transmission of {', '.join(names)}: no joint that moves, left out")
            self._remove(self._root, transmission)
        elif any(not math.isfinite(joint.effort) for joint in joints.values()):
            self._remove(self._root, transmission)


def _centre(inertial: Element) -> list[float]:
    """Centre of mass in its link [m]."""
    origin = inertial.find("origin")
    return (numbers_in(origin.get("xyz", "")) if origin is not None else None) or [0.0]


def _put(shape: Element, around: Enclosure) -> None:
    """Replace the mesh of a shape by the box, sphere or capsule around it."""
    geometry, origin = shape.find("geometry"), shape.find("origin")
    if geometry is None:
        return
    if origin is None:
        origin = ElementTree.SubElement(shape, "origin")
    xyz = np.array(numbers_in(origin.get("xyz", "")) or [0.0] * 3)
    R = RollPitchYaw(np.array(numbers_in(origin.get("rpy", "")) or [0.0] * 3)).ToRotationMatrix()
    origin.set("xyz", _text(xyz + R @ around.X.translation()))
    origin.set("rpy", _text(RollPitchYaw(R @ around.X.rotation()).vector()))
    for mesh in geometry.findall("mesh"):
        geometry.remove(mesh)
    if not around.radius:
        ElementTree.SubElement(geometry, "box", size=_text(2 * around.half))
    elif not around.half[2]:
        ElementTree.SubElement(geometry, "sphere", radius=repr(around.radius))
    else:
        length = repr(float(2 * around.half[2]))
        ElementTree.SubElement(geometry, "capsule", radius=repr(around.radius), length=length)


def _text(numbers: np.ndarray) -> str:
    return " ".join(repr(float(each)) for each in numbers)
