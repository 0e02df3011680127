"""The multibody station with a torque interface: its compliance, its energy, its contacts, what controllers know."""

from collections.abc import Callable
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from pydrake.multibody.math import SpatialForce
from pydrake.multibody.plant import ExternallyAppliedSpatialForce
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Diagram

import forcectl
from forcectl.diagrams.drives.position_drive import JointImpedanceDriveConfig
from forcectl.diagrams.fidelities.multibody import MultibodyStation
from forcectl.diagrams.model import plant_model
from forcectl.diagrams.station import build_station
from forcectl.diagrams.workcell import Workcell, describe
from forcectl.doctor import Report
from forcectl.errors import BadInputError
from forcectl.estimation.recursive_vrft import GAINS
from forcectl.force.integral import IntegralConfig
from forcectl.framework.yaml_tree import Tagged
from forcectl.plant.contact.compliant_contact import EnvironmentConfig
from forcectl.plant.drives.servo import ServoConfig
from forcectl.runs.result import RunResult
from forcectl.scenario.scenario import Scenario, load_scenario
from forcectl.testing import (
    Log,
    assert_feedthrough,
    assert_memory_released,
    assert_ports,
    assert_same_after_reset_and_clone,
    run_diagram,
)
from forcectl.tuning.controller_basis import continuous_pid
from forcectl.tuning.reference_model import first_order
from forcectl.tuning.vrft import fit_vrft
from tests.diagrams.test_station_ports import INPUTS, outputs
from tests.examples.station_runs import NORMALS, PERIOD, POSTURES, SPRINGS, command_for, compliance_of, multibody

SLOW = pytest.mark.slow


def torque_workcell(servo: ServoConfig | None = None, stiffness: list[float] | None = None, **changes: Any) -> Workcell:
    drive = JointImpedanceDriveConfig(servo=servo or ServoConfig(), stiffness=stiffness or [])
    return describe(multibody(drive=drive, **changes))


def drives_compliance(workcell: Workcell) -> float:
    """n'J K_q^-1 J'n [m/N], with the default K_q = (60 rad/s)^2 B."""
    parameters, row = (
        workcell.robot.parameters,
        workcell.contact.n @ workcell.robot.jacobian(workcell.start_context())[3:],
    )
    return float(row**2 @ (1 / (60.0**2 * parameters.rotor_inertia * parameters.gear_ratio**2)))


def run(controller: Tagged | dict[str, float], interface: dict[str, Any] | None = None, **changes: Any) -> RunResult:
    scenario = {
        "station.fidelity": "Multibody",
        "station.drive": Tagged(interface or {}, "JointImpedance"),
        "controller": controller,
        "reference.force": 15.0,
        "duration": 4.0,
    } | {key.replace("__", "."): value for key, value in changes.items()}
    return forcectl.run({}, overrides=scenario)


def last(log: Log, name: str) -> float:
    return float(log[name][-1, 0])


# --- ports, rest, compliance ------------------------------------------------------------------------------------------


def test_it_has_the_ports_of_the_slot_and_no_feedthrough() -> None:
    station = build_station(torque_workcell())
    assert_ports(station, INPUTS, outputs("Multibody"))
    assert_feedthrough(station, [])


def test_it_runs_the_same_after_reset_and_clone() -> None:
    workcell = torque_workcell()
    inputs = {"joint_position_command": workcell.motor_start - 5e-4 * workcell.contact.direction}
    log = assert_same_after_reset_and_clone(build_station(workcell), duration=0.2, period=0.01, inputs=inputs)
    assert log["contact_force"][-1, 0] > 0.1


def test_the_doctor_finds_nothing_wrong_with_a_closed_loop(check_diagram: Callable[..., Report]) -> None:
    loop = Scenario(station=torque_workcell().config, controller=IntegralConfig()).build()
    assert check_diagram(loop.diagram).delays[-1].total == 0.0


@SLOW
def test_memory_is_released() -> None:
    def build() -> Diagram:
        return Scenario(station=torque_workcell().config, controller=IntegralConfig()).build().diagram

    assert_memory_released(build, duration=0.02, builds=5, allowed_kb=1792)


@pytest.mark.parametrize("posture", POSTURES[:3])
def test_at_rest_the_weight_is_carried_and_nothing_moves(posture: tuple[float, ...]) -> None:
    workcell = torque_workcell(posture_deg=list(posture))
    log = run_diagram(
        build_station(workcell), 0.2, period=0.01, inputs={"joint_position_command": workcell.motor_start}
    )
    np.testing.assert_allclose(log["contact_force"], 0.0, atol=1e-6)
    np.testing.assert_allclose(log["motor_position"], np.tile(workcell.motor_start, (21, 1)), atol=1e-9)
    np.testing.assert_allclose(log["link_position"][-1], workcell.start, atol=1e-7)


