"""Momentum terms against the kinetic energy, the polarised bias term and the motion of a plant."""

import numpy as np
import pytest
from pydrake.math import RigidTransform
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import PrismaticJoint, SpatialInertia

from forcectl.errors import BadInputError
from forcectl.robot.momentum_model import MomentumModel
from tests.examples.block_examples_estimation import add_chain, chain_plant


def two_arms(gravity: bool = True) -> MultibodyPlant:
    plant = MultibodyPlant(0.0)
    if not gravity:
        plant.mutable_gravity_field().set_gravity_vector([0.0, 0.0, 0.0])
    add_chain(plant, "left", 7, RigidTransform([0.0, 0.2, 0.3]))
    add_chain(plant, "right", 7, RigidTransform([0.0, -0.2, 0.3]))
    plant.Finalize()
    return plant


def polarised(model: MomentumModel, q: np.ndarray, v: np.ndarray) -> np.ndarray:
    """(C'v)_k = v.(c(v + e_k) - c(v - e_k))/4 of the quadratic form c(v) = C v: exact but for rounding."""
    plant, context = model.plant, model.create_context()
    plant.SetPositions(context, q)

    def c(speed: np.ndarray) -> np.ndarray:
        plant.SetVelocities(context, speed)
        return plant.CalcBiasTerm(context)

    size = np.max(np.abs(v))
    unit = v / size
    eye = np.eye(len(v))
    return size**2 * np.array([unit @ (c(unit + e) - c(unit - e)) / 4 for e in eye])


@pytest.mark.parametrize("scale", [1e-5, 1e-2, 1.0, 10.0])
def test_coriolis_is_the_polarised_form(scale):
    model, rng = MomentumModel(two_arms(gravity=False)), np.random.default_rng(4)
    context, worst = model.create_context(), 0.0
    for _ in range(60):
        q, v = rng.uniform(-3, 3, 14), scale * rng.normal(size=14)
        _, coriolis = model.terms(context, q, v)
        exact = polarised(model, q, v)
        worst = max(worst, np.max(np.abs(coriolis - exact)) / np.max(np.abs(exact)))
    assert worst < 1e-7


def test_coriolis_is_the_gradient_of_the_kinetic_energy():
    model, rng = MomentumModel(two_arms(gravity=False)), np.random.default_rng(5)
    plant, context = model.plant, model.create_context()
    for _ in range(20):
        q, v = rng.uniform(-3, 3, 14), rng.normal(size=14)
        _, coriolis = model.terms(context, q, v)

        def energy(q: np.ndarray, v: np.ndarray = v) -> float:
            plant.SetPositionsAndVelocities(context, np.concatenate([q, v]))
            return plant.CalcKineticEnergy(context)

        h = 1e-3
        gradient = np.array(
            [
                (8 * (energy(q + h * e) - energy(q - h * e)) - energy(q + 2 * h * e) + energy(q - 2 * h * e)) / (12 * h)
                for e in np.eye(14)
            ]
        )
        np.testing.assert_allclose(coriolis, gradient, atol=1e-7 * np.max(np.abs(gradient)))


def test_momentum_changes_as_the_equation_of_motion_says():
    """p' = C'v + tau_g + tau, with p' = B vdot + B' v from Drake's forward dynamics."""
    plant = chain_plant(3)
    model, rng = MomentumModel(plant), np.random.default_rng(6)
    context, own = plant.CreateDefaultContext(), model.create_context()
    instance = plant.GetModelInstanceByName("DefaultModelInstance")
    for _ in range(10):
        q, v, tau = rng.normal(size=(3, 3))
        plant.SetPositionsAndVelocities(context, np.concatenate([q, v]))
        plant.get_applied_generalized_force_input_port().FixValue(context, tau)
        vdot = plant.get_generalized_acceleration_output_port(instance).Eval(context)
        _, force = model.terms(own, q, v)
        h = 1e-5
        rate = (model.terms(own, q + h * v, v + h * vdot)[0] - model.terms(own, q - h * v, v - h * vdot)[0]) / (2 * h)
        np.testing.assert_allclose(rate, force + tau, rtol=0, atol=1e-7 * np.max(np.abs(rate)))


