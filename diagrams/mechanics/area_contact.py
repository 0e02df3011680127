"""Contact of parts by areas of pressure: on boxes, and of shapes whose model says nothing of it.

One point of contact cannot carry a face: it jumps from corner to corner, and a part that lies on a box wanders and
turns for good. Links have shapes without pressure: they touch boxes and parts in one point each.
"""

from __future__ import annotations

from pydrake.geometry import (
    AddCompliantHydroelasticProperties,
    AddRigidHydroelasticProperties,
    Ellipsoid,
    ProximityProperties,
    RoleAssign,
    SceneGraph,
    Shape,
)
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import BodyIndex

from forcectl.diagrams.mechanics.placed_part import PlacedPart
from forcectl.plant.contact.obstacle import ObstacleConfig

_AREA = 1e-4  # [m2] that a box carries with its stiffness at a point
_FACETS = 5  # of a round shape, per radius
_ANY = 1.0  # [m] edge of facets of a shape that has only flat faces


def add_pressure(properties: ProximityProperties, obstacle: ObstacleConfig) -> None:
    """Let a box carry parts by areas.

    Args:
        properties: of its shape.
        obstacle: the box.
    """
    # Drake's pressure is zero at the faces, and the modulus at the middle of the thinnest side.
    modulus = obstacle.stiffness / _AREA * 0.5 * min(obstacle.size)
    AddCompliantHydroelasticProperties(_ANY, float(modulus), properties)


def touch_by_area(plant: MultibodyPlant, scene_graph: SceneGraph, parts: tuple[PlacedPart, ...]) -> None:
    """Make the shapes of parts rigid ones that touch by areas, where their model says nothing of it.

    Args:
        plant: finalized.
        scene_graph: of the plant.
        parts: in the plant.
    """
    inspector = scene_graph.model_inspector()
    for index in sorted(body for part in parts for body in part.bodies):
        for geometry in plant.GetCollisionGeometriesForBody(plant.get_body(BodyIndex(index))):
            properties = ProximityProperties(inspector.GetProximityProperties(geometry))
            if properties.HasProperty("hydroelastic", "compliance_type"):
                continue
            if properties.HasProperty("hydroelastic", "resolution_hint"):
                AddRigidHydroelasticProperties(properties)
            else:
                AddRigidHydroelasticProperties(_facet(inspector.GetShape(geometry)), properties)
            scene_graph.AssignRole(plant.get_source_id(), geometry, properties, RoleAssign.kReplace)


def _facet(shape: Shape) -> float:
    """Edge of the facets that stand for a round shape [m]."""
    if isinstance(shape, Ellipsoid):
        return min(shape.a(), shape.b(), shape.c()) / _FACETS
    return shape.radius() / _FACETS if hasattr(shape, "radius") else _ANY
