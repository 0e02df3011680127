"""What a robot folder defines, what it leaves out, and proposals for that: `forcectl robot FOLDER`."""

from __future__ import annotations

import difflib
import os
from collections.abc import Collection, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
from pydrake.multibody.plant import MultibodyPlant

from forcectl.arrays import Array
from forcectl.errors import BadInputError, unknown
from forcectl.framework.reader import Reader
from forcectl.framework.yaml_tree import Tagged, place, plain
from forcectl.models import ROBOT_PARAMETERS, TOOL_PARAMETERS, robot_folder
from forcectl.robot.checks import about_file, check_drives, check_lists, check_weight
from forcectl.robot.model_file import ModelFile, add_models
from forcectl.robot.parameters import DERIVED, PER_JOINT, ControlParameters, missing_limits, read_keys
from forcectl.robot.parts import frame_named
from forcectl.runs.robots.proposal import TOUCHING, Explorer, Found, ModelTree
from forcectl.runs.robots.remarks import remarks
from forcectl.runs.robots.values import (
    add_arms,
    known_limits,
    listed,
    posture_within,
    proposed,
    provisional,
    refused_limits,
    sliding,
)

_SUFFIXES = (".urdf", ".sdf", ".xml")
_LENGTH = 0.5  # [m], provisional
_FILTER = {"natural_frequency": 75, "damping_ratio": 1}
_FASTEST = 1e-4  # [s], provisional period, at which no filter is too fast
# Keys that cannot be checked once another key is wrong: `_TOGETHER` has them by that key.
_SETS = ("joint_stiffness", "default_stiffness_set", "link_compliance_sets")
_FLANGE = ("flange_frame", "flange_turn_deg", "tool_neighbours")
_JOINTS = ("arm_joints", "arms", "held_joints", "motor_coupling", *_FLANGE, *PER_JOINT, *_SETS)
_TOGETHER = {"arm_joints": _JOINTS, "arms": _JOINTS, "joint_stiffness": _SETS}
_ENTRIES = ("ignored_collisions", "tool_neighbours")  # lists whose entries are checked one by one
# Keys that the checks of drives and weight need.
_BASIC = {
    "arm_joints",
    "arms",
    "velocity_limit",
    "torque_limit",
    "rotor_inertia",
    "gear_ratio",
    "characteristic_length",
}
# Purpose and typical values of keys that must be given. Arms of 1 m and less are sampled faster and have faster loops.
_TYPICAL = {
    "model": "the file with the joints",
    "arm_joints": "of all arms, from the base outwards",
    "arms": "each with its joints, and the frame that carries the tool",
    "flange_frame": "frame that carries the tool, with its z axis out of the flange",
    "flange_turn_deg": "rotation after which the z axis points out of the flange",
    "default_posture_deg": "far from singular, the tool downwards; see your scenario",
    "characteristic_length": "half the reach [m]",
    "reference_filter": "w [rad/s] of 50 to 100; z [1] of 0.7 to 1",
    "period": "control sampling [s], 0.002 to 0.004; delays of the drive are whole periods",
    "held_joints": "joints without a drive here, fixed at this position [rad, m]",
    "velocity_limit": "data sheet [rad/s]; 2 to 7 for arms of 1 m",
    "torque_limit": "data sheet [Nm]; here twice what weight, acceleration and 20 N at a tool need",
    "ignored_collisions": "pairs whose shapes overlap, or nearly: else LinkDistance is violated from the start",
}
_MOVED = ("default_posture_deg", "characteristic_length", "velocity_limit", "torque_limit")  # from moving the robot


@dataclass
class LoadedRobot:
    """A robot that could be put into a plant.

    Attributes:
        parameters: as read or proposed, including assumed ones.
        explorer: the robot in a plant of its own.
        found: its properties, from moving it.
        posture: the default posture, as read or proposed, (n,) [rad or m].
    """

    parameters: ControlParameters
    explorer: Explorer
    found: Found
    posture: Array


@dataclass
class RobotReport:
    """The report on one robot folder.

    Attributes:
        folder: the folder.
        model: the model file; None when none was found.
        robot: the robot in a plant; None when it cannot be used.
        read: whether the model could be read.
        problems: why the folder cannot be used, one line for each key that is wrong.
        missing: proposed YAML text of each missing key, by the key; empty while there is no model.
        notes: on what was replaced or left out of the model, and on the robot.
        advice: what to check of the proposed values.
    """

    folder: Path
    model: Path | None = None
    robot: LoadedRobot | None = None
    read: bool = False
    problems: list[str] = field(default_factory=list)
    missing: dict[str, str] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)
    advice: list[str] = field(default_factory=list)

    @property
    def complete(self) -> bool:
        """Whether scenarios can use the folder as it is."""
        return not self.problems and not self.missing

    def yaml(self) -> str:
        """The keys that are missing, to be pasted into the control parameters."""
        guess = "a first guess, until all problems are corrected; "
        comments = {key: guess * (key in _MOVED and self.robot is None) + _TYPICAL[key] for key in self.missing}
        return "\n".join(
            f"{value}  # {comments[key]}" if "\n" not in value else f"# {comments[key]}\n{value}"
            for key, value in self.missing.items()
        )


