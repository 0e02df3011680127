"""The model of the plant agrees with it until the scenario says otherwise, and shares nothing with it."""

import numpy as np
import pytest
from pydrake.systems.framework import DiagramBuilder

import forcectl as fc
from forcectl.diagrams.drives.position_drive import JointImpedanceDriveConfig
from forcectl.diagrams.model import ModelConfig, PayloadConfig, friction_of, plant_model
from forcectl.diagrams.workcell import describe
from forcectl.force.adaptive_integral import AdaptiveIntegralConfig
from tests.examples.stations import free, pressing


def test_compliances_are_scaled():
    workcell = describe(pressing(fidelity="Kinematic"))
    model = ModelConfig(robot_compliance=1.5, environment_compliance=0.5).applied(plant_model(workcell))
    assert model.robot_compliance.item() == pytest.approx(1.5 * workcell.contact.robot_compliance)
    assert model.environment_compliance.item() == pytest.approx(0.5 * workcell.contact.environment_compliance)


def test_the_part_of_the_drives_is_as_wrong_as_the_whole():
    """Else what is left for joints and links is below zero, and no estimator can be made of it."""
    workcell = describe(pressing(fidelity="Multibody", drive=JointImpedanceDriveConfig()))
    truth, model = plant_model(workcell), ModelConfig(robot_compliance=0.3).applied(plant_model(workcell))
    assert 0 < truth.drive_compliance < truth.robot_compliance
    assert model.drive_compliance / model.robot_compliance == pytest.approx(
        truth.drive_compliance / truth.robot_compliance
    )
    AdaptiveIntegralConfig().add_to(DiagramBuilder(), model)


def test_friction_of_the_model_is_another_object():
    workcell = describe(free())
    model = plant_model(workcell)
    assert model.friction is not workcell.config.drive.true_friction(workcell.robot)
    scaled = ModelConfig(friction_scale=0.5).applied(model).friction
    np.testing.assert_allclose(scaled.coulomb, 0.5 * model.friction.coulomb)


def test_masses_and_payload_change_the_model_only():
    workcell = describe(free(robot="yumi/left"))
    truth = plant_model(workcell)
    beside = [0.05, -0.02, 0.1]
    load = PayloadConfig(mass=0.3, position=beside)
    wrong = ModelConfig(inertia_scale=1.1, payload={"left": load}).applied(truth)
    q = truth.start

    def gravity(robot):
        context = robot.create_context()
        robot.set_positions(context, q)
        return robot.gravity_torque(context)

    arm = truth.robot
    context = arm.create_context()
    arm.set_positions(context, q)
    J, lever = arm.jacobian(context), arm.pose(context).rotation() @ beside
    weight = (J[3:] + np.cross(J[:3].T, lever).T)[2] * 0.3 * 9.81
    np.testing.assert_allclose(gravity(wrong.robot), 1.1 * gravity(truth.robot) + weight, atol=1e-6)
    np.testing.assert_allclose(gravity(workcell.robot), gravity(truth.robot))


def test_each_arm_has_its_own_payload():
    workcell = describe(free(robot="yumi"))
    truth = plant_model(workcell)
    loaded = ModelConfig(payload={"right": PayloadConfig(mass=0.3)}).applied(truth)
    own, other = (each.robot.gravity_torque(each.robot.context_at(truth.start)) for each in (truth, loaded))
    arms = truth.robot.parts.arms
    np.testing.assert_allclose(other[arms["left"].joints], own[arms["left"].joints], atol=1e-12)
    assert np.abs(other - own)[arms["right"].joints].max() > 0.5


def test_payload_of_an_arm_that_is_not_there():
    model = plant_model(describe(free(robot="yumi/left")))
    with pytest.raises(fc.BadInputError, match="unknown payload 'right': known: left"):
        ModelConfig(payload={"right": PayloadConfig(mass=0.3)}).applied(model)


@pytest.mark.slow
def test_identified_friction_is_written_by_the_identification_and_read_by_a_model(tmp_path, without_pictures):
    fc.run("fig_5_2", variant="readings as they are", out=tmp_path / "run")
    file = tmp_path / "run" / "friction.yaml"
    workcell = describe(free())
    true = workcell.config.drive.true_friction(workcell.robot)
    found = friction_of(str(file), workcell.robot)
    np.testing.assert_allclose(found.coulomb, true.coulomb, rtol=0.01)
    model = ModelConfig(friction=str(file)).applied(plant_model(workcell))
    np.testing.assert_array_equal(model.friction.coulomb, found.coulomb)


