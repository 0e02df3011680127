"""Checks of the numbers of an SDF file. Drake parses the file unchanged, and ignores many errors in it."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from xml.etree import ElementTree
from xml.parsers import expat

from forcectl.robot.ranges import (
    LIMITS,
    NUMBERS,
    POSITION,
    TURN,
    ConditionalFault,
    NumberRange,
    inertia_matrix,
    is_axis,
    numbers_in,
    wrong_body,
    wrong_friction,
    wrong_limits,
)
from forcectl.robot.urdf_text import parse_xml

Element = ElementTree.Element

_NO_LIMIT = 1e16  # no limit in SDF from here on, as negative efforts and velocities
_DEFAULT_INERTIA = {"ixx": 1.0, "iyy": 1.0, "izz": 1.0, "ixy": 0.0, "ixz": 0.0, "iyz": 0.0}  # defaults of the format


# Children of which an element may have one, beside its numbers and its pose: Drake ignores further ones.
_ONCE = {
    "link": ("inertial",),
    "inertial": ("inertia",),
    "joint": ("parent", "child", "axis"),
    "axis": ("limit", "dynamics"),
}


def wrong_sdf(path: Path) -> tuple[list[str], list[ConditionalFault]]:
    """Messages about wrong numbers of an SDF file, and conditional faults, which matter only where something moves.

    Files that it includes are not checked.
    """
    lines = dict[int, int]()
    try:
        root = parse_xml(path.read_bytes(), lines)
    except OSError as error:
        return [str(error.strerror)], []
    except expat.ExpatError as error:
        return [f"not valid XML: {error}"], []
    wrong, conditional_faults = [*_wrong_counts(root), *_wrong_texts(root)], list[ConditionalFault]()
    if not wrong:
        for element, text, about in (*_wrong_links(root), *_wrong_joints(root)):
            if about:
                conditional_faults.append(ConditionalFault(f"line {lines[id(element)]}: {text}", **about))
            else:
                wrong.append((element, text))
    return [f"line {lines[id(element)]}: {text}" for element, text in wrong], conditional_faults


def _wrong_counts(root: Element) -> Iterator[tuple[Element, str]]:
    for element in root.iter():
        once, seen = {"pose", *NUMBERS.get(element.tag, ()), *_ONCE.get(element.tag, ())}, set[str]()
        for child in element:
            if child.tag in once & seen:
                yield child, f"{element.tag} has another <{child.tag}>: must have one"
            seen.add(child.tag)
        if element.tag == "geometry" and len(element) != 1:
            yield element, f"geometry holds {len(element)} shapes: must hold one"


def _wrong_texts(root: Element) -> Iterator[tuple[Element, str]]:
    for element in root.iter():
        allowed_of = NUMBERS.get(element.tag, {})
        for child in element:
            text = (child.text or "").strip()
            if child.tag == "pose" and text:
                words = _wrong_pose(child, text, far=element.tag == "inertial")
                if words:
                    yield child, f"pose of {element.tag} {element.get('name', '')!r} = {text!r}: must be {words}"
            elif child.tag in allowed_of and not allowed_of[child.tag].holds(text):
                yield child, f"{element.tag} {child.tag} = {text!r}: must be {allowed_of[child.tag].words()}"


def _wrong_pose(pose: Element, text: str, far: bool) -> str:
    """Allowed values of a wrong pose, else ""; `far`: that of a centre of mass, whose distance is checked elsewhere."""
    parts = text.split()
    position = NumberRange(3) if far else POSITION
    if pose.get("rotation_format") == "quat_xyzw":
        turn = NumberRange(4)
    else:
        turn = (
            NumberRange(3, largest=math.degrees(TURN.largest), unit="deg")
            if pose.get("degrees") in ("true", "1")
            else TURN
        )
    right = position.holds(" ".join(parts[:3])) and turn.holds(" ".join(parts[3:]))
    return "" if right else f"{position.words()} and then {turn.words()}"


# Element, message, and fields of a `ConditionalFault`, empty for an error.
_Fault = tuple[Element, str, dict[str, str]]


def _wrong_links(root: Element) -> Iterator[_Fault]:
    moving = [joint for joint in root.iter("joint") if joint.get("type") != "fixed"]
    moved = {(joint.findtext("child") or "").strip().rpartition("::")[2] for joint in moving}
    for link in root.iter("link"):
        for inertial in link.findall("inertial"):
            if inertial.get("auto") in ("true", "1"):
                continue
            inertia, pose = inertial.find("inertia"), inertial.findtext("pose") or ""
            entries = _DEFAULT_INERTIA | _values(inertia if inertia is not None else Element("inertia"))
            mass, centre = _values(inertial).get("mass", 1.0), (numbers_in(pose) or [0.0])[:3]
            # Drake replaces a mass by 1 kg if it is zero or has an impossible inertia.
            M, name = inertia_matrix(entries), link.get("name", "")
            if text := wrong_body(mass, M, centre, name in moved, exact=True):
                still = wrong_body(mass, M, centre, moved=False, exact=True)
                yield inertial, f"link {name!r}: {text}", {} if still else {"link": name}


def _wrong_joints(root: Element) -> Iterator[_Fault]:
    for joint in root.iter("joint"):
        axis = joint.find("axis")
        if axis is None:
            continue
        name = f"joint {joint.get('name')!r}"
        if not is_axis(numbers_in(axis.findtext("xyz") or "0 0 1") or [0.0]):
            yield axis, f"{name}: axis is zero: must be a direction", {}
        for limit in axis.findall("limit"):
            values = {name: value for name, value in _values(limit).items() if name in LIMITS}
            if values.get("velocity") == 0:
                yield limit, f"{name}: velocity = 0: must be above zero, or left out for none", {}
            counting = {each: _limit(each, value) for each, value in values.items()}
            for text, key in wrong_limits(counting, turns=joint.get("type") in ("revolute", "continuous")):
                yield limit, f"{name}: {text}", {"joint": joint.get("name", ""), "key": key}
        for dynamics in axis.findall("dynamics"):
            for text in wrong_friction(_values(dynamics)):
                yield dynamics, f"{name}: {text}", {}


def _limit(name: str, value: float) -> float:
    endless = abs(value) >= _NO_LIMIT or (name in ("effort", "velocity") and value < 0)
    return math.inf if endless else value


def _values(element: Element) -> dict[str, float]:
    """The numbers within an element by their names."""
    known = NUMBERS[element.tag]
    return {child.tag: float(child.text or "") for child in element if child.tag in known}