def test_one_arm_of_two_is_the_arm_alone():
    plant = two_arms()
    joints = [plant.GetJointByName(f"right_{i + 1}") for i in range(7)]
    one = MomentumModel(plant, joints)
    alone_plant = MultibodyPlant(0.0)
    add_chain(alone_plant, "right", 7, RigidTransform([0.0, -0.2, 0.3]))
    alone_plant.Finalize()
    alone = MomentumModel(alone_plant)
    q, v = np.random.default_rng(7).normal(size=(2, 7))
    for part, whole in zip(
        one.terms(one.create_context(), q, v), alone.terms(alone.create_context(), q, v), strict=True
    ):
        np.testing.assert_allclose(part, whole, atol=1e-9)
    frame, other = plant.GetFrameByName("right_link_7"), alone_plant.GetFrameByName("right_link_7")
    np.testing.assert_allclose(
        one.jacobian(one.create_context(), q, frame, plant.world_frame()),
        alone.jacobian(alone.create_context(), q, other, alone_plant.world_frame()),
        atol=1e-12,
    )


def test_rotors_add_to_the_momentum_only():
    plant, rotors = chain_plant(2), np.array([0.3, 0.1])
    bare, geared = MomentumModel(plant), MomentumModel(plant, rotor_inertia=rotors)
    q, v = np.array([0.3, -1.0]), np.array([1.2, 0.7])
    p, force = bare.terms(bare.create_context(), q, v)
    p_rotors, force_rotors = geared.terms(geared.create_context(), q, v)
    np.testing.assert_allclose(p_rotors, p + rotors * v)
    np.testing.assert_array_equal(force_rotors, force)


@pytest.mark.parametrize("speed", [0.0, 1e-313])  # a filtered speed decays to that after some seconds of rest
def test_at_rest_there_is_gravity_only(speed):
    model = MomentumModel(chain_plant(2))
    context = model.create_context()
    p, force = model.terms(context, np.array([0.3, -1.0]), np.full(2, speed))
    np.testing.assert_array_equal(p, np.zeros(2))
    np.testing.assert_allclose(force, model.plant.CalcGravityGeneralizedForces(context), atol=1e-12)
    assert np.max(np.abs(force)) > 0.1


def test_a_sliding_joint_will_do():
    plant = MultibodyPlant(0.0)
    body = plant.AddRigidBody("slider", SpatialInertia.SolidBoxWithMass(3.0, 0.1, 0.1, 0.1))
    plant.AddJoint(PrismaticJoint("slide", plant.world_frame(), body.body_frame(), [0.0, 0.0, 1.0]))
    plant.Finalize()
    model = MomentumModel(plant)
    p, force = model.terms(model.create_context(), np.array([0.2]), np.array([2.0]))
    np.testing.assert_allclose([p, force], [[6.0], [-3.0 * 9.81]], atol=1e-9)


def test_a_damper_of_the_plant_is_a_force_on_the_right_hand_side():
    plant = MultibodyPlant(0.0)
    body = plant.AddRigidBody("slider", SpatialInertia.SolidBoxWithMass(3.0, 0.1, 0.1, 0.1))
    plant.AddJoint(PrismaticJoint("slide", plant.world_frame(), body.body_frame(), [1.0, 0.0, 0.0], damping=4.0))
    plant.Finalize()
    model = MomentumModel(plant)
    _, force = model.terms(model.create_context(), np.array([0.2]), np.array([2.0]))
    np.testing.assert_allclose(force, [-8.0], atol=1e-9)


def test_what_is_no_arm_is_refused():
    floating = MultibodyPlant(0.0)
    floating.AddRigidBody("free", SpatialInertia.SolidBoxWithMass(1.0, 0.1, 0.1, 0.1))
    with pytest.raises(BadInputError, match="finalized"):
        MomentumModel(floating)
    floating.Finalize()
    with pytest.raises(BadInputError, match="one position"):
        MomentumModel(floating)
    with pytest.raises(BadInputError, match="rotor_inertia"):
        MomentumModel(chain_plant(2), rotor_inertia=[1.0, 2.0, 3.0])
    with pytest.raises(BadInputError, match="number of joints"):
        MomentumModel(chain_plant(2), joints=[])