@pytest.mark.parametrize(
    ("posture", "normal", "friction"),
    [(POSTURES[0], NORMALS[0], 1.0), (POSTURES[1], NORMALS[2], 1.0), (POSTURES[1], NORMALS[2], 0.0)],
)
def test_a_static_force_moves_the_tool_by_the_compliance_of_drives_joints_and_surface(
    posture: tuple[float, ...], normal: tuple[float, ...], friction: float
) -> None:
    """C F, with friction too: the torque loop makes the springs carry what impedance control says."""
    workcell = torque_workcell(
        posture_deg=list(posture),
        normal=list(normal),
        environment=EnvironmentConfig(stiffness=2e5),
        servo=ServoConfig(friction_scale=friction),
    )
    drives = drives_compliance(workcell)
    told = plant_model(workcell)
    assert told.drive_compliance == pytest.approx(drives)
    assert told.total_compliance.item() == pytest.approx(compliance_of(workcell) + drives, rel=1e-9)
    depth = 15.0 * told.total_compliance.item()

    def command(t: float) -> np.ndarray:
        s = min(1.0, t)
        return command_for(workcell, -depth * s * s * (3 - 2 * s))

    log = run_diagram(build_station(workcell), 1.6, period=0.05, inputs={"joint_position_command": command})
    assert last(log, "contact_force") == pytest.approx(15.0, rel=0.02)
    # What the motors have not given way by is left to joints and surface.
    assert -last(log, "contact_displacement") == pytest.approx(15.0 * compliance_of(workcell), rel=0.02)


def test_stiffness_of_the_users_own() -> None:
    soft = torque_workcell(stiffness=[2e4, 2e4, 2e4, 300.0, 500.0, 300.0])
    row = soft.contact.n @ soft.robot.jacobian(soft.start_context())[3:]
    drives = row**2 @ (1 / np.array([2e4, 2e4, 2e4, 300, 500, 300]))
    assert soft.contact.robot_compliance == pytest.approx(3.2e-5 + drives)


@pytest.mark.parametrize("fidelity", ["OneDimensional", "Kinematic"])
@pytest.mark.parametrize("elastic", [True, False])
def test_the_light_stations_have_it_as_softer_joints(fidelity: str, elastic: bool) -> None:
    servo = ServoConfig(friction_scale=0.0, coulomb_friction=0.0)
    workcell = torque_workcell(fidelity=fidelity, elastic_joints=elastic, servo=servo)
    told = plant_model(workcell)
    assert told.drive_compliance == 0.0
    expected = drives_compliance(workcell) + (compliance_of(workcell) if elastic else 1 / SPRINGS)
    assert told.total_compliance.item() == pytest.approx(expected, rel=1e-9)
    depth = -15.0 * expected
    inputs = {"joint_position_command": lambda t: command_for(workcell, depth * min(1.0, t))}
    log = run_diagram(build_station(workcell), 2.0, period=0.05, inputs=inputs)
    assert last(log, "contact_force") == pytest.approx(15.0, rel=5e-3)


# --- energy -----------------------------------------------------------------------------------------------------------


def energy(workcell: Workcell, q: np.ndarray, v: np.ndarray, motors: np.ndarray, speeds: np.ndarray) -> float:
    """Of the deviations from rest: links, springs, motors as light as the torque loop makes them, impedance."""
    robot = workcell.robot
    links = robot.mass_matrix(workcell.start_context())
    rotors = np.diag(robot.parameters.rotor_inertia * robot.parameters.gear_ratio**2) / (
        1 + workcell.config.drive.torque_gain
    )
    dq, dm = q - workcell.start, motors - workcell.motor_start
    springs, impedance = np.diag(workcell.spring_stiffness), np.diag(workcell.drive_stiffness)
    terms = ((v, links), (speeds, rotors), (dq - dm, springs), (dm, impedance))
    return float(sum(0.5 * x @ matrix @ x for x, matrix in terms))