def examine_robot(folder: str | Path) -> RobotReport:
    """Examine a robot folder: a shipped robot's name, a folder, or a model file in one.

    Raises:
        BadInputError: `folder` is none of these.
    """
    path = Path(os.path.expanduser(folder))
    given = path if os.path.isfile(path) and path.suffix.lower() in _SUFFIXES else None
    report = RobotReport(path.parent if given else robot_folder(folder))
    try:
        file = _keys_file(report)
        if not file and (tools := sorted(report.folder.glob(TOOL_PARAMETERS))):
            raise BadInputError(
                f"is the folder of a tool, with {tools[0].name}: name it as `station.tool` of a scenario"
            )
        keys = read_keys(file) if file else Tagged()
        if file and not keys:
            report.notes.append(f"{file.name} is empty and has no effect")
        origin = file.name if file else ""
        report.model = given or _model_file(report, keys, origin)
        if given and "model" not in keys:
            report.missing["model"] = f"model: {given.name}"
        if report.model is not None:
            _examine(report, report.model, keys, origin)
    except BadInputError as error:
        report.problems.append(str(error))
    return report


def _keys_file(report: RobotReport) -> Path | None:
    files = sorted(report.folder.glob(ROBOT_PARAMETERS))
    if len(files) > 1:
        names = ", ".join(file.name for file in files)
        raise BadInputError(f"holds several {ROBOT_PARAMETERS} files: {names}: must be one")
    return files[0] if files else None


def _model_file(report: RobotReport, keys: Tagged, origin: str) -> Path | None:
    named = keys.get("model")
    if isinstance(named, str):
        if os.path.isfile(report.folder / named):
            return report.folder / named
        text = f" = {named!r}: there is no such file in folder {str(report.folder)!r}"
        report.problems.append(str(BadInputError(text).at("model", place(origin, keys.lines, "model"))))
    below = [report.folder, *sorted(each for each in report.folder.iterdir() if each.is_dir())]
    found = [file for place in below for file in sorted(place.iterdir()) if _is_model(file)] if below else []
    if len(found) == 1:
        report.missing["model"] = f"model: {found[0].relative_to(report.folder)}"
        return found[0]
    macros = [str(file.relative_to(report.folder)) for file in report.folder.glob("**/*.xacro")]
    if found:
        names = ", ".join(str(file.relative_to(report.folder)) for file in found)
        how = f"name one as `model:` in a {ROBOT_PARAMETERS} file, or here: `forcectl robot {found[0]}`"
        report.problems.append(f"holds {len(found)} models: {names}: {how}")
    elif macros:
        report.problems.append(f"holds no model but macros: expand them first, `xacro {macros[0]} > robot.urdf`")
    else:
        report.problems.append("holds no model: must hold a .urdf, .sdf or MuJoCo .xml file")
    return None


def _is_model(file: Path) -> bool:
    if file.suffix.lower() != ".xml":
        return file.suffix.lower() in _SUFFIXES and file.is_file()
    try:
        return ElementTree.parse(file).getroot().tag == "mujoco"
    except (OSError, ElementTree.ParseError):
        return False


def _examine(report: RobotReport, model: Path, keys: Tagged, origin: str) -> None:
    """Examine keys and model; each wrong key is reported and left out, until the rest can be used."""
    file = ModelFile.read(model, everything=False)
    report.read = True
    report.notes += [*file.urdf.notes, *file.remarks]
    plant = MultibodyPlant(time_step=0.0)
    (instance,), _ = add_models(plant, file.path, file.urdf)
    tree = ModelTree(plant, instance, file.urdf)
    plant.Finalize()
    rest, wrong, named = plain(keys), set[str](), dict(report.missing)
    places = {key: list(range(len(rest[key]))) for key in _ENTRIES if isinstance(rest.get(key), list)}
    if isinstance(rest.get("model"), str):
        del rest["model"]  # checked before
    for error in _unknown_joints(rest, tree):
        report.problems.append(str(error.at(error.key, place(origin, keys.lines, error.key))))
        wrong.add("arm_joints")
    while True:
        report.missing, refused = dict(named), list[str]()
        try:
            _understand(report, file, rest, wrong, tree, refused)
        except BadInputError as error:
            key = error.field
            first, _, name = key.partition(".")
            entry, _, within = name.partition(".")
            if first in places and entry.isdigit():  # the other entries are still checked
                del rest[first][int(entry)]
                key = ".".join([first, str(places[first].pop(int(entry))), *([within] if within else [])])
            elif first == "default_posture_deg" and entry.isdigit() and "arm_joints" in rest:
                rest[first][int(entry)] = posture_within(tree.plant, rest["arm_joints"])[int(entry)]
            elif not _left_out(rest, key):
                first = ""
            located = error.at(key, place(origin, keys.lines, key)) if first in keys else error
            report.problems.append(str(located))
            if first:
                wrong |= {first, key}
                continue
        break
    report.problems += refused
    touched = {"reference_filter", "ignored_collisions"}  # keys to which entries may be added
    report.missing = {name: text for name, text in report.missing.items() if name in touched or name not in keys}


