"""The truth of contacts is Drake's own, for points and for surfaces of pressure, in any frame."""

import numpy as np
import pytest
from pydrake.geometry import (
    AddCompliantHydroelasticProperties,
    AddContactMaterial,
    AddRigidHydroelasticProperties,
    Box,
    ProximityProperties,
    Sphere,
)
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.multibody.math import SpatialForce
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph, ContactModel, CoulombFriction
from pydrake.multibody.tree import FixedOffsetFrame, SpatialInertia
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder

from forcectl.errors import BadInputError
from forcectl.plant import ContactReader, ContactWrench, bodies_named, wrench_between

MODELS = [ContactModel.kPoint, ContactModel.kHydroelastic, ContactModel.kHydroelasticWithFallback]
NAMES = ("first", "second", "third")  # balls on a plate, each against the next
X_BF = RigidTransform(RollPitchYaw(0.3, -0.5, 0.9), [0.02, 0.05, -0.1])


def material(compliant: bool, hydroelastic: bool = True) -> ProximityProperties:
    properties = ProximityProperties()
    AddContactMaterial(dissipation=5.0, point_stiffness=1e4, friction=CoulombFriction(0.3, 0.3), properties=properties)
    if hydroelastic and compliant:
        AddCompliantHydroelasticProperties(0.02, 1e6, properties)
    elif hydroelastic:
        AddRigidHydroelasticProperties(0.02, properties)
    return properties


class Balls:
    """Three balls that slide and roll on a plate; `height` of their lowest points over it [m]."""

    def __init__(self, model: ContactModel, height: float = -1e-3, duration: float = 0.01):
        builder = DiagramBuilder()
        plant, _ = AddMultibodyPlantSceneGraph(builder, 0.001)
        plant.SetUseSampledOutputPorts(False)
        plant.set_contact_model(model)
        for i, name in enumerate(NAMES):
            body = plant.AddRigidBody(name, SpatialInertia.SolidSphereWithMass(1.0, 0.05))
            # With fallback the last one touches at points and the others by surfaces.
            own = material(True, hydroelastic=i < 2 or model != ContactModel.kHydroelasticWithFallback)
            plant.RegisterCollisionGeometry(body, RigidTransform(), Sphere(0.05), name, own)
            plant.SetDefaultFloatingBaseBodyPose(
                body, RigidTransform(RollPitchYaw(0.1, 0.2, i), [0.09 * i if height < 0 else 0.2 * i, 0, 0.05 + height])
            )
        plant.RegisterCollisionGeometry(
            plant.world_body(), RigidTransform([0, 0, -0.1]), Box(2.0, 2.0, 0.2), "plate", material(False)
        )
        frame = plant.AddFrame(FixedOffsetFrame("grip", plant.GetFrameByName("second"), X_BF))
        plant.Finalize()
        self.plant, self.frame = plant, frame
        second, others = bodies_named(plant, ["second"], "on"), bodies_named(plant, ["first", "third"], "by")
        self.blocks = {
            "all": builder.AddNamedSystem("all", ContactWrench(plant, second, None, frame)),
            "balls": builder.AddNamedSystem("balls", ContactWrench(plant, second, others, frame)),
            # By indices as Drake has them.
            "plate": builder.AddNamedSystem(
                "plate",
                ContactWrench(plant, {plant.GetBodyByName("second").index()}, [plant.world_body().index()], frame),
            ),
        }
        for block in self.blocks.values():
            builder.Connect(plant.get_contact_results_output_port(), block.GetInputPort("contact_results"))
            builder.Connect(plant.get_body_poses_output_port(), block.GetInputPort("body_poses"))
        simulator = Simulator(builder.Build())
        self.root = simulator.get_mutable_context()
        self.context = plant.GetMyMutableContextFromRoot(self.root)
        plant.SetVelocities(self.context, 0.3 * np.cos(np.arange(plant.num_velocities())))
        simulator.AdvanceTo(duration)
        self._simulator = simulator

    def read(self, name: str) -> np.ndarray:
        block = self.blocks[name]
        return block.GetOutputPort("body_contact_wrench").Eval(block.GetMyContextFromRoot(self.root))

    def in_frame(self, wrench: np.ndarray) -> np.ndarray:
        """A wrench at the origin of the second ball in the world, at the frame in the frame."""
        R_WB = self.plant.EvalBodyPoseInWorld(self.context, self.plant.GetBodyByName("second")).rotation()
        moved = SpatialForce(wrench[:3], wrench[3:]).Shift(R_WB @ X_BF.translation())
        R_FW = (R_WB @ X_BF.rotation()).inverse()
        return np.concatenate([R_FW @ moved.rotational(), R_FW @ moved.translational()])


