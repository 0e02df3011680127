"""Keys that change nothing in their scenario are refused in one line."""

from __future__ import annotations

import pytest

from forcectl.errors import BadInputError
from forcectl.runs.run import run
from forcectl.scenario.scenario import build, load_scenario

SEGMENTS = "materials: {segments: [{material: plastic, start: -1, end: 1}]}"
# Text of a scenario; how the message goes on after file and line.
REFUSED = [
    ("{environment: {surface: {slope: 0.1}}}", "environment.surface.slope = 0.1: must be left out without a motion"),
    (
        "{environment: {surface: {heights: {w: !Waves {}}}}}",
        "environment.surface.heights = ['w']: must be left out without a motion along the surface",
    ),
    (
        f"{{environment: {{stiffness: 1e4, surface: {{{SEGMENTS}}}}}}}",
        "environment.stiffness = 10000.0: must be left out beside surface.materials, whose segments say it",
    ),
    (
        f"{{environment: {{damping: 10, surface: {{{SEGMENTS}}}}}}}",
        "environment.damping = 10.0: must be left out beside surface.materials, whose segments say it",
    ),
    (
        "{self_collision: true}",
        "self_collision = true: must be false or left out, or have a fidelity with dynamics, such as Multibody, not",
    ),
    (
        "{elastic_joints: false, stiffness_scale: 2}",
        "stiffness_scale = 2.0: must be left out with elastic_joints = false: rigid joints have none",
    ),
    (
        "{drive: {servo: {ideal: true, position_gain: 3}}}",
        "drive.servo.position_gain = 3.0: must be left out with ideal = true: an ideal servo has no loops",
    ),
]
LOAD = "!Load {wrenches: [[0, 0, 0, 5, 0, 0]]}"
BACK = "!Load {wrenches: [[0, 0, 0, -5, 0, 0]]}"
MOVES = "controller: !RecursiveVrft {excitation: !TrapezoidalMoves"


def over(surface: str) -> str:
    """A motion of 50 mm over a surface."""
    return f"{{motion: {{distance: 0.05}}, station: {{environment: {{surface: {{{surface}}}}}}}}}"


