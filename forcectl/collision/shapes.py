"""Collision shapes of a robot, read from its model, in a form in which distances of many pairs are cheap to compute.

Each pair of shapes consists of a *core* and of *balls*::

    core    the points within a radius of a box that is fixed on a link; the box may be flat in any direction, so that
            a capsule is the core with the box (0, 0, length/2), a sphere that with (0, 0, 0)
    balls   spheres fixed on a link that together contain the other shape, up to `tolerance` beyond its surface

The distance of a ball from a core has a closed form and is convex in the position of the ball. Distances are too small
by up to `tolerance`, or `box_tolerance` between two boxes. They are exact between a sphere and any shape.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from pydrake.geometry import (
    Box,
    Capsule,
    Convex,
    Cylinder,
    GeometryId,
    Mesh,
    SceneGraph,
    SceneGraphInspector,
    Shape,
    Sphere,
)
from pydrake.math import RigidTransform
from pydrake.multibody.plant import MultibodyPlant

from forcectl.arrays import Array
from forcectl.errors import BadInputError, invalid, unknown
from forcectl.robot.joint_tree import JointTree
from forcectl.robot.meshes import Enclosure, enclosure
from forcectl.robot.parts import RobotParts, Tool, add_robot

_ROW = 6  # largest number of balls in a row


@dataclass(frozen=True)
class Solid:
    """A sphere, capsule or box on a link of the tree.

    Attributes:
        name: of the body and the shape.
        link: see `JointTree`.
        X_LC: pose of its middle on the link, (4, 4), z along a capsule.
        half: half the size of the box (3,) [m].
        radius: distance from the box up to which points belong to the solid [m].
    """

    name: str
    link: int
    X_LC: Array
    half: Array
    radius: float

    @property
    def is_box(self) -> bool:
        """Whether it is a box, and not a sphere or a capsule."""
        return bool(self.half[:2].any())


@dataclass(frozen=True)
class Obstacle:
    """A shape fixed to the world that is not a part of the robot.

    Attributes:
        shape: Drake's `Sphere`, `Capsule` or `Box`.
        X_WO: pose of the shape in the world.
        name: for messages.
    """

    shape: Shape
    X_WO: RigidTransform
    name: str = "obstacle"

    @classmethod
    def boxes(cls, configs: Mapping[str, Any]) -> list[Obstacle]:
        """Of the boxes around a robot, by name, each with `size` [m] and `pose`."""
        return [cls(Box(*box.size), box.pose, name) for name, box in configs.items()]


class Balls(NamedTuple):
    """Balls of one radius in the frame of a solid, in rows: centres of each row (m, 3) [m], radius [m]."""

    rows: list[Array]
    radius: float


def cover(solid: Solid, tolerance: float, box_tolerance: float) -> Balls:
    """Balls that contain a solid and exceed it by at most `tolerance` [m], or by `box_tolerance` if it is a box."""
    if solid.is_box:
        return _cover_box(solid.half, box_tolerance)
    length, radius = 2 * solid.half[2], solid.radius
    if length / 2 <= tolerance:
        return Balls([np.zeros((1, 3))], radius + length / 2)
    # Two neighbours at a distance s contain the cylinder of radius r between them if R^2 = r^2 + (s/2)^2.
    count = math.ceil(length / (2 * math.sqrt((radius + tolerance) ** 2 - radius**2))) + 1
    z = np.linspace(-0.5, 0.5, count) * length
    centres = np.stack([0 * z, 0 * z, z], axis=1)
    rows = [centres[at : at + _ROW] for at in range(0, count, _ROW)]
    return Balls(rows, math.hypot(radius, 0.5 * length / (count - 1)))


def _cover_box(half: Array, tolerance: float) -> Balls:
    """A ball around each cell of a grid at a face of the box; inner cells are left out."""
    if not (half > 0).all():
        raise BadInputError(f"box of size {(2 * half).tolist()}: must be above zero in every direction")
    for step in itertools.count(1):
        counts = np.ceil(half / half.max() * step - 1e-9).astype(int)
        cell = half / counts
        radius = float(np.linalg.norm(cell))
        if radius - cell.min() <= tolerance:
            break
    rows = []
    longest = int(np.argmax(counts))
    for place in itertools.product(*[range(n) if i != longest else (0,) for i, n in enumerate(counts)]):
        at_face = any(p in (0, n - 1) for i, (p, n) in enumerate(zip(place, counts, strict=True)) if i != longest)
        along = np.arange(counts[longest]) if at_face else np.unique([0, counts[longest] - 1])
        places = np.tile(np.array(place, dtype=float), (len(along), 1))
        places[:, longest] = along
        centres = (2 * places + 1) * cell - half
        rows += [centres[at : at + _ROW] for at in range(0, len(centres), _ROW)]
    return Balls(rows, radius)


class RobotShapes:
    """The collision shapes of a robot with its tools, and the pairs of them that Drake would check.

    Attributes:
        tree: joint tree of the plant, with the links of the shapes.
        parts: of the robot.
        solids: shapes of the robot, and of obstacles if there are any.
        pairs: two indices of solids each.
    """

    def __init__(self, tree: JointTree, parts: RobotParts, solids: Sequence[Solid], pairs: Sequence[tuple[int, int]]):
        """Use `load`."""
        self.tree, self.parts = tree, parts
        self.solids, self.pairs = tuple(solids), tuple(pairs)

    @classmethod
    def load(cls, robot: str | Path, tool: Tool | Mapping[str, Tool]) -> RobotShapes:
        """The shapes of what `forcectl.robot.model.add_robot` adds to a plant; joints in the order of `RobotModel`.

        A cylinder is replaced by the capsule around it, a mesh by the box or capsule around it.

        Raises:
            BadInputError: unknown robot or tool, a shape that is missing, or one that is not a sphere, capsule,
                cylinder, box or mesh.
        """
        plant, scene_graph = MultibodyPlant(0.001), SceneGraph()
        plant.RegisterAsSourceForSceneGraph(scene_graph)
        parts = add_robot(plant, robot, tool)
        plant.Finalize()
        return cls.of_plant(plant, scene_graph.model_inspector(), parts)

    @classmethod
    def of_plant(cls, plant: MultibodyPlant, inspector: SceneGraphInspector, parts: RobotParts) -> RobotShapes:
        """The shapes of a robot in a plant with nothing else in it.

        Args:
            plant: finalized.
            inspector: of its scene graph.
            parts: of the robot.

        Raises:
            BadInputError: see `load`.
        """
        parts.require_shapes()
        tree = JointTree(plant, parts.joints)
        candidates = sorted(inspector.GetCollisionCandidates(), key=lambda pair: [each.get_value() for each in pair])
        geometries = sorted({geometry for pair in candidates for geometry in pair}, key=GeometryId.get_value)
        solids = []
        for geometry in geometries:
            body = plant.GetBodyFromFrameId(inspector.GetFrameId(geometry))
            name, shape = f"{body.name()}/{inspector.GetName(geometry)}", inspector.GetShape(geometry)
            pose = inspector.GetPoseInFrame(geometry)
            if isinstance(shape, Mesh | Convex):
                around = _around(shape)
                core, pose = (around.half, around.radius), pose @ around.X
            else:
                core = _core(name, shape)
            solids.append(Solid(name, *tree.place(body.body_frame(), pose), *core))
        index = {geometry: i for i, geometry in enumerate(geometries)}
        pairs = [(index[a], index[b]) for a, b in candidates]
        # The distance of two shapes on one link is constant.
        return cls(tree, parts, solids, [(a, b) for a, b in pairs if solids[a].link != solids[b].link])

    def against(self, obstacles: Iterable[Obstacle]) -> RobotShapes:
        """The pairs of each obstacle with each of the shapes that the joints move."""
        moved = [i for i, solid in enumerate(self.solids) if self.tree.moves[solid.link].any()]
        solids, pairs = list(self.solids), []
        for obstacle in obstacles:
            core = _core(obstacle.name, obstacle.shape)
            solids.append(Solid(obstacle.name, 0, obstacle.X_WO.GetAsMatrix4(), *core))
            pairs += [(i, len(solids) - 1) for i in moved]
        return RobotShapes(self.tree, self.parts, solids, pairs)

    def without(self, touching: Iterable[tuple[str, str]]) -> RobotShapes:
        """The same pairs without those of shapes that may touch.

        Args:
            touching: pairs of names: of a shape, "finger_1/left_yumi_gripper::finger", or for all shapes of a body or a
                tool that of the body, "finger_1", of the tool, "left_yumi_gripper", or of both,
                "finger_1/left_yumi_gripper".

        Raises:
            BadInputError: there is no such shape.
        """
        left_out: set[tuple[int, int]] = set()
        for pair in touching:
            first, second = (self._named(name) for name in pair)
            left_out |= {(a, b) for a in first for b in second} | {(b, a) for a in first for b in second}
        kept = [pair for pair in self.pairs if pair not in left_out]
        return RobotShapes(self.tree, self.parts, self.solids, kept)

    @property
    def names(self) -> list[str]:
        """Names that `without` accepts: of tools, bodies and shapes."""
        every = [name for solid in self.solids for name in _names(solid)]
        return sorted(dict.fromkeys(every), key=len)

    def _named(self, name: str) -> list[int]:
        found = [i for i, solid in enumerate(self.solids) if name in _names(solid)]
        if not found:
            raise unknown("shape", name, [each.name for each in self.solids])
        return found


def _names(solid: Solid) -> tuple[str, ...]:
    whole = solid.name.split("::")[0]
    return *whole.split("/"), whole, solid.name


def _around(mesh: Mesh | Convex) -> Enclosure:
    hull = mesh.GetConvexHull()
    return enclosure(np.array([hull.vertex(i) for i in range(hull.num_vertices())]))


def _core(name: str, shape: Shape) -> tuple[Array, float]:
    """Half the size of the core's box, and the radius around the box."""
    if isinstance(shape, Sphere):
        return np.zeros(3), shape.radius()
    if isinstance(shape, Capsule | Cylinder):
        return np.array([0.0, 0.0, 0.5 * shape.length()]), shape.radius()
    if isinstance(shape, Box):
        return 0.5 * np.asarray(shape.size()), 0.0
    raise invalid(f"shape of {name}", type(shape).__name__, "a Sphere, Capsule, Cylinder or Box")
