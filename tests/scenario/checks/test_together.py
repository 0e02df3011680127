"""What is far from the run that it is in, or from its ticks, is refused in one line."""

import pytest

from forcectl.errors import BadInputError
from forcectl.motion.references import RampConfig, StepConfig
from forcectl.scenario.scenario import build, load_scenario

# Text of a scenario of 2 s; how the message goes on after file and line.
REFUSED = [
    ("analyses: {s: !SurfaceAlignment {deadline: 3.5}}", "analyses.s.deadline = 3.5: must be below duration = 2 s"),
    ("reference: !Ramp {rate: 0.001}", "reference.rate = 0.001: must be enough to end before 60 s, the longer of 20"),
    ("reference: !Sine {frequency: 0.001}", "reference.frequency = 0.001: must be at least 0.01667 Hz, one period in"),
    (
        "reference_model: 1e-3",
        "reference_model = 0.001: must be at least 0.01667 rad/s, the inverse of the longer of 20 times",
    ),
    (
        "reference_model: 1e5",
        "reference_model = 100000.0: must be below 1000 rad/s, two over the control tick of 0.002",
    ),
    ("model_error_window: 4100", "model_error_window = 4100.0: must be above 0 and at most 1000"),
    ("model_error_window: 0.002", "model_error_window = 0.002: must be at least 0.004 s, two control ticks"),
    (
        "station: {environment: {surface: {moves: [{distance: 0.01, duration: 100}]}}}",
        "station.environment.surface.moves.0.duration = 100.0: must be at most 60 s, the longer of "
        "20 times duration and a minute",
    ),
    (
        "station: {sensors: {force: {faults: [{kind: jitter, value: 1e-4}]}}}",
        "station.sensors.force.faults.0.value = 0.0001: must be at least a control tick, 0.002 s",
    ),
    (
        "station: {sensors: {force: {faults: [{kind: noise, value: 1e5}]}}}",
        "station.sensors.force.faults.0.value = 100000.0: must be at most 4000 N, 10 times range",
    ),
    ("after_end: 500", "after_end = 500.0: must be below duration = 2 s"),
    (
        "controller: !Approach {touch_speed: 1e-8}",
        "controller.touch_speed = 1e-08: must be from 1e-05 to 1",
    ),
    (
        "controller: !Hybrid {directions: {z: {law: !Integral {}, compliance: 1000}}}",
        "controller.directions.z.compliance = 1000.0: must be at most 1 m/N along an axis",
    ),
    ("findings: {saturated: 200}", "findings.saturated = 200.0: must be below duration = 2 s"),
    ("findings: {stuck: 20}", "findings.stuck = 20.0: must be below duration = 2 s"),
    ("findings: {limit_share: 10}", "findings.limit_share = 10.0: must be from 0 to 1"),
    ("findings: {ignore: [guarded, guarded]}", "findings.ignore.1 = 'guarded': must be another one than those before"),
    (
        "findings: {largest_force: 1e5}",
        "findings.largest_force = 100000.0: must be at least the largest desired force, 15 N, and at most 800 N, at",
    ),
    ("motion: {distance: 1e-9}", "motion.distance = 1e-09: must be 0 to stay, or at least 1e-07 m"),
    (
        "controller: !JointMoves {dither: {amplitude_deg: 90}}",
        "controller.dither.amplitude_deg = 90.0: must be from 0 to 10",
    ),
    (
        "station: {loads: [&load {wrenches: [[0, 0, 0, 0, 0, 1]]}, *load]}",
        "station.loads.1 = LoadConfig(arm='', body='', ... 1.0]], repeats=1, every=0.0): must be another one than",
    ),
    (
        "station: {loads: [{wrenches: [[0, 0, 0, 0, 0, 1]], every: 3}]}",
        "station.loads.0.every = 3.0: must be left out without repeats",
    ),
    (
        "station: {environment: {surface: {moves: [{distance: 1e-9}]}}}",
        "station.environment.surface.moves.0.distance = 1e-09: must be at least 1e-07 m in size",
    ),
]


@pytest.mark.parametrize(("text", "message"), REFUSED)
def test_what_is_far_from_its_run_is_refused(tmp_path, text, message):
    file = tmp_path / "own.yaml"
    file.write_text(f"duration: 2\n{text}\n")
    with pytest.raises(BadInputError) as caught:
        build(file, fidelity="OneDimensional")
    assert str(caught.value).startswith(f"own.yaml:2: {message}")
    assert "\n" not in str(caught.value)


def test_a_load_shorter_than_a_tick_is_refused(tmp_path):
    file = tmp_path / "own.yaml"
    file.write_text("station: {loads: [{wrenches: [[0, 0, 0, 0, 0, 1]], hold: 1e-4}]}\n")
    with pytest.raises(BadInputError, match=r"^own\.yaml:1: station\.loads\.0\.hold = 0\.0001: must be at least a con"):
        build(file)


def test_a_run_that_is_cut_short_keeps_what_is_slow_in_it(tmp_path):
    file = tmp_path / "own.yaml"
    file.write_text("duration: 60\nreference: !Ramp {rate: 0.1}\nmodel_error_window: 50\n")
    assert load_scenario(file, overrides={"duration": 0.1}).duration == 0.1
    assert load_scenario({"duration": 0.02, "reference": StepConfig()}).model_error_window == 4.1
    assert load_scenario({"duration": 0.02, "reference": RampConfig()}).reference.end_time == 3.0