SURFACE = "station.environment.surface"
HEIGHTS = f"{SURFACE}.heights"
# Text of a whole scenario; how the message goes on after file and line.
WITHOUT_TRACE = [
    (
        "station: {loads: [!Load {wrenches: [[0, 0, 0, 1e-6, 0, 0]]}]}",
        "station.loads.0.wrenches = [[0.0, 0.0, 0.0, 1e-06, 0.0, 0.0]]: must be above 0.0001 N or Nm at some time",
    ),
    (over("heights: {w: !Waves {amplitude: 1e-9}}"), f"{HEIGHTS}.w is level where the motion goes, from 0 to 0.05 m:"),
    (f"station: {{loads: [{LOAD}, {BACK}]}}", "station.loads.1.wrenches = [[0.0, 0.0, 0.0, -5.0, 0.0, 0.0]]: must be"),
    ("station: {loads: [!Load {body: base, wrenches: [[0, 0, 0, 1, 0, 0]]}]}", "station.loads.0.body = 'base': must b"),
    (over("heights: {w: !Waves {wavelength: 5}}"), f"{HEIGHTS}.w.wavelength = 5.0: must be at most 0.4 m, twice len"),
    (over("heights: {g: !Grooves {positions: [0.1]}}"), f"{HEIGHTS}.g is level where the motion goes, from 0 to 0.05"),
    (over("heights: {g: !Grooves {positions: [-0.02]}}"), f"{HEIGHTS}.g is level where the motion goes, from 0 to 0."),
    (over("heights: {g: !Grooves {}}, direction: [0, 1, 0]"), f"{SURFACE}.direction = [0.0, 1.0, 0.0]: must be along"),
    (
        "station: {environment: {surface: {materials: {segments: [{material: plastic, start: -1, end: 0.01}, "
        "{material: wood, start: 0.01, end: 1}]}}}}",
        f"{SURFACE}.materials.segments = 'several': must be one without a motion along the surface",
    ),
    (over("slope: 0.1, direction: [0, 1, 0]"), f"{SURFACE}.direction = [0.0, 1.0, 0.0]: must be along motion.direct"),
    ("station: {faults: [!ReadingFault {}]}", "station.faults = '1 faults': must be left out without a sensor of the"),
    ("station: {environment: {surface: {turning: true}}}", "station.environment.surface.turning = True: must be left"),
    ("station: {environment: {damping: 6000}}", "station.environment.damping = 6000.0: must be at most 5900 N s/m, 1"),
    ("station: {drive: {servo: {position_gain: 0.001}}}", "station.drive.servo.position_gain = 0.001: must be at leas"),
    ("controller: {integral_gain: 1e-6}", "controller.integral_gain = 1e-06: must be at least 0.01 1/s, one over 20 t"),
    ("controller: !Vrft {reference_bandwidth: 1e6}", "controller.reference_bandwidth = 1000000.0: must be below 1000"),
    (f"{MOVES} {{speed: 1e-6}}}}", "controller.excitation.speed = 1e-06: must be such that the moves end before 100 s"),
    (f"{MOVES} {{rest: 600}}}}", "controller.excitation.rest = 600.0: must be such that the moves end before 100 s, 2"),
    (f"{MOVES} {{depths: [0, 2]}}}}", "controller.excitation.depths.1 = 2.0: must be from -1 to 1"),
    ("controller: !Vrft {proportional_gain: 1e-3}", "controller.proportional_gain = 0.001: must be at most 2.53e-05 m"),
    ("controller: {lower_limit: -1e-6}", "controller.lower_limit = -1e-06: must be at most -3e-05 m, a hundredth of"),
    ("controller: !Invariance {gamma: -1e-9}", "controller.gamma = -1e-09: must be from -1000 to -1e-6"),
    ("station: {drive: {position_loop: {bandwidth: 7540}}}", "station.drive.position_loop.bandwidth = 7540.0: must be"),
    ("guard: {retreat_distance: 1, retreat_speed: 0.001}", "guard.retreat_distance = 1.0: must be at most 0.06 m, 60"),
    ("controller: !JointMoves {dither: {amplitude_deg: 0.1, ramp: 9}}", "controller.dither.ramp = 9.0: must be below"),
]  # fmt: skip
# What may look like it, and has an effect, or is said by a preset.
ACCEPTED = [
    "station: {environment: {surface: {slope: 0.1}}}\nmotion: {distance: 0.01}",
    "station: {environment: {surface: {heights: {w: !Waves {}}}}}\nmotion: {distance: 0.01}",
    f"preset: delay_only\nstation: {{environment: {{surface: {{{SEGMENTS}}}}}}}",
    "preset: ideal\nstation: {self_collision: false}",
    over("heights: {g: !Grooves {positions: [0.058]}}"),
    over("moves: [{distance: -0.001}], direction: [0, 1, 0]"),
    "motion: {distance: 0.05, direction: [-1, 1, 0]}\nstation: {environment: {surface: {slope: 0.1}}}",
]
LATER = f"station: {{loads: [{LOAD}, {BACK.replace('wrenches', 'start: 0.5, wrenches')}]}}"


@pytest.mark.parametrize(("text", "message"), WITHOUT_TRACE)
def test_what_leaves_no_trace_in_the_run_is_refused(tmp_path, text, message):
    file = tmp_path / "own.yaml"
    file.write_text(text)
    with pytest.raises(BadInputError) as caught:
        build(file)
    assert str(caught.value).startswith(f"own.yaml:1: {message}")
    assert "\n" not in str(caught.value)


def test_loads_that_cancel_each_other_for_a_while_are_not(tmp_path):
    file = tmp_path / "own.yaml"
    file.write_text(LATER)
    assert build(file).workcell.contact.name == "environment"


def test_a_guard_that_stops_what_a_mode_presses_with_is_refused():
    with pytest.raises(BadInputError, match=r"maximum_force = 6.5: must be above controller.modes.align.*force, 7 N"):
        load_scenario("peg_in_hole", None, {"guard.maximum_force": 6.5})
    load_scenario("peg_in_hole", None, {"guard.maximum_force": 7.5})


