"""Quantities of a robot and its tool for control: kinematics, torques, inertias, stiffness.

A robot is a folder; no code is for one robot only. `add_robot` puts the same models into a simulated plant.

The plant holds the links without rotors: with elastic joints the rotors are on the motor side of the springs. The
matrix of their inertia is B = T' diag(J_m) T, with the map T from joint to motor speeds by gears and motor couplings.
"""

from __future__ import annotations

import copy
import threading
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike
from pydrake.common.value import AbstractValue, Value
from pydrake.math import RigidTransform
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import (
    BodyIndex,
    Frame,
    JacobianWrtVariable,
    Joint,
    MultibodyForces,
    RigidBody,
    SpatialInertia,
    UnitInertia,
)
from pydrake.systems.framework import Context, InputPort, LeafSystem

from forcectl.arrays import Array
from forcectl.errors import invalid, unknown
from forcectl.framework.block import BlockCache
from forcectl.models import ROBOT_PARAMETERS, parameter_file, robot_and_arm
from forcectl.robot.checks import about_file, check_arms
from forcectl.robot.parameters import ControlParameters
from forcectl.robot.parts import RobotParts, Tool, add_robot, frame_named

_ORIGIN = np.zeros(3)


@dataclass(frozen=True)
class JointLimits:
    """Limits of the arm joints, each of shape (n,); infinite where the model gives none."""

    position_lower: Array  # [rad]
    position_upper: Array  # [rad]
    velocity: Array  # [rad/s]
    acceleration: Array  # [rad/s2]
    torque: Array  # joint side [Nm]


def unit_normal(n: ArrayLike, name: str = "normal") -> Array:
    """n as a unit vector of shape (3,); BadInputError, with its name, when it is not a direction."""
    try:
        vector = np.asarray(n, dtype=float)
    except (TypeError, ValueError):
        raise invalid(name, n, "three numbers") from None
    length = np.linalg.norm(vector) if vector.shape == (3,) else np.nan
    if not np.isfinite(length) or length < 1e-9:
        raise invalid(name, np.asarray(n).tolist(), "three finite numbers, not all zero")
    return vector / length


class _Forces(threading.local):
    """Scratch memory for forces of a plant, overwritten at every use; each thread has its own."""

    def __init__(self, plant: MultibodyPlant):
        self.forces = MultibodyForces(plant)


class PlantJoints:
    """n joints of a plant, each with one position and one velocity; other joints stay as they are in a context.

    Holds no state: every function takes a context of `plant`. Vectors over joints have shape (n,), in the order of
    `joints`.

    Args:
        plant: finalized.
        joints: of the plant.
    """

    def __init__(self, plant: MultibodyPlant, joints: Sequence[Joint]):
        self.plant, self.num_joints = plant, len(joints)
        self._world, self._scratch = plant.world_frame(), _Forces(plant)
        self._q = np.array([joint.position_start() for joint in joints])
        self._v = np.array([joint.velocity_start() for joint in joints])
        # Usually the joints are all of the plant's, in its order; then none need to be selected.
        in_order = np.arange(plant.num_positions())
        self._all = np.array_equal(self._q, in_order) and np.array_equal(self._v, in_order)

    def set_positions(self, context: Context, q: Array) -> None:
        """Set the joint positions q, shape (n,) [rad]."""
        if self._all:
            self.plant.SetPositions(context, q)
            return
        everything = self.plant.GetPositions(context)
        everything[self._q] = q
        self.plant.SetPositions(context, everything)

    def set_velocities(self, context: Context, v: Array) -> None:
        """Set the joint speeds v, shape (n,) [rad/s]."""
        if self._all:
            self.plant.SetVelocities(context, v)
            return
        everything = self.plant.GetVelocities(context)
        everything[self._v] = v
        self.plant.SetVelocities(context, everything)

    def jacobian_of(self, context: Context, frame: Frame, expressed_in: Frame | None = None) -> Array:
        """Spatial velocity of the origin of `frame` in the world per joint speed, shape (6, n) [1; m].

        Args:
            context: with the posture.
            frame: of the plant.
            expressed_in: frame the components are in; the world when None.
        """
        world = self._world
        J = self.plant.CalcJacobianSpatialVelocity(
            context, JacobianWrtVariable.kV, frame, _ORIGIN, world, expressed_in or world
        )
        return J if self._all else J[:, self._v]

    def mass_matrix(self, context: Context) -> Array:
        """Mass matrix of the plant, that is without rotors, shape (n, n) [kg m2]."""
        M: Array = self.plant.CalcMassMatrix(context)
        return M if self._all else M[np.ix_(self._v, self._v)]

    def link_torque(self, context: Context, vdot: Array) -> Array:
        """M(q) vdot + c(q, v) + g(q), without rotors, at q and v of `context`, shape (n,) [Nm]."""
        forces = self._scratch.forces
        self.plant.CalcForceElementsContribution(context, forces)
        if self._all:
            return self.plant.CalcInverseDynamics(context, vdot, forces)
        everything = np.zeros(self.plant.num_velocities())
        everything[self._v] = vdot
        return self.plant.CalcInverseDynamics(context, everything, forces)[self._v]


