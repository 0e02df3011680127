"""Findings of joints, tasks and state machines: one arm in motion, and logs in which what happened is changed."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
import xarray as xr
from pydrake.systems.framework import DiagramBuilder, LeafSystem

import forcectl as fc
from forcectl.analysis.findings import FindingsConfig
from forcectl.analysis.findings.finding import KINDS, RunFinding
from forcectl.analysis.findings.joints import joint_findings, task_findings
from forcectl.diagrams.drives.joint_interface import JointInterfaceConfig
from forcectl.diagrams.model import Setting
from forcectl.framework.yaml_tree import parse
from forcectl.plant.contact.parts import EnvironmentPartsConfig
from tests.examples import stations
from tests.examples.joint_interface_runs import describe

TICK = 0.004
TIME = TICK * np.arange(501)
ARM: Setting = stations.setting(describe(sensors={}))
START, LIMITS = ARM.truth.start, ARM.truth.known_robot().limits
JOINTS = list(ARM.truth.known_robot().parameters.arm_joints)


class Swing(LeafSystem):
    """The first joint swings, the others stay."""

    def __init__(self, amplitude: float, rate: float):
        super().__init__()

        def put(name: str, value: Any) -> None:
            self.DeclareVectorOutputPort(
                name, 7, lambda c, y: y.SetFromVector(value(c.get_time())), {self.time_ticket()}
            )

        first = np.eye(7)[0]
        put("joint_position_command", lambda t: START + first * amplitude * (1 - np.cos(rate * t)))
        put("joint_velocity_command", lambda t: first * amplitude * rate * np.sin(rate * t))


@dataclass
class SwingConfig:
    amplitude: float
    rate: float

    def add_to(self, builder: DiagramBuilder, model: Any) -> LeafSystem:
        return builder.AddNamedSystem("swing", Swing(self.amplitude, self.rate))


def swung(speed: float, rate: float) -> set[str]:
    """Kinds of findings of a run of one arm whose first joint swings, up to this share of its speed limit."""
    station = {"robot": "yumi/left", "tool": None, "time_step": 0.002, "sensors": {}}
    station |= {"drive": JointInterfaceConfig(), "environment": EnvironmentPartsConfig(), "gravity": False}
    swing = SwingConfig(speed * LIMITS.velocity[0] / rate, rate)
    result = fc.run({"preset": "ideal", "station": station, "controller": swing, "duration": 0.5})
    return {one.kind for one in result.findings["default"]}


def test_a_joint_that_is_sent_too_fast_is_told_of_command_and_link() -> None:
    assert swung(1.06, 12.0) == {"command_beyond_limits", "links_beyond_limits"}
    assert swung(0.93, 12.0) == set()


def made_up(**signals: Any) -> xr.Dataset:
    """A log of one arm at rest, but for these signals."""
    still, stand = np.zeros((len(TIME), 7)), np.tile(START, (len(TIME), 1))
    rows = dict.fromkeys(("joint_position_command", "link_position", "motor_position"), stand)
    rows |= dict.fromkeys(("joint_velocity_command", "link_velocity", "motor_torque"), still)
    log = xr.Dataset(coords={"time": TIME, "joint": JOINTS})
    for name, values in (rows | signals).items():
        log[name] = (("time", *{7: ["joint"], 6: ["task"]}.get(np.shape(values)[-1], [])), values)
    return log


def of_joints(**signals: Any) -> list[RunFinding]:
    return list(joint_findings(made_up(**signals), ARM, FindingsConfig()))


def on_joint(k: int, values: Any) -> np.ndarray:
    """Values of joint k, at its start else."""
    return np.outer(values, np.eye(7)[k])


def test_position_limits_may_be_passed_by_a_hundredth_of_their_span() -> None:
    span = LIMITS.position_upper[3] - LIMITS.position_lower[3]
    far = LIMITS.position_upper[3] - START[3] + span * np.array([0.02, 0.005])
    out, within = (START + on_joint(3, np.clip(TIME, 0, 1) * way) for way in far)
    (one,) = of_joints(link_position=out)
    assert one.text == f"{JOINTS[3]} is {np.degrees(0.02 * span):.3g} deg beyond its position limits"
    assert of_joints(link_position=within) == []
    (one,) = of_joints(joint_position_command=out)
    assert one.kind == "command_beyond_limits"
    assert of_joints(joint_position_command=within) == []


def test_a_motor_at_its_torque_limit_is_saturated() -> None:
    (one,) = of_joints(motor_torque=on_joint(2, LIMITS.torque[2] * (np.sin(7 * TIME) > 0.5)))
    assert one.kind == "command_saturated"
    assert of_joints(motor_torque=on_joint(2, 0.98 * LIMITS.torque[2] * np.sin(7 * TIME))) == []


def test_a_drive_without_a_limit_is_told_of_a_motor_that_may_need_more_than_it_has() -> None:
    (one,) = of_joints(torque_share=on_joint(2, 1.2 * np.sin(7 * TIME)))
    assert one.kind == "torque_beyond_limits"
    assert one.text == f"{JOINTS[2]} may need 120 % of the torque limit of its motor"
    assert of_joints(torque_share=on_joint(2, 0.98 * np.sin(7 * TIME))) == []


@pytest.mark.parametrize(("frequency", "kinds"), [(14.0, ["chatter"]), (2.0, [])])
def test_commands_that_turn_round_at_rest_chatter(frequency: float, kinds: list[str]) -> None:
    phase = 2 * np.pi * frequency * TIME
    position = START + on_joint(5, 2e-4 * np.sin(phase))
    speed = on_joint(5, 2e-4 * 2 * np.pi * frequency * np.cos(phase))
    found = of_joints(joint_position_command=position, joint_velocity_command=speed)
    assert [one.kind for one in found] == kinds


@pytest.mark.parametrize(("steps", "kinds"), [(6, ["stick_slip"]), (400, []), (2, [])])
def test_a_joint_that_moves_in_jerks_while_its_command_goes_on_sticks(steps: int, kinds: list[str]) -> None:
    way = 0.02 * TIME
    jerky = np.round(way / way[-1] * steps) / steps * way[-1]
    signals = {"joint_position_command": START + on_joint(4, way), "motor_position": START + on_joint(4, jerky)}
    found = of_joints(**signals, joint_velocity_command=on_joint(4, np.full_like(TIME, 0.02)))
    assert [one.kind for one in found] == kinds


def test_a_joint_that_rests_where_its_command_turns_round_does_not_stick() -> None:
    phase = 2 * np.pi * 2.0 * TIME
    motor = START + on_joint(4, 0.1 * np.clip(np.sin(phase), -0.8, 0.8))
    speed = on_joint(4, 0.1 * 4 * np.pi * np.cos(phase))
    assert of_joints(motor_position=motor, joint_velocity_command=speed) == []


def test_a_joint_that_rests_where_its_dither_turns_it_round_does_not_stick() -> None:
    way = 0.02 * TIME
    motor = np.round(way / way[-1] * 6) / 6 * way[-1]
    signals = {"motor_position": START + on_joint(4, motor), "joint_velocity_command": on_joint(4, 0.02 + 0 * TIME)}
    assert [one.kind for one in of_joints(**signals)] == ["stick_slip"]
    dithered = on_joint(4, 0.02 + 0.1 * np.cos(2 * np.pi * 6.0 * TIME))
    assert of_joints(**signals, dithered_velocity=dithered) == []


def of_tasks(**signals: Any) -> list[RunFinding]:
    target = np.tile([0.3, 0.2, 0.1, 0.0, 0.0, 0.0], (len(TIME), 1))
    target[TIME < 0.5, 0] = 0.25
    never = np.zeros(len(TIME))
    rows = {"task_target": target, "task_position": target.copy(), "reached": 1.0 + never}
    rows |= dict.fromkeys(("stalled", "status", "holding"), never)
    return list(task_findings(made_up(**(rows | signals)), ARM))


def test_targets_that_are_not_reached_are_told_with_their_distance() -> None:
    assert of_tasks() == []
    place = np.tile([0.3, 0.2, 0.37, 0.0, 0.0, 0.0], (len(TIME), 1))
    off = {"task_position": place, "reached": np.zeros(len(TIME))}
    (one,) = of_tasks(**off)
    assert one.kind == "target_not_reached"
    assert one.text == (
        "the last targets, set at 0.5 s, are not reached: the distance at the end is 270 mm (left) and still decreases"
    )
    (one,) = of_tasks(**off, stalled=np.ones(len(TIME)))
    assert one.kind == "target_stalled"
    assert "270 mm (left) and no longer decreases" in one.text
    # What is nearly there is there, and what is sent elsewhere in the last moment is not late.
    assert of_tasks(**(off | {"task_position": np.tile([0.3005, 0.2, 0.1, 0.0, 0.0, 0.0], (len(TIME), 1))})) == []
    late = place.copy()
    late[TIME > 1.95, 0] = 0.4
    assert of_tasks(**off, task_target=late) == []
    # Reached at the end is reached.
    assert of_tasks(reached=(TIME > 1.9).astype(float)) == []


REACH = """
preset: ideal
station:
  robot: yumi
  tool: null
  time_step: 0.002
  drive: !JointInterface {}
  sensors: {joints: !JointReadings {}}
  environment: !Parts {}