@pytest.mark.parametrize("model", MODELS)
def test_it_is_what_drake_moves_the_bodies_by(model):
    """Generalized contact forces of a floating body are the torque at its origin and the force, in the world."""
    balls = Balls(model)
    plant = balls.plant
    results = plant.get_contact_results_output_port().Eval(balls.context)
    counts = results.num_point_pair_contacts(), results.num_hydroelastic_contacts()
    kinds = {MODELS[0]: (True, False), MODELS[1]: (False, True), MODELS[2]: (True, True)}
    assert tuple(count > 0 for count in counts) == kinds[model]
    instance = plant.GetBodyByName("second").model_instance()
    drake = plant.get_generalized_contact_forces_output_port(instance).Eval(balls.context).reshape(-1, 6)
    contacts = list(ContactReader(plant).read(results))
    for name, expected in zip(NAMES, drake, strict=True):
        body = plant.GetBodyByName(name)
        origin = plant.EvalBodyPoseInWorld(balls.context, body).translation()
        np.testing.assert_allclose(wrench_between(contacts, {int(body.index())}, None, origin), expected, atol=1e-9)
    assert np.abs(drake).min(axis=1).max() > 0  # friction and rolling: all six components
    np.testing.assert_allclose(balls.read("all"), balls.in_frame(drake[1]), atol=1e-9)


@pytest.mark.parametrize("model", MODELS)
def test_parts_add_up_and_action_is_reaction(model):
    balls = Balls(model)
    assert np.linalg.norm(balls.read("balls")[3:]) > 0.1
    np.testing.assert_allclose(balls.read("balls") + balls.read("plate"), balls.read("all"), atol=1e-9)
    contacts = list(ContactReader(balls.plant).read(balls.plant.get_contact_results_output_port().Eval(balls.context)))
    first, second = (int(balls.plant.GetBodyByName(name).index()) for name in ("first", "second"))
    point = np.array([0.3, -0.2, 0.1])
    there, back = wrench_between(contacts, {first}, {second}, point), wrench_between(contacts, {second}, {first}, point)
    np.testing.assert_allclose(there, -back, atol=1e-12)
    # What bodies of one side do to each other is not from outside.
    both = wrench_between(contacts, {first, second}, None, point)
    each = sum(wrench_between(contacts, {body}, None, point) for body in (first, second))
    np.testing.assert_allclose(both, each, atol=1e-9)


@pytest.mark.parametrize("model", MODELS)
def test_free_of_contact_it_is_zero(model):
    balls = Balls(model, height=0.05)
    for name in balls.blocks:
        np.testing.assert_array_equal(balls.read(name), np.zeros(6))


@pytest.mark.parametrize(
    ("names", "message"),
    [
        (["fourth"], "unknown on 'fourth'"),
        (["DefaultModelInstance::firts"], "DefaultModelInstance::first"),
        (["DefaultModelInstanse"], "did you mean 'DefaultModelInstance'?"),
    ],
)
def test_a_body_that_is_not_there_is_refused_by_name(names, message):
    plant = Balls(ContactModel.kPoint, duration=0.0).plant
    assert bodies_named(plant, ["DefaultModelInstance"], "on") == {1, 2, 3}
    assert bodies_named(plant, ["DefaultModelInstance::third"], "on") == {3}
    with pytest.raises(BadInputError) as caught:
        bodies_named(plant, names, "on")
    assert message in str(caught.value)
