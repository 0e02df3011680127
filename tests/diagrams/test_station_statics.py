"""What a station at rest must show: its compliance, zero force without contact, a known load as that load."""

import shutil
from pathlib import Path

import numpy as np
import pytest
from pydrake.common.yaml import yaml_dump, yaml_load
from pydrake.math import RigidTransform
from pydrake.multibody.math import SpatialForce
from pydrake.multibody.plant import ExternallyAppliedSpatialForce
from pydrake.systems.framework import Context

from forcectl.diagrams.fidelities.multibody import MultibodyStation
from forcectl.diagrams.station import SHIPPED_FIDELITIES, build_station
from forcectl.diagrams.workcell import Workcell, describe
from forcectl.models import robot_folder
from forcectl.plant.contact.compliant_contact import EnvironmentConfig
from forcectl.plant.contact.contact_monitor import ContactMode
from forcectl.plant.drives.servo import ServoConfig
from forcectl.plant.sensors.force_sensor import ForceSensorConfig
from forcectl.plant.sensors.wrist_sensor import sensor_frame
from forcectl.testing import Log, run_diagram
from tests.examples.station_runs import NORMALS, POSTURES, SPRINGS, command_for, compliance_of, multibody, quiet_sensor
from tests.examples.stations import pressing

FRICTIONLESS = ServoConfig(friction_scale=0.0, coulomb_friction=0.0)
STIFF = 2e5  # [N/m]
STEP = 0.01  # distance of the samples [s]
TOOL_WEIGHT = 9.8  # beyond the sensor [N]


def press(workcell: Workcell, force: float, duration: float) -> Log:
    """Command the displacement that should give `force` [N], smoothly over the first half of the time."""

    def command(t: float) -> np.ndarray:
        s = min(1.0, 2 * t / duration)
        return command_for(workcell, -force * compliance * s**3 * (10 - 15 * s + 6 * s**2))

    compliance = compliance_of(workcell)
    return run_diagram(build_station(workcell), duration, period=STEP, inputs={"joint_position_command": command})


def last(log: Log, name: str) -> float:
    return float(log[name][-1, 0])


def sensed_in_world(workcell: Workcell, log: Log) -> tuple[np.ndarray, np.ndarray]:
    """Force [N] on the tool and its torque about the TCP [Nm], in the world, from the wrench in the sensor's frame."""
    context = workcell.robot.create_context()
    workcell.robot.set_positions(context, log["link_position"][-1])
    X_WS = sensor_frame(workcell.robot).CalcPoseInWorld(context)
    torque, force = (X_WS.rotation().matrix() @ part for part in log["measured_wrench"][-1].reshape(2, 3))
    lever = X_WS.translation() - workcell.robot.pose(context).translation()
    return force, torque + np.cross(lever, force)


# --- compliance ------------------------------------------------------------------------------------------------------


def assert_compliance(workcell: Workcell, duration: float) -> Log:
    """The station is as compliant as the robot's Jacobian and joint stiffness and the environment say, within 2 %."""
    expected = compliance_of(workcell)
    assert workcell.contact.robot_compliance + workcell.contact.environment_compliance == pytest.approx(
        expected, rel=1e-9
    )
    log = press(workcell, 15.0, duration)
    found = -last(log, "contact_displacement") / last(log, "contact_force")
    assert found == pytest.approx(expected, rel=0.02)
    assert last(log, "contact_state") == ContactMode.CONTACT
    return log


# Every posture with every normal, the stiffnesses in turns.
EVERYWHERE = [
    (posture, normal, (SPRINGS, STIFF)[(i + j) % 2])
    for i, posture in enumerate(POSTURES)
    for j, normal in enumerate(NORMALS)
]


@pytest.mark.parametrize(("posture", "normal", "stiffness"), EVERYWHERE)
def test_compliance_at_the_end_effector_is_that_of_the_joints_and_the_environment(
    posture: tuple[float, ...], normal: tuple[float, ...], stiffness: float
) -> None:
    environment = EnvironmentConfig(stiffness=stiffness)
    workcell = describe(
        multibody(
            posture_deg=list(posture), normal=list(normal), environment=environment, servo=ServoConfig(ideal=True)
        )
    )
    log = assert_compliance(workcell, 0.8 if stiffness == SPRINGS else 0.6)
    # Compliance and commanded displacement give the force.
    assert last(log, "contact_force") == pytest.approx(15.0, rel=0.02)


