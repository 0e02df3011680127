"""What makes no sense is refused in one line with file, line, key, value and what is allowed."""

import pytest

from forcectl.errors import BadInputError
from forcectl.framework.yaml_tree import equal, parse
from forcectl.scenario.scenario import build, load_scenario

LINE = "{target: t, metric: peak_force_N, maximum: 20, "
MOVE = "distance: 0.01, duration: 0.6"
# Text of a scenario; how the message goes on after the file. A line with `build` is only seen when the loop is built.
REFUSED = [
    # tags where there is no choice
    ("station: !Bar {}", "station = '!Bar': must be without a tag"),
    ("guard: !Foo {}", "guard = '!Foo': must be without a tag"),
    ("model: !Foo {}", "model = '!Foo': must be without a tag"),
    ("findings: !Foo {}", "findings = '!Foo': must be without a tag"),
    ("station: {environment: !Surface {surface: !Foo {}}}", "station.environment.surface = '!Foo': must be without"),
    ("station: {faults: [!Foo {}]}", "station.faults.0: unknown tag '!Foo'"),
    ("expect: [!Foo {target: t}]", "expect.0 = '!Foo': must be without a tag"),
    ("estimators: !Foo {}", "estimators = !Foo: must be a mapping of names to parts"),
    # sensors
    ("station: {sensors: {force: {noise_std: 300}}}", "force.noise_std = 300.0: must be at most 0.1 of range = 400 N"),
    ("station: {sensors: {force: {quantum: 1e5}}}", "force.quantum = 100000.0: must be at most 0.1 of range = 400 N"),
    ("station: {sensors: {force: {bias: -250}}}", "force.bias = -250.0: must be at most 0.5 of range = 400 N"),
    ("station: {sensors: {force: {drift: 1e6}}}", "force.drift = 1000000.0: must be at most 0.1 of range = 400 N in 1"),
    ("station: {sensors: {force: {bandwidth: 1e-6}}}", "force.bandwidth = 1e-06: must be from 0.1 to 1e+06"),
    ("station: {sensors: {force: {range: -1}}}", "force.range = -1.0: must be positive or infinite"),
    ("station: {sensors: {force: {delay: 99}}}", "force.delay = 99.0: must be not negative, at most 1"),
    ("station: {sensors: {'': !WristForce {}}}", "station.sensors: the name '' must be 1 to 100 printable"),
    ("station: {sensors: {\"a\\nb\": !WristForce {}}}", "station.sensors: the name 'a\\nb' must be 1 to 100 printable"),
    ("station: {sensors: {force: {damping_ratio: 100}}}", "force.damping_ratio = 100.0: must be from 0.01 to 10"),
    ("station: {sensors: {force: {faults: [{kind: noise, value: -5}]}}}", "value = -5.0: must be at least 0.0001 N"),
    # times
    ("duration: 2\nreference: !Step {start_time: 3}", "reference.start_time = 3.0: must be below duration = 2 s"),
    ("duration: 2\nreference: !Sequence {times: [2, 3], forces: [1, 2]}", "reference.times.0 = 2.0: must be below"),
    ("duration: 2\nreference: !Sequence {times: [0, 3], forces: [1, 2]}", "reference.times.1 = 3.0: must be below"),
    ("duration: 2\nmotion: {start_time: 2}", "motion.start_time = 2.0: must be below duration = 2 s"),
    ("duration: 2\nstation: {faults: [!ReadingFault {start: 9}]}", "station.faults.0.start = 9.0: must be below"),
    ("duration: 2\nstation: {sensors: {force: {faults: [{start: 9}]}}}", "station.sensors.force.faults.0.start = 9.0"),
    ("duration: 2\nstation: {loads: [!Load {start: 9, wrenches: [[0, 0, 0, 1, 0, 0]]}]}", "station.loads.0.start = 9."),
    ("duration: 2\nstation: {environment: {surface: {moves: [{start: 9, distance: 0.01}]}}}", "surface.moves.0.start "),
    ("duration: 0.001\nstation: {period: 0.002}", "duration = 0.001: must be at least station.period = 0.002 s"),
    ("duration: 0.0001", "build", "duration = 0.0001: must be at least a control tick, 0.002 s"),
    ("duration: .inf", "duration = inf: must be a finite number"),
    ("duration: true", "duration = True: must be a number"),
    ("duration: '5'", "duration = '5': must be a number"),
    ("duration: 50\nreference: !File {path: late.csv}", "reference.path begins at 100 s: must begin before duration"),
    ("duration: 0.5\nstation: {sensors: {force: {delay: 0.5}}}", "force.delay = 0.5: must be below duration = 0.5 s"),
    ("duration: 5\nreference: !File {path: ms.csv}", "reference.path ends at 4000 s: must end before 100 s, 20 times"),
    ("reference: !Sequence {times: [0, 1e-9]}", "build", "times.1 = 1e-09: must be at least a control tick of 0.002"),
    ("station: {sensors: {force: {faults: [{duration: 1e-6}]}}}", "build", "faults.0.duration = 1e-06: must be at lea"),
    ("station: {faults: [!ReadingFault {duration: 1e-6}]}", "build", "faults.0.duration = 1e-06: must be at least a"),
    ("station: {sensors: {force: {faults: [{kind: scale, value: 1}]}}}", "faults.0.value = 1.0: must be at least 0.00"),
    ("station: {sensors: {force: {faults: [{start: 1}, {start: 1}]}}}", "faults.1.start = 1.0: must be before or aft"),
    ("station: {faults: [!ReadingFault {}, !ReadingFault {}]}", "station.faults.1 = ReadingFaultConfig(kind='nan"),
    ("duration: 1\nestimators: {f: !ForceEstimator {tare_duration: 50}}", "tare_duration = 50.0: must be below dura"),
    ("duration: 1\nanalyses: {f: !FrictionIdentification {begin: 90}}", "analyses.f.begin = 90.0: must be below durat"),
    ("duration: 2\nguard: {patience: 50}", "guard.patience = 50.0: must be below duration = 2 s"),
    ("duration: 2\nmotion: {distance: 0.2, speed: 0.001}", "motion ends at 200 s: must end before 40 s, 20 times dura"),
    (
        "station: {sensors: {force: {faults: [{kind: nan, duration: 0.5}, {kind: value, start: 0.4}]}}}",
        "faults.1.start = 0.4: must be before or after the fault nan from 0 s to 0.5 s",
    ),
    ("duration: 0.5\nstation: {posture_period: 100}", "station.posture_period = 100.0: must be below duration = 0.5 s"),
    (
        "duration: 2\ncontroller: !ReactiveReaching {targets: [{arm: left, position: [0, 0, 0], time: 50}]}",
        "controller.targets.0.time = 50.0: must be below duration = 2 s",
    ),
    (
        "duration: 2\nstation: {environment: !Parts {parts: {a: !Part {model: m, arm: r, grasp: {released_at: 9}}}}}",
        "station.environment.parts.a.grasp.released_at = 9.0: must be below duration = 2 s",
    ),
    # surfaces, faults, signals
    (
        f"station: {{environment: {{surface: {{moves: [{{start: 1, {MOVE}}}, {{start: 0.5, {MOVE}}}]}}}}}}",
        "surface.moves.0.start = 1.0: must be at least 1.1 s, when the move before it ends",
    ),
    (
        "station: {environment: {surface: {materials: {segments: [{material: plastic, start: 50, end: 60}]}}}}",
        "surface.materials.segments.0.start = 50.0: must be below 2 m: no path goes farther",
    ),
    (
        "station: {environment: {surface: {heights: {f: !ProfileFile {path: far.csv}}}}}",
        "positions from 5 to 6 m: must overlap the path, from -0.2 to 0.2 m",
    ),
    ("station: {environment: {surface: {moves: [{start: 0.1}]}}}", "moves.0.distance = 0.0: must be at least 1e-07 m"),
    (
        "station: {environment: {surface: {moves: [{distance: 0.05, duration: 1e-6}]}}}",
        "surface.moves.0.duration = 1e-06: must be at least 0.005 s, for at most 10 m/s",
    ),
    (
        "station: {environment: {surface: {heights: {w: !Waves {amplitude: 0.005, wavelength: 0.01}}}}}",
        "surface.heights.w.amplitude = 0.005: must be at most 0.00159 m, where the slope is 1 m/m",
    ),
    ("station: {sensors: {force: {faults: [{kind: noise}]}}}", "faults.0.value = 0.0: must be at least 0.0001 N"),
    ("station: {sensors: {force: {faults: [{value: 77}]}}}", "faults.0.value = 77.0: must be left out: frozen has non"),
    ("signals: {measured_force: !Projection {factor: 0}}", "signals.measured_force.factor = 0.0: must be not zero"),
    ("station: {robot: yumi/middle}", "build", "station.robot: unknown arm of yumi.urdf 'middle': known: left, right"),
    # the guard
    ("guard: {maximum_force: 5}", "build", "guard.maximum_force = 5.0: must be above the largest desired force, 15 N"),
    ("guard: {maximum_force: 1e5}", "build", "guard.maximum_force = 100000.0: must be above the largest desired force"),
    ("guard: {reaction_time: 1e5}", "guard.reaction_time = 100000.0: must be from 0 to 1"),
    ("guard: {patience: 1e5}", "guard.patience = 100000.0: must be from 0 to 60"),
    ("guard: {frozen_time: 1e-6}", "guard.frozen_time = 1e-06: must be from 0.01 to 10"),
    ("guard: {frozen_time: 1e5}", "guard.frozen_time = 100000.0: must be from 0.01 to 10"),
    ("guard: {retreat_distance: 50}", "guard.retreat_distance = 50.0: must be from 0.0001 to 1"),
    ("guard: {retreat_speed: 50}", "guard.retreat_speed = 50.0: must be from 0.001 to 2"),
    ("guard: {retreats: 1e12}", "guard.retreats = 1000000000000: must be a whole number from 0 to 1000"),
    ("guard: {slow_speed: 1, maximum_speed: 0.1}", "guard.slow_speed = 1.0: must be at most maximum_speed = 0.1 m/s"),
    # texts and names
    ("title: " + 201 * "x", "title has 201 characters: must have at most 200"),
    ("source: " + 201 * "x", "source has 201 characters: must have at most 200"),
    ("description: " + 5001 * "x", "description has 5001 characters: must have at most 5000"),
    ("variants: {a: {variants: {b: {}}}}", "variants.a has variants of its own: must not"),
    # what nothing can do
    ("motion: {distance: 0.1, speed: 1e-7}", "motion takes 1e+06 s: must take at most 86400 s"),
    ("controller: !AdaptiveIntegral {minimum_force: 401}", "build", "minimum_force = 401.0: must be below the sensor'"),
    ("controller: !AdaptiveIntegral {forgetting: 0.01}", "controller.forgetting = 0.01: must be from 0.1 to 1"),
    ("controller: !Pid {derivative_filter: 1e6}", "controller.derivative_filter = 1000000.0: must be from 0 to 100"),
    ("station: {drive: {servo: {position_gain: 1e-6}}}", "servo.position_gain = 1e-06: must be from 0.001 to 100000"),
    ("station: {drive: {position_loop: {bandwidth: 1e6}}}", "position_loop.bandwidth = 1000000.0: must be from 0.1"),
    ("station: {sensors: {force: {torque_ratio: 100}}}", "force.torque_ratio = 100.0: must be from 0.0001 to 10"),
    ("guard: {maximum_speed: 1e-9}", "guard.maximum_speed = 1e-09: must be from 1e-06 to 10000"),
    ("analyses: {a: !TouchDown {}}", "build", "analyses.a finds no approach_mode: must go together with controller: !"),
    ("analyses: {a: !FrictionIdentification {}}", "build", "analyses.a finds no joint_velocity: must go together with"),
    ("analyses: {a: !Assembly {}}", "build", "analyses.a finds no part_released: must go together with parts that an"),
    ("after_end: 2", "build", "after_end = 2.0: must be null: there is no state machine that ends"),
    ("reference: !Sine {frequency: 250}", "build", "reference.frequency = 250.0: must be below 250 Hz, half the rate"),
    ("station: {environment: {dissipation: 1e7}}", "environment.dissipation = 10000000.0: must be not negative, at mo"),
    ("station: {drive: {position_loop: {damping_ratio: 11}}}", "position_loop.damping_ratio = 11.0: must be from 0.01"),
    ("controller: !FourthDegreeInvariance {damping_ratio: 1e-3}", "controller.damping_ratio = 0.001: must be from 0.0"),
    ("controller: !Governed {upper_limit: -5}", "controller.upper_limit = -5.0: must be positive or infinite"),
    # forces
    ("controller: !Governed {upper_force: 1}", "build", "controller.upper_force = 1.0: must be at least 1.5 N, a"),
    ("controller: !Approach {speed: 5}", "controller.speed = 5.0: must be above 0 and at most 1"),
    ("controller: !Approach {touch_speed: 5}", "controller.touch_speed = 5.0: must be from 1e-05 to 1"),
    ("reference: {initial_force: 9e4, start_time: 1}", "build", "reference"),
    ("reference: {initial_force: 9e4}", "build", "reference.initial_force = 90000.0: must be at most the sensor's ran"),
    ("controller: {dead_zone: 20}", "build", "controller.dead_zone = 20.0: must be below the largest desired force, 1"),
    ("reference: {force: -1}", "reference.force = -1.0: must be not negative"),
    ("reference: {force: .nan}", "reference.force = nan: must be a finite number"),
    ("reference: !Sine {force: 5, amplitude: 6}", "reference.amplitude = 6.0: must be at most force = 5"),
    # what is never reached
    (
        "guard: {maximum_force: 16}\ncontroller: !Approach {threshold: 20}",
        "build",
        "controller.threshold = 20.0: must be below guard.maximum_force = 16 N, the largest force that "
        "the guard allows",
    ),
    (
        "guard: {maximum_force: 16}\ncontroller: !AdaptiveIntegral {minimum_force: 17}",
        "build",
        "controller.minimum_force = 17.0: must be below guard.maximum_force = 16 N, the largest force that "
        "the guard allows",
    ),
    # directions
    ("station: {environment: {surface: {direction: [0, 0, 1]}}}", "environment.surface.direction = [0.0, 0.0, 1.0]"),
    ("station: {normal: [1, 0, 0], environment: {surface: {slope: 0.1}}}", "surface.direction = [1.0, 0.0, 0.0]: must"),
    ("motion: {direction: [0, 0, 2]}", "motion.direction = [0.0, 0.0, 2.0]: must be across the normal [0.0, 0.0, 1.0]"),
    ("station: {normal: [0, 0, 0]}", "station.normal = [0.0, 0.0, 0.0]: must be not all zero"),
    ("station: {normal: [0, 1]}", "station.normal = [0.0, 1.0]: must be three numbers"),
    # magnitudes
    ("reference: !Sine {frequency: 1000}", "build", "below 250 Hz, half the rate of control with its tick of 0.002 s"),
    ("station: {environment: {stiffness: 1e-9}}", "environment.stiffness = 1e-09: must be positive, from 1 to 1"),
    ("station: {environment: {stiffness: 1e10}}", "environment.stiffness = 10000000000.0: must be positive, from 1 to"),
    ("station: {stiffness_scale: 1e-6}", "station.stiffness_scale = 1e-06: must be from 0.001 to 1000"),
    ("station: {stiffness_scale: 1e6}", "station.stiffness_scale = 1000000.0: must be from 0.001 to 1000"),
    ("station: {drive: {servo: {coulomb_friction: 1e6}}}", "coulomb_friction = 1000000.0: must be from 0 to 100"),
    ("model: {payload: {arm: {mass: 1e6}}}", "payload.arm.mass = 1000000.0: must be not negative, at most 2000 kg"),
    ("model: {environment_compliance: 1e-9}", "model.environment_compliance = 1e-09: must be from 0.001 to 1000"),
    ("controller: {compliance_error: 1e-15}", "controller.compliance_error = 1e-15: must be from 0.001 to 1000"),
    ("controller: {lower_limit: -1000}", "controller.lower_limit = -1000.0: must be from -10 to -0.000001"),
    ("controller: {upper_limit: -0.1}", "controller.upper_limit = -0.1: must be from 0.000001 to 10"),
    ("controller: {lower_limit: -1e-9}", "controller.lower_limit = -1e-09: must be from -10 to -0.000001"),
    ("controller: {upper_limit: 1e-9}", "controller.upper_limit = 1e-09: must be from 0.000001 to 10"),
    ("reference: !Ramp {rate: 1e-9}", "reference.rate = 1e-09: must be at least 0.001"),
    ("reference: !Sine {frequency: 1e-9}", "reference.frequency = 1e-09: must be at least 0.0001"),
    ("station: {period: 0.5}", "build", "station.period = 0.5: must be at most 100 time_step, 0.1 s"),
    ("station: {period: 0.004, time_step: 1e-5}", "build", "station.period = 0.004: must be at most 100 time_step, 0"),
    ("station: {time_step: 1e-5}", "build", "station.time_step = 1e-05: must be at least the period over 100, 2e-05 s"),
    ("estimators: {e: !ForceEstimator {}}", "build", "estimators.e reads joint_position (joint positions that the"),
    ("controller: {integral_gain: 1e6}", "controller.integral_gain = 1000000.0: must be from 0.000001 to 10000"),
    ("motion: {speed: 1000}", "motion.speed = 1000.0: must be above 0 and at most 10"),
    ("motion: {distance: 500}", "motion.distance = 500.0: must be not negative, at most 100 m"),
    # what has no effect
    ("reference: !Ramp {force: 4, initial_force: 4}", "build", "reference.initial_force = 4.0: must be another one"),
    ("reference: !Step {force: 4, initial_force: 4, start_time: 1}", "build", "another one than force: !Step {force"),
    ("reference: !Ramp {force: 0}", "build", "initial_force = 0.0: must be another one than force: !Step {force: 0}"),
    ("reference: {initial_force: 4}", "build", "reference.initial_force = 4.0: must be left out if start_time is zero"),
    ("station: {elastic_joints: false, stiffness_scale: 2}", "stiffness_scale = 2.0: must be left out with elastic_jo"),
    ("station: {elastic_joints: false, stiffness_set: bending}", "stiffness_set = 'bending': must be left out with"),
    ("station: {drive: {servo: {ideal: true, coulomb_friction: 3}}}", "coulomb_friction = 3.0: must be left out with"),
    ("station: {drive: {servo: {ideal: true, position_gain: 3}}}", "servo.position_gain = 3.0: must be left out"),
    # expectations
    ("expect: [{target: t, metric: peak_force_N, maximum: -5}]", "expect.0.maximum = -5.0: must be not negative, as p"),
    ("expect: [{target: t, metric: peak_force_N, minimum: -5}]", "expect.0.minimum = -5.0: must be not negative, as p"),
    (f"expect: [{LINE}target: x}}]", "not valid YAML: key 'target' is written twice"),
    ("expect: [{target: '', metric: peak_force_N, maximum: 20}]", "expect.0.target = '': must be printable characters"),
    (f"expect: [{LINE}}}, {LINE}}}]", "expect.1.target = 't': must be another one than those before it"),
    (f"expect: [{LINE}expected: 21}}]", "expect.0.expected = 21.0: must be from -inf to 20"),
    (f"expect: [{LINE}expected: {{Kinematic: 21}}}}]", "expect.0.expected.Kinematic = 21.0: must be from -inf to 20"),
    (f"expect: [{LINE}expected: {{Kinetic: 1}}}}]", "expect.0.expected: unknown fidelity 'Kinetic': did you mean"),
    (f"expect: [{LINE}gaps: {{Kinetic: why}}}}]", "expect.0.gaps: unknown fidelity 'Kinetic': did you mean"),
    (f"expect: [{LINE}fidelities: [Kinematic, Kinematic]}}]", "expect.0.fidelities.1 = 'Kinematic': must be another"),
    (f"expect: [{LINE}minimum: 20, strict: true}}]", "expect.0.minimum = 20.0: must be below maximum = 20"),
    (
        f"expect: [{LINE}published: 25, tolerance: {{absolute: 4}}}}]",
        "expect.0.published = 25.0: must be within 4 of the range from -inf to 20",
    ),
    (f"expect: [{LINE}minimum: 21}}]", "expect.0.minimum = 21.0: must be at most maximum = 20"),
    (f"expect: [{LINE}minus: {{metric: peak_force_N}}}}]", "expect.0.minus.metric = 'peak_force_N': must be another m"),
    (f"expect: [{LINE}ratio: {{metric: peak_force_N}}}}]", "expect.0.ratio.metric = 'peak_force_N': must be another m"),
    (f"expect: [{LINE}minus: {{metric: overshoot_pct}}}}]", "minus.metric = 'overshoot_pct': must be a metric in N, a"),
    (
        f"expect: [{LINE}minus: {{metric: overshoot_N}}, ratio: {{metric: overshoot_N}}}}]",
        "expect.0: target 't': minus and ratio must not go together",
    ),
    (
        f"expect: [{LINE}fidelities: [Multibody], gaps: {{Kinematic: why}}}}]",
        "expect.0.gaps.Kinematic = 'why': must be left out: the line is not judged there",
    ),
    ("findings: {largest_force: 1e-9}", "build", "findings.largest_force = 1e-09: must be at least the largest desire"),
    ("fidelities: [Kinematic, Kinematic]", "fidelities.1 = 'Kinematic': must be another one than those before it"),
    # names, types, text
    ("seed: -1", "seed = -1: must be a whole number from 0"),
    ("seed: 1.5", "seed = 1.5: must be a whole number"),
    ("title: 5", "title = 5: must be text"),
    ("durations: 5", "unknown key 'durations': did you mean 'duration'"),
    ("station: {robot: [a]}", "station.robot = ['a']: must be text"),
    ("variants: {'': {}}", "variants: the name '' must be 1 to 200 printable characters"),
    ("variants: {a: {duration: 1}, A : {}}", "variants: the name 'A' must differ from 'a' by more than case"),
    ("variants: {soft one: {}, 'soft  one': {duration: 1}}", "the name 'soft one' must differ from 'soft one' by"),
    ("variants: {a: {seed: 2}, b: {}, c: {seed: 2}}", "variants.c = {'seed': 2}: must be other values than"),
    ("variants: {a: {}, b: {}}", "variants.b = {}: must be other values than those of variants.a"),
    ("variants: {a: {controller: !Integral {}}, b: {controller: !Integral {}}}", "variants.b = {"),
    (f"variants: {{{'a' * 300}: {{}}}}", "variants: the name 'aaaaaaaaaaaaaaaaaaaaa"),
    ("_a: &a {<<: *a}\ncontroller: *a", "not valid YAML: a mapping is merged into itself (line 1, column 5)"),
    ("_a: &a [*a]", "not usable: more than 100000 values, or an alias that holds itself"),
    ("title: !!binary aGk=", "not valid YAML: could not determine a constructor for the tag"),
    ("duration: !!bool maybe", "not valid YAML: 'maybe'"),
    # laws
    ("controller: !Approach {threshold: 3000}", "build", "controller.threshold = 3000.0: must be below the sensor's r"),
    ("controller: !Approach {threshold: 30}", "build", "controller.threshold = 30.0: must be below 30 N, as forces be"),
    ("controller: !Approach {speed: 0.001, touch_speed: 1}", "controller.touch_speed = 1.0: must be at most speed = 0"),
    ("controller: !Approach {patience: 100, timeout: 1}", "controller.patience = 100.0: must be at most timeout = 1 s"),
    (
        "station: {environment: {surface: {gap: 0.05}}}\ncontroller: !Approach {timeout: 2}",
        "build",
        "controller.timeout = 2.0: must be at least 2.75 s, which speed takes for surface.gap = 0.05 m",
    ),
    (
        "station: {environment: {surface: {gap: 0.05}}}\ncontroller: {lower_limit: -0.01}",
        "build",
        "controller.lower_limit = -0.01: must be below -0.05 m, where the surface is",
    ),
    ("controller: !FourthDegreeInvariance {rest_region: 99}", "build", "controller.rest_region = 99.0: must be below "),
    ("controller: !Approach {law: {dead_zone: 20}}", "build", "controller.law.dead_zone = 20.0: must be below the lar"),
    ("controller: {integral_gain: 1000}", "build", "controller.integral_gain = 1000.0: must be below 1000 1/s, two ov"),
    ("controller: {integral_gain: 0}", "controller.integral_gain = 0.0: must be from 0.000001 to 10000"),
    ("controller: !DisturbanceObserver {observer_bandwidth: 1e6}", "build", "observer_bandwidth = 1000000.0: must be "),
    (
        "controller: !Vrft {proportional_gain: 0, integral_gain: 0, derivative_gain: 0}",
        "controller.proportional_gain = 0.0: must be below zero with integral_gain = 0: else the law does not press",
    ),
    ("controller: !Vrft {proportional_gain: 1, integral_gain: 0}", "controller.proportional_gain = 1.0: must be below"),
    ("controller: !Pid {proportional_gain: 0, integral_gain: 0}", "controller.integral_gain = 0.0: must be above zero"),
    ("controller: !Vrft {gains_variant: cheese}", "controller.gains_variant = 'cheese': must be null without gains_fr"),
    (
        "controller: !Vrft {gains_from: fig_4_5, proportional_gain: -1e-5}",
        "controller.proportional_gain = -1e-05: must be left out: gains_from = 'fig_4_5' determines it",
    ),
    ("controller: !Passive {law: !Passive {}}", "controller.law = '!Passive': must be a law, not a second passivity"),
    ("controller: !Passive {law: !Approach {law: !Passive {}}}", "controller.law = '!Passive': must be a law, not a"),
    ("controller: !Governed {law: !Passive {law: !Governed {}}}", "controller.law = '!Governed': must be a law, not"),
    ("controller: !InvarianceControl {nominal: !JointMoves {}}", "build", "controller.nominal: JointPath commands joi"),
    ("controller: !InvarianceControl {nominal: !ScaledVrft {}}", "build", "nominal: ScaledVrftConfig needs motor_di"),
    ("controller: !Governed {delay: 100}", "build", "controller.delay = 100.0: must be at most 20 s, 10000 control ti"),
    ("controller: !PredictiveInvariance {search_speed: 999}", "controller.search_speed = 999.0: must be from 0 to 1"),
    ("controller: !PredictiveInvariance {offset_limit: 100}", "controller.offset_limit = 100.0: must be from 0 to 1"),
    ("controller: !PredictiveInvariance {filter_delay: 1}", "controller.filter_delay = 1.0: must be from 0 to 0.1"),
    ("controller: !PredictiveInvariance {filter_bandwidth: 1e6}", "filter_bandwidth = 1000000.0: must be from 0.1 to"),
    ("controller: !DisturbanceObserver {model_lag: 1e6}", "controller.model_lag = 1000000.0: must be from 0 to 1"),
    ("controller: !Hybrid {directions: {z: {desired: -99}}}", "directions.z.desired = -99.0: must be not negative"),
    ("controller: !Hybrid {directions: {z: {}}, smallest_singular_value: 1e6}", "smallest_singular_value = 1000000.0:"),
    (
        "controller: !RecursiveVrft {excitation: {depths: [0, -0.01, -0.02]}}",
        "controller.excitation.depths = [0.0, -0.01, -0.02]: must be above zero somewhere: away from the surface",
    ),
    (
        "controller: !RecursiveVrft {excitation: {depths: [0, 0.3]}}",
        "build",
        "controller.lower_limit = -0.1: must be at most -",
    ),
    ("controller: !RecursiveVrft {hand_over_time: 0.1}", "build", "controller.hand_over_time = 0.1: must be above 0.5"),
    ("controller: !RecursiveVrft {convergence_window: 99}", "build", "controller.convergence_window = 99.0: must be b"),
    ("controller: !RecursiveVrft {drive: {bandwidth: 50}}", "controller.input = 'command': must be motor with a drive"),
    # ways into the surface
    ("station: {environment: {stiffness: 5.9}}", "build", "environment.stiffness = 5.9: must be at least 50."),
    (
        "station: {environment: {surface: {materials: {segments: [{material: a, stiffness: 9, start: 0, end: 1}]}}}}",
        "build",
        "surface.materials.segments.0.stiffness = 9.0: must be at least 50",
    ),
    ("station: {environment: {stiffness: 900, surface: {gap: 0.05}}}\nreference: {force: 300}", "build", "N/m: 300 N"),
    # sensors that show nothing of the wanted force
    ("station: {sensors: {force: {range: .inf, quantum: 1e5}}}", "force.quantum = 100000.0: must be at most 0.1 of 10"),
    ("station: {sensors: {force: {range: .inf, noise_std: 1e5}}}", "force.noise_std = 100000.0: must be at most 0.1 o"),
    ("station: {sensors: {force: {range: .inf, bias: 1e5}}}", "force.bias = 100000.0: must be at most 0.5 of 10000 N"),
    ("station: {sensors: {force: {quantum: 40}}}", "build", "quantum = 40.0: must be at most the largest desired forc"),
    ("station: {sensors: {force: {noise_std: 40}}}", "build", "noise_std = 40.0: must be at most the largest desired"),
    ("station: {sensors: {force: {bias: 40, tare: false}}}", "build", "bias = 40.0: must be at most the largest desir"),
    ("station: {sensors: {j: !JointReadings {quantum: 0.1}}}", "sensors.j.quantum = 0.1: must be from 0 to 0.01"),
    ("station: {sensors: {j: !JointReadings {torque_noise: 1e5}}}", "j.torque_noise = 100000.0: must be from 0 to 100"),
    # friction and damping that nothing overcomes
    ("station: {drive: {servo: {friction_scale: 1e6}}}", "servo.friction_scale = 1000000.0: must be from 0 to 20"),
    ("station: {drive: {servo: {coulomb_friction: 1000}}}", "servo.coulomb_friction = 1000.0: must be from 0 to 100"),
    ("station: {drive: !JointInterface {friction: {scale: 1e6}}}", "friction.scale = 1000000.0: must be from 0 to 20"),
    ("model: {friction_scale: 950}", "model.friction_scale = 950.0: must be from 0 to 20"),
    ("station: {environment: {damping: 1e7}}", "environment.damping = 10000000.0: must be not negative, at most 10000"),
    ("station: {environment: {dissipation: 1e6}}", "dissipation = 1000000.0: must be not negative, at most 1000"),
    ("station: {environment: !Patch {damping: 1e7}}", "damping = 10000000.0: must be not negative, at most 10000"),
    ("station: {environment: !Parts {parts: {b: !PegInBore {peg: p, bore: b, friction: 9}}}}", "friction = 9.0: must"),
    # laws that do nothing, or too much
    ("controller: !Governed {upper_limit: 5}", "build", "controller.upper_limit = 5.0: must be at least the largest d"),
    ("controller: !AdaptiveIntegral {minimum_force: 300}", "build", "minimum_force = 300.0: must be below the largest"),
    ("controller: !AdaptiveIntegral {initial_covariance: 1e15}", "initial_covariance = 1000000000000000.0: must be ab"),
    ("controller: !Passive {energy: 1e15}", "controller.energy = 1000000000000000.0: must be from 0 to 1000"),
    ("controller: !Passive {model_lag: 10}", "controller.model_lag = 10.0: must be from 0 to 1"),
    ("controller: !AdaptiveAdmittance {adaptation_rate: 1e4}", "build", "adaptation_rate = 10000.0: must be below 100"),
    ("controller: !Invariance {speed_limit: 1e-9}", "controller.speed_limit = 1e-09: must be at least 0.00001"),
    ("controller: !FourthDegreeInvariance {speed_limit: 1e-9}", "controller.speed_limit = 1e-09: must be at least 0.0"),
    ("controller: !Approach {clearance: 100}", "controller.clearance = 100.0: must be above 0 and at most 1"),
    ("controller: !Approach {step_back: 1000}", "controller.step_back = 1000.0: must be from 0 to 1"),
    ("controller: !Approach {patience: 1e-6}", "controller.patience = 1e-06: must be at least 0.005"),
    ("controller: !RecursiveVrft {excitation: {speed: 900}}", "excitation.speed = 900.0: must be above 0 and at most"),
    ("controller: !RecursiveVrft {excitation: {rest: 1e6}}", "excitation.rest = 1000000.0: must be from 0 to 600"),
    ("controller: !RecursiveVrft {forgetting: 0.1}", "controller.forgetting = 0.1: must be from 0.9 to 1"),
    ("controller: !Vrft {fir: [1000000]}", "controller.fir.0 = 1000000.0: must be from -100000 to"),
    ("controller: !Pid {proportional_gain: 1e5}", "controller.proportional_gain = 100000.0: must be from 0 to 100"),
    ("controller: !Pid {derivative_gain: 1e5}", "controller.derivative_gain = 100000.0: must be from 0 to 10"),
    # drives
    ("station: {drive: {position_loop: {delay: 1}}}", "position_loop.delay = 1.0: must be not negative, at most 0.3"),
    ("station: {drive: {position_loop: {bandwidth: 5e4}}}", "position_loop.bandwidth = 50000.0: must be from 0.1 to 1"),
    ("station: {drive: {servo: {velocity_gain: 5e4}}}", "servo.velocity_gain = 50000.0: must be from 0.01 to 10000"),
    ("station: {drive: !JointInterface {servo: {bandwidth: 1e6}}}", "servo.bandwidth = 1000000.0: must be from 0.1 to"),
    ("station: {drive: !JointInterface {servo: {rate: 1e-6}}}", "servo.rate = 1e-06: must be from 1 to 100000"),
    ("station: {drive: !JointImpedance {friction_bandwidth: 1e6}}", "friction_bandwidth = 1000000.0: must be from 0 t"),
    # geometry of the contact
    ("station: {normal: [0, 0, -1]}", "build", "station.normal = [0.0, 0.0, -1.0]: must be against the z axis of the"),
    ("station: {environment: {normal: [0, 0, -1]}}", "build", "station.environment.normal = [0.0, 0.0, -1.0]: must be"),
    ("station: {environment: {surface: {heights: {g: !Grooves {depth: 0.05}}}}}", "g.depth = 0.05: must be at most 0."),
    ("station: {stiffness_scale: 1e-3}", "build", "station.stiffness_scale deflects the robot by 0.48 m at the"),
]  # fmt: skip


