"""The loop: its slots from outside, what does not fit them, delays, determinism, loads, logs, what it knows."""

from dataclasses import replace

import numpy as np
import pytest
from pydrake.systems.framework import DiagramBuilder, LeafSystem
from pydrake.systems.primitives import ConstantVectorSource, ZeroOrderHold

from forcectl.diagrams.fidelities.light import KinematicFidelity
from forcectl.diagrams.signals import FromConfig
from forcectl.diagrams.station import SHIPPED_FIDELITIES, StationConfig
from forcectl.errors import BadInputError
from forcectl.estimation.force_estimator_config import ForceEstimatorConfig
from forcectl.force.integral import IntegralConfig
from forcectl.framework.sampled_block import SampledBlock
from forcectl.motion.joint_path import DitherConfig, JointMovesConfig, PostureConfig
from forcectl.motion.loads import LoadConfig
from forcectl.motion.references import StepConfig
from forcectl.plant.sensors.force_sensor import ForceSensorConfig
from forcectl.scenario.scenario import Scenario
from forcectl.tasks.controllers.reaching import ReactiveReachingConfig
from forcectl.testing import assert_memory_released
from tests.examples.joint_interface_runs import TICK
from tests.examples.motion_runs import motion_loop, run
from tests.examples.station_runs import FORCE, SPRINGS
from tests.examples.stations import free, pressing

ARM = ("yumi/left", None)
COMMANDS = ("joint_position_command", "joint_velocity_command")
FREE = {"friction": {"scale": 0.0}, "sensors": {"quantum": 0.0}}


class Echo(SampledBlock):
    """The position it reads plus 1 mrad, from 20 ms on; its command of a tick."""

    def __init__(self, size: int, start: np.ndarray):
        super().__init__()
        self.declare_memory({COMMANDS[0]: start}, [self.DeclareVectorInputPort("joint_position", size)], TICK)
        self.show(COMMANDS[0])

    def step(self, context, memory, inputs):
        return {COMMANDS[0]: inputs["joint_position"] + 1e-3 * (context.get_time() > 0.018)}


class Filler:
    """A filler of the controller's slot, or one with a fault."""

    def __init__(self, **changed):
        self.changed = changed

    def add_to(self, builder, model):
        inner = DiagramBuilder()
        n = model.num_joints
        echo = inner.AddNamedSystem("echo", Echo(n, model.start))
        rest = inner.AddNamedSystem("rest", ConstantVectorSource(np.zeros(self.changed.get("size", n))))
        inner.ExportInput(echo.GetInputPort("joint_position"), self.changed.get("input", "joint_position"))
        inner.ExportOutput(echo.GetOutputPort(COMMANDS[0]), COMMANDS[0])
        inner.ExportOutput(rest.get_output_port(), self.changed.get("output", COMMANDS[1]))
        return builder.AddNamedSystem("controller", inner.Build())


def test_a_command_moves_the_robot_in_the_tick_it_is_computed_in():
    """From a reading to the motion it causes: no tick of the loop, one plant step, then the servo."""
    loop = motion_loop(*ARM, Filler(), **FREE)
    log = run(loop, 0.04)
    moved = np.abs(log["link_position"] - log["link_position"][0]).max(axis=1) > 1e-7
    assert log["time"][np.argmax(moved)] == pytest.approx(0.024)
    asked = np.abs(log[COMMANDS[0]] - log["joint_position"]).max(axis=1) > 5e-4
    assert log["time"][np.argmax(asked)] == pytest.approx(0.020)


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"input": "joint_angle"}, "reads joint_angle, which no part outputs: must be one of joint_position"),
        ({"size": 3}, "joint_velocity_command has size 3: must be 7"),
        ({"input": "estimated_torque"}, "reads estimated_torque (estimated external joint torques), which no part"),
        (
            {"input": "link_position"},
            "reads link_position (positions of the links, behind the joint elasticity), which",
        ),
    ],
)
def test_what_does_not_fit_the_slot_is_refused_by_port(changed, message):
    with pytest.raises(BadInputError) as caught:
        motion_loop(*ARM, Filler(**changed))
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


def test_estimates_reach_a_controller_that_wants_them():
    loop = motion_loop(*ARM, Filler(input="estimated_torque"), ForceEstimatorConfig())
    assert np.isfinite(run(loop, 0.02)["estimated_torque"]).all()


def test_drives_that_are_told_no_speed_follow_the_positions():
    loop = motion_loop(*ARM, Filler(output="speed"), **FREE)
    log = run(loop, 0.04)
    assert np.abs(log["link_position"][-1] - log["link_position"][0]).max() > 1e-7


