"""Hydroelastic contact of parts: on boxes, and for shapes whose model does not define it.

A single contact point cannot support a face: it jumps from corner to corner, and a part that lies on a box drifts and
turns without end. Links have no hydroelastic shapes: they touch boxes and parts in one point each.
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

_AREA = 1e-4  # [m2] contact area on which a box has the stiffness of its point contact
_FACETS = 5  # facets of a round shape, per radius
_ANY = 1.0  # [m] edge of the facets of a shape with flat faces only; any length does


def add_pressure(properties: ProximityProperties, obstacle: ObstacleConfig) -> None:
    """Give a box compliant hydroelastic properties, so that it supports parts by areas of contact.

    Args:
        properties: of its shape.
        obstacle: the box.
    """
    # Drake's pressure grows from zero at the faces to the modulus in the middle of the thinnest side.
    modulus = obstacle.stiffness / _AREA * 0.5 * min(obstacle.size)
    AddCompliantHydroelasticProperties(_ANY, float(modulus), properties)


def touch_by_area(plant: MultibodyPlant, scene_graph: SceneGraph, parts: tuple[PlacedPart, ...]) -> None:
    """Give the shapes of parts rigid hydroelastic properties, where their model does not define any.

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
    """Edge of the facets that approximate a round shape [m]."""
    if isinstance(shape, Ellipsoid):
        return min(shape.a(), shape.b(), shape.c()) / _FACETS
    return shape.radius() / _FACETS if hasattr(shape, "radius") else _ANY
