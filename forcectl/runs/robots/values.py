"""Values that `forcectl robot` proposes for missing keys, and provisional ones until the robot is moved."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import Joint, RevoluteJoint

from forcectl.arrays import Array
from forcectl.errors import BadInputError, invalid
from forcectl.framework.yaml_tree import Tagged
from forcectl.robot.assumptions import ACCELERATION_TIME, bounded
from forcectl.robot.model_file import ModelFile
from forcectl.runs.robots.proposal import Explorer, Flange, Found, ModelTree

PROVISIONAL = {"velocity_limit": 2.0, "torque_limit": 100.0}  # [rad/s], [Nm]
_NO_ARM = re.compile("leg|hip|knee|ankle|foot|wheel|neck|head", re.IGNORECASE)
_HOW_TO_CHECK = (
    "to check it, compare `its z` in the table Arms, in the world at the default posture, with where a tool or gripper "
    "points in a picture of the robot; flange_turn_deg turns it: [180, 0, 0] to the other side, [90, 0, 0] or "
    "[0, 90, 0] to another axis of the frame"
)
_PUSH = 20.0  # [N], force at the tool that proposed torque limits allow for


def add_arms(missing: dict[str, str], values: Tagged, tree: ModelTree) -> list[str]:
    """Add arms, and joints that are held, where none are given.

    Args:
        missing: proposed YAML text of each missing key; extended.
        values: keys that are given; extended.
        tree: joints of the model.

    Returns:
        What should be checked of these proposals.
    """
    flanges, advice = dict[str, Flange](), list[str]()
    known = {joint.name(): joint for joint in tree.moving}
    if "arm_joints" not in values:
        arms = tree.arms()
        if not arms:
            what = "no joints in a row, of those that move" if known else "no joint moves"
            raise BadInputError(f"{values['model']}: {what}: must hold an arm")
        joints = [joint.name() for chain in arms.values() for joint in chain]
        values["arm_joints"] = joints
        missing["arm_joints"] = f"arm_joints: [{', '.join(joints)}]"
        if len(arms) > 1 and "arms" not in values:
            lines, parts = ["arms:"], Tagged()
            for name, chain in arms.items():
                flange = flanges[name] = tree.flange(chain[-1])
                own = [joint.name() for joint in chain]
                parts[name] = Tagged(
                    {"flange_frame": flange.frame, "joints": own, "flange_turn_deg": flange.turn.tolist()}
                )
                turned = f", flange_turn_deg: {listed(flange.turn)}" if flange.turn.any() else ""
                lines.append(f"  {name}: {{flange_frame: {flange.frame}, joints: [{', '.join(own)}]{turned}}}")
            values["arms"] = parts
            missing["arms"] = "\n".join(lines)
            advice += _left_out(arms)
        loose = [name for name in known if name not in joints]
        if loose and "held_joints" not in values:
            held = {name: _nearest_zero(known[name]) for name in loose}
            values["held_joints"] = Tagged(held)
            missing["held_joints"] = f"held_joints: {{{', '.join(f'{k}: {v:g}' for k, v in held.items())}}}"
    if not isinstance(values["arm_joints"], list) or not values["arm_joints"]:
        raise invalid("arm_joints", values["arm_joints"], "a list of joint names")
    if "arms" not in values and "flange_frame" not in values:
        last = values["arm_joints"][-1] if values["arm_joints"] else ""
        if last in known:
            flange = flanges["arm"] = tree.flange(known[last])
            values["flange_frame"] = flange.frame
            missing["flange_frame"] = f"flange_frame: {flange.frame}"
            if flange.turn.any() and "flange_turn_deg" not in values:
                values["flange_turn_deg"] = flange.turn.tolist()
                missing["flange_turn_deg"] = f"flange_turn_deg: {listed(flange.turn)}"
    if "flange_turn_deg" not in missing and "flange_turn_deg" in values:
        flanges.pop("arm", None)  # its direction is given
    guesses = {name: flange for name, flange in flanges.items() if flange.guess}
    advice += [
        f"{name}: z out of flange {flange.frame}, where the tool points, is a guess: {flange.guess}"
        for name, flange in guesses.items()
    ]
    return advice + [_HOW_TO_CHECK] * bool(guesses)


def _left_out(arms: Mapping[str, Sequence[Joint]]) -> list[str]:
    """How to leave out one of several arms, and those that are none by their names."""
    joints = {name: [joint.name() for joint in chain] for name, chain in arms.items()}
    others = [name for name in joints if any(_NO_ARM.search(joint) for joint in joints[name])]
    held = ", ".join(f"{joint.name()}: {_nearest_zero(joint):g}" for name in others for joint in arms[name])
    how = "delete them from arm_joints and arms, add their joints to held_joints"
    again = "delete default_posture_deg and other lists with one number per joint, and run this command again"
    if not others or len(others) == len(joints):
        return [f"arms that you do not need may be left out: {how}, {again}"]
    looks = f"{', '.join(others)} by the names of joints {'is' if len(others) == 1 else 'are'} a leg, wheel or neck"
    return [f"{looks}, and may be left out: {how} ({held}), {again}"]


def known_limits(names: Sequence[str], file: ModelFile, plant: MultibodyPlant) -> dict[str, Array]:
    """Limits of velocity and torque that the model gives, by key, (n,) each; infinite where it gives none.

    Args:
        names: of the arm joints; unknown ones have no limits.
        file: the model; a limit that it has, but that is refused, counts as none.
        plant: with the model alone.
    """
    actuators = map(plant.get_joint_actuator, plant.GetJointActuatorIndices())
    efforts = {each.joint().name(): each.effort_limit() for each in actuators}
    efforts |= {name: joint.effort for name, joint in file.urdf.joints.items()}
    speeds = {name: float(plant.GetJointByName(name).velocity_upper_limits()[0]) for name in names if _has(plant, name)}
    found = {
        key: np.array([limits.get(name, np.inf) for name in names], dtype=float)
        for key, limits in (("velocity_limit", speeds), ("torque_limit", efforts))
    }
    for key, fault in ((each.key, each) for each in file.conditional_faults if each.key in found):
        found[key][[name == fault.joint for name in names]] = np.inf
    return found


def refused_limits(names: Sequence[str], file: ModelFile) -> set[str]:
    """Keys that replace limits of arm joints which the model has, but which are refused."""
    return {fault.key for fault in file.conditional_faults if fault.key and fault.joint in names}


def provisional(known: Mapping[str, Array]) -> dict[str, list[float]]:
    """The limits that are known, and typical ones for the others, within what a YAML file may have."""
    filled = {key: np.where(np.isfinite(limits), limits, PROVISIONAL[key]) for key, limits in known.items()}
    return {key: bounded(key, limits).tolist() for key, limits in filled.items()}


def proposed(explorer: Explorer, found: Found, posture: Array, known: Mapping[str, Array]) -> dict[str, str]:
    """Proposed values of missing keys, from moving the robot.

    Args:
        explorer: the robot.
        found: its properties.
        posture: proposed, (n,) [rad or m].
        known: see `known_limits`.
    """
    turns = np.array([isinstance(joint, RevoluteJoint) for joint in explorer.parts.joints])
    degrees = np.degrees(posture)
    acceleration = PROVISIONAL["velocity_limit"] / ACCELERATION_TIME
    need = 2 * (found.gravity + found.inertia * acceleration + _PUSH * found.leverage)
    torque = [float(f"{max(each, 1.0):.2g}") for each in need]
    return {
        "default_posture_deg": listed(np.where(turns, degrees.round(1), degrees)),
        "characteristic_length": f"{0.5 * found.reach:.2g}",
        "velocity_limit": listed(provisional(known)["velocity_limit"]),
        "torque_limit": listed(
            bounded("torque_limit", np.where(np.isfinite(own := known["torque_limit"]), own, torque))
        ),
    }


def sliding(explorer: Explorer) -> list[str]:
    """How `default_posture_deg` is meant for joints that slide; nothing for a robot without any."""
    joints = [joint.name() for joint in explorer.parts.joints if not isinstance(joint, RevoluteJoint)]
    meant = "in default_posture_deg stands its position in m times 57.296, as if they were radians"
    return [f"{', '.join(joints)}: slides; {meant}"] if joints else []


def _has(plant: MultibodyPlant, name: str) -> bool:
    return plant.HasJointNamed(name) and plant.GetJointByName(name).num_velocities() == 1


def posture_within(plant: MultibodyPlant, names: Sequence[str]) -> list[float]:
    """A posture within the limits [deg], as close to zero as they allow."""
    found = []
    for name in names:
        if not plant.HasJointNamed(name):
            found.append(0.0)  # refused by name later
            continue
        found.append(float(np.degrees(_nearest_zero(plant.GetJointByName(name)))))
    return found


def _nearest_zero(joint: Any) -> float:
    return float(np.clip(0.0, joint.position_lower_limits()[0], joint.position_upper_limits()[0]))


def listed(numbers: Any) -> str:
    """Numbers as a list in YAML."""
    return f"[{', '.join(f'{each:.6g}' for each in numbers)}]"