class Odd:
    """An estimator whose block has this input, or none at all."""

    def __init__(self, wanted=None):
        self.wanted = wanted

    def add_to(self, builder, model):
        if self.wanted is None:
            return None

        class Half(LeafSystem):
            def __init__(self, name):
                super().__init__()
                self.DeclareVectorInputPort(name, model.num_joints)

        return builder.AddNamedSystem("half", Half(self.wanted))


@pytest.mark.parametrize(
    ("wanted", "message"),
    [
        (None, "estimators.force: add_to must return a Drake system, not NoneType"),
        ("joint_angle", "estimators.force reads joint_angle, which no part outputs"),
        ("external_torque", "estimators.force reads external_torque"),
    ],
)
def test_an_estimator_that_does_not_fit_is_refused(wanted, message):
    with pytest.raises(BadInputError) as caught:
        motion_loop(*ARM, JointMovesConfig(), Odd(wanted))
    assert message in str(caught.value)


def test_every_signal_is_logged_with_its_unit_and_its_components():
    loads = [LoadConfig(arm="right", wrenches=[[0, 0, 0, 0, 0, 1]])]
    loop = Scenario(
        station=free(loads=loads), controller=JointMovesConfig(), estimators={"force": ForceEstimatorConfig()}
    ).build()
    units = {name: signal.unit for name, signal in loop.signals.items()}
    assert units == {
        "joint_position": "rad",
        "joint_velocity": "rad/s",
        "motor_torque": "Nm",
        "motor_position": "rad",
        "motor_velocity": "rad/s",
        "link_position": "rad",
        "link_velocity": "rad/s",
        "external_torque": "Nm",
        "tip_wrench": "Nm,N",
        "arm_contact_force": "N",
        "applied_wrench": "Nm,N",
        "joint_position_command": "rad",
        "joint_velocity_command": "rad/s",
        "estimated_torque": "Nm",
        "estimated_wrench": "Nm,N",
        "residual": "Nm",
        "torque_balance": "Nm",
        "balance_ok": "1",
        "near_singular": "1",
        "status": "1",
    }
    assert loop.signals["estimated_wrench"].labels[-1] == "right_force_z"
    assert loop.signals["arm_contact_force"].labels == ("left", "right")
    assert loop.signals["residual"].labels[7] == "right_joint_1"


def test_signals_of_one_name_do_not_hide_each_other():
    parts = {"station": free(), "controller": ReactiveReachingConfig(), "estimators": {"force": ForceEstimatorConfig()}}
    signals = Scenario(**parts).build().signals
    assert signals["near_singular"].labels is None  # of the controller
    assert signals["force_near_singular"].labels == ("left", "right")
    parts["estimators"]["other"] = ForceEstimatorConfig(gain=20.0)
    chosen = {"estimated_wrench": FromConfig(part="other"), "estimated_torque": FromConfig(part="force")}
    loop = Scenario(**parts, signals=chosen, duration=0.1).build()
    log = run(loop, 0.1)
    assert {"force_estimated_wrench", "other_estimated_torque"} <= {*log}
    assert not {"other_estimated_wrench", "force_estimated_torque"} & {*log}
    assert loop.signals["force_estimated_wrench"].unit == "Nm,N"


@pytest.mark.slow
def test_the_same_seed_gives_the_same_bits():
    logs = []
    for seed in (1, 1, 2):
        station = free(robot=ARM[0], tool=None, time_step=0.001, sensors={"torque_noise": 0.1})
        moves = JointMovesConfig(dither=DitherConfig(amplitude_deg=0.5))
        estimators = {"force": ForceEstimatorConfig()}
        logs.append(run(Scenario(station=station, controller=moves, estimators=estimators, seed=seed).build(), 0.3))
    for name, values in logs[0].items():
        np.testing.assert_array_equal(values, logs[1][name])
    assert (logs[0]["estimated_torque"] != logs[2]["estimated_torque"]).any()


def test_moves_reach_their_postures():
    there = [10.0, -120.0, 120.0, 40.0, 10.0, 50.0, -20.0]
    moves = JointMovesConfig(postures=[PostureConfig(posture_deg=there, start=0.1, duration=0.8)])
    log = run(motion_loop(*ARM, moves), 1.4)
    np.testing.assert_allclose(np.degrees(log["link_position"][-1]), there, atol=0.05)
    for name in COMMANDS:
        assert np.isfinite(log[name]).all()
    rate = np.gradient(log[COMMANDS[0]], TICK, axis=0)[2:-2]
    np.testing.assert_allclose(log[COMMANDS[1]][2:-2], rate, atol=2e-3)


@pytest.mark.parametrize(
    ("postures", "message"),
    [
        ([PostureConfig(posture_deg=[1.0])], "postures.0.posture_deg has 1 angles: must have 7"),
        ([PostureConfig(posture_deg=[999.0] * 7)], "within the joint limits"),
        ([PostureConfig(posture_deg=[0.0] * 7, duration=0.1)], "duration = 0.1: must be at least"),
    ],
)
def test_a_posture_that_cannot_be_is_refused_by_name(postures, message):
    with pytest.raises(BadInputError) as caught:
        motion_loop(*ARM, JointMovesConfig(postures=postures))
    assert message in str(caught.value)