class RobotModel(PlantJoints):
    """Control-side quantities of a robot with its tool: kinematics, torques, inertias, stiffness.

    For a robot with several arms, the vectors cover the joints of all arms, and "TCP" is the TCP of the first arm;
    `parts.arms` has the frames and joints of each, and the functions that end in `_of` take any frame.

    A block keeps a context in a cache entry, see `create_context`. Joints are in the order of the control parameters;
    others of the model (a gripper's, say) stay at their defaults. Spatial vectors are [rotation; translation], in W.

    Attributes:
        parameters: those of its YAML file; those of a tool are in `arm.tool`.
        plant: robot and tool, fixed to the world, continuous, without geometry, finalized.
        parts: joints, actuators and frames in `plant`.
        arm: the first one, or that of `for_arm`.
        tcp_frame: its tool centre point T.
        limits: joint limits.
        joint_stiffness: of the set in use [Nm/rad].
        link_compliance: that is added to this set, by frame, see the parameters.
        motor_from_joint: T, motor speeds per joint speeds, shape (n, n) [1].
        motor_inertia: T' diag(J_m) T, shape (n, n), joint side [kg m2].
        source: the arguments `robot` and `tool` of `load`.
    """

    source: tuple[str | Path, Tool | Mapping[str, Tool]] = ("", None)
    _inertias: tuple[tuple[RigidBody, SpatialInertia], ...] = ()

    def __init__(self, plant: MultibodyPlant, parts: RobotParts, stiffness_set: str | None = None):
        """Use `load`."""
        super().__init__(plant, parts.joints)
        self.parameters = parameters = parts.parameters
        self.parts, self.arm = parts, parts.first_arm
        self.tcp_frame = self.arm.tcp_frame
        self.limits = _limits(parts)
        self.joint_stiffness = parameters.stiffness(stiffness_set)
        self.motor_from_joint = parameters.gear_ratio[:, None] * parameters.coupling()
        self.motor_inertia = self.motor_from_joint.T @ np.diag(parameters.rotor_inertia) @ self.motor_from_joint
        self.link_compliance = parameters.bending(stiffness_set)
        # The frames must also exist if the chosen set does not use them.
        frames = {
            name: frame_named(plant, name, parts.instance, "link_compliance") for name in parameters.link_compliance
        }
        self._link_frames = {name: frames[name] for name in self.link_compliance}

    @classmethod
    def load(
        cls,
        robot: str | Path = "comau_smart_six",
        tool: Tool | Mapping[str, Tool] = "force_probe",
        stiffness_set: str | None = None,
    ) -> RobotModel:
        """A robot with its tool, by shipped name or folder path.

        Args:
            robot: shipped robot or robot folder; "yumi/left" is one arm of a robot that has several.
            tool: shipped tool, tool folder, or None for the bare flange, of every arm; or of each by its name.
            stiffness_set: which joint stiffness to use; the parameters' default when None.

        Raises:
            BadInputError: unknown name, bad parameters, or a model that does not fit them.
        """
        plant = MultibodyPlant(time_step=0.0)
        parts = add_robot(plant, robot, tool)
        plant.Finalize()
        with about_file(ControlParameters, parameter_file(robot_and_arm(robot)[0], ROBOT_PARAMETERS)):
            loaded = cls(plant, parts, stiffness_set)
            loaded.source = (robot, tool)
            check_arms(loaded)
        return loaded

    def for_arm(self, name: str) -> RobotModel:
        """The same robot, with the TCP of the named arm in the place of the first one's.

        Args:
            name: of an arm, see `parts.arms`.

        Raises:
            BadInputError: the robot has no arm of that name.
        """
        if name not in self.parts.arms:
            raise unknown("arm", name, self.parts.arms)
        other = copy.copy(self)
        other.arm = self.parts.arms[name]
        other.tcp_frame = other.arm.tcp_frame
        return other

    def with_other_masses(self, scale: float, payload: Mapping[str, tuple[float, Array]]) -> RobotModel:
        """The same robot with a model error, or with parts in its hands: its contexts have other masses.

        Args:
            scale: factor on mass and inertia of every body of robot and tools [1].
            payload: by arm, a point mass [kg] and its position in the TCP frame, shape (3,) [m].

        Raises:
            BadInputError: the robot has no arm of that name.
        """
        other = copy.copy(self)
        changed = {}
        for i in range(1, self.plant.num_bodies()):
            body = self.plant.get_body(BodyIndex(i))
            inertia = body.default_spatial_inertia()
            if inertia.get_mass() > 0:
                changed[body] = SpatialInertia(
                    scale * inertia.get_mass(), inertia.get_com(), inertia.get_unit_inertia()
                )
        for arm, (mass, position) in payload.items():
            if arm not in self.parts.arms:
                raise unknown("payload", arm, self.parts.arms)
            tcp = self.parts.arms[arm].tcp_frame
            place = tcp.GetFixedPoseInBodyFrame() @ position
            held = changed.get(tcp.body(), tcp.body().default_spatial_inertia())
            if mass > 0:
                loaded = SpatialInertia(held.get_mass(), held.get_com(), held.get_unit_inertia())
                loaded += SpatialInertia(mass, place, UnitInertia.PointMass(place))
                changed[tcp.body()] = loaded
        other._inertias = tuple(changed.items())
        return other

    def create_context(self) -> Context:
        """A context of `plant` in the default posture at rest."""
        context = self.plant.CreateDefaultContext()
        for body, inertia in self._inertias:
            body.SetSpatialInertiaInBodyFrame(context, inertia)
        return context

    def context_at(self, q: Array) -> Context:
        """A context of `plant` at rest in posture q, shape (n,) [rad]."""
        context = self.create_context()
        self.set_positions(context, q)
        return context

    def pose(self, context: Context) -> RigidTransform:
        """Pose X_WT of the TCP frame in the world [m]."""
        return self.tcp_frame.CalcPoseInWorld(context)

    def tip_position(self, context: Context) -> Array:
        """Position p_WT of the TCP in the world, shape (3,) [m]; a third of the cost of `pose`."""
        position: Array = self.plant.CalcPointsPositions(context, self.tcp_frame, _ORIGIN, self._world)
        return position.ravel()

    def jacobian(self, context: Context) -> Array:
        """J_WT: spatial velocity of the TCP in the world per joint speed, shape (6, n) [1; m]."""
        return self.jacobian_of(context, self.tcp_frame)

    def bias_acceleration_of(self, context: Context, frame: Frame) -> Array:
        """J'v: spatial acceleration of the origin of `frame` in the world while no joint speed changes, shape (6,)."""
        world = self._world
        A = self.plant.CalcBiasSpatialAcceleration(context, JacobianWrtVariable.kV, frame, _ORIGIN, world, world)
        return A.get_coeffs()

    def link_poses(self, context: Context) -> dict[str, RigidTransform]:
        """Poses in the world of the frames named in `link_compliance`."""
        return {name: frame.CalcPoseInWorld(context) for name, frame in self._link_frames.items()}

    def gravity_torque(self, context: Context) -> Array:
        """Torque that holds robot and tool at rest, shape (n,) [Nm]; opposite to Drake's generalized gravity force."""
        return -self.plant.CalcGravityGeneralizedForces(context)[self._v]

    def load_torque(self, context: Context) -> Array:
        """c(q, v) + g(q): joint torque of a motion without acceleration, at q and v of `context`, shape (n,) [Nm]."""
        return self.link_torque(context, np.zeros(self.num_joints))

    def torque(self, context: Context, vdot: Array) -> Array:
        """(M(q) + B) vdot + c(q, v) + g(q) with the rotors' B, joint side, without friction, shape (n,) [Nm]."""
        return self.link_torque(context, vdot) + self.motor_inertia.dot(vdot)

    def check_torque(self, key: str, value: object, torque: Array, factor: float = 1.0) -> None:
        """Refuse a value that needs more torque than a joint has; a joint without a known limit has any torque.

        Args:
            key: that needs the torque.
            value: of that key.
            torque: that is needed in the start posture (n,) [Nm].
            factor: on the limits [1].

        Raises:
            BadInputError: about the joint that is the farthest beyond its limit.
        """
        share = np.abs(torque) / self.limits.torque
        joint = int(np.argmax(share))
        if share[joint] > factor:
            name, needed = self.parts.joints[joint].name(), abs(float(torque[joint]))
            most = f"{factor:g} times " * (factor != 1.0) + f"its {self.limits.torque[joint]:.4g} Nm"
            raise invalid(key, value, f"held in the start posture: {name} needs {needed:.6g} Nm of at most {most}")

    def smallest_singular_value(self, context: Context) -> float:
        """Distance from a singular posture [1]: smallest singular value of the TCP Jacobian.

        Translations are divided by the parameters' `characteristic_length`. With fewer than six joints it shows whether
        the joints move the TCP independently. With several arms it is the smallest of all.
        """
        smallest = []
        for arm in self.parts.arms.values():
            J = self.jacobian_of(context, arm.tcp_frame)[:, arm.joints]
            J[3:] /= self.parameters.characteristic_length
            smallest.append(float(np.linalg.svd(J, compute_uv=False)[-1]))
        return min(smallest)


