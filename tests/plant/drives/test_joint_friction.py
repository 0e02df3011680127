"""Joint friction: the formulas, their means over a tick, and friction that sticks on the motor side and in a plant."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydrake.math import RigidTransform
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.analysis import Simulator

from forcectl.errors import BadInputError
from forcectl.plant.drives.joint_friction import (
    FrictionRest,
    JointFriction,
    actuation_gain,
    add_coulomb_friction,
    desired_state_gain,
    friction_threshold,
    friction_torque,
    mean_features,
)
from forcectl.robot.model import RobotModel
from tests.examples.block_examples_estimation import add_chain, chain_plant, friction

speeds = st.floats(-5.0, 5.0)


@given(speeds)
def test_friction_is_the_formula_5_2(v):
    f = JointFriction(1, offset=0.3, coulomb=1.7, viscous_forward=0.4, viscous_backward=0.9)
    expected = 0.3 + 1.7 * math.tanh(130 * v) + (0.4 if v > 0 else 0.9) * v
    assert friction_torque(np.array([v]), f).item() == pytest.approx(expected, abs=1e-12)


@given(speeds)
def test_the_coulomb_part_is_odd(v):
    f = JointFriction(1, coulomb=1.7)
    assert friction_torque(np.array([v]), f).item() == -friction_torque(np.array([-v]), f).item()


def test_threshold_is_widest_at_rest():
    assert friction_threshold(0.0, 0.2, 0.7) == pytest.approx(0.9, abs=1e-15)
    assert friction_threshold(3.0, 0.2, 0.7) == pytest.approx(0.2, abs=1e-15)
    assert friction_threshold(-1e4, 0.2, 0.7) == 0.2
    v = np.linspace(-0.2, 0.2, 41)
    np.testing.assert_allclose(friction_threshold(v, 0.2, 0.7), 0.2 + 0.7 / np.cosh(30 * v), rtol=1e-14)


@pytest.mark.parametrize(
    ("before", "after"), [(-0.3, 0.5), (0.02, 0.021), (0.0, 0.0), (-0.01, 0.002), (2.0, 2.0), (1e-9, -1e-9), (4, -4)]
)
def test_means_over_a_tick_are_the_integrals(before, after):
    grid = np.linspace(before, after, 200001)
    features = np.tanh(130 * grid), np.maximum(grid, 0), np.minimum(grid, 0)
    expected = [np.mean(0.5 * (f[1:] + f[:-1])) for f in features]
    found = [float(value) for value in mean_features(np.array(before, float), np.array(after, float))]
    np.testing.assert_allclose(found, expected, atol=1e-6)


def test_the_rest_completes_the_plants_own_part():
    plant, f = chain_plant(), friction()
    joints = [plant.GetJointByName(name) for name in ("arm_1", "arm_2")]
    block = FrictionRest(plant, joints, f)
    context = block.CreateDefaultContext()
    for v in (np.array([0.4, -0.7]), np.array([-2.0, 0.1]), np.zeros(2)):
        block.GetInputPort("velocity").FixValue(context, v)
        common = np.minimum(f.viscous_forward, f.viscous_backward) * v + f.coulomb * np.tanh(130 * v)
        np.testing.assert_allclose(
            -block.GetOutputPort("generalized_force").Eval(context) + common, friction_torque(v, f), atol=1e-14
        )


def loaded_chain(f: JointFriction, torque: float, *, speed: float = 0.0, time_step: float = 0.001):
    """One link turning about the vertical, under a constant torque, with friction; its simulator and plant."""
    plant = MultibodyPlant(time_step)
    plant.SetUseSampledOutputPorts(False)
    (joint,) = add_chain(plant, "arm", 1, RigidTransform(np.array([[1, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0.0]])))
    motor = plant.AddJointActuator("motor", joint)
    motor.set_default_rotor_inertia(0.2)
    drag = add_coulomb_friction(plant, [joint], f)
    plant.Finalize()
    context = plant.CreateDefaultContext()
    instance = joint.model_instance()
    ports = (
        (plant.get_desired_state_input_port(instance), desired_state_gain(plant, instance, drag), np.zeros(2)),
        (plant.get_actuation_input_port(instance), actuation_gain(plant, instance, [motor]), [torque]),
    )
    for port, gain, value in ports:
        own = gain.CreateDefaultContext()
        gain.get_input_port().FixValue(own, value)
        port.FixValue(context, gain.get_output_port().Eval(own))
    plant.SetVelocities(context, [speed])
    simulator = Simulator(plant, context)
    simulator.Initialize()
    return simulator, plant, context


@pytest.mark.parametrize("time_step", [0.0005, 0.001])
def test_a_joint_of_a_plant_sticks_under_load(time_step):
    simulator, plant, context = loaded_chain(JointFriction(1, coulomb=2.0), 1.9, time_step=time_step)
    simulator.AdvanceTo(1.0)
    assert abs(plant.GetVelocities(context)[0]) < 5e-6
    assert abs(plant.GetPositions(context)[0]) < 5e-6


@pytest.mark.parametrize("torque", [3.0, -3.0])
def test_beyond_the_coulomb_torque_a_joint_moves_by_the_rest(torque):
    f = JointFriction(1, coulomb=2.0, viscous_forward=0.5)
    simulator, plant, context = loaded_chain(f, torque)
    inertia = plant.CalcMassMatrix(context)[0, 0]
    assert inertia > 0.2, "the rotor of the motor is lost"
    simulator.AdvanceTo(0.3)
    expected = math.copysign(1.0, torque) * 1.0 / 0.5 * (1 - math.exp(-0.5 * 0.3 / inertia))
    assert plant.GetVelocities(context)[0] == pytest.approx(expected, rel=2e-3)


def test_friction_stops_a_joint_and_keeps_it():
    simulator, plant, context = loaded_chain(JointFriction(1, coulomb=2.0), 0.0, speed=1.0)
    inertia = plant.CalcMassMatrix(context)[0, 0]
    simulator.AdvanceTo(0.9 * inertia / 2.0)
    assert plant.GetVelocities(context)[0] == pytest.approx(0.1, abs=0.011)
    simulator.AdvanceTo(2.0)
    assert abs(plant.GetVelocities(context)[0]) < 1e-6


def test_what_cannot_have_friction_is_refused():
    plant = chain_plant(2, time_step=0.001)
    joints = [plant.GetJointByName(name) for name in ("arm_1", "arm_2")]
    with pytest.raises(BadInputError, match="not yet finalized"):
        add_coulomb_friction(plant, joints, friction())
    fresh = MultibodyPlant(0.001)
    with pytest.raises(BadInputError, match="must have 2"):
        add_coulomb_friction(fresh, add_chain(fresh, "arm", 1, RigidTransform()), friction())
    with pytest.raises(BadInputError, match="steepness"):
        add_coulomb_friction(fresh, add_chain(fresh, "other", 2, RigidTransform()), friction(), steepness=0.0)
    with pytest.raises(BadInputError, match="coulomb"):
        JointFriction(2, coulomb=[1.0, -0.1])
    with pytest.raises(BadInputError, match="viscous_backward"):
        JointFriction(2, viscous_backward=[1.0, math.inf])


def test_scaled_friction_scales_all_of_it():
    v = np.array([0.3, -0.02])
    np.testing.assert_allclose(friction_torque(v, friction().scaled(1.3)), 1.3 * friction_torque(v, friction()))


def test_the_friction_of_a_robot_is_that_of_its_parameters():
    """Backward speeds have coefficients of their own where the parameters give them, offsets too."""
    for robot in ("comau_smart_six", "yumi"):
        parameters = RobotModel.load(robot, None).parameters
        f = JointFriction.of_parameters(parameters)
        for v in (0.5, -0.5):
            viscous = parameters.viscous_friction if v > 0 else parameters.viscous_friction_backward
            expected = parameters.friction_offset + math.copysign(1, v) * parameters.coulomb_friction + v * viscous
            np.testing.assert_allclose(friction_torque(np.full(f.size, v), f), expected, rtol=1e-12)
