"""What a scenario says to no effect is told by `check` and by the run, and refused by neither."""

import pytest

from forcectl.runs.run import run

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
        "model: {payload: {arm: {mass: 1}}, friction_scale: 2}",
        ["model.friction_scale = 2.0", "model.payload"],
        "no part of the scenario reads",
    ),
    ("model: {payload: {arm: {mass: 1}}}\ncontroller: !InvarianceRobot {nominal_gain: 1}", [], ""),
    ("model: {payload: {arm: {mass: 1}}}\nanalyses: {mine: !Import {path: own:Mine}}", [], ""),
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
        "the gain of the signal that it filters is 0",
    ),
    ("controller: !Pid {derivative_gain: 0.01, derivative_filter: 0.1}", [], ""),
    ("reference: !Step {force: 0}", ["reference"], "the desired force is always 0 N"),
    ("reference: !Step {force: 0}\ncontroller: !RecursiveVrft {}", [], ""),
    ("reference: !Ramp {force: 15, rate: 5}", ["reference.force = 15"], "the ramp ends at 3 s, the run at 0.4 s"),
    ("reference: !Ramp {force: 15, rate: 50}", [], ""),
    ("motion: {distance: 0.1, speed: 0.02}", ["motion.distance = 0.1"], "the tool goes 0.004 m in the run, of 0.4 s"),
    (
        "fidelities: [OneDimensional]\n"
        "expect: [{target: a, metric: overshoot_N, maximum: 9, fidelities: [Kinematic], expected: {Multibody: 1}}]",
        ["expect.0.fidelities = Kinematic", "expect.0.expected = Multibody"],
        "not listed in fidelities",
    ),
    ("expect: [{target: a, metric: overshoot_N, maximum: 9, fidelities: [Kinematic]}]", [], ""),
    (SLIDING.format("0, end: 0.02", "0.02, end: 0.09"), [f"{SEGMENTS}.1"], "the tool goes from 0 to 0.01 m of"),
    (SLIDING.format("-0.2, end: -0.1", "-0.1, end: 0.09"), [f"{SEGMENTS}.0"], "the tool goes from 0 to 0.01 m of"),
    (SLIDING.format("0, end: 0.005", "0.005, end: 0.09"), [], ""),
    (
        SLIDING.format("0, end: 0.005", "0.005, end: 0.09").replace("wood", "plastic"),
        [f"{SEGMENTS}.1"],
        "it equals the",
    ),
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
