"""A scenario with an admittance is refused where its sampled loop is unstable, and only there."""

from typing import Any, get_args

import numpy as np
import pytest

import forcectl as fc
from forcectl.diagrams import loop
from forcectl.diagrams.chain import force_chain
from forcectl.diagrams.loop import Loop
from forcectl.errors import BadInputError
from forcectl.framework.fields import Config, key_of, typed_fields
from forcectl.framework.yaml_tree import Tagged, parse
from forcectl.scenario.catalog import SLOTS
from forcectl.scenario.scenario import load_scenario
from forcectl.scenario.schema import load_object

ONE_ARM = """
preset: linear
controller: !Admittance {inertia: 3.0, damping: 300.0}
reference: !Step {force: 8.0}
"""
SENSORLESS = """
preset: ideal
station: {robot: yumi, tool: yumi_gripper, drive: !JointInterface {friction: {scale: 0.0}},
          sensors: {joints: !JointReadings {}}, environment: !Surface {arm: right}}
controller: !Admittance {inertia: 0.5, damping: 40.0, lower_limit: -0.3, upper_limit: 0.3}
estimators: {force: !ForceEstimator {}}
signals: {measured_force: !Projection {of: estimated_wrench, along: normal}}
reference: !Step {force: 8.0}
"""


def largest(text: str, **overrides: Any) -> float:
    scenario = load_scenario(parse(text, "test"), overrides=overrides)
    return force_chain(scenario.controller, scenario.parts, scenario.setting(), 0).largest_stiffness(1e7)


def swing(text: str, stiffness: float, duration: float, **overrides: Any) -> tuple[float, float]:
    """Standard deviation of the force in the second and in the last fifth of a run [N]."""
    changes = {"station.environment.stiffness": stiffness, "duration": duration, **overrides}
    log = fc.run(parse(text, "test"), overrides=changes).log
    parts = np.array_split(log["contact_force"].values.ravel(), 5)
    return float(parts[1].std()), float(parts[4].std())


def assert_settles_and_swings(
    monkeypatch: pytest.MonkeyPatch,
    text: str,
    limit: float,
    shares: tuple[float, float] = (0.85, 1.15),
    duration: float = 4.0,
    **overrides: Any,
) -> None:
    """The force settles on the one share of the largest stiffness, and swings on the other if it is not refused."""
    early, late = swing(text, shares[0] * limit, duration, **overrides)
    assert late < 0.5 * early
    monkeypatch.setattr(loop, "check_stability", lambda parts, setting: None)
    early, late = swing(text, shares[1] * limit, duration, **overrides)
    assert late > 0.95 * early > 1.0


@pytest.mark.slow
@pytest.mark.parametrize("fidelity", ["OneDimensional", "Kinematic", "Multibody"])
def test_up_to_the_largest_stiffness_the_force_settles_and_beyond_it_swings(fidelity, monkeypatch):
    limit = largest(ONE_ARM, **{"station.fidelity": fidelity})
    fidelity_is = {"station.fidelity": fidelity}
    with pytest.raises(BadInputError):
        swing(ONE_ARM, 1.15 * limit, 4.0, **fidelity_is)
    assert_settles_and_swings(monkeypatch, ONE_ARM, limit, **fidelity_is)


@pytest.mark.slow
def test_the_same_of_a_force_that_is_estimated_and_servos_that_give_way(monkeypatch):
    assert_settles_and_swings(monkeypatch, SENSORLESS, largest(SENSORLESS), (0.9, 1.2), 2.0)


def built(text: str, **overrides: Any) -> Loop:
    return fc.build(load_scenario(parse(text, "test"), overrides=overrides))


def refused(text: str, **overrides: Any) -> str:
    with pytest.raises(BadInputError) as caught:
        built(text, **overrides)
    message = str(caught.value)
    assert "\n" not in message
    return message


