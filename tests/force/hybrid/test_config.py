"""What a selection may be, the models of its directions, and alignment on the robot."""

from typing import Any

import numpy as np
import pytest

import forcectl as fc
from forcectl.diagrams.drives.position_drive import PositionDriveConfig
from forcectl.errors import BadInputError
from forcectl.force.admittance import AdmittanceConfig
from forcectl.force.approach import ApproachConfig
from forcectl.force.baselines.pid import PidConfig
from forcectl.force.hybrid.config import DirectionConfig, HybridConfig, direction_model
from forcectl.force.hybrid.task_axes import DIRECTIONS
from forcectl.force.integral import IntegralConfig
from forcectl.motion.references import SequenceConfig
from forcectl.plant.compliance import robot_compliance
from forcectl.plant.drives.servo import ServoConfig
from tests.examples.hybrid_examples import axes, model


def selected(*names: str, **keys: Any) -> dict[str, DirectionConfig]:
    return {name: DirectionConfig(compliance=0.2, **keys) for name in names}


def test_the_model_of_a_direction_is_the_compliance_along_or_about_it():
    known = model()
    robot = known.known_robot()
    context = robot.context_at(known.start)
    matrix = robot_compliance(robot, context, robot.joint_stiffness)
    for i, name in enumerate(DIRECTIONS):
        own = direction_model(known, axes(), name, 0.2)
        row = np.zeros(6)
        row[3 * (i // 3) : 3 * (i // 3) + 3] = axes().rotation(context)[:, i % 3]
        assert own.robot_compliance[0] == pytest.approx(row @ matrix @ row, rel=1e-6)
        assert own.environment_compliance[0] == 0.2
    along = direction_model(known, axes(), "z", None)
    np.testing.assert_allclose(along.total_compliance, known.total_compliance)


@pytest.mark.parametrize(
    ("directions", "message"),
    [
        (selected(*DIRECTIONS, desired=0.0), "must be from one to five directions"),
        ({}, "must be from one to five directions"),
        (selected("q"), "directions.q: unknown direction 'q': known: rx, ry, rz, x, y, z"),
        (selected("x", "z"), r"directions\.z\.desired: must be given in all but one of x, y, z"),
    ],
)
def test_an_impossible_selection_is_refused(directions, message):
    with pytest.raises(BadInputError, match=message):
        HybridConfig(directions=directions)


@pytest.mark.parametrize(
    ("directions", "message"),
    [
        ("{rx: {law: !Integral {}}}", r"directions\.rx\.compliance: must be given"),
        ("{x: {law: !Integral {}}}", r"directions\.x\.compliance: must be given"),
        ("{z: {law: !InvarianceRobot {}}}", r"directions\.z\.law: InvarianceRobotConfig needs motor_position"),
        ("{z: {law: !JointMoves {}}}", r"directions\.z\.law: JointMovesConfig is no force law"),
        ("{q: {}}", r"directions\.q"),
        ("{x: {}, y: {}, z: {}, rx: {}, ry: {}, rz: {}}", "from one to five directions"),
    ],
)
def test_a_scenario_that_cannot_be_gives_one_line(tmp_path, directions, message):
    file = tmp_path / "own.yaml"
    file.write_text(
        f"station:\n  fidelity: Kinematic\ncontroller: !Hybrid\n  directions: {directions}\nduration: 0.1\n"
    )
    with pytest.raises(BadInputError, match=message) as refused:
        fc.build(file)
    assert "\n" not in str(refused.value)
    assert "own.yaml" in str(refused.value)


@pytest.mark.slow
def test_without_torques_it_is_the_force_law_alone():
    """Selected along the normal only, the loop is that of the law behind the kinematic inversion."""
    alone = {"station": {"fidelity": "Kinematic"}, "reference": {"force": 15.0}, "duration": 1.0}
    logs = [
        fc.run({**alone, "controller": law}).log.squeeze()
        for law in (IntegralConfig(), HybridConfig(directions={"z": DirectionConfig(law=IntegralConfig())}))
    ]
    force = [log["contact_force"].values for log in logs]
    assert force[0][-1] > 5.0
    np.testing.assert_allclose(force[1], force[0], atol=0.15)  # [N], three quanta of the sensor


@pytest.mark.slow
def test_another_tilt_other_laws_and_a_motion_along_the_plate():
    """6 degrees about x; once flat, the tool moves by 20 mm along x, and keeps its force and torques."""
    torque = PidConfig(proportional_gain=0.3, integral_gain=1.5, lower_limit=-0.5, upper_limit=0.5)
    overrides = {
        "station.environment.tilt_deg": 6.0,
        "station.environment.tilt_axis": [1.0, 0.0, 0.0],
        "controller.directions.rx.law": torque,
        "controller.directions.ry.law": AdmittanceConfig(
            inertia=0.0354, damping=3.54, lower_limit=-0.5, upper_limit=0.5
        ),
        "motion.distance": 0.02,
        "motion.speed": 0.02,
        "motion.start_time": 2.0,
        "duration": 3.6,
    }
    result = fc.run("hybrid_alignment", variant="integral", overrides=overrides)
    metrics, log = result.metrics["integral"], result.log.squeeze()
    assert metrics["tilt_at_start_deg"] == pytest.approx(6.0, abs=0.01)
    assert metrics["tilt_at_end_deg"] < 0.5
    assert metrics["aligned_s"] < 2.0
    assert metrics["aligned_torque_Nm"] < 0.2
    still, end = (log.sel(time=t, method="nearest") for t in (2.0, 3.6))
    way = end["tool_position"].values - still["tool_position"].values
    np.testing.assert_allclose(way, [0.02, 0.0, 0.0], atol=5e-4)
    assert float(end["contact_force"]) == pytest.approx(15.0, rel=0.05)


@pytest.mark.slow
def test_with_a_guarded_move_along_z_it_touches_presses_and_leaves():
    station = {
        "fidelity": "Kinematic",
        "environment": {"stiffness": 1e4, "surface": {"gap": 2e-3}},
        "drive": PositionDriveConfig(servo=ServoConfig(friction_scale=0.0, coulomb_friction=0.0)),
    }
    law = ApproachConfig(law=IntegralConfig(integral_gain=2.5), speed=0.02, patience=0.3)
    reference = SequenceConfig(times=[0.0, 1.8], forces=[15.0, 0.0])
    scenario = {
        "station": station,
        "controller": HybridConfig(directions={"z": DirectionConfig(law=law)}),
        "reference": reference,
        "duration": 2.3,
    }
    log = fc.run(scenario).log.squeeze()
    force, time = log["contact_force"].values, log["time"].values
    assert force[time < 0.1].max() == 0.0
    np.testing.assert_allclose(force[(time > 1.7) & (time < 1.8)], 15.0, atol=0.75)
    assert force.max() < 16.5
    assert force[time > 2.2].max() == 0.0