def _unknown_joints(rest: Tagged, tree: ModelTree) -> Iterator[BadInputError]:
    """Errors for unknown arm joints; similar names replace them, or else all keys about joints are left out."""
    names, known, meant = rest.get("arm_joints"), [joint.name() for joint in tree.moving], dict[str, str]()
    if not isinstance(names, list):
        return
    for i, name in enumerate(map(str, names)):
        if name not in known:
            yield unknown("joint", name, known).at(f"arm_joints.{i}")
            others = [each for each in known if each not in names and each not in meant.values()]
            if near := difflib.get_close_matches(name, others, n=1, cutoff=0.5):
                meant[name] = near[0]
    if any(name not in known and name not in meant for name in map(str, names)):
        _left_out(rest, "arm_joints")
        return
    arms = rest.get("arms")
    for part, key in ((rest, "arm_joints"), *((arm, "joints") for arm in (arms or {}).values())):
        if isinstance(part, Tagged) and isinstance(part.get(key), list):
            part[key] = [meant.get(str(name), name) for name in part[key]]


def _left_out(rest: Tagged, key: str) -> bool:
    """Remove a dotted key, and all keys that cannot be checked without it; returns whether it was there."""
    first, _, name = key.partition(".")
    if first not in rest:
        return False
    part = rest[first]
    if first not in _TOGETHER and isinstance(part, Tagged) and name in part:
        del part[name]
    else:
        for each in (first, *_TOGETHER.get(first, ())):
            rest.pop(each, None)
    return True


def _understand(
    report: RobotReport, file: ModelFile, rest: Tagged, wrong: Collection[str], tree: ModelTree, refused: list[str]
) -> None:
    model = file.path
    values = Tagged({"model": str(model.relative_to(report.folder))} | plain(rest))
    report.advice = add_arms(report.missing, values, tree)
    given = values.setdefault("reference_filter", Tagged())
    lacking = [name for name in _FILTER if isinstance(given, Tagged) and name not in given]
    if lacking:
        values["reference_filter"] = Tagged(_FILTER | given)
        if "reference_filter" not in wrong or {f"reference_filter.{name}" for name in lacking} - set(wrong):
            both = ", ".join(f"{name}: {value}" for name, value in values["reference_filter"].items())
            report.missing["reference_filter"] = f"reference_filter: {{{both}}}"
    if "period" not in values:
        report.missing["period"], values["period"] = "period: 0.002", _FASTEST if "period" in wrong else 0.002
    # Provisional values, until the robot is moved.
    unknown = {text.partition(" ")[0] for text in missing_limits(values, model)}
    names = list(map(str, values["arm_joints"]))
    known = known_limits(names, file, tree.plant)
    if model.suffix.lower() != ".urdf" and not all(name in values for name in DERIVED):
        unknown |= {name for name, limits in known.items() if name not in values and not np.isfinite(limits).all()}
    unknown |= {"default_posture_deg", "characteristic_length"} - set(values)
    some: dict[str, Any] = {"characteristic_length": _LENGTH, **provisional(known)}
    some["default_posture_deg"] = posture_within(tree.plant, names)
    asked = unknown | refused_limits(names, file) - set(values)
    report.missing |= {
        name: f"{name}: {listed(some[name]) if isinstance(some[name], list) else some[name]}"
        for name in _MOVED
        if name in asked
    }
    parameters = Reader().dataclass(ControlParameters, Tagged(values | {name: some[name] for name in unknown}))
    with about_file(ControlParameters, next(report.folder.glob(ROBOT_PARAMETERS), model)):
        check_lists(parameters)
        explorer = Explorer(report.folder, parameters, refused)
        parts = explorer.parts
        for name in parameters.link_compliance:
            frame_named(explorer.plant, name, parts.instance, "link_compliance")
        if not set(some) & unknown - {"default_posture_deg"} and not _BASIC & set(wrong):
            check_drives(parts.parameters, parts.actuators)
            check_weight(explorer.plant, parts.instance, parts.parameters, parts.actuators)
    parameters, found = explorer.parts.parameters, explorer.explore(parameters.characteristic_length)
    posture = found.posture if "default_posture_deg" in unknown else parameters.default_posture
    report.robot = LoadedRobot(parameters, explorer, found, posture)
    if "default_posture_deg" in unknown:
        report.advice += sliding(explorer)
    texts = proposed(explorer, found, posture, known)
    report.missing |= {name: f"{name}: {text}" for name, text in texts.items() if name in asked}
    ignored = [(min(pair), max(pair)) for pair in parameters.ignored_collisions]
    touching = sorted({*found.touching, *explorer.close(posture, TOUCHING)} - set(ignored))
    if touching:
        pairs = ", ".join(f"[{a}, {b}]" for a, b in [*ignored, *touching])
        report.missing["ignored_collisions"] = f"ignored_collisions: [{pairs}]"
    report.notes += remarks(explorer, found, tree, wrong)
