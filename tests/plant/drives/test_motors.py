"""What the drives share: motors, their couplings and their friction that sticks."""

import numpy as np
import pytest
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource

from forcectl.errors import BadInputError
from forcectl.plant.drives.motors import MOTOR_PORTS, Motors, export_motion, joint_to_motor

S = np.array([[1.0, 0.0], [-0.02, 1.0]])


def test_couplings_of_the_comau_wrist(robot):
    """Parameters: motor 6 turns 50 q6 - 1 q5, all others with their own joint."""
    expected = np.eye(6)
    expected[5, 4] = -0.02
    np.testing.assert_allclose(joint_to_motor(robot), expected, atol=1e-15)


def test_a_rotor_weighs_at_its_joint_with_its_gear_ratio_squared(robot):
    """The energy of the rotors is the same on both sides: B on motor angles over gear ratios, as in the robot model."""
    coupling = joint_to_motor(robot)
    np.testing.assert_allclose(coupling.T @ np.diag(robot.parameters.reflected_inertia) @ coupling, robot.motor_inertia)


@pytest.mark.parametrize(
    ("free", "left"), [([3.0, -4.0], [2.0, -3.5]), ([0.9, -0.3], [0.0, 0.0]), ([-1.5, 0.5], [-0.5, 0.0])]
)
def test_friction_takes_what_it_can_and_sticks_exactly(free, left):
    motors = Motors([1.0, 2.0], S, [0.0, 0.0], [0.0, 0.0])
    builder = DiagramBuilder()
    source = builder.AddSystem(ConstantVectorSource(np.array(free)))
    reads, slip = motors.add_friction(builder, np.eye(2), np.array([1.0, 0.5]))
    builder.Connect(source.get_output_port(), reads)
    builder.ExportOutput(slip, "slip")
    diagram = builder.Build()
    value = diagram.get_output_port().Eval(diagram.CreateDefaultContext())
    np.testing.assert_allclose(value, left, atol=1e-15)
    assert all(v == 0.0 for v, wanted in zip(value, left, strict=True) if wanted == 0.0)


def test_the_motion_goes_out_whole_and_in_halves():
    builder = DiagramBuilder()
    source = builder.AddSystem(ConstantVectorSource([1.0, 2.0, 3.0, 4.0]))
    export_motion(builder, source.get_output_port())
    diagram = builder.Build()
    context = diagram.CreateDefaultContext()
    values = [diagram.GetOutputPort(name).Eval(context).tolist() for name in MOTOR_PORTS]
    assert values == [[1.0, 2.0, 3.0, 4.0], [1.0, 2.0], [3.0, 4.0]]


def test_positions_of_joints_as_angles_of_motors():
    motors = Motors(1.0, S, 0.0, 0.0)
    np.testing.assert_allclose(motors.at_rest([1.0, 2.0]), [1.0, 1.98])
    np.testing.assert_allclose(motors.to_joint @ motors.at_rest([1.0, 2.0]), [1.0, 2.0])


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        ((1.0, np.ones((2, 2)), 0.0, 0.0), "to_motor"),
        ((0.0, S, 0.0, 0.0), "inertia"),
        ((1.0, S, -1.0, 0.0), "coulomb_friction"),
        ((1.0, S, 0.0, [1.0, -1.0]), "viscous_friction"),
    ],
)
def test_what_is_refused(arguments, told):
    with pytest.raises(BadInputError, match=told):
        Motors(*arguments)