controller: !ReactiveReaching
  targets: [{arm: left, position: [0.9, 0.4, 0.25]}]
duration: 0.4
"""


@pytest.mark.slow
def test_a_reach_beyond_the_arm_ends_in_words() -> None:
    """The same reach, cut short; one that has the time for its target is in the tests of the controller."""
    for duration, kind, end in (
        (0.4, "target_not_reached", "still decreases"),
        (2.6, "target_stalled", "no longer decreases"),
    ):
        result = fc.run(fc.load_scenario(parse(REACH, "far.yaml"), overrides={"duration": duration}))
        (one,) = result.findings["default"]
        assert one.kind == kind
        assert f"0 mm (right) and {end}" in one.text


def test_ticks_without_a_solution_and_ticks_that_only_hold_are_told_apart() -> None:
    ticks = ((TIME > 1.0) & (TIME < 1.0101)).astype(float)
    (one,) = of_tasks(status=3.0 * ticks, holding=ticks)
    assert (one.kind, one.time) == ("solver_fallback", pytest.approx(1.004))
    why = "its optimisation problem has no solution (solver failed)"
    assert one.text == f"the controller uses its fallback in 2 of 501 ticks: {why}"
    (one,) = of_tasks(holding=ticks)
    assert one.kind == "held"
    assert of_tasks(status=1.0 * ticks) == []  # soft rows are missed, as they may be


@pytest.mark.parametrize(
    ("read", "what"),
    [
        (lambda q, at: np.where(at, q[np.argmax(at) - 1], q), "repeats while its command moves on"),
        (lambda q, at: np.where(at, np.nan, q), "is not a number"),
        (lambda q, at: np.where(at, q + 1.0, q), "is far from its command"),
    ],
)
def test_readings_that_stop_a_controller_are_told_by_joint(read: Any, what: str) -> None:
    poor = (TIME > 1.0) & (TIME < 1.0201)
    position, ok = np.outer(np.sin(TIME), np.ones(7)), np.ones((len(TIME), 7))
    position[:, 2], ok[poor, 2] = read(position[:, 2], poor), 0.0
    late = (poor & (TIME > 1.0101)).astype(float)  # the controller bridges a gap of some ticks
    (one,) = of_tasks(status=4.0 * late, holding=late, reading_ok=ok, joint_position=position)
    told = f"the reading of {JOINTS[2]} {what}"
    assert (one.kind, one.text) == ("solver_fallback", f"the controller uses its fallback in 3 of 501 ticks: {told}")
    (one,) = of_tasks(status=4.0 * late, holding=late, reading_ok=np.ones((len(TIME), 7)))
    assert one.text.endswith("a reference, reading or constraint is not a number, or a constraint raises an error")


@pytest.mark.parametrize(("end", "kinds"), [(2.0, ["machine_failed"]), (0.0, ["machine_not_ended"]), (1.0, [])])
def test_a_machine_that_fails_or_does_not_end_is_told(end: float, kinds: list[str]) -> None:
    log = made_up().drop_vars(["motor_torque", "joint_position_command"])
    later = (TIME >= 1.2).astype(float)
    log["mode"] = ("time", later, {"flag_meanings": "lower lost", "flag_reasons": "lost: no part"})
    signals = {"transition": later, "transition_value": 0.3 * later, "machine_end": end * later}
    for name, values in signals.items():
        log[name] = ("time", values)
    found = list(task_findings(log, ARM))
    assert [one.kind for one in found] == kinds
    if end == 2.0:
        told = "the state machine ended in the failure 'lost' after 'lower', at 1.200 s: no part"
        assert found[0].text == told
        for begin, held_back in ((1.15, False), (1.05, True)):
            log["active_constraints"] = ("time", (begin < TIME) & (TIME < 1.2))
            (one,) = task_findings(log, ARM)
            assert one.text == told + held_back * (
                "; limits or constraints, such as the distance of links, were active in the 0.1 s before"
            )
        log["joint_position_command"] = (("time", "joint"), np.tile(LIMITS.position_upper, (len(TIME), 1)))
        (one,) = task_findings(log, ARM)
        assert f"; limits or constraints ({JOINTS[0]} is at its position limit, {JOINTS[1]} is at" in one.text


def test_every_kind_is_provoked_here_or_in_the_tests_of_force_loops() -> None:
    from tests.analysis.findings.test_force import CASES

    here = {"command_beyond_limits", "links_beyond_limits", "command_saturated", "chatter", "stick_slip", "held"}
    here |= {"target_not_reached", "target_stalled", "solver_fallback", "machine_failed", "machine_not_ended"}
    here |= {"guarded", "guard_stopped"}  # in test_guard
    here |= {"torque_beyond_limits", "compliance_off"}  # the second in test_compliance
    here |= {"swings_beside_reference", "reference_not_followed", "touched_again"}  # in test_holds
    here |= {"friction_unknown", "key_unread"}  # in tests/analysis/test_analyses.py, tests/scenario/test_effects.py
    assert set(KINDS) == here | set(CASES)
