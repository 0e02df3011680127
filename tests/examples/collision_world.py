"""Drake's own distances of a robot with its tools and obstacles, to compare with."""

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from pydrake.geometry import GeometryId, QueryObject
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph, CoulombFriction
from pydrake.systems.framework import DiagramBuilder

from forcectl.collision.shapes import Obstacle
from forcectl.robot.parts import add_robot


@dataclass(frozen=True)
class Posture:
    q: np.ndarray
    v: np.ndarray
    known: dict[Any, Any] = field(default_factory=dict)


class World:
    """Signed distances by Drake, of shapes named as `RobotShapes` does."""

    def __init__(self, robot: str = "yumi", tool: str | None = "yumi_gripper", obstacles: Iterable[Obstacle] = ()):
        builder = DiagramBuilder()
        self.plant, scene_graph = AddMultibodyPlantSceneGraph(builder, 0.001)
        add_robot(self.plant, robot, tool)
        anchored = {}
        for one in obstacles:
            body, friction = self.plant.world_body(), CoulombFriction(0.0, 0.0)
            anchored[self.plant.RegisterCollisionGeometry(body, one.X_WO, one.shape, one.name, friction)] = one.name
        self.plant.Finalize()
        self._diagram = builder.Build()
        self._root = self._diagram.CreateDefaultContext()
        self._context = self.plant.GetMyMutableContextFromRoot(self._root)
        inspector = scene_graph.model_inspector()
        self._pairs: dict[frozenset[str], tuple[GeometryId, GeometryId]] = {}
        for a, b in inspector.GetCollisionCandidates():
            names = []
            for geometry in (a, b):
                body = self.plant.GetBodyFromFrameId(inspector.GetFrameId(geometry))
                names.append(anchored.get(geometry, f"{body.name()}/{inspector.GetName(geometry)}"))
            self._pairs[frozenset(names)] = (a, b)
        self.q = self.plant.GetPositions(self._context)

    def _query(self, q: np.ndarray) -> QueryObject:
        self.plant.SetPositions(self._context, q)
        return self.plant.get_geometry_query_input_port().Eval(self._context)

    def distance(self, q: np.ndarray, a: str, b: str) -> float:
        """Between two shapes [m]."""
        return float(self._query(q).ComputeSignedDistancePairClosestPoints(*self._pairs[frozenset((a, b))]).distance)

    def least(self, q: np.ndarray, within: float = 0.03) -> float:
        """Of all pairs that Drake checks [m]; `within` where all are further apart."""
        found = self._query(q).ComputeSignedDistancePairwiseClosestPoints(within)
        return min((pair.distance for pair in found), default=within)