@pytest.mark.parametrize("posture", [POSTURES[0], pytest.param(POSTURES[1], marks=SLOW)])
@pytest.mark.parametrize("stiffness", [None, pytest.param(1e4, marks=SLOW), 1e6])
def test_a_robot_that_is_held_gains_no_energy(posture: tuple[float, ...], stiffness: float | None) -> None:
    """Without friction, which would help, after a push of 200 N that is let go: every 20 ms there is less."""
    height = 0.05 if stiffness is None else 0.0  # above the surface
    workcell = torque_workcell(
        posture_deg=list(posture),
        servo=ServoConfig(friction_scale=0.0),
        environment=EnvironmentConfig(stiffness=stiffness or 1e4),
    )
    station = build_station(workcell)
    assert isinstance(station, MultibodyStation)
    plant, parts = station.plant, workcell.robot.parts
    simulator = Simulator(station)
    context = simulator.get_mutable_context()
    robot = plant.GetModelInstanceByName(workcell.robot.plant.GetModelInstanceName(parts.instance))
    inner = plant.GetMyMutableContextFromRoot(context)
    station.GetInputPort("joint_position_command").FixValue(context, command_for(workcell, height))
    simulator.AdvanceTo(1.5 if height else 0.1)
    rest_q, rest_m = plant.GetPositions(inner, robot), station.GetOutputPort("motor_position").Eval(context)
    push = ExternallyAppliedSpatialForce()
    tcp = plant.GetFrameByName(workcell.robot.tcp_frame.name())
    push.body_index = tcp.body().index()
    push.p_BoBq_B = tcp.GetFixedPoseInBodyFrame().translation()
    start, stored = context.get_time(), []
    for pressed in (True, False):
        push.F_Bq_W = SpatialForce(tau=np.zeros(3), f=200.0 * np.array([0.5, 0.7, 0.5]) * pressed)
        plant.get_applied_spatial_force_input_port().FixValue(inner, [push])
        for _ in range(5 if pressed else 25):
            simulator.AdvanceTo(context.get_time() + 0.02)
            if not pressed:
                q, v = plant.GetPositions(inner, robot), plant.GetVelocities(inner, robot)
                motors, speeds = (
                    station.GetOutputPort(name).Eval(context) for name in ("motor_position", "motor_velocity")
                )
                stored.append(
                    energy(workcell, q - rest_q + workcell.start, v, motors - rest_m + workcell.motor_start, speeds)
                )
    assert context.get_time() == pytest.approx(start + 0.6)
    assert stored[0] > 0.1
    assert stored[-1] < 1e-3 * stored[0]
    assert all(after <= before + 1e-4 * stored[0] for before, after in pairwise(stored))


# --- contact and force control ---------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize(
    ("stiffness", "friction"),
    [(1e3, 1.0), (1e6, 0.0)],
)
def test_contacts_from_soft_to_stiff_settle(stiffness: float, friction: float) -> None:
    result = run(
        {"integral_gain": 1.5},
        station__environment__stiffness=stiffness,
        station__drive__servo__friction_scale=friction,
    )
    force = result.log["contact_force"].values.ravel()
    assert force.max() < 1.05 * 15.0
    assert force[-1] == pytest.approx(15.0, rel=0.01)
    assert np.ptp(force[-250:]) < 0.1


@pytest.mark.slow
@pytest.mark.parametrize(
    ("tag", "settling"),
    [
        ("AdaptiveInvariance", 3.0),
        ("AdaptiveIntegral", 3.0),
        ("Invariance", 0.8),
        ("PredictiveInvariance", 0.8),
        ("FourthDegreeInvariance", 1.6),
        ("InvarianceRobot", 0.8),
    ],
)
def test_every_force_law_works_unchanged(tag: str, settling: float) -> None:
    """They know the compliance up to the command; the adaptive ones find that of the surface from the motors."""
    result = run(Tagged({}, tag), station__environment__stiffness=SPRINGS, duration=settling + 0.4)
    (metrics,) = result.metrics.values()
    assert metrics["overshoot_pct"] < 2.0
    assert metrics["settling_time_2pct_s"] < settling
    if tag.startswith("Adaptive"):
        assert result.log["environment_compliance"].values.ravel()[-1] == pytest.approx(1 / SPRINGS, rel=0.01)


