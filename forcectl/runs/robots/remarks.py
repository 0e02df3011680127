"""Notes of `forcectl robot` on a robot that can be used."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator
from itertools import pairwise

from pydrake.multibody.tree import BodyIndex, RevoluteJoint

from forcectl.robot.assumptions import OF_MODEL
from forcectl.runs.robots.proposal import Explorer, Found, ModelTree

_NO_INERTIA = 1e-9  # [kg m2]
_SLOW = 0.1  # [rad/s] below which the fastest joint is implausibly slow: heavy robots turn ten times as fast
_SWINGS = 0.3  # damping ratio of a position loop, below which it overshoots by more than a third


def remarks(explorer: Explorer, found: Found, tree: ModelTree, wrong: Collection[str]) -> Iterator[str]:
    """Notes on tolerated faults of the model, free joints, missing inertia, motion, friction and collision shapes.

    Args:
        explorer: the robot in a plant of its own.
        found: its properties, from moving it.
        tree: its joints.
        wrong: keys of the control parameters that are left out because they are wrong.
    """
    plant, parts, arm_joints = explorer.plant, explorer.parts, explorer.parts.parameters.arm_joints
    yield from parts.accepted_faults
    there = [joint.name() for joint in tree.moving if plant.HasJointNamed(joint.name())]
    loose = [name for name in there if name not in arm_joints]
    if loose and not {"held_joints", "arm_joints", "arms"} & set(wrong):
        yield f"joints {', '.join(loose)} are neither of an arm nor held: they move freely"
    for name, inertia in zip(arm_joints, found.inertia, strict=True):
        if inertia < _NO_INERTIA:
            yield f"what joint {name} moves has no inertia: the only inertia is that of its rotor"
    yield from _of_order(explorer)
    yield from _of_motion(explorer)
    yield from _of_friction(explorer, tree)
    if parts.missing_shapes:
        yield "some collision shapes are missing: links keep no distance and do not touch (link_distance: 0)"
    elif not any(plant.GetCollisionGeometriesForBody(plant.get_body(BodyIndex(i))) for i in range(plant.num_bodies())):
        yield "there are no collision shapes: links keep no distance and do not touch (link_distance: 0)"


def _of_order(explorer: Explorer) -> Iterator[str]:
    """Notes on arms whose joints are not listed from base to flange, which is the order of all lists of numbers."""
    plant, joints = explorer.plant, explorer.parts.joints
    for arm in explorer.parts.arms.values():
        for before, after in pairwise(joints[arm.joints]):
            moved = plant.GetBodiesKinematicallyAffectedBy([after.index()])
            if before.child_body().index() in moved:
                order = "the joints are not listed from base to flange, and lists of numbers are in their order"
                yield f"arm_joints: {before.name()} before {after.name()}, which moves it: {order}"


def _of_motion(explorer: Explorer) -> Iterator[str]:
    """Notes on implausibly slow joints, and on underdamped position loops."""
    turning = [joint for joint in explorer.parts.joints if isinstance(joint, RevoluteJoint)]
    fastest = max((float(joint.velocity_upper_limits()[0]) for joint in turning), default=math.inf)
    if fastest < _SLOW:
        yield f"the fastest joint turns with {math.degrees(fastest):.3g} deg/s: are speed limits in rad/s?"
    damping = explorer.parts.parameters.reference_filter.damping_ratio
    if damping < _SWINGS:
        beyond = 100 * math.exp(-math.pi * damping / math.sqrt(1 - damping**2))
        yield f"reference_filter.damping_ratio = {damping:g}: position loops overshoot by {beyond:.0f} %"


def _of_friction(explorer: Explorer, tree: ModelTree) -> Iterator[str]:
    parameters = explorer.parts.parameters
    rule = parameters.assumed.get("coulomb_friction")
    if rule is None:
        return
    joints = {name: tree.urdf.joints[name] for name in parameters.arm_joints if name in tree.urdf.joints}
    slick = ", ".join(name for name, joint in joints.items() if not joint.friction)
    if rule == OF_MODEL and slick:
        yield f"friction of the model is 0 in {slick}: no stick-slip; without a sensor force estimates are too accurate"
    elif rule != OF_MODEL and any(joint.damping for joint in joints.values()):
        yield f"friction of the model is 0 in all arm joints: counts as unknown, {rule} is assumed"