def test_moves_that_overlap_are_refused():
    with pytest.raises(BadInputError, match=r"postures\.1\.start = .*must be at least 1\.5 s, after the move before"):
        JointMovesConfig(postures=[PostureConfig(start=0.5), PostureConfig(start=1.0)])


def test_loads_act_when_they_are_said_to():
    load = LoadConfig(start=0.02, hold=0.04, pause=0.02, ramp=0.01, wrenches=[[0, 0, 0, 8, 0, 0]], repeats=2, every=0.1)
    log = run(motion_loop(*ARM, None, None, [load]), 0.26)
    force, time = log["applied_wrench"][:, 3], log["time"]
    # The load of a tick shows in the next one of the log.
    expected = np.array([load.wrench(t - TICK + 1e-9)[3] if t >= TICK else 0.0 for t in time])
    np.testing.assert_allclose(force, expected, atol=1e-9)
    assert force.max() == 8.0
    assert np.count_nonzero(np.diff((force > 0).astype(int)) == 1) == 2
    np.testing.assert_allclose(log["tip_wrench"][:, 3], force)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"wrenches": []}, "at least one wrench"),
        ({"wrenches": [[1.0, 2.0]]}, "wrenches.0 = [1.0, 2.0]: must be six numbers"),
        ({"hold": 0.1, "ramp": 0.2}, "ramp = 0.2: must be at most half of hold"),
        ({"repeats": 2, "every": 0.5}, "every = 0.5: must be at least"),
        ({"start": -1.0}, "start = -1"),
    ],
)
def test_a_load_that_cannot_be_is_refused_by_name(options, message):
    with pytest.raises(BadInputError) as caught:
        LoadConfig(**{"wrenches": [[0.0, 0, 0, 8, 0, 0]], **options})
    assert message in str(caught.value)


def test_a_load_on_an_arm_that_is_not_there_is_refused():
    with pytest.raises(BadInputError, match="unknown arm 'middle'"):
        motion_loop(*ARM, None, None, [LoadConfig(arm="middle", wrenches=[[0.0, 0, 0, 8, 0, 0]])])


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"gain": 0.0}, "gain = 0"),
        ({"friction_scale": -1.0}, "friction_scale = -1"),
        ({"moment": 1}, "moment = 1: must be true or false"),
        ({"tare_duration": float("nan")}, "tare_duration = nan"),
    ],
)
def test_an_estimator_that_cannot_be_is_refused_by_name(options, message):
    with pytest.raises(BadInputError) as caught:
        ForceEstimatorConfig(**options)
    assert message in str(caught.value)


def test_nothing_keeps_a_loop_alive():
    assert_memory_released(lambda: motion_loop(*ARM, None, ForceEstimatorConfig()).diagram, builds=3, allowed_kb=2048)


def test_reference_beyond_the_sensor_is_refused() -> None:
    station = pressing(force_sensor=replace(ForceSensorConfig(), range=10.0))
    with pytest.raises(BadInputError, match=r"reference\.force = 15.*10 N"):
        Scenario(station=station, reference=StepConfig(force=FORCE)).build()


@pytest.mark.parametrize("fidelity", SHIPPED_FIDELITIES)
def test_believed_compliance_in_the_loop_is_the_true_one(fidelity: str) -> None:
    loop = Scenario(station=StationConfig(fidelity=fidelity), controller=IntegralConfig()).build()
    assert loop.workcell.contact.environment_compliance == pytest.approx(1 / SPRINGS)
    assert loop.workcell.contact.robot_compliance == pytest.approx(3.2e-5, rel=1e-3)
    assert loop.reference_model_bandwidth == 1.5


class _TwoForces(KinematicFidelity):
    """A station that puts out two true forces at its only surface."""

    def build(self, workcell, seed):
        builder = DiagramBuilder()
        joints = workcell.num_joints
        command = builder.AddNamedSystem("command", ZeroOrderHold(workcell.period, joints))
        builder.ExportInput(command.get_input_port(), "joint_position_command")
        sizes = {"measured_force": 1, "contact_force": 2, "motor_position": joints, "motor_velocity": joints}
        for name, size in sizes.items():
            block = builder.AddNamedSystem(name, ConstantVectorSource(np.zeros(size)))
            builder.ExportOutput(block.get_output_port(), name)
        return builder.Build()


def test_a_station_has_one_true_force_at_each_surface():
    message = r"^station\.fidelity outputs contact_force of size 2: must be 1, one for each surface$"
    with pytest.raises(BadInputError, match=message):
        Scenario(station=StationConfig(fidelity=_TwoForces())).build()
