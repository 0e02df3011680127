"""Wrenches on the tool centre points of a robot: as a load on its plant, and what they and contacts do to its joints.

    tau_ext = sum J_i' mu_i + tau_contact

Wrenches are [torque; force] on the robot, in the world, at the TCP of each arm [Nm, N].
"""

from __future__ import annotations

from typing import Any
from weakref import ref

import numpy as np
from numpy.typing import NDArray
from pydrake.common.value import AbstractValue
from pydrake.multibody.math import SpatialForce
from pydrake.multibody.plant import ContactResults, ExternallyAppliedSpatialForce, MultibodyPlant
from pydrake.systems.framework import BasicVector, Context, LeafSystem

from forcectl.framework.cache import BlockCache
from forcectl.robot.model import RobotModel, RobotParts, posture_cache

Array = NDArray[np.float64]


def bodies_beyond(plant: MultibodyPlant, parts: RobotParts) -> list[tuple[set[int], set[int]]]:
    """For each arm the indices of all its bodies that move, and of those that move rigidly with its TCP.

    Args:
        plant: finalized, with the robot.
    """
    found = []
    for arm in parts.arms.values():
        joints = [parts.joints[i].index() for i in range(arm.joints.start, arm.joints.stop)]
        moving = {int(body) for body in plant.GetBodiesKinematicallyAffectedBy(joints)}
        rigid = {int(body.index()) for body in plant.GetBodiesWeldedTo(arm.tcp_frame.body())}
        found.append((moving, rigid))
    return found


class TipLoad(LeafSystem):
    """Wrenches at the tool centre points as a load on the plant.

    ```
    name: TipLoad
    input_ports: [external_wrench]
    output_ports: [spatial_forces]
    ```

    external_wrench: shape (6a,) of a arms, on the robot at each TCP in the world, [torque; force] [Nm, N]; may be left
        unconnected. A wrench that is not finite is none.
    spatial_forces: abstract, for the plant's `applied_spatial_force` input. Feedthrough.

    Sampling: none; evaluated when read.

    Args:
        parts: of the robot in the plant.
    """

    port_units = {"external_wrench": "Nm,N"}
    optional_inputs = ("external_wrench",)

    def __init__(self, parts: RobotParts):
        super().__init__()
        frames = [arm.tcp_frame for arm in parts.arms.values()]
        self._at = [(frame.body().index(), frame.GetFixedPoseInBodyFrame().translation()) for frame in frames]
        self._wrench = self.DeclareVectorInputPort("external_wrench", 6 * len(frames))
        block: Any = ref(self)  # Drake keeps a block whose method it is given here
        self.DeclareAbstractOutputPort(
            "spatial_forces",
            lambda: AbstractValue.Make([ExternallyAppliedSpatialForce()]),
            lambda context, output: block()._apply(context, output),
            prerequisites_of_calc={self._wrench.ticket()},
        )

    def _apply(self, context: Context, output: AbstractValue) -> None:
        forces = []
        if self._wrench.HasValue(context):
            wrenches = self._wrench.Eval(context).reshape(-1, 6)
            for (body, point), wrench in zip(self._at, wrenches, strict=True):
                if np.isfinite(wrench).all():
                    one = ExternallyAppliedSpatialForce()
                    one.body_index, one.p_BoBq_B = body, point
                    one.F_Bq_W = SpatialForce(wrench[:3], wrench[3:])
                    forces.append(one)
        output.set_value(forces)