def posture_cache(block: LeafSystem, robot: RobotModel, position: InputPort) -> BlockCache:
    """A cache entry of `block` with a context of `robot.plant` in the posture of the port, shape (n,) [rad]."""
    index = position.get_index()  # a reference to the port would keep the block alive

    def calc(block: LeafSystem, context: Context, value: AbstractValue) -> None:
        if value.get_value() == ():  # made at the first use, see `scratch`
            value.set_value(robot.create_context())
        robot.set_positions(value.get_value(), block.EvalVectorInput(context, index).value())

    return BlockCache(block, "robot posture", lambda: Value[object](()), calc, {position.ticket()})


_STILL = 1e-4  # [rad]


def has_moved(q: Array, since: Array) -> bool:
    """Whether a posture differs from another by more than 1e-4 rad (norm), for quantities of the posture alone.

    For smaller steps a linear approximation of the motion has an error below 1e-8 of an arm's length.
    """
    step = q - since
    return bool(step @ step > _STILL**2)


def _limits(parts: RobotParts) -> JointLimits:
    def smaller(lower: list[Array], upper: list[Array]) -> Array:
        return np.minimum(-np.concatenate(lower), np.concatenate(upper))

    joints = parts.joints
    return JointLimits(
        position_lower=np.concatenate([j.position_lower_limits() for j in joints]),
        position_upper=np.concatenate([j.position_upper_limits() for j in joints]),
        velocity=smaller([j.velocity_lower_limits() for j in joints], [j.velocity_upper_limits() for j in joints]),
        acceleration=smaller(
            [j.acceleration_lower_limits() for j in joints], [j.acceleration_upper_limits() for j in joints]
        ),
        torque=np.array([actuator.effort_limit() for actuator in parts.actuators]),
    )