# The first posture on both stiffnesses, then every other one, the normals and the stiffnesses in turns.
BEHIND_DRIVES = [EVERYWHERE[k] for k in (0, 1, 5, 6, 10, 14)]


@pytest.mark.slow
@pytest.mark.parametrize(("posture", "normal", "stiffness"), BEHIND_DRIVES)
def test_compliance_is_the_same_behind_real_drives(
    posture: tuple[float, ...], normal: tuple[float, ...], stiffness: float
) -> None:
    environment = EnvironmentConfig(stiffness=stiffness)
    workcell = describe(
        multibody(posture_deg=list(posture), normal=list(normal), environment=environment, servo=FRICTIONLESS)
    )
    # Long enough for the integral part of the drives to carry the load.
    log = assert_compliance(workcell, 3.0)
    assert last(log, "contact_force") == pytest.approx(15.0, rel=0.02)


@pytest.mark.slow
@pytest.mark.parametrize("fidelity", ["OneDimensional", "Kinematic"])
def test_light_stations_have_the_same_compliance(fidelity: str) -> None:
    for normal in NORMALS:
        workcell = describe(pressing(fidelity=fidelity, normal=list(normal), servo=FRICTIONLESS))
        log = press(workcell, 15.0, 1.5)
        found = -last(log, "contact_displacement") / last(log, "contact_force")
        # C_T(q) is that of the motor posture, a millimetre further on.
        assert found == pytest.approx(compliance_of(workcell), rel=2e-3)


@pytest.mark.slow
def test_stiffer_joints_make_a_stiffer_robot() -> None:
    workcells = [
        describe(
            multibody(servo=ServoConfig(ideal=True), stiffness_set=name, environment=EnvironmentConfig(stiffness=STIFF))
        )
        for name in ("calibrated", "estimated")
    ]
    for workcell in workcells:
        assert_compliance(workcell, 0.6)
    assert compliance_of(workcells[1]) < 0.5 * compliance_of(workcells[0])


@pytest.fixture
def bending_robot(tmp_path: Path) -> Path:
    """The shipped robot with a compliant forearm and upper arm."""
    folder = tmp_path / "bending_robot"
    shutil.copytree(robot_folder("comau_smart_six"), folder)
    parameters = folder / "comau_smart_six.control.yaml"
    frames = {
        "link_3": [2e-5, 3e-5, 1e-5, 2e-6, 1e-6, 4e-6],
        "flange": [1e-5, 2e-5, 1e-5, 3e-6, 5e-6, 1e-6],
    }
    data = yaml_load(filename=parameters)
    parameters.write_text(yaml_dump(data | {"link_compliance": frames, "link_compliance_sets": None}))
    return folder


@pytest.mark.parametrize("normal", NORMALS)
def test_bending_links_of_a_users_robot_are_realised(bending_robot: Path, normal: tuple[float, ...]) -> None:
    environment = EnvironmentConfig(stiffness=STIFF)
    settings = {"normal": list(normal), "servo": ServoConfig(ideal=True), "environment": environment}
    rigid, bending = describe(multibody(**settings)), describe(multibody(robot=str(bending_robot), **settings))
    assert compliance_of(bending) > 1.1 * compliance_of(rigid)
    assert_compliance(bending, 0.6)


# --- no contact ------------------------------------------------------------------------------------------------------


