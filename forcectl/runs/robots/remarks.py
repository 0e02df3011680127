"""What else should be known of a robot that can be used: notes of `forcectl robot`."""

from __future__ import annotations

from collections.abc import Collection, Iterator

from pydrake.multibody.tree import BodyIndex

from forcectl.runs.robots.proposal import Explorer, Found, ModelTree

_NO_INERTIA = 1e-9  # [kg m2]


def remarks(explorer: Explorer, found: Found, tree: ModelTree, wrong: Collection[str]) -> Iterator[str]:
    """Notes on what was let be, what moves freely, and what resists or touches nothing.

    Args:
        explorer: the robot in a plant of its own.
        found: what moving it showed.
        tree: its joints.
        wrong: keys of the control parameters that are left out, for they are wrong.
    """
    plant, parts, arm_joints = explorer.plant, explorer.parts, explorer.parts.parameters.arm_joints
    yield from parts.let_be
    there = [joint.name() for joint in tree.moving if plant.HasJointNamed(joint.name())]
    loose = [name for name in there if name not in arm_joints]
    if loose and not {"held_joints", "arm_joints", "arms"} & set(wrong):
        yield f"joints {', '.join(loose)} are neither of an arm nor held: they move freely"
    for name, inertia in zip(arm_joints, found.inertia, strict=True):
        if inertia < _NO_INERTIA:
            yield f"what joint {name} moves has no inertia: only its rotor resists"
    if parts.missing_shapes:
        yield "some collision shapes are missing: links keep no distance and do not touch (link_distance: 0)"
    elif not any(plant.GetCollisionGeometriesForBody(plant.get_body(BodyIndex(i))) for i in range(plant.num_bodies())):
        yield "there are no collision shapes: links keep no distance and do not touch (link_distance: 0)"