@pytest.mark.parametrize("case", REFUSED, ids=lambda case: case[0])
def test_nonsense_is_refused_in_one_line(tmp_path, case):
    text, *when, message = case
    file = tmp_path / "own.yaml"
    file.write_text(f"{text}\n")
    (tmp_path / "far.csv").write_text("position,height\n5,0\n6,0.001\n")
    (tmp_path / "ms.csv").write_text("time,force\n0,1\n1000,5\n4000,5\n")
    (tmp_path / "late.csv").write_text("time,force\n100,1\n200,5\n")
    with pytest.raises(BadInputError) as caught:
        build(file, fidelity="OneDimensional") if when else load_scenario(file)
    assert str(caught.value).startswith("own.yaml:")
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_run_may_be_cut_short_before_what_is_in_it_begins(tmp_path):
    file = tmp_path / "own.yaml"
    file.write_text("duration: 9\nreference: !Step {start_time: 3}\n")
    assert load_scenario(file, overrides={"duration": 1.0}).duration == 1.0
    with pytest.raises(BadInputError, match=r"^override: reference\.start_time = 2\.0: must be below duration = 1 s$"):
        load_scenario(file, overrides={"duration": 1.0, "reference.start_time": 2.0})


@pytest.mark.slow
def test_a_long_text_says_the_same_as_a_short_one():
    """A long one is composed in C, where that is there."""
    part = "b: &a {k: on, v: 0x12, w: 1_000, x: 2020-01-01, y: 1e3, n: ~}\nc: !Foo {<<: *a, k: [true, .5]}\n"
    short, long = parse(part, "text"), parse(f"{part}_x: [{'12345, ' * 20_000}]\n", "text")
    assert len(long.pop("_x")) == 20_000
    assert equal(short, long)
    assert (long["c"].tag, long.lines["c"]) == ("Foo", 2)
    deep = "[" * 60_000 + "]" * 60_000
    for wrong, said in ((deep, "nested too deeply"), (f"a: 1\na: 2\n{'# x' * 40_000}", "key 'a' is written twice")):
        with pytest.raises(BadInputError, match=f"^text: not valid YAML: {said}"):
            parse(wrong, "text")


def test_a_long_list_is_refused_before_it_is_read(tmp_path, monkeypatch):
    file = tmp_path / "own.yaml"
    file.write_text(f"_a: [{'1,' * 240_000}]\n")
    monkeypatch.setattr("forcectl.framework.yaml_tree._Loader", None)
    with pytest.raises(BadInputError, match=r"^own\.yaml: not usable: more than 100000 values$"):
        load_scenario(file)