def test_a_motion_that_an_override_cuts_short_need_not_meet_all_heights(tmp_path):
    file = tmp_path / "own.yaml"
    file.write_text(over("heights: {g: !Grooves {positions: [0.05]}}"))
    assert build(file, overrides={"motion.distance": 0.01}, fidelity="OneDimensional")


@pytest.mark.parametrize(("text", "message"), REFUSED)
def test_what_changes_nothing_is_refused(tmp_path, text, message):
    file = tmp_path / "own.yaml"
    file.write_text(f"duration: 1\nstation: {text}\n")
    with pytest.raises(BadInputError) as caught:
        build(file, fidelity="OneDimensional")
    assert str(caught.value).startswith(f"own.yaml:2: station.{message}")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("text", ACCEPTED)
def test_what_has_an_effect_is_not(tmp_path, text):
    file = tmp_path / "own.yaml"
    file.write_text(f"{text}\n")
    assert build(file, fidelity="OneDimensional").workcell.contact.name == "environment"


# Of a station, what its fidelity does not read; and what it reads, or another fidelity that the scenario is for.
UNREAD = [
    ("gravity: false, time_step: 0.0005", "OneDimensional", ["gravity = False", "time_step = 0.0005"]),
    ("posture_period: 0.08", "OneDimensional", ["posture_period = 0.08"]),
    ("posture_period: 0.08", "Kinematic", []),
    ("drive: {servo: {coulomb_friction: 0}}", "Multibody", ["drive.servo.coulomb_friction = 0.0"]),
    ("drive: {servo: {coulomb_friction: 0}}", "OneDimensional", []),
    ("sensors: {force: {torque_ratio: 0.1}}", "Kinematic", ["sensors.force.torque_ratio = 0.1"]),
    ("gravity: false}\nfidelities: [Multibody, Kinematic]\n_: {", "Kinematic", []),
    ("}\npreset: linear\n_: {", "OneDimensional", []),
]
SEGMENTS = "station.environment.surface.materials.segments"
SLIDING = (
    "motion: {{distance: 0.01, speed: 0.1, acceleration: 1}}\nstation: {{environment: {{surface: {{materials: "
    "{{segments: [{{material: plastic, start: {}}}, {{material: wood, start: {}}}]}}}}}}}}"
)
# Text of a scenario; what has no effect beside the rest of it, for a reason that goes on like this.
NO_EFFECT = [
    ("motion: {speed: 0.01, slope: 0.1}", ["motion.slope = 0.1", "motion.speed = 0.01"], "distance is 0"),
    ("motion: {speed: 0.01, distance: 0.001}", [], ""),
    ("station: {environment: {surface: {length: 1}}}", ["station.environment.surface.length = 1.0"], "there are no he"),
    (
        "model: {payload: 1, friction_scale: 2}",
        ["model.friction_scale = 2.0", "model.payload = 1.0"],
        "nothing here",
    ),
    ("model: {payload: 1}\ncontroller: !InvarianceRobot {nominal_gain: 1}", [], ""),
    ("model: {payload: 1}\nanalyses: {mine: !Import {path: own:Mine}}", [], ""),
    ("reference: !Sequence {times: [0, 0.2], forces: [5, 5]}", ["reference.times.1"], "the force stays 5 N"),
    ("reference: !Sequence {times: [0, 0.2], forces: [5, 6]}", [], ""),
    (
        "controller: !Admittance {velocity_limit: 0.01, acceleration_limit: 1, jerk_limit: 1e3}",
        [
            f"controller.{limit}"
            for limit in ("velocity_limit = 0.01", "acceleration_limit = 1.0", "jerk_limit = 1000.0")
        ],
        "by itself the generator rests, and the command has no such limit",
    ),
    (
        "controller: !Admittance {arrangement: increment, velocity_limit: 0.01, acceleration_limit: 999}",
        ["controller.velocity_limit = 0.01"],
        "a generator of velocities that stops has none",
    ),
    ("controller: !Admittance {arrangement: increment, generator: position, velocity_limit: 0.9}", [], ""),
    (
        "controller: !Approach {law: !Pid {derivative_filter: 0.1, feed_forward_filter: 0.2}}",
        ["controller.law.derivative_filter = 0.1", "controller.law.feed_forward_filter = 0.2"],
        "the gain of what it filters is 0",
    ),
    ("controller: !Pid {derivative_gain: 0.01, derivative_filter: 0.1}", [], ""),
    ("reference: !Step {force: 0}", ["reference"], "0 N are wanted all the time"),
    ("reference: !Step {force: 0}\ncontroller: !RecursiveVrft {}", [], ""),
    ("reference: !Ramp {force: 15, rate: 5}", ["reference.force = 15"], "the ramp ends at 3 s, the run at 0.4 s"),
    ("reference: !Ramp {force: 15, rate: 50}", [], ""),
    ("motion: {distance: 0.1, speed: 0.02}", ["motion.distance = 0.1"], "the tool goes 0.004 m in the run, of 0.4 s"),
    (
        "fidelities: [OneDimensional]\n"
        "expect: [{target: a, metric: overshoot_N, maximum: 9, fidelities: [Kinematic], expected: {Multibody: 1}}]",
        ["expect.0.fidelities = Kinematic", "expect.0.expected = Multibody"],
        "it is none of fidelities",
    ),
    ("expect: [{target: a, metric: overshoot_N, maximum: 9, fidelities: [Kinematic]}]", [], ""),
    (SLIDING.format("0, end: 0.02", "0.02, end: 0.09"), [f"{SEGMENTS}.1"], "the tool goes from 0 to 0.01 m of"),
    (SLIDING.format("-0.2, end: -0.1", "-0.1, end: 0.09"), [f"{SEGMENTS}.0"], "the tool goes from 0 to 0.01 m of"),
    (SLIDING.format("0, end: 0.005", "0.005, end: 0.09"), [], ""),
    (SLIDING.format("0, end: 0.005", "0.005, end: 0.09").replace("wood", "plastic"), [f"{SEGMENTS}.1"], "it is as the"),
    (
        "station: {environment: {surface: {materials: {segments: [{material: wood, start: 0, end: 1}], blend: 0.01}}}}",
        ["station.environment.surface.materials.blend = 0.01"],
        "there is one segment",
    ),
    ("station: {sensors: {}}\nreference: !Sine {}\ncontroller: !Import {path: own:Still}", ["reference"], "the contro"),
]
STILL = """from dataclasses import dataclass
from pydrake.systems.primitives import ConstantVectorSource
from pydrake.systems.framework import DiagramBuilder


@dataclass
class Still:
    def add_to(self, builder, model):
        inner = DiagramBuilder()
        source = inner.AddNamedSystem("source", ConstantVectorSource(model.start))
        inner.ExportOutput(source.get_output_port(), "joint_position_command")
        return builder.AddNamedSystem("still", inner.Build())


class Mine:
    def metrics(self, log, setting):
        return {}

    def figures(self, log, setting, title):
        return {}
"""