def turning_retreat(workcell: Workcell, t: float) -> np.ndarray:
    """Back off by 5 mm within 0.4 s, then turn the wrist smoothly for a second, then rest."""
    away = command_for(workcell, 5e-3 * min(1.0, t / 0.4))
    s = float(np.clip((t - 0.4) / 1.0, 0.0, 1.0))
    return away + np.radians([0.0, 0.0, 0.0, 6.0, -5.0, 10.0]) * s * s * (3 - 2 * s)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("posture", "tare"), [(POSTURES[0], True), (POSTURES[0], False), (POSTURES[1], True), (POSTURES[2], False)]
)
def test_no_contact_is_no_force_on_any_path_also_after_turning_the_tool(posture: tuple[float, ...], tare: bool) -> None:
    settings = {"posture_deg": list(posture), "force_sensor": quiet_sensor(tare=tare)}
    workcell = describe(multibody(**settings))
    # Pressing along the tool axis: turning the wrist then leads away from the surface.
    axis = workcell.robot.pose(workcell.start_context()).rotation().matrix()[:, 2]
    workcell = describe(multibody(normal=(-axis).tolist(), **settings))
    log = run_diagram(
        build_station(workcell),
        2.0,
        period=0.01,
        inputs={"joint_position_command": lambda t: turning_retreat(workcell, t)},
        outputs=["measured_wrench", "measured_force", "contact_force", "contact_state", "link_position"],
    )
    free = log.time > 0.4
    assert not log["contact_force"][free].any()
    assert (log["contact_state"][free] != ContactMode.CONTACT).all()
    # What remains in motion is the inertia of the tool, small beside its weight.
    assert np.abs(log["measured_force"][free]).max() < 0.05 * TOOL_WEIGHT
    allowed = ForceSensorConfig().noise_std
    if not tare:
        # The weight is compensated for the orientation of the motor side; the joints sag under it.
        context = workcell.start_context()
        sag = workcell.robot.jacobian(context)[:3] @ (workcell.gravity_torque / workcell.spring_stiffness)
        allowed += TOOL_WEIGHT * float(np.linalg.norm(sag))
    assert abs(last(log, "measured_force")) < allowed
    assert np.abs(log["measured_wrench"][-1, 3:]).max() < allowed
    assert np.abs(log["measured_wrench"][-1, :3]).max() < allowed * ForceSensorConfig().torque_ratio


@pytest.mark.parametrize("fidelity", SHIPPED_FIDELITIES)
def test_at_rest_before_any_command_there_is_no_force(fidelity: str) -> None:
    for posture in POSTURES:
        workcell = describe(pressing(fidelity=fidelity, posture_deg=list(posture), force_sensor=quiet_sensor()))
        log = run_diagram(
            build_station(workcell), 0.1, period=0.01, inputs={"joint_position_command": workcell.motor_start}
        )
        for name in ("measured_force", "measured_wrench", "contact_force"):
            np.testing.assert_allclose(log[name], 0.0, atol=1e-6, err_msg=name)
        np.testing.assert_allclose(log["motor_position"][-1], workcell.motor_start, atol=1e-9)
        np.testing.assert_allclose(log["link_position"][-1], workcell.start, atol=1e-7)


@pytest.mark.parametrize("fidelity", SHIPPED_FIDELITIES)
def test_retreating_robot_feels_nothing(fidelity: str) -> None:
    workcell = describe(pressing(fidelity=fidelity, force_sensor=quiet_sensor()))
    log = run_diagram(
        build_station(workcell), 1.2, period=0.01, inputs={"joint_position_command": command_for(workcell, 2e-3)}
    )
    assert last(log, "contact_displacement") == pytest.approx(2e-3, rel=0.02)
    assert not log["contact_force"][-50:].any()
    assert (log["contact_state"][-50:] != ContactMode.CONTACT).all()
    assert abs(last(log, "measured_force")) < ForceSensorConfig().noise_std


# --- known loads -----------------------------------------------------------------------------------------------------


def hang_on_tool(station: MultibodyStation, context: Context, workcell: Workcell, force_W: np.ndarray) -> None:
    """Pull the TCP with a constant force [N], in the world: a load that no part of the station knows of."""
    load = ExternallyAppliedSpatialForce()
    tcp = station.plant.GetFrameByName(workcell.robot.tcp_frame.name())
    load.body_index = tcp.body().index()
    X_BT: RigidTransform = tcp.GetFixedPoseInBodyFrame()
    load.p_BoBq_B = X_BT.translation()
    load.F_Bq_W = SpatialForce(tau=np.zeros(3), f=force_W)
    plant_context = station.plant.GetMyMutableContextFromRoot(context)
    station.plant.get_applied_spatial_force_input_port().FixValue(plant_context, [load])


