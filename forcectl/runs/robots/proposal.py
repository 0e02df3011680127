"""Control parameters proposed for a model that has none yet, from its joints and their limits.

Arms are the longest chains of joints that do not fork; a chain ends where a gripper begins: at joints that others
mimic, at fewer than four joints behind a frame that carries tools, at names such as finger. Joints before the fork of
two arms, and all others, are held. The posture is the best of random ones: far from singular, tool downwards, links
apart.
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from pydrake.geometry import SceneGraph
from pydrake.math import RigidTransform, RollPitchYaw, RotationMatrix
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import (
    JacobianWrtVariable,
    Joint,
    ModelInstanceIndex,
    PrismaticJoint,
    RevoluteJoint,
    RigidBody,
)

from forcectl.arrays import Array
from forcectl.collision.distance import LinkDistance
from forcectl.collision.shapes import RobotShapes
from forcectl.robot.parameters import ControlParameters
from forcectl.robot.parts import ArmParts, add_robot_with
from forcectl.robot.urdf import Urdf

_HAND = re.compile(r"grip|finger|hand|thumb|claw|jaw|knuckle", re.IGNORECASE)
_FINGER = re.compile(r"finger|thumb|claw|jaw|knuckle", re.IGNORECASE)  # of a link; a last link may be a gripper's
_FLANGE = re.compile(r"(tool0|flange|ee_link|tcp|tool_link|link_eef?|_hand|hand_link|end_effector)$", re.IGNORECASE)
_SENSOR = re.compile(r"cam|sensor|optical|imu|lidar|laser|depth|light|_eye|^eye|d435|realsense", re.IGNORECASE)
_SIDES = {side: re.compile(rf"{side}|^{side[0]}_|_{side[0]}(_|$)", re.IGNORECASE) for side in ("left", "right")}
_ARM = 4  # smallest number of joints, of one of several arms
_TOOL = 0.15  # [m] length of an assumed tool
_ON_AXIS = 1e-3  # [m] largest distance of a frame on the axis of the last joint
_SHORT = 0.005  # [m] smallest distance from the last joint that shows a direction
_ALONG, _ACROSS = np.cos(np.radians(30)), np.cos(np.radians(60))  # angle to an axis
_WIDEST = np.radians(135.0)  # of a random joint position from the middle of its range
TOUCHING = 0.0105  # [m] distance below which `LinkDistance` is violated at its default of 10 mm
_SAMPLES, _KEPT, _PAIRS_LOOKED_AT = 1500, 12, 150


@dataclass(frozen=True)
class Flange:
    """The proposed flange of an arm.

    Attributes:
        frame: its name.
        turn: `flange_turn_deg`, after which z points out of the flange, (3,) [deg].
        guess: the direction in words, where the model does not make it certain; "" where it does.
    """

    frame: str
    turn: Array
    guess: str


class ModelTree:
    """The joints of a model as a tree, by body."""

    def __init__(self, plant: MultibodyPlant, instance: ModelInstanceIndex, urdf: Urdf):
        self.plant, self.urdf = plant, urdf
        self.joints: list[Joint] = [plant.get_joint(i) for i in plant.GetJointIndices(instance)]
        self._below: dict[int, list[Joint]] = {}
        for joint in self.joints:
            self._below.setdefault(int(joint.parent_body().index()), []).append(joint)
        children = {int(joint.child_body().index()) for joint in self.joints}
        world = int(plant.world_body().index())
        bodies = [int(i) for i in plant.GetBodyIndices(instance)]
        self.roots = [world] if world in self._below else [i for i in bodies if i not in children]
        self._depths: dict[int, int] = {}
        self._followers: dict[str, list[Joint]] = {}
        for joint in self.joints:
            known = urdf.joints.get(joint.name())
            if known is not None and known.mimics is not None:
                self._followers.setdefault(known.mimics[0], []).append(joint)

    @property
    def moving(self) -> list[Joint]:
        """Joints with one position, without those that mimic others."""
        return [joint for joint in self.joints if self._moves(joint)]

    def arms(self) -> dict[str, list[Joint]]:
        """Joints of each arm by its name."""
        chains = [chain for root in self.roots for chain in self._chains(root, [])]
        if len(chains) > 1:
            chains = [chain for chain in chains if len(chain) >= _ARM] or chains[:1]
        if len(chains) > 1:
            shared = [set(map(id, a)) & set(map(id, b)) for a, b in itertools.combinations(chains, 2)]
            chains = [[joint for joint in chain if not any(id(joint) in each for each in shared)] for chain in chains]
        names: dict[str, list[Joint]] = {}
        for i, chain in enumerate(chain for chain in chains if chain):
            sides = [side for side, word in _SIDES.items() if all(word.search(each.name()) for each in chain[-3:])]
            name = sides[0] if len(sides) == 1 and sides[0] not in names else f"arm_{i + 1}"
            names[name] = chain
        return names

    def flange(self, last: Joint) -> Flange:
        """The frame behind the last joint of an arm that most likely carries the tool, and the direction out of it."""
        bodies, look = [last.child_body()], [int(last.child_body().index())]
        while look:
            for joint in self._below.get(look.pop(), []):
                if joint.num_positions() == 0:
                    bodies.append(joint.child_body())
                    look.append(int(joint.child_body().index()))
        named = [body for body in bodies if _FLANGE.search(body.name())]
        flange = (named or self._frame_on(last, bodies[1:]) or bodies[:1])[0]
        z, guess = self._outward(last, flange)
        if z[2] > 0.99:
            return Flange(flange.name(), np.zeros(3), guess)
        x = np.eye(3)[np.argmin(np.abs(z))]
        x = x - (x @ z) * z
        R = RotationMatrix(np.column_stack([x / np.linalg.norm(x), np.cross(z, x / np.linalg.norm(x)), z]))
        return Flange(flange.name(), np.degrees(RollPitchYaw(R).vector()).round(3) + 0.0, guess)

    def _outward(self, last: Joint, flange: RigidBody) -> tuple[Array, str]:
        """The direction out of a flange, in its frame, and why it is a guess; "" where joint and links agree.

        The links behind the last joint tell it: where they extend along its axis, it is the axis. Where they extend
        across it, it is the axis of the flange frame that is closest to them.
        """
        plant, context = self.plant, self.plant.CreateDefaultContext()
        X_FW = plant.EvalBodyPoseInWorld(context, flange).inverse()
        X_FJ = X_FW @ last.frame_on_child().CalcPoseInWorld(context)
        axis, behind = _axis(last), self._extent(last, X_FW)
        if axis is None:
            return np.array([0.0, 0.0, 1.0]), "z of the frame itself"
        z, joint = X_FJ.rotation() @ axis, X_FJ.translation()
        offsets = [-joint, *(place - joint for place in behind)]
        far = next((each for each in offsets if np.linalg.norm(each) > _SHORT), None)
        if far is None:
            base = X_FW @ last.parent_body().EvalPoseInWorld(context).translation()
            z = -z if base @ z > 1e-6 else z
            if z[2] > _ALONG and _FLANGE.search(flange.name()):
                return z, ""
            return z, f"along the axis of {last.name()}: no link behind it shows the direction"
        far = far / np.linalg.norm(far)
        z = -z if far @ z < -1e-6 else z
        if far @ z > _ALONG:
            return z, ""
        across = np.sign(far) * (np.abs(far) == np.abs(far).max())
        if far @ z < _ACROSS and far @ across > _ALONG:
            return across, f"along the links behind {last.name()}, which is across its axis"
        return z, f"along the axis of {last.name()}: the links behind it extend in another direction"

    def _extent(self, last: Joint, X_FW: RigidTransform) -> list[Array]:
        """The end of the chain of fixed links behind the last joint, and the middle of all that is behind it.

        Both are in the frame of the flange. The last link itself does not count, nor do cameras and other sensors,
        which are mounted in any direction.
        """
        context, places = self.plant.CreateDefaultContext(), {True: list[Array](), False: list[Array]()}
        X_FJ = X_FW @ last.frame_on_child().CalcPoseInWorld(context)
        look = [(joint, True) for joint in self._below.get(int(last.child_body().index()), [])]
        while look:
            joint, rigid = look.pop()
            body, rigid = joint.child_body(), rigid and joint.num_positions() == 0
            if not _SENSOR.search(body.name()):
                look += [(each, rigid) for each in self._below.get(int(body.index()), [])]
                X_FB = X_FW @ self.plant.EvalBodyPoseInWorld(context, body)
                places[rigid].append(X_FB.translation())
        far = sorted(places[True], key=lambda place: float(np.linalg.norm(place - X_FJ.translation())))
        everything = places[True] + places[False]
        return far[-1:] + ([np.mean(everything, axis=0)] if everything else [])

    def _frame_on(self, last: Joint, bodies: list[RigidBody]) -> list[RigidBody]:
        """The only massless link of these with its origin on the axis of the last joint; not a camera's; or none."""
        axis, context = _axis(last), self.plant.CreateDefaultContext()
        if not isinstance(last, RevoluteJoint) or axis is None:
            return []
        X_JW = last.frame_on_child().CalcPoseInWorld(context).inverse()
        off = [np.cross(axis, X_JW @ self.plant.EvalBodyPoseInWorld(context, body).translation()) for body in bodies]
        found = [
            body
            for body, apart in zip(bodies, off, strict=True)
            if body.default_mass() == 0 and np.linalg.norm(apart) < _ON_AXIS
        ]
        return found if len(found) == 1 else []

    def _moves(self, joint: Joint) -> bool:
        known = self.urdf.joints.get(joint.name())
        return joint.num_positions() == 1 and (known is None or known.mimics is None)

    def _next(self, body: int, in_arm: bool = True) -> list[Joint]:
        """The next moving joints of an arm behind a body; `in_arm`: an arm joint is before the body."""
        found: list[Joint] = []
        for joint in self._below.get(body, []):
            child = joint.child_body()
            if joint.num_positions() == 0:
                behind = self._next(int(child.index()), in_arm)
                carries = in_arm and (_FLANGE.search(child.name()) or _HAND.search(child.name()))
                found += [each for each in behind if not carries or self._depth(each) >= _ARM]
            elif not self._moves(joint) or _HAND.search(joint.name()) or _FINGER.search(child.name()):
                continue
            elif joint.name() not in self._followers:
                found.append(joint)
            else:  # others mimic it, as no arm joint may be: it is of a gripper, or before an arm and held
                behind = self._next(int(child.index()))
                arms = [each for each in behind if self._depth(each) >= _ARM]
                found += arms or ([] if self._is_gripper(joint, behind) else [joint])
        return found

    def _is_gripper(self, leader: Joint, behind: list[Joint]) -> bool:
        """Whether a joint that others mimic is the last of its chain, and does not carry all of them."""
        moved, look = set[int](), [leader]
        while look:
            moved.add(int(look[-1].child_body().index()))
            look += self._below.get(int(look.pop().child_body().index()), [])
        return not behind and any(
            int(each.child_body().index()) not in moved for each in self._followers[leader.name()]
        )

    def _depth(self, joint: Joint) -> int:
        """Number of joints of the longest chain that begins with this one."""
        index = int(joint.index())
        if index not in self._depths:
            behind = self._next(int(joint.child_body().index()))
            self._depths[index] = 1 + max(map(self._depth, behind), default=0)
        return self._depths[index]

    def _chains(self, body: int, path: list[Joint]) -> list[list[Joint]]:
        behind = self._next(body, bool(path))
        if len(behind) > 1:
            behind = [joint for joint in behind if self._depth(joint) >= _ARM]
        if not behind:
            return [path] if path else []
        return [chain for joint in behind for chain in self._chains(int(joint.child_body().index()), [*path, joint])]