def test_the_message_has_the_numbers_and_the_largest_stiffness():
    message = refused(ONE_ARM, **{"station.environment.stiffness": 1e5})
    limit = largest(ONE_ARM)
    assert (
        "station.environment.stiffness = 100000 N/m is unstable with inertia = 3 kg and damping = 300 N s/m" in message
    )
    assert "the largest pole of the sampled loop is 1.01" in message
    assert message.endswith(f"at a tick of 0.002 s: must be at most {limit:.4g} N/m")
    # What it says is so.
    built(ONE_ARM, **{"station.environment.stiffness": 0.99 * limit})


def test_every_material_is_looked_at():
    segments = [
        {"material": "custom", "start": -0.1, "end": 0.1, "stiffness": 2e3},
        {"material": "custom", "start": 0.1, "end": 0.3, "stiffness": 1e5},
    ]
    message = refused(ONE_ARM, **{"station.environment.surface.materials.segments": segments})
    assert "station.environment.surface.materials.segments.1" in message


def test_a_drive_with_dynamics_has_a_command_delay_of_at_least_a_plant_step():
    quick = {
        "station.period": 0.004,
        "station.sensors.force.bandwidth": 200.0,
        "station.drive.position_loop.delay": 0.0,
    }
    late = quick | {"station.drive.position_loop.delay": 0.004}
    limits = [largest(ONE_ARM, **quick, **{"station.time_step": step}) for step in (0.004, 0.002, 1e-4)]
    assert limits[0] == largest(ONE_ARM, **late) < limits[1] < limits[2]
    light = {name: largest(ONE_ARM, **quick, **{"station.fidelity": name}) for name in ("Kinematic", "OneDimensional")}
    assert light["Kinematic"] == light["OneDimensional"] == pytest.approx(limits[2], rel=0.02)


def materials(*pairs: tuple[float, float]) -> dict[str, Any]:
    """Segments of these stiffnesses [N/m] and dampings [N s/m], side by side."""
    places = [{"material": "custom", "start": 0.2 * i - 0.1, "end": 0.2 * i + 0.1} for i in range(len(pairs))]
    segments = [place | {"stiffness": K, "damping": D} for place, (K, D) in zip(places, pairs, strict=True)]
    return {"station.environment.surface.materials.segments": segments}


def test_every_material_has_its_own_damping():
    # Each of the two is damped enough, or little enough, for its own stiffness alone.
    built(ONE_ARM, **materials((3e3, 0.0), (6e3, 400.0)))
    segments = "station.environment.surface.materials.segments"
    message = refused(ONE_ARM, **materials((3e3, 400.0), (6e3, 0.0)))
    assert f"{segments}.1.stiffness = 6000 N/m is unstable" in message
    message = refused(ONE_ARM, **materials((3e3, 0.0), (3e3, 2500.0)))
    assert f"{segments}.1.damping = 2500 N s/m is too much on 3000 N/m with inertia = 3 kg" in message


def test_too_much_damping_of_the_contact_is_named():
    stiff = {"station.environment.stiffness": 4e3}
    message = refused(ONE_ARM, **stiff, **{"station.environment.damping": 1600.0})
    assert "station.environment.damping = 1600 N s/m is too much on 4000 N/m with inertia = 3 kg" in message
    largest_damping = float(message.split("must be at most ")[1].split()[0])
    built(ONE_ARM, **stiff, **{"station.environment.damping": largest_damping})
    refused(ONE_ARM, **stiff, **{"station.environment.damping": 1.002 * largest_damping})
    # Without it the surface would be too stiff; with it every surface is unstable.
    message = refused(ONE_ARM, **{"station.environment.stiffness": 6e3, "station.environment.damping": 2500.0})
    assert "station.environment.stiffness = 6000 N/m is unstable" in message
    assert "no stiffness is stable with the contact's damping of 2500 N s/m: must have another controller" in message


