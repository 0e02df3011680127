"""Signals connect by name; what stands for one is chosen in the scenario, and what no part outputs is refused."""

import numpy as np
import pytest

import forcectl as fc
from forcectl.conventions import SIGNALS, TRUTH
from forcectl.framework.yaml_tree import parse

ARM = """
preset: ideal
station:
  fidelity: Multibody
  robot: yumi
  tool: yumi_gripper
  drive: !JointInterface {friction: {scale: 0.0}}
  sensors: {joints: !JointReadings {}}
  environment: !Parts
    parts:
      table: !Surface {arm: left, stiffness: 5.0e3}
      wall: !Surface {arm: right, stiffness: 2.0e4}
estimators: {force: !ForceEstimator {}}
controller: !PerArm {laws: {left: !Integral {}, right: !Integral {integral_gain: 2.0}}}
reference: !Step {force: 10.0}
signals: {measured_force: !Projection {}}
duration: 2.0
"""


def scenario(text: str = ARM, **changes):
    return parse(text, "own.yaml") | changes


def test_what_two_laws_put_out_is_logged_with_the_name_of_the_arm_in_front():
    laws = "!PerArm {laws: {left: !AdaptiveInvariance {}, right: !AdaptiveIntegral {}}}"
    log = fc.run(scenario(controller=parse(laws, "own.yaml"), duration=0.02)).log
    for name in ("left_environment_compliance", "right_environment_compliance"):
        assert (log[name].dims, log[name].attrs["units"]) == (("time",), "m/N")
    assert "left_invariance_function" in log


def test_a_projection_of_ones_own_is_logged_in_newton_by_surface():
    signals = parse("{measured_force: !Projection {}, pull: !Projection {factor: -1.0}}", "own.yaml")
    log = fc.run(scenario(signals=signals, duration=0.02)).log
    assert (log["pull"].dims, log["pull"].attrs["units"]) == (("time", "surface"), "N")
    np.testing.assert_array_equal(log["pull"], -log["measured_force"])
    of_one = parse("{measured_force: !Projection {}, pull: !Projection {arm: right}}", "own.yaml")
    log = fc.run(scenario(signals=of_one, duration=0.02)).log
    assert (log["pull"].dims, log["pull"].attrs["units"]) == (("time",), "N")


@pytest.mark.slow
def test_two_laws_press_with_two_arms_on_two_surfaces():
    result = fc.run(scenario())
    log = result.log
    assert list(log["surface"].values) == ["table", "wall"]
    np.testing.assert_allclose(log["contact_force"].values[-1], 10.0, atol=1.0)
    np.testing.assert_allclose(log["measured_force"].values[-1], log["contact_force"].values[-1], atol=0.2)
    # Neither arm feels the surface of the other.
    depth = -log["contact_displacement"].values[-1]
    np.testing.assert_allclose(log["contact_force"].values[-1] / depth, [5e3, 2e4], rtol=0.1)
    assert {"table.steady_state_error_N", "wall.steady_state_error_N"} <= set(result.metrics["default"])


@pytest.mark.slow
def test_one_law_presses_with_both():
    controller = parse("!Integral {integral_gain: 4.0}", "own.yaml")
    log = fc.run(scenario(controller=controller, duration=0.8)).log
    np.testing.assert_allclose(log["measured_force"].values[-1], 10.0, atol=1.0)


@pytest.mark.slow
def test_a_hand_does_not_touch_the_plate_that_its_ball_presses_on():
    """Links that may touch each other go through the surfaces; the fingers reach beyond the TCPs here."""
    changes = [{"station.self_collision": own, "duration": 0.1} for own in (True, False)]
    forces = [fc.run(scenario(), overrides=each).log["contact_force"].values for each in changes]
    assert forces[1].max() > 1.0
    np.testing.assert_allclose(forces[0], forces[1], atol=1e-6)


TWO_SENSORS = """
station:
  sensors:
    force: !WristForce {noise_std: 0.0, quantum: 0.0}
    slow: !WristForce {noise_std: 0.0, quantum: 0.0, bias: 2.0, tare: false}
duration: 0.3
"""