@SLOW
@pytest.mark.parametrize("material", ["springs", "aluminium"])
def test_vrft_finds_the_gains_of_the_theory_and_those_of_the_experiment(material: str) -> None:
    """K_I = -w_c C_E; K_P/K_I is the sum of the lags, stretched by the feedback of C_R, impedance included."""
    variant = f"{material}, tune and regulate"
    result = forcectl.run("vrft_torque", variant=variant, overrides={"duration": 6.6})
    found = result.metrics[variant]
    station = load_scenario("vrft_torque", variant).station
    workcell = describe(station)
    assert found["integral_gain"] == pytest.approx(-1.5 * workcell.contact.environment_compliance, rel=0.02)
    lags = 2 / 12.6 + 2 / 75.4 + 0.002
    stretched = lags * (1 + workcell.contact.robot_compliance / workcell.contact.environment_compliance)
    assert found["proportional_gain"] / found["integral_gain"] == pytest.approx(stretched, rel=0.1)
    moves = slice(0, round(6.5 / PERIOD))
    u, y = (result.log[name].values.ravel()[moves] for name in ("controller_output", "measured_force"))
    recorded = fit_vrft(u - u[0], y - y[0], first_order(1.5, PERIOD), continuous_pid(PERIOD)).gains
    assert recorded[1] == pytest.approx(-1.5 * workcell.contact.environment_compliance, rel=0.03)
    laws = [(load_scenario("vrft_torque", f"{material}, governed").controller.law, [found[gain] for gain in GAINS])]
    if material == "springs":
        laws.append((load_scenario("vrft_torque", "springs, tuned from the record").controller, recorded))
    for law, gains in laws:
        np.testing.assert_allclose([getattr(law, gain) for gain in GAINS], gains, rtol=5e-4)


@SLOW
def test_the_tuning_does_not_depend_on_the_posture() -> None:
    """The robot is five times as soft here as in the posture of the experiment."""
    posture = {"station.posture_deg": list(POSTURES[3])}
    here, there = torque_workcell(posture_deg=list(POSTURES[3])).contact, torque_workcell().contact
    assert here.robot_compliance > 5 * there.robot_compliance
    variant = "springs, tune and regulate"
    found = forcectl.run("vrft_torque", variant=variant, overrides={"duration": 6.6} | posture).metrics[variant]
    assert found["integral_gain"] == pytest.approx(-1.5 / SPRINGS, rel=0.03)


@SLOW
def test_friction_that_is_neither_divided_nor_observed_falsifies_the_tuning() -> None:
    """Why the drives have a torque loop: with plain torques the friction of the joints passes for compliance."""
    experiment = Tagged(
        {"excitation": Tagged({"depths": [0.0, 2e-3, 0.0], "rest": 1.0}, "TrapezoidalMoves"), "prefilter": False},
        "RecursiveVrft",
    )
    stiffness = 5e4
    gains = {}
    for name, interface in (("plain", {"torque_gain": 0.0, "friction_bandwidth": 0.0}), ("default", {})):
        changes = {"station.environment.stiffness": stiffness, "reference.force": 0.0, "duration": 3.0}
        result = run(experiment, interface, **changes)
        (metrics,) = result.metrics.values()
        gains[name] = metrics["integral_gain"] / (-1.5 / stiffness)
    assert gains["default"] == pytest.approx(1.0, abs=0.05)
    assert not 0.5 < gains["plain"] < 2.0


# --- bad input --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"elastic_joints": False}, "elastic_joints = False: must be true"),
        ({"servo": ServoConfig(ideal=True)}, r"servo.ideal = True: must be false"),
    ],
)
def test_a_station_that_cannot_have_it_is_refused(changes: dict[str, Any], told: str) -> None:
    with pytest.raises(BadInputError, match=told):
        build_station(torque_workcell(**changes))


def test_a_drive_that_is_none_is_refused() -> None:
    with pytest.raises(BadInputError, match=r"station\.drive = 3: must be a part: one of !PositionLoop"):
        forcectl.run({}, overrides={"station.drive": 3})


@pytest.mark.parametrize(
    ("interface", "told"),
    [
        ({"torque_gain": 50.0}, "joint . take .* must be at most"),
        ({"damping_ratio": 2.0}, "joint . take .* must be at most"),
        ({"damping_ratio": 0.02}, "must be at least its stiffness"),
        ({"stiffness": [1e4] * 5}, "stiffness has 5 values: must have 6"),
        ({"stiffness": [1e4] * 5 + [-1.0]}, "stiffness.*positive"),
        ({"stifness": [1e4] * 6}, "did you mean 'stiffness'"),
    ],
)
def test_gains_that_cannot_be_are_refused_by_name(interface: dict[str, Any], told: str) -> None:
    with pytest.raises(BadInputError, match=f"drive.*{told}"):
        run({"integral_gain": 1.5}, interface)


def test_an_unknown_drive_is_refused_with_the_nearest() -> None:
    with pytest.raises(BadInputError, match=r"station\.drive: unknown tag .*did you mean '!JointImpedance'"):
        forcectl.run({}, overrides={"station.drive": Tagged({}, "JointImpedence")})
