"""Keys that change nothing in their scenario are refused in one line."""

import pytest

from forcectl.errors import BadInputError
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
        "environment.stiffness = 10000.0: must be left out beside surface.materials, whose segments define it",
    ),
    (
        f"{{environment: {{damping: 10, surface: {{{SEGMENTS}}}}}}}",
        "environment.damping = 10.0: must be left out beside surface.materials, whose segments define it",
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
    ("controller: {integral_gain: 1e-6}", "controller.integral_gain = 1e-06: must be at least 0.01 1/s, the inv"),
    ("controller: !Vrft {reference_bandwidth: 1e6}", "controller.reference_bandwidth = 1000000.0: must be below 1000"),
    (f"{MOVES} {{speed: 1e-6}}}}", "controller.excitation.speed = 1e-06: must be such that the moves end before 100 s"),
    (f"{MOVES} {{rest: 600}}}}", "controller.excitation.rest = 600.0: must be such that the moves end before 100 s, t"),
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