@pytest.mark.parametrize("fidelity", ["OneDimensional", "Kinematic", "Multibody"])
def test_a_second_sensor_of_a_kind_has_its_name_in_front(fidelity):
    overrides = {"signals.measured_force": parse("!From {part: station, signal: slow_measured_force}", "test")}
    chosen = {"signals.measured_force": parse("!From {part: station}", "test")}
    first = fc.run(scenario(TWO_SENSORS), fidelity=fidelity, overrides=chosen)
    station = first.diagram.GetSubsystemByName("station")
    assert {each.get_name() for each in station.GetSystems()} >= {"force_sensor", "slow_force_sensor"}
    assert station.HasOutputPort("slow_measured_wrench")
    second = fc.run(scenario(TWO_SENSORS), fidelity=fidelity, overrides=overrides)
    # The loop regulates what the sensor tells, its bias included; a wrist sensor has that in its own axes.
    forces = [each.log["measured_force"].values[-1] - each.log["contact_force"].values[-1] for each in (first, second)]
    assert abs(forces[1] - forces[0]) == pytest.approx(2.0, abs=0.3)


def test_a_signal_is_chosen_of_a_part_that_there_is():
    choice = parse("!From {part: nope}", "test")
    for name in ("measured_force", "estimated_wrench"):  # no part outputs the latter
        with pytest.raises(fc.BadInputError, match=rf"signals\.{name}\.part: unknown part 'nope': known: .*station"):
            fc.build(fc.load_scenario({"signals": {name: choice}}))


def test_the_truth_cannot_be_chosen():
    for signal in ("contact_force", "measured_torque"):
        choice = parse(f"!From {{part: station, signal: {signal}}}", "test")
        with pytest.raises(fc.BadInputError, match=rf"signals\.measured_force: no part outputs {signal}: must be"):
            fc.build(fc.load_scenario({"signals": {"measured_force": choice}}))


def exact(signal: str):
    return {"estimated_wrench": parse(f"!Exact {{of: {signal}}}", "f"), "measured_force": parse("!Projection {}", "f")}


@pytest.mark.slow
def test_a_truth_is_chosen_where_the_scenario_says_that_it_is_one():
    log = fc.run(scenario(signals=exact("tip_wrench"), duration=0.4)).log
    np.testing.assert_array_equal(log["estimated_wrench"], log["tip_wrench"])
    np.testing.assert_allclose(log["measured_force"], log["contact_force"], atol=1e-9)
    assert log["contact_force"].values[-1].min() > 1.0
    with pytest.raises(fc.BadInputError, match=r"signals\.estimated_wrench\.of: unknown truth 'joint_position'"):
        fc.build(fc.load_scenario(scenario(signals=exact("joint_position"))))


def test_behind_a_joint_interface_motors_are_known_by_its_readings():
    """Their exact positions are for the log only."""
    loop = fc.build(fc.load_scenario(scenario(controller="!Integral", duration=0.1)))
    controller, station = (loop.diagram.GetSubsystemByName(name) for name in ("controller", "station"))
    given = {
        loop.diagram.connection_map()[(controller, controller.GetInputPort(name).get_index())]
        for name in ("motor_position", "motor_velocity")
    }
    readings = {station.GetOutputPort(name).get_index() for name in ("joint_position", "joint_velocity")}
    assert {(system.get_name(), port) for system, port in given} == {("station", port) for port in readings}
    with pytest.raises(fc.BadInputError, match=r"controller reads joint_position .*, which no part outputs"):
        fc.build(fc.load_scenario({"station": {"drive": "!JointInterface", "fidelity": "Multibody"}}))


def test_a_force_loop_takes_the_positions_of_its_motors_from_encoders_where_it_says_so():
    """`docs/hunting.md`: whole quanta, and what else the controller reads is as before."""
    text = """
    station:
      fidelity: Multibody
      sensors: {force: !WristForce {}, joints: !JointReadings {quantum: 1.0e-6}}
      drive: !PositionLoop {encoders: true}
    controller: !AdaptiveInvariance {}
    duration: 0.1
    """
    loop = fc.build(fc.load_scenario(parse(text, "own.yaml")))
    controller, station = (loop.diagram.GetSubsystemByName(name) for name in ("controller", "station"))
    given = loop.diagram.connection_map()[(controller, controller.GetInputPort("motor_position").get_index())]
    assert given == (station, station.GetOutputPort("joint_position").get_index())
    log = fc.run(parse(text, "own.yaml")).log
    read, exact = log["joint_position"].values, log["motor_position"].values
    np.testing.assert_allclose(read / 1e-6, np.round(read / 1e-6), atol=1e-6)
    assert 0 < np.abs(read[1:] - exact[1:]).max() < 0.51e-6
    with pytest.raises(fc.BadInputError, match=r"controller reads joint_position .*, which no part outputs"):
        fc.build(fc.load_scenario({"station": {"drive": {"encoders": True}}}))