GOOD = {
    "joints": [f"joint_{i}" for i in range(1, 7)],
    "offset": [0.0] * 6,
    "coulomb": [38.0, 52.0, 30.0, 4.5, 5.8, 5.3],
    "viscous_forward": [33.0, 47.0, 42.0, 1.8, 5.1, 1.1],
    "viscous_backward": [33.0, 47.0, 42.0, 1.8, 5.1, 1.1],
}


def read(tmp_path, text):
    (tmp_path / "friction.yaml").write_text(text)
    workcell = describe(pressing(fidelity="Multibody"))
    return ModelConfig(friction=str(tmp_path / "friction.yaml")).applied(plant_model(workcell)).friction


@pytest.mark.parametrize(("coulomb", "viscous"), [(2.0, 0.5), (0.5, 2.0), (0.7, 1.4), (0.5, 0.5)])
def test_friction_that_differs_from_the_robots_own_is_not_taken_for_an_exchange(tmp_path, coulomb, viscous):
    scales = {"coulomb": coulomb, "viscous_forward": viscous, "viscous_backward": viscous}
    changes = {name: [scale * value for value in GOOD[name]] for name, scale in scales.items()}
    np.testing.assert_allclose(read(tmp_path, str(GOOD | changes)).coulomb, changes["coulomb"])


def test_joints_of_a_friction_file_are_found_by_name(tmp_path):
    backwards = {name: values[::-1] for name, values in GOOD.items()}
    np.testing.assert_array_equal(read(tmp_path, str(backwards)).coulomb, GOOD["coulomb"])


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"coulomb": ["a"] * 6}, "friction.yaml:1: coulomb = .* must be a list of numbers"),
        ({"coulomb": [True] * 6}, "friction.yaml:1: coulomb = .* must be a list of numbers"),
        ({"coulomb": [float("nan")] * 6}, "coulomb .* must be"),
        ({"viscous_forward": [-1.0] * 6}, "friction.yaml:1: viscous_forward .* must be not negative"),
        ({"offset": [0.0]}, "friction.yaml:1: offset .* must be 6 numbers, one for each of joints"),
        ({"joints": ["joint_1"] * 6}, r"friction.yaml:1: joints.1 = 'joint_1': must be another"),
        ({"joints": [f"axis_{i}" for i in range(6)]}, "friction.yaml:1: joints .* must be joint_1, joint_2"),
        ({"coulomb": [1.5e3] * 6}, "friction.yaml:1: coulomb .* below the torque limits"),
        ({"coulomb": [0.038] * 6}, "friction.yaml:1: coulomb .* within 100 times the robot's"),
        ({"viscous_backward": [1e4] * 6}, "friction.yaml:1: viscous_backward .* at most 10 times torque limits over"),
        ({"coulomb": GOOD["viscous_forward"], "viscous_forward": GOOD["coulomb"]}, "exchanged, the two would be near"),
        ({name: [0.0] * 6 for name in list(GOOD)[1:]}, "coulomb .* must be above zero for some joint"),
    ],
)
def test_friction_that_no_robot_has_is_one_line(tmp_path, changes, message):
    with pytest.raises(fc.BadInputError, match=message) as caught:
        read(tmp_path, str(GOOD | changes).replace("nan", ".nan").replace("True", "true"))
    assert caught.value.key == "friction"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("joints: [a]\noffset: [0]\n", "coulomb is missing: must be a list of numbers"),
        ("- 1\n", "must be keys and values"),
        ("{", "not valid YAML"),
        ("joints: [a]\njoints: [a]\n", "written twice"),
    ],
)
def test_a_wrong_friction_file_is_one_line(tmp_path, text, message):
    (tmp_path / "friction.yaml").write_text(text)
    with pytest.raises(fc.BadInputError, match=message) as caught:
        ModelConfig(friction=str(tmp_path / "friction.yaml"))
    assert "\n" not in str(caught.value)