def test_dissipation_is_damping_about_the_smallest_and_the_largest_desired_force():
    damping = 400.0
    limit = largest(ONE_ARM, **{"station.environment.damping": damping})
    for force in (8.0, 16.0):
        changes = {"reference.force": force, "station.environment.dissipation": damping / force}
        assert largest(ONE_ARM, **changes) == pytest.approx(limit)
    steps = {"reference": Tagged({"times": [0.0, 1.0, 2.0], "forces": [4.0, 20.0, 0.0]}, "Sequence")}
    stiff = {"station.environment.stiffness": 6e3}
    built(ONE_ARM, **stiff, **{"station.environment.dissipation": 50.0, "reference.force": 8.0})
    # About 4 N it is too little damping for so stiff a surface, about 20 N too much for a soft one.
    assert "stiffness = 6000 N/m is unstable" in refused(
        ONE_ARM, **stiff, **steps, **{"station.environment.dissipation": 20.0}
    )
    message = refused(ONE_ARM, **steps, **{"station.environment": {"stiffness": 4e3, "dissipation": 60.0}})
    assert "station.environment.dissipation = 60 s/m is too much about 20 N on 4000 N/m" in message
    dissipation = float(message.split("must be at most ")[1].split()[0])
    built(ONE_ARM, **steps, **{"station.environment": {"stiffness": 4e3, "dissipation": dissipation}})


def test_a_law_behind_a_governor_is_looked_at():
    inside = ONE_ARM.replace("!Admittance {", "!Governed {inner_bandwidth: 1.5, law: !Admittance {").replace(
        "0.0}", "0.0}}"
    )
    assert "is unstable with inertia = 3 kg" in refused(inside, **{"station.environment.stiffness": 1e5})


def test_the_factor_of_a_projection_is_a_gain_of_the_loop():
    twice = SENSORLESS.replace("along: normal", "along: normal, factor: 2.0")
    assert largest(twice) < 0.7 * largest(SENSORLESS)


def test_the_direction_of_a_projection_is_a_gain_of_the_loop():
    along = {
        axis: largest(SENSORLESS.replace("along: normal", f"along: {axis}")) for axis in ("[0, 0, 2]", "[1, 0, 1]")
    }
    half = largest(SENSORLESS.replace("along: normal", "along: normal, factor: 0.7071067811865476"))
    assert along == {"[0, 0, 2]": largest(SENSORLESS), "[1, 0, 1]": pytest.approx(half)}
    # The force of the wrong sign pushes the tool into the surface.
    message = refused(SENSORLESS.replace("along: normal", "along: [0, 0, -1]"))
    assert "must have a measured force that rises with the contact force, not -1 times that force" in message


TWO_SENSORS = (
    ONE_ARM
    + """
station: {sensors: {force: !WristForce {bandwidth: FIRST}, other: !WristForce {bandwidth: SECOND}}}
signals: {measured_force: !From {part: station, signal: SIGNAL}}
"""
)


def test_the_lag_is_that_of_the_sensor_that_is_read():
    alone = {width: largest(ONE_ARM, **{"station.sensors.force.bandwidth": width}) for width in (20.0, 5.0)}
    assert alone[5.0] < 0.6 * alone[20.0]
    for signal, read in (("measured_force", 20.0), ("other_measured_force", 5.0)):
        text = TWO_SENSORS.replace("FIRST", "20.0").replace("SECOND", "5.0").replace("SIGNAL", signal)
        assert largest(text) == alone[read]


def test_a_hybrid_controller_reads_the_wrench():
    reads = "signals: {measured_wrench: !From {part: station, signal: SIGNAL}}"
    sensors = (
        "fidelity: Multibody, sensors: {force: !WristForce {bandwidth: 20.0}, other: !WristForce {bandwidth: 5.0}}"
    )
    text = PRESSED.replace("fidelity: Multibody", sensors).replace("WITHIN", WITHIN["!Hybrid"]) + reads
    first, other = (limit_of(text.replace("SIGNAL", name)) for name in ("measured_wrench", "other_measured_wrench"))
    assert other < 0.6 * first


