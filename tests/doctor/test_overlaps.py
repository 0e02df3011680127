"""Bodies that overlap at the start."""

import pytest
from pydrake.geometry import AddCompliantHydroelasticProperties, AddContactMaterial, ProximityProperties, Sphere
from pydrake.math import RigidTransform
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph, CoulombFriction
from pydrake.multibody.tree import SpatialInertia
from pydrake.systems.framework import Diagram, DiagramBuilder

from forcectl.doctor import examine

RADIUS, MASS, STIFFNESS, MODULUS = 0.05, 0.1, 1e5, 1e8  # [m, kg, N/m, Pa]


def two_balls(distance: float, *, compliant: bool = False, sampled: bool = True) -> Diagram:
    """A ball fixed to the world, and a free one beside it."""
    builder = DiagramBuilder()
    plant, _ = AddMultibodyPlantSceneGraph(builder, 1e-3)
    properties = ProximityProperties()
    AddContactMaterial(0.0, STIFFNESS, CoulombFriction(0.1, 0.1), properties)
    if compliant:
        AddCompliantHydroelasticProperties(0.01, MODULUS, properties)
    bodies = [plant.world_body(), plant.AddRigidBody("ball", SpatialInertia.SolidSphereWithMass(MASS, RADIUS))]
    for i, body in enumerate(bodies):
        plant.RegisterCollisionGeometry(body, RigidTransform(), Sphere(RADIUS), f"ball_{i}", properties)
    plant.SetUseSampledOutputPorts(sampled)
    plant.Finalize()
    plant.SetDefaultFloatingBaseBodyPose(bodies[1], RigidTransform([distance, 0.0, 0.0]))
    return builder.Build()


@pytest.mark.parametrize("sampled", [True, False])
@pytest.mark.parametrize("compliant", [False, True])
def test_balls_inside_each_other_are_told(compliant: bool, sampled: bool) -> None:
    (finding,) = examine(two_balls(1.9 * RADIUS, compliant=compliant, sampled=sampled)).with_code("overlap")
    assert (finding.severity, finding.path) == ("warning", "plant")
    assert all(name in finding.message for name in ("the world", "ball", "overlap"))
    if not compliant:  # two springs one behind the other, implicit in a step of 1 ms
        force = float(finding.message.split(" with ")[1].split()[0])
        stiffness = STIFFNESS / 2
        assert force == pytest.approx(0.1 * RADIUS * stiffness / (1 + stiffness * 1e-6 / MASS), rel=0.01)


@pytest.mark.parametrize("distance", [1.999 * RADIUS, 2.1 * RADIUS])
def test_balls_that_touch_lightly_or_not_are_no_finding(distance: float) -> None:
    assert not examine(two_balls(distance)).with_code("overlap")