def test_a_projection_is_the_force_along_the_normal():
    loop = fc.build(fc.load_scenario(scenario()))
    projection = loop.diagram.GetSubsystemByName("measured_force_projection")
    gain = projection.D()
    assert gain.shape == (2, 12)
    np.testing.assert_allclose(gain[0, 3:6], loop.setting.model.normals[0])
    np.testing.assert_allclose(gain[1, 9:12], loop.setting.model.normals[1])
    assert np.count_nonzero(gain) == 2


@pytest.mark.slow
def test_a_momentum_observer_watches_a_loop_with_a_force_sensor():
    text = """
    station:
      fidelity: Multibody
      sensors: {force: !WristForce {}, joints: !JointReadings {}}
    estimators: {watch: !ForceEstimator {}}
    duration: 2.0
    """
    log = fc.run(parse(text, "own.yaml")).log
    estimated = log["estimated_wrench"].isel(wrench_component=-1)
    assert float(estimated[-1]) == pytest.approx(float(log["contact_force"][-1]), abs=0.5)


def test_a_load_on_the_elbow_is_no_load_on_the_tool():
    load = {"body": "left_link_3", "start": 0.1, "hold": 0.3, "wrenches": [[0, 0, 0, 0, 10, 0]]}
    base = scenario(controller="!JointMoves", signals={}, duration=0.35)
    log = fc.run(base, overrides={"station.loads": [load], "station.environment": "!Parts"}).log
    assert float(abs(log["external_torque"]).max()) > 0.5
    assert not log["tip_wrench"].values.any()


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        (
            {"signals": {}},
            "controller reads measured_force (measured force of each surface on the tool along its normal)",
        ),
        ({"estimators": {}}, "signals.measured_force reads estimated_wrench"),
        (
            {"signals": {"measured_force": parse("!Projection {of: motor_torque}", "f")}},
            "must be a signal of shape (12,)",
        ),
        ({"signals": {"measured_force": parse("!Projection {arm: middle}", "f")}}, "unknown arm 'middle'"),
        (
            {"signals": {"measured_force": parse("!Projection {along: up}", "f")}},
            "along = 'up': must be normal, or three",
        ),
        ({"signals": {"measured_force": parse("!Projection {of: tip_wrench}", "f")}}, "reads tip_wrench"),
        ({"signals": {"measured_force": parse("!Projection {arm: left}", "f")}}, "has size 2: must be 1"),
        ({"controller": parse("!PerArm {laws: {left: !Integral {}}}", "f")}, "must be one for each arm that presses"),
        (
            {"controller": parse("!PerArm {laws: {left: !InvarianceRobot {}, right: !Integral {}}}", "f")},
            "laws.left: InvarianceController commands joints: must be a force law",
        ),
    ],
)
def test_what_does_not_connect_is_one_line(changes, text):
    with pytest.raises(fc.BadInputError) as caught:
        fc.build(fc.load_scenario(scenario(**changes)))
    assert text in str(caught.value)
    assert "\n" not in str(caught.value)


def test_two_providers_are_an_error_until_the_scenario_chooses():
    several = {"force": parse("!ForceEstimator {gain: 10}", "f"), "other": parse("!ForceEstimator {}", "f")}
    with pytest.raises(fc.BadInputError, match=r"'force', 'other' output: must have signals\.estimated_wrench to"):
        fc.build(fc.load_scenario(scenario(estimators=several)))
    chosen = {
        "estimated_wrench": parse("!From {part: other}", "f"),
        "measured_force": parse("!Projection {}", "f"),
    }
    fc.build(fc.load_scenario(scenario(estimators=several, signals=chosen)))


def test_every_signal_says_unit_shape_and_meaning():
    for name, signal in SIGNALS.items():
        assert signal.shape in ("1", "6", "n", "a", "k", "h", "6a", "3m", "4m"), name
        assert signal.unit
        assert signal.meaning
    assert "contact_force" in TRUTH
    assert "measured_force" not in TRUTH