def test_the_lag_is_that_of_the_estimator_that_is_read_and_the_truth_has_none():
    both = "estimators: {force: !ForceEstimator {gain: 60.0}, slow: !ForceEstimator {gain: 8.0}}"
    for name, gain in (("force", 60.0), ("slow", 8.0)):
        choice = f"signals: {{estimated_wrench: !From {{part: {name}}}, measured_force"
        two = SENSORLESS.replace("estimators: {force: !ForceEstimator {}}", both).replace(
            "signals: {measured_force", choice
        )
        assert largest(two) == largest(SENSORLESS, **{"estimators.force.gain": gain})
    exact = SENSORLESS.replace("signals: {", "signals: {estimated_wrench: !Exact {of: tip_wrench}, ")
    assert largest(exact) > 3 * largest(SENSORLESS)


def has_a_law_inside(cls: Any) -> bool:
    """Whether a configuration, or one of those in its keys, has a slot for a controller."""
    found = False
    for field, kind in typed_fields(cls):
        inside = [each for each in (kind, *get_args(kind)) if isinstance(each, type) and issubclass(each, Config)]
        found |= key_of(field).slot == "controller" or any(has_a_law_inside(each) for each in inside)
    return found


def test_whatever_has_a_law_inside_says_so():
    around = {tag for tag, path in SLOTS["controller"].items() if has_a_law_inside(load_object(path))}
    walked = {tag for tag in around if hasattr(load_object(SLOTS["controller"][tag]), "force_laws")}
    assert {"Approach", "Governed", "Hybrid", "Passive", "PerArm"} <= walked
    # With its correction a law is no linear system.
    assert around - walked == {"InvarianceControl", "AdaptiveInvarianceControl"}


PRESSED = """
preset: linear
station: {fidelity: Multibody, environment: !Surface {stiffness: 2.0e4, damping: 0.0}}
controller: WITHIN
reference: !Step {force: 10.0}
"""
LAW = "!Admittance {inertia: 3.0, damping: 150.0}"
WITHIN = {
    "!Approach": f"!Approach {{law: {LAW}}}",
    "!Governed": f"!Governed {{inner_bandwidth: 1.5, law: {LAW}}}",
    "!Passive": f"!Passive {{law: {LAW}}}",
    "!PerArm": f"!PerArm {{laws: {{arm: {LAW}}}}}",
    "!Hybrid": f"!Hybrid {{directions: {{z: {{law: {LAW}}}}}}}",
    "!Hybrid of two": (
        f"!Hybrid {{directions: {{z: {{law: {LAW}}}, x: {{law: {LAW}, desired: 0.0, compliance: 1e-4}}}}}}"
    ),
    "!Passive in !Hybrid": f"!Hybrid {{directions: {{z: {{law: !Passive {{law: {LAW}}}}}}}}}",
}


@pytest.mark.parametrize("controller", WITHIN.values(), ids=WITHIN)
def test_a_law_within_others_is_refused_as_it_is_alone(controller):
    alone, within = (refused(PRESSED.replace("WITHIN", law)) for law in (LAW, controller))
    assert within == alone
    assert "must be at most 1970 N/m" in alone


def tilted(degrees: float, **directions: str) -> str:
    """Of a task frame that is turned about its y, with these laws in directions."""
    compliant = ", ".join(f"{name}: {{law: {law}, desired: 8.0, compliance: 1e-4}}" for name, law in directions.items())
    turned = f"rotation_deg: [180.0, {degrees}, 0.0]"
    return PRESSED.replace("WITHIN", f"!Hybrid {{directions: {{{compliant}}}, {turned}}}")


def limit_of(text: str) -> float:
    return float(refused(text).split("must be at most ")[1].split()[0])