@pytest.mark.parametrize("posture", POSTURES)
def test_known_load_on_the_tool_is_measured_in_any_orientation_of_the_sensor(posture: tuple[float, ...]) -> None:
    # Stiff joints, so that the load does not turn the tool; without taring, which would hide a constant load.
    config = multibody(posture_deg=list(posture), elastic_joints=False, force_sensor=quiet_sensor(tare=False))
    workcell = describe(config)
    load = np.array([8.0, -5.0, 12.0])
    station = build_station(workcell)
    assert isinstance(station, MultibodyStation)
    context = station.CreateDefaultContext()
    hang_on_tool(station, context, workcell, load)
    command = command_for(workcell, 3e-3)
    log = run_diagram(station, 1.0, period=STEP, inputs={"joint_position_command": command}, context=context)
    assert not log["contact_force"][-5:].any()
    size = float(np.linalg.norm(load))
    assert last(log, "measured_force") == pytest.approx(workcell.contact.n @ load, abs=0.01 * size)
    force, torque = sensed_in_world(workcell, log)
    np.testing.assert_allclose(force, load, atol=0.01 * size)
    # The load acts at the TCP: no torque about it, beside what 0.15 m of tool make of 1 % of the force.
    np.testing.assert_allclose(torque, 0.0, atol=0.01 * size * 0.15)


@pytest.mark.slow
@pytest.mark.parametrize(("posture", "normal"), [(q, NORMALS[1 + i % 2]) for i, q in enumerate(POSTURES)])
def test_contact_force_is_hookes_law_and_is_what_the_wrist_measures(
    posture: tuple[float, ...], normal: tuple[float, ...]
) -> None:
    workcell = describe(multibody(posture_deg=list(posture), normal=list(normal), servo=ServoConfig(ideal=True)))
    log = press(workcell, 20.0, 1.0)
    context = workcell.start_context()
    undeformed = workcell.contact.n @ workcell.robot.pose(context).translation()
    workcell.robot.set_positions(context, log["link_position"][-1])
    penetration = undeformed - workcell.contact.n @ workcell.robot.pose(context).translation()
    hooke = SPRINGS * penetration
    assert hooke == pytest.approx(20.0, rel=0.02)
    assert last(log, "contact_force") == pytest.approx(hooke, rel=1e-3)
    assert last(log, "measured_force") == pytest.approx(hooke, rel=0.01)
    force, torque = sensed_in_world(workcell, log)
    np.testing.assert_allclose(force, hooke * workcell.contact.n, atol=0.01 * hooke)
    np.testing.assert_allclose(torque, 0.0, atol=0.01 * hooke * 0.15)


@pytest.mark.slow
@pytest.mark.parametrize("fidelity", ["OneDimensional", "Kinematic"])
def test_wrench_of_the_light_stations_is_that_of_the_force_at_the_tcp(fidelity: str) -> None:
    for posture, normal in zip(POSTURES, (*NORMALS, *NORMALS[1:]), strict=True):
        workcell = describe(
            pressing(
                fidelity=fidelity,
                posture_deg=list(posture),
                normal=list(normal),
                servo=ServoConfig(ideal=True),
                force_sensor=quiet_sensor(),
            )
        )
        log = press(workcell, 20.0, 1.2)
        # Seen from the motor side, where these stations put the sensor.
        context = workcell.start_context()
        workcell.robot.set_positions(context, log["motor_position"][-1])
        X_WS = sensor_frame(workcell.robot).CalcPoseInWorld(context)
        torque, force = (X_WS.rotation().matrix() @ part for part in log["measured_wrench"][-1].reshape(2, 3))
        lever = X_WS.translation() - workcell.robot.pose(context).translation()
        np.testing.assert_allclose(force, last(log, "measured_force") * workcell.contact.n, atol=1e-9)
        np.testing.assert_allclose(torque + np.cross(lever, force), 0.0, atol=1e-9)
        assert last(log, "measured_force") == pytest.approx(last(log, "contact_force"), rel=1e-3)


@pytest.mark.slow
def test_tare_takes_out_a_bias_and_without_it_the_bias_stays() -> None:
    for tare, expected in ((True, 0.0), (False, 3.0)):
        sensor = quiet_sensor(bias=3.0, tare=tare)
        for fidelity in SHIPPED_FIDELITIES:
            workcell = describe(pressing(fidelity=fidelity, force_sensor=sensor, normal=[0.0, 0.0, 1.0]))
            log = run_diagram(
                build_station(workcell), 0.6, period=0.1, inputs={"joint_position_command": workcell.motor_start}
            )
            assert abs(last(log, "measured_force")) == pytest.approx(expected, abs=0.02), fidelity