class LoadTruth(LeafSystem):
    """What loads and contacts really do to a robot.

    ```
    name: LoadTruth
    input_ports: [link_position, external_wrench, contact_results, contact_torque]
    output_ports: [external_torque, tip_wrench, contact_force]
    ```

    link_position: shape (n,) [rad]. external_wrench: shape (6a,), as that of `TipLoad` [Nm, N].
    contact_results: abstract, of the plant. contact_torque: shape (n_v,), its generalized contact forces on the model
        instance of the robot [Nm]. Both may be left unconnected: no contacts.
    external_torque: shape (n,), joint torques of all loads and contacts [Nm]. Feedthrough of all inputs but
        contact_results.
    tip_wrench: shape (6a,), of loads at the TCPs and of contacts of the bodies fixed to them, at each TCP in the world,
        [torque; force] [Nm, N]. Feedthrough of all inputs but contact_torque.
    contact_force: shape (a,), sum of the magnitudes of the contact forces on each arm,
        those between two arms included [N]. Feedthrough of all inputs but contact_torque.

    Sampling: none; evaluated when read.

    Args:
        robot: kinematics. plant: finalized, with the robot `parts`.
    """

    port_units = {
        "external_wrench": "Nm,N",
        "contact_torque": "Nm",
        "external_torque": "Nm",
        "tip_wrench": "Nm,N",
        "contact_force": "N",
    }
    optional_inputs = ("external_wrench", "contact_results", "contact_torque")

    def __init__(self, robot: RobotModel, plant: MultibodyPlant, parts: RobotParts):
        super().__init__()
        n, count = robot.num_joints, len(parts.arms)
        self._robot, self._bodies = robot, bodies_beyond(plant, parts)
        self._arms = list(robot.parts.arms.values())
        order = plant.GetVelocitiesFromArray(parts.instance, np.arange(plant.num_velocities(), dtype=float)).tolist()
        self._rows = [order.index(joint.velocity_start()) for joint in parts.joints]
        position = self.DeclareVectorInputPort("link_position", n)
        self._wrench = self.DeclareVectorInputPort("external_wrench", 6 * count)
        self._results = self.DeclareAbstractInputPort("contact_results", AbstractValue.Make(ContactResults()))
        self._contact_torque = self.DeclareVectorInputPort("contact_torque", len(order))
        self._posture = posture_cache(self, robot, position)
        posture: Any = self._posture.ticket()
        self._contacts = BlockCache(
            self,
            "wrench at each TCP, then force",
            lambda: AbstractValue.Make(BasicVector(7 * count)),
            lambda block, context, value: value.get_mutable_value().SetFromVector(block._touch(context)),
            {posture, self._wrench.ticket(), self._results.ticket()},
        )
        self.DeclareVectorOutputPort(
            "external_torque",
            n,
            self._show_torque,
            prerequisites_of_calc={posture, self._wrench.ticket(), self._contact_torque.ticket()},
        )
        known = {self._contacts.ticket()}
        self.DeclareVectorOutputPort("tip_wrench", 6 * count, self._show_wrench, prerequisites_of_calc=known)
        self.DeclareVectorOutputPort("contact_force", count, self._show_force, prerequisites_of_calc=known)

    def _applied(self, context: Context) -> Array:
        if not self._wrench.HasValue(context):
            return np.zeros((len(self._arms), 6))
        wrenches: Array = self._wrench.Eval(context).reshape(-1, 6)
        wrenches[~np.isfinite(wrenches).all(axis=1)] = 0.0
        return wrenches

    def _touch(self, context: Context) -> Array:
        wrenches, forces = self._applied(context), np.zeros(len(self._arms))
        if self._results.HasValue(context):
            results = self._results.Eval(context)
            count = results.num_point_pair_contacts()
            posture = self._posture.Eval(context) if count else None
            tips = [arm.tcp_frame.CalcPoseInWorld(posture).translation() for arm in self._arms] if count else []
            for i in range(count):
                contact = results.point_pair_contact_info(i)
                on_b, where = contact.contact_force(), contact.contact_point()
                for body, force in ((contact.bodyB_index(), on_b), (contact.bodyA_index(), -on_b)):
                    for k, (moving, rigid) in enumerate(self._bodies):
                        if int(body) in moving:
                            forces[k] += float(np.linalg.norm(force))
                        if int(body) in rigid:
                            wrenches[k] += np.concatenate([np.cross(where - tips[k], force), force])
        return np.concatenate([wrenches.ravel(), forces])

    def _show_torque(self, context: Context, output: BasicVector) -> None:
        torque = np.zeros(self._robot.num_joints)
        for arm, wrench in zip(self._arms, self._applied(context), strict=True):
            if wrench.any():
                torque += self._robot.jacobian_of(self._posture.Eval(context), arm.tcp_frame).T @ wrench
        if self._contact_torque.HasValue(context):
            torque += self._contact_torque.Eval(context)[self._rows]
        output.SetFromVector(torque)

    def _show_wrench(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(self._contacts.Eval(context).value()[: 6 * len(self._arms)])

    def _show_force(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(self._contacts.Eval(context).value()[6 * len(self._arms) :])