def _axis(joint: Joint) -> Array | None:
    if isinstance(joint, RevoluteJoint):
        return np.asarray(joint.revolute_axis())
    return np.asarray(joint.translation_axis()) if isinstance(joint, PrismaticJoint) else None


@dataclass
class Found:
    """Properties of a robot, found by moving it to random postures.

    Attributes:
        posture: joint positions, (n,) [rad or m].
        reach: largest distance of a TCP from the first joint of its arm [m].
        gravity: largest torque against gravity of each joint, (n,) [Nm].
        inertia: largest inertia of each joint with the others at rest, (n,) [kg m2].
        leverage: largest joint torque per force at the tip of a tool of 0.15 m, (n,) [Nm/N].
        touching: pairs of bodies whose shapes overlap, or nearly, in most postures.
    """

    posture: Array
    reach: float
    gravity: Array
    inertia: Array
    leverage: Array
    touching: list[tuple[str, str]]


class Explorer:
    """A robot with its shapes, moved to postures.

    Args:
        folder, parameters, refused: see `add_robot_with`.
    """

    def __init__(self, folder: Any, parameters: ControlParameters, refused: list[str]):
        self.plant, self.scene_graph = MultibodyPlant(0.0), SceneGraph()
        self.plant.RegisterAsSourceForSceneGraph(self.scene_graph)
        self.parts = add_robot_with(self.plant, folder, parameters, None, refused=refused)
        self.plant.Finalize()
        self._context = self.plant.CreateDefaultContext()
        self._q = np.array([joint.position_start() for joint in self.parts.joints])
        self._v = np.array([joint.velocity_start() for joint in self.parts.joints])
        self._first = [joint.frame_on_parent() for joint in self.parts.joints]
        self._distance, self._pairs = None, list[tuple[str, str]]()
        if not self.parts.missing_shapes:
            shapes = RobotShapes.of_plant(self.plant, self.scene_graph.model_inspector(), self.parts)
            bodies = [solid.name.partition("/")[0] for solid in shapes.solids]
            self._pairs = [(min(bodies[a], bodies[b]), max(bodies[a], bodies[b])) for a, b in shapes.pairs]
            self._distance = LinkDistance(shapes) if shapes.pairs else None

    def limits(self) -> tuple[Array, Array]:
        """Lower and upper bounds of random postures, (n,) each [rad or m]."""
        lower = np.array([float(joint.position_lower_limits()[0]) for joint in self.parts.joints])
        upper = np.array([float(joint.position_upper_limits()[0]) for joint in self.parts.joints])
        low, high = np.clip(lower, -np.pi, np.pi), np.clip(upper, -np.pi, np.pi)
        middle = 0.5 * (low + high)
        return np.maximum(low, middle - _WIDEST), np.minimum(high, middle + _WIDEST)

    def close(self, q: Array, margin: float) -> list[tuple[str, str]]:
        """Pairs of bodies whose shapes are closer than a margin [m] by `LinkDistance`; the names of each are sorted."""
        if self._distance is None:
            return []
        near = self._distance.distances(q) < margin
        return sorted({pair for pair, close in zip(self._pairs, near, strict=True) if close})

    def poses(self, q: Array) -> dict[str, RigidTransform]:
        """Poses of the flanges in the world by arm."""
        self._move(q)
        return {name: arm.tcp_frame.CalcPoseInWorld(self._context) for name, arm in self.parts.arms.items()}

    def inertia(self, q: Array) -> Array:
        """Inertia of each joint with the others at rest, without rotors and tools, (n,) [kg m2]."""
        self._move(q)
        return np.diag(self.plant.CalcMassMatrix(self._context))[self._v]

    def explore(self, length: float) -> Found:
        """Move to random postures, the same each time.

        Args:
            length: characteristic length, by which translations are divided [m].
        """
        generator, (low, high) = np.random.default_rng(0), self.limits()
        postures = generator.uniform(low, high, size=(_SAMPLES, len(low)))
        reach, (gravity, inertia, leverage) = 0.0, np.zeros((3, len(low)))
        scores = np.empty((_SAMPLES, len(self.parts.arms)))
        for k, q in enumerate(postures):
            inertia = np.maximum(inertia, self.inertia(q))
            gravity = np.maximum(gravity, np.abs(self.plant.CalcGravityGeneralizedForces(self._context)[self._v]))
            leverage = np.maximum(leverage, self._leverage())
            scores[k] = self._scores(q, low, high, length)
            reach = max(reach, *(self._reach(arm) for arm in self.parts.arms.values()))
        count: dict[tuple[str, str], int] = {}
        for q in postures[:60]:
            for pair in self.close(q, TOUCHING):
                count[pair] = count.get(pair, 0) + 1
        touching = sorted(pair for pair, times in count.items() if times >= 30)
        return Found(self._best(postures, scores, touching), reach, gravity, inertia, leverage, touching)

    def _best(self, postures: Array, scores: Array, allowed: Sequence[tuple[str, str]]) -> Array:
        """The posture of highest score in which only the `allowed` pairs touch, in whole degrees."""
        ranked = [np.argsort(-column)[:_KEPT] for column in scores.T]
        choices = sorted(
            itertools.islice(itertools.product(*map(range, [_KEPT] * len(ranked))), 20_000),
            key=lambda places: -sum(scores[ranked[arm][place], arm] for arm, place in enumerate(places)),
        )
        best = None
        for places in choices[:_PAIRS_LOOKED_AT]:
            q = postures[0].copy()
            for arm, (part, place) in enumerate(zip(self.parts.arms.values(), places, strict=True)):
                q[part.joints] = postures[ranked[arm][place]][part.joints]
            turns = np.array([isinstance(joint, RevoluteJoint) for joint in self.parts.joints])
            q = np.where(turns, np.radians(np.round(np.degrees(q))), np.round(q, 3)) + 0.0  # no minus zero
            best = q if best is None else best
            if not set(self.close(q, 2 * TOUCHING)) - set(allowed):
                return q
        return best if best is not None else postures[0]

    def _scores(self, q: Array, low: Array, high: Array, length: float) -> list[float]:
        found, room = [], np.minimum(q - low, high - q) / (high - low)
        for arm in self.parts.arms.values():
            J = self._jacobian(arm)
            J[3:] /= length
            smallest = float(np.linalg.svd(J, compute_uv=False)[-1])
            pose = arm.tcp_frame.CalcPoseInWorld(self._context)
            down = max(0.0, -float(pose.rotation().matrix()[2, 2]))
            found.append(smallest * (0.2 + down**8) * min(1.0, 4 * float(room[arm.joints].min())))
        return found

    def _leverage(self) -> Array:
        found = np.zeros(len(self._v))
        for arm in self.parts.arms.values():
            turn, shift = np.linalg.norm(self._jacobian(arm).reshape(2, 3, -1), axis=1)
            found[arm.joints] = shift + _TOOL * turn
        return found

    def _jacobian(self, arm: ArmParts) -> Array:
        """Jacobian of the spatial velocity of an arm's TCP in the world, with respect to its joint velocities."""
        world, velocity = self.plant.world_frame(), JacobianWrtVariable.kV
        J = self.plant.CalcJacobianSpatialVelocity(self._context, velocity, arm.tcp_frame, np.zeros(3), world, world)
        return J[:, self._v[arm.joints]]

    def _reach(self, arm: ArmParts) -> float:
        base = self._first[arm.joints.start].CalcPoseInWorld(self._context).translation()
        return float(np.linalg.norm(arm.tcp_frame.CalcPoseInWorld(self._context).translation() - base))

    def _move(self, q: Array) -> None:
        everything = self.plant.GetPositions(self._context).copy()
        everything[self._q] = q
        self.plant.SetPositions(self._context, everything)