def test_an_axis_beside_the_normal_feels_its_share_of_the_stiffness():
    scenario = load_scenario(parse(tilted(35.0, z=LAW), "test"))
    setting = scenario.setting()
    ((_, share),) = scenario.controller.force_laws(setting.truth.loop(0))
    # The motors hold the weight at the start, which turns the tool by 0.2 degrees.
    assert share == pytest.approx(np.cos(np.radians(35.0)) ** 2, rel=0.01)
    whole, compliance = limit_of(tilted(0.0, z=LAW)), setting.workcell.contact.robot_compliance
    part = 1 / (share * (1 / whole + compliance) - compliance)
    assert limit_of(tilted(35.0, z=LAW)) == pytest.approx(part, rel=2e-3)
    # Equal laws in two axes are one law along the normal between them.
    assert limit_of(tilted(35.0, x=LAW, z=LAW)) == whole


def test_unlike_laws_in_two_axes_are_checked_together():
    nearly = LAW.replace("150.0", "150.1")
    assert limit_of(tilted(45.0, x=LAW, z=nearly)) == pytest.approx(limit_of(tilted(45.0, x=LAW, z=LAW)), rel=2e-3)
    stiffer = LAW.replace("150.0", "300.0")
    message = refused(tilted(45.0, x=stiffer, z=LAW))
    both = "inertia = 3 kg and damping = 300 N s/m, together with inertia = 3 kg and damping = 150 N s/m"
    assert f"station.environment.stiffness = 20000 N/m is unstable with {both}: the largest pole" in message
    limits = [limit_of(tilted(0.0, z=law)) for law in (LAW, stiffer)]
    assert limits[0] < limit_of(tilted(45.0, x=stiffer, z=LAW)) < limits[1]
    missing = tilted(60.0, x="!Integral {}", z=LAW).replace("compliance: 1e-4", "compliance: null")
    assert "controller.directions.z.compliance: must be given" in refused(missing)
    # A law inside another is combined as well; one across the normal is not.
    behind = f"!Passive {{law: {stiffer}}}"
    assert limit_of(tilted(45.0, x=behind, z=LAW)) == limit_of(tilted(45.0, x=stiffer, z=LAW))
    assert limit_of(tilted(0.0, x=stiffer, z=LAW)) == limits[0]


@pytest.mark.slow
def test_the_force_along_two_axes_settles_below_the_limit_and_swings_beyond(monkeypatch):
    text = tilted(45.0, x=LAW.replace("150.0", "300.0"), z=LAW)
    assert_settles_and_swings(monkeypatch, text, limit_of(text))


@pytest.mark.slow
def test_the_force_along_such_an_axis_settles_below_the_limit_and_swings_beyond(monkeypatch):
    text = tilted(35.0, z=LAW)
    assert_settles_and_swings(monkeypatch, text, limit_of(text))


def test_a_law_across_the_normal_is_left_alone():
    other = "!Integral {integral_gain: 1.0}"
    built(tilted(0.0, x=LAW, z=other))


def test_the_printed_stiffness_is_accepted_and_the_pole_is_outside():
    draw = np.random.default_rng(77)
    for _ in range(6):
        damping = 10 ** draw.uniform(2.0, 3.2)
        law = {"controller.damping": damping, "controller.inertia": damping * 10 ** draw.uniform(-2.5, -0.8)}
        message = refused(ONE_ARM, **law, **{"station.environment.stiffness": 1e6})
        stiffness = float(message.split("must be at most ")[1].split()[0])
        built(ONE_ARM, **law, **{"station.environment.stiffness": stiffness})
        above = refused(ONE_ARM, **law, **{"station.environment.stiffness": 1.0011 * stiffness})
        assert float(above.split("largest pole of the sampled loop is ")[1].split()[0]) > 1.0


def test_other_controllers_are_left_alone():
    wild = ONE_ARM.replace("!Admittance {inertia: 3.0, damping: 300.0}", "!Integral {integral_gain: 500.0}")
    built(wild)
