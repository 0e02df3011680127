"""Wrenches on a robot at its tool centre points and other frames: as a load on its plant, and as joint torques.

    tau_ext = sum J_i' mu_i + tau_contact

Wrenches are [torque; force] on the robot, in the world, at the TCP of each arm [Nm, N].
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.multibody.plant import ContactResults, ExternallyAppliedSpatialForce, MultibodyPlant
from pydrake.multibody.tree import Frame
from pydrake.systems.framework import BasicVector, Context, LeafSystem

from forcectl.arrays import Array
from forcectl.framework.block import PythonBlock, values_of_tick
from forcectl.plant.contact.contact_truth import BodyContact, ContactPairs, ContactReader, applied_force, wrench_between
from forcectl.robot.model import RobotModel, posture_cache
from forcectl.robot.parts import RobotParts


def _bodies_beyond(plant: MultibodyPlant, parts: RobotParts) -> list[tuple[set[int], set[int]]]:
    """For each arm the indices of all bodies that its joints move, and of those fixed to its TCP."""
    found = []
    for arm in parts.arms.values():
        joints = [parts.joints[i].index() for i in range(arm.joints.start, arm.joints.stop)]
        moving = {int(body) for body in plant.GetBodiesKinematicallyAffectedBy(joints)}
        rigid = {int(body.index()) for body in plant.GetBodiesWeldedTo(arm.tcp_frame.body())}
        found.append((moving, rigid))
    return found


class HeldPart(NamedTuple):
    """A part that an arm holds or can take.

    Attributes:
        arm: number of the arm.
        bodies: indices of the part's bodies, whose joints in the plant are relative to the arm's TCP.
    """

    arm: int
    bodies: frozenset[int]


class _Wrenches:
    """Input ports for wrenches on a robot: loads and contacts at the TCPs of a arms, loads at b further frames."""

    def __init__(self, block: LeafSystem, arms: int, bodies: int):
        self.arms, self.bodies = arms, bodies
        self.tips = [block.DeclareVectorInputPort(name, 6 * arms) for name in ("external_wrench", "contact_wrench")]
        self.body = block.DeclareVectorInputPort("body_wrench", 6 * bodies) if bodies else None
        self.tickets = {port.ticket() for port in (*self.tips, self.body) if port is not None}

    def read(self, context: Context) -> tuple[Array, Array]:
        """Sums at the TCPs, shape (a, 6), and at the further frames, (b, 6); a wrench not finite counts as zero."""
        at_tips, on_bodies = np.zeros((self.arms, 6)), np.zeros((self.bodies, 6))
        for port in self.tips:
            if port.HasValue(context):
                at_tips += _finite_rows(port.Eval(context))
        if self.body is not None and self.body.HasValue(context):
            on_bodies += _finite_rows(self.body.Eval(context))
        return at_tips, on_bodies


def _finite_rows(values: Array) -> Array:
    wrenches: Array = values.reshape(-1, 6)
    wrenches[~np.isfinite(wrenches).all(axis=1)] = 0.0
    return wrenches


class TipLoad(PythonBlock):
    """Wrenches on a robot as externally applied forces on the plant.

    ```
    name: TipLoad
    input_ports: [external_wrench, contact_wrench, body_wrench (optional)]
    output_ports: [spatial_forces]
    ```

    external_wrench: shape (6a,) of a arms, on the robot at each TCP in the world, [torque; force] [Nm, N].
    contact_wrench: shape (6a,), of contacts, in the same form, added to external_wrench [Nm, N].
    body_wrench: shape (6b,), at the origins of the further frames in the world [Nm, N].
    spatial_forces: abstract, for the plant's `applied_spatial_force` input. Feedthrough.

    Each input may be left unconnected. A wrench that is not finite counts as zero.

    Sampling: none; evaluated when read.

    Args:
        parts: of the robot in the plant.
        frames: further frames of the plant, for body_wrench.
    """

    port_units = {"external_wrench": "Nm,N", "contact_wrench": "Nm,N", "body_wrench": "Nm,N"}
    optional_inputs = ("external_wrench", "contact_wrench", "body_wrench")

    def __init__(self, parts: RobotParts, frames: Sequence[Frame] = ()):
        super().__init__()
        tips = [arm.tcp_frame for arm in parts.arms.values()]
        places = [*tips, *frames]
        self._at = [(frame.body().index(), frame.GetFixedPoseInBodyFrame().translation()) for frame in places]
        self._wrenches = _Wrenches(self, len(tips), len(frames))
        self.DeclareAbstractOutputPort(
            "spatial_forces",
            lambda: AbstractValue.Make([ExternallyAppliedSpatialForce()]),
            self._apply,
            prerequisites_of_calc=self._wrenches.tickets,
        )

    def _apply(self, context: Context, output: AbstractValue) -> None:
        at_tips, on_bodies = self._wrenches.read(context)
        wrenches = zip(self._at, [*at_tips, *on_bodies], strict=True)
        output.set_value([applied_force(body, point, wrench) for (body, point), wrench in wrenches if wrench.any()])


class LoadTruth(PythonBlock):
    """True joint torques, TCP wrenches and contact forces of a robot under its loads and contacts.

    ```
    name: LoadTruth
    input_ports: [link_position, external_wrench, contact_wrench, body_wrench (optional), contact_results,
    contact_torque, part_released (optional), contact_pair_1 (optional), (further ones of the same kind)]
    output_ports: [external_torque, tip_wrench, arm_contact_force]
    ```

    link_position: shape (n,) [rad]. external_wrench, contact_wrench, body_wrench: those of `TipLoad`.
    contact_results: abstract, of the plant. contact_torque: shape (n_v,), its generalized contact forces on the model
    instance of the robot [Nm]. Both may be left unconnected: no contacts.
    part_released: shape (h,), of h held parts, 0 while held: contacts of a part count as those of the tool that holds
    it, but not while it is released [1]. Must be connected if there are held parts.
    contact_pair_1: abstract, of a `PegContact` or `CapContact`; contact_pair_2 of a second one, and so on.
    external_torque: shape (n,), joint torques of all loads and contacts [Nm]. Feedthrough of all inputs but
    contact_results. Feedthrough of contact_results when parts are held.
    tip_wrench: shape (6a,), of loads at the TCPs and of contacts of the bodies fixed to them, at each TCP in the world,
    [torque; force] [Nm, N]. Feedthrough of all inputs but contact_torque.
    arm_contact_force: shape (a,), sum of the magnitudes of the contact forces on each arm, those between two arms
    included [N]. Feedthrough of all inputs but contact_torque.

    Sampling: none; evaluated when read.

    Args:
        robot: kinematics.
        plant: finalized, with the robot.
        parts: of the robot in the plant.
        frames: the further frames of `TipLoad`, in the robot's own plant.
        held: parts that arms hold.
        pairs: number of contacts that the plant does not compute itself, each with an input.
    """

    port_units = {
        "external_wrench": "Nm,N",
        "contact_wrench": "Nm,N",
        "body_wrench": "Nm,N",
        "contact_torque": "Nm",
    }
    optional_inputs = ("external_wrench", "contact_wrench", "body_wrench", "contact_results", "contact_torque")

    def __init__(
        self,
        robot: RobotModel,
        plant: MultibodyPlant,
        parts: RobotParts,
        frames: Sequence[Frame] = (),
        held: Sequence[HeldPart] = (),
        pairs: int = 0,
    ):
        super().__init__()
        n, count = robot.num_joints, len(parts.arms)
        self._robot, self._reader, self._held = robot, ContactReader(plant), tuple(held)
        grasped = {body for part in held for body in part.bodies}
        self._bodies = [(moving - grasped, rigid) for moving, rigid in _bodies_beyond(plant, parts)]
        self._arms, self._frames = list(robot.parts.arms.values()), list(frames)
        order = plant.GetVelocitiesFromArray(parts.instance, np.arange(plant.num_velocities(), dtype=float)).tolist()
        self._rows = [order.index(joint.velocity_start()) for joint in parts.joints]
        position = self.DeclareVectorInputPort("link_position", n)
        self._wrenches = _Wrenches(self, count, len(frames))
        self._results = self.DeclareAbstractInputPort("contact_results", AbstractValue.Make(ContactResults()))
        self._contact_torque = self.DeclareVectorInputPort("contact_torque", len(order))
        self._released = self.DeclareVectorInputPort("part_released", len(held)) if held else None
        parts_tickets = {self._released.ticket()} if self._released is not None else set()
        self._pairs = ContactPairs(self, pairs)
        parts_tickets |= self._pairs.tickets
        self._posture = posture_cache(self, robot, position)
        posture: Any = self._posture.ticket()
        reads = {posture, self._results.ticket()} | self._wrenches.tickets | parts_tickets
        self._contacts = values_of_tick(self, reads)
        self.DeclareVectorOutputPort(
            "external_torque",
            n,
            self._show_torque,
            prerequisites_of_calc={posture, self._contact_torque.ticket()}
            | self._wrenches.tickets
            | ({self._results.ticket()} | parts_tickets if held else set()),
        )
        known = {self._contacts.ticket()}
        self.DeclareVectorOutputPort("tip_wrench", 6 * count, self._show_wrench, prerequisites_of_calc=known)
        self.DeclareVectorOutputPort("arm_contact_force", count, self._show_force, prerequisites_of_calc=known)

    def _compute(self, context: Context) -> tuple[Array, Array]:
        """Wrenches at the TCPs, shape (6a,), and the forces on the arms, shape (a,)."""
        wrenches, _ = self._wrenches.read(context)
        forces = np.zeros(len(self._arms))
        contacts = self._read(context) + self._pairs.read(context)
        if contacts:
            posture = self._posture.Eval(context)
            released = self._are_released(context)
            for k, (arm, (moving, rigid)) in enumerate(zip(self._arms, self._bodies, strict=True)):
                tip = arm.tcp_frame.CalcPoseInWorld(posture).translation()
                for part, free in zip(self._held, released, strict=True):
                    if part.arm == k and not free:
                        moving, rigid = moving | part.bodies, rigid | part.bodies
                wrenches[k] += wrench_between(contacts, rigid, None, tip)
                forces[k] = sum(
                    float(np.linalg.norm(contact.wrench[3:]))
                    for contact in contacts
                    for body in (contact.body_a, contact.body_b)
                    if body in moving
                )
        return wrenches.ravel(), forces

    def _read(self, context: Context) -> list[BodyContact]:
        return list(self._reader.read(self._results.Eval(context))) if self._results.HasValue(context) else []

    def _are_released(self, context: Context) -> list[bool]:
        return [] if self._released is None else (self._released.Eval(context) > 0.5).tolist()

    def _show_torque(self, context: Context, output: BasicVector) -> None:
        torque = np.zeros(self._robot.num_joints)
        places = [*(arm.tcp_frame for arm in self._arms), *self._frames]
        at_tips, on_bodies = self._wrenches.read(context)
        for frame, wrench in zip(places, [*at_tips, *on_bodies], strict=True):
            if wrench.any():
                torque += self._robot.jacobian_of(self._posture.Eval(context), frame).T @ wrench
        if self._contact_torque.HasValue(context):
            torque += self._contact_torque.Eval(context)[self._rows]
        # The plant's contact torques include contacts of held parts, and also of released parts, whose coordinates are
        # still relative to the arm: these are subtracted. Contacts of `pairs` are not included: those are added.
        for part, free in zip(self._held, self._are_released(context), strict=True):
            contacts, sign = (self._read(context), -1.0) if free else (self._pairs.read(context), 1.0)
            if contacts:
                frame, posture = self._arms[part.arm].tcp_frame, self._posture.Eval(context)
                tip = frame.CalcPoseInWorld(posture).translation()
                on_part = wrench_between(contacts, part.bodies, None, tip)
                torque += sign * (self._robot.jacobian_of(posture, frame).T @ on_part)
        output.SetFromVector(torque)

    def _show_wrench(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(self._contacts.Eval(context)[0])

    def _show_force(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(self._contacts.Eval(context)[1])
