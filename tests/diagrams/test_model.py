"""The model of the plant agrees with it until the scenario says otherwise, and shares nothing with it."""

from __future__ import annotations

import numpy as np
import pytest

import forcectl as fc
from forcectl.diagrams.model import ModelConfig, friction_of, plant_model
from forcectl.diagrams.workcell import describe
from tests.examples.stations import free, pressing


def test_compliances_are_scaled():
    workcell = describe(pressing(fidelity="Kinematic"))
    model = ModelConfig(robot_compliance=1.5, environment_compliance=0.5).applied(plant_model(workcell))
    assert model.robot_compliance.item() == pytest.approx(1.5 * workcell.contact.robot_compliance)
    assert model.environment_compliance.item() == pytest.approx(0.5 * workcell.contact.environment_compliance)


def test_friction_of_the_model_is_another_object():
    workcell = describe(free())
    model = plant_model(workcell)
    assert model.friction is not workcell.config.drive.true_friction(workcell.robot)
    scaled = ModelConfig(friction_scale=0.5).applied(model).friction
    np.testing.assert_allclose(scaled.coulomb, 0.5 * model.friction.coulomb)


def test_masses_and_payload_change_the_model_only():
    workcell = describe(free(robot="yumi/left"))
    truth = plant_model(workcell)
    wrong = ModelConfig(inertia_scale=1.1, payload=0.3).applied(truth)
    q = truth.start

    def gravity(robot):
        context = robot.create_context()
        robot.set_positions(context, q)
        return robot.gravity_torque(context)

    arm = truth.robot
    context = arm.create_context()
    arm.set_positions(context, q)
    weight = arm.jacobian(context)[5] * 0.3 * 9.81
    np.testing.assert_allclose(gravity(wrong.robot), 1.1 * gravity(truth.robot) + weight, atol=1e-6)
    np.testing.assert_allclose(gravity(workcell.robot), gravity(truth.robot))


@pytest.mark.slow
def test_identified_friction_is_written_by_the_identification_and_read_by_a_model(tmp_path, without_pictures):
    fc.run("fig_5_2", variant="readings as they are", out=tmp_path / "run")
    file = tmp_path / "run" / "friction.yaml"
    workcell = describe(free())
    joints = workcell.robot.parameters.arm_joints
    found, true = friction_of(str(file), joints), workcell.config.drive.true_friction(workcell.robot)
    np.testing.assert_allclose(found.coulomb, true.coulomb, rtol=0.01)
    model = ModelConfig(friction=str(file)).applied(plant_model(workcell))
    np.testing.assert_array_equal(model.friction.coulomb, found.coulomb)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("joints: [a]\noffset: [0]\n", "a file with the keys joints, offset, coulomb"),
        ("- 1\n", "a file with the keys"),
        ("{", "cannot be read"),
        (
            "{joints: [a], offset: [0], coulomb: [1, 2], viscous_forward: [1], viscous_backward: [1]}",
            "lists of equal length",
        ),
    ],
)
def test_a_wrong_friction_file_is_one_line(tmp_path, text, message):
    (tmp_path / "friction.yaml").write_text(text)
    with pytest.raises(fc.BadInputError) as caught:
        ModelConfig(friction=str(tmp_path / "friction.yaml"))
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)