@pytest.mark.parametrize(("text", "said", "why"), NO_EFFECT)
def test_a_key_that_has_no_effect_beside_others_is_told(tmp_path, text, said, why):
    (tmp_path / "own.py").write_text(STILL)
    file = tmp_path / "own.yaml"
    file.write_text(f"duration: 0.4\n{text}\n")
    (found,) = run(file, fidelity="OneDimensional").findings.values()
    lines = [one.text.split(" has no effect: ") for one in found if one.kind == "key_unread"]
    assert [key for key, _ in lines] == said
    assert all(reason.startswith(why) for _, reason in lines)


@pytest.mark.parametrize(("text", "fidelity", "said"), UNREAD)
def test_a_key_that_the_fidelity_does_not_read_is_told_in_check_and_run(forcectl, tmp_path, text, fidelity, said):
    file = tmp_path / "own.yaml"
    file.write_text(f"duration: 0.1\nstation: {{{text}}}\n")
    lines = [f"info: station.{key} has no effect: {fidelity} does not read it" for key in said]
    _, out, _ = forcectl("check", file, "--fidelity", fidelity)
    assert [line for line in out.splitlines() if "has no effect" in line] == lines
    (found,) = run(file, fidelity=fidelity).findings.values()
    assert [str(one) for one in found if one.kind == "key_unread"] == lines
