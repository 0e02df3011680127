"""Guarded moves: modes and displacements by themselves, and force laws behind them on surfaces that start away."""

import numpy as np
import pytest
from pydrake.systems.framework import Diagram, DiagramBuilder
from pydrake.systems.primitives import AffineSystem, LinearSystem, PassThrough, Saturation

import forcectl as fc
from forcectl.errors import BadInputError
from forcectl.force.approach import ApproachConfig, ApproachMode, GuardedMove
from forcectl.force.invariance.predictive import PredictiveInvarianceConfig
from forcectl.framework.yaml_tree import Tagged, parse
from forcectl.testing import Log, run_diagram
from tests.force.baselines.ideal_plant import model

PERIOD = 0.002
KEYS = {"speed": 0.02, "threshold": 1.0, "touch_speed": 0.004, "step_back": 0.1, "patience": 0.1, "timeout": 2.0}
KEYS |= {"clearance": 0.005, "rise_time": 0.0}
APPROACH, TOUCH, CONTACT, LEAVE, GAVE_UP = map(float, ApproachMode)


def moves(force, ticks: int, desired=15.0, **changed: float) -> Log:
    """A guarded move that is given forces over time, numbers or functions of it."""
    block = GuardedMove(1, **{**KEYS, **changed}, period=PERIOD)
    inputs = {"desired_force": desired, "measured_force": force}
    return run_diagram(block, (ticks - 1) * PERIOD, period=PERIOD, inputs=inputs)


def on_a_wall(depth: float, stiffness: float = 1e4, desired=15.0, ticks: int = 2000, **changed: float) -> Log:
    """The move alone against a wall at -depth [m], without lags."""
    builder = DiagramBuilder()
    move = builder.AddNamedSystem("move", GuardedMove(1, **{**KEYS, **changed}, period=PERIOD))
    touched = builder.AddNamedSystem("wall", wall(depth, stiffness))
    builder.Connect(move.GetOutputPort("approach_displacement"), touched.get_input_port())
    builder.Connect(touched.get_output_port(), move.GetInputPort("measured_force"))
    builder.ExportInput(move.GetInputPort("desired_force"), "desired_force")
    for i in range(move.num_output_ports()):
        builder.ExportOutput(move.get_output_port(i), move.get_output_port(i).get_name())
    return run_diagram(builder.Build(), (ticks - 1) * PERIOD, period=PERIOD, inputs={"desired_force": desired})


def way(log: Log) -> list[float]:
    """The modes one after the other."""
    mode = log["approach_mode"][:, 0]
    return mode[np.append(True, np.diff(mode) != 0)].tolist()


def test_it_moves_at_its_speed_until_the_threshold_and_goes_back():
    log = moves(lambda t: 5.0 if t > 0.5 - 1e-9 else 0.0, 260)
    x, mode = log["approach_displacement"][:, 0], log["approach_mode"][:, 0]
    np.testing.assert_allclose(x[:250], -0.02 * PERIOD * np.arange(1, 251), atol=1e-12)
    assert (mode[:250] == APPROACH).all()
    assert mode[250] == TOUCH
    assert x[250] == pytest.approx(x[249] + 0.02 * 0.1)


def test_it_comes_to_its_speed_within_the_rise_time_in_both_touches():
    log = moves(lambda t: 5.0 if 0.6 < t < 0.7 or t > 1.6 else 0.0, 900, rise_time=0.4)
    speed, mode = np.diff(log["approach_displacement"][:, 0]) / PERIOD, log["approach_mode"][1:, 0]
    risen = np.minimum(np.arange(1, 901) / 200, 1.0)
    first, second = speed[(mode == APPROACH)], speed[(mode == TOUCH) & (speed < 0.0)]
    assert (len(first), len(second)) == (300, 451)
    np.testing.assert_allclose(first, -0.02 * risen[1:301], atol=1e-12)  # the first tick has none to differ from
    np.testing.assert_allclose(second, -0.004 * risen[:451], atol=1e-12)


def test_it_touches_twice_and_hands_over_at_rest():
    log = on_a_wall(0.01, step_back=0.005)
    assert way(log) == [APPROACH, TOUCH, CONTACT]
    x, mode = log["approach_displacement"][:, 0], log["approach_mode"][:, 0]
    assert (np.diff(x[mode == CONTACT]) == 0.0).all()
    # The second touch goes no further than the threshold and a tick or two of its slow speed, and goes back as well.
    deepest = x[mode == TOUCH].min()
    assert 1.0 < 1e4 * (-0.01 - deepest) < 1.0 + 2 * 1e4 * 0.004 * PERIOD
    assert x[-1] == pytest.approx(deepest + 0.004 * 0.005)
    inside = mode == CONTACT
    np.testing.assert_array_equal(log["regulated_force"][:, 0], np.where(inside, 15.0, 0.0))
    assert (log["force_in_contact"][~inside] == 0.0).all()
    assert (log["force_in_contact"][inside] > 0.0).all()


def test_a_force_that_stays_after_the_first_touch_is_a_contact():
    log = moves(lambda t: 5.0 if t > 0.5 else 0.0, 400)
    assert way(log) == [APPROACH, TOUCH, CONTACT]


def test_without_a_surface_it_gives_up_and_stays():
    log = moves(0.0, 1500)
    assert way(log) == [APPROACH, GAVE_UP]
    x = log["approach_displacement"][:, 0]
    assert x[-1] == pytest.approx(-0.02 * 2.0, abs=1e-4)
    assert x[-1] == x[-400]


def test_a_lost_contact_is_looked_for_slowly_and_found():
    def force(t: float) -> float:
        return 5.0 if 0.5 < t < 1.0 or t > 2.0 else 0.0

    log = moves(force, 1300)
    assert way(log) == [APPROACH, TOUCH, CONTACT, TOUCH, CONTACT]
    lost = (log.time > 1.2) & (log.time < 2.0)
    np.testing.assert_allclose(np.diff(log["approach_displacement"][lost, 0]), -0.004 * PERIOD, atol=1e-12)


def test_a_short_loss_is_the_laws_to_mend():
    log = moves(lambda t: 0.0 if t < 0.5 or 1.0 < t < 1.05 else 5.0, 800)
    assert way(log) == [APPROACH, TOUCH, CONTACT]


@pytest.mark.slow
def test_a_desired_force_of_zero_leaves_the_surface_and_comes_back():
    log = on_a_wall(0.01, step_back=0.005, desired=lambda t: 0.0 if 2.0 < t < 3.0 else 15.0, ticks=3000)
    assert way(log) == [APPROACH, TOUCH, CONTACT, LEAVE, APPROACH, TOUCH, CONTACT]
    x, left = log["approach_displacement"][:, 0], (log.time > 2.5) & (log.time < 2.9)
    at = x[np.flatnonzero(log["approach_mode"][:, 0] == CONTACT)[0]]
    np.testing.assert_allclose(x[left], at + 0.005, atol=1e-9)


def test_before_a_force_is_wanted_it_does_not_move():
    log = moves(0.0, 200, desired=0.0)
    assert way(log) == [LEAVE]
    assert not log["approach_displacement"].any()


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_a_bad_reading_holds_the_move(bad):
    log = moves(lambda t: bad if 0.1 < t < 0.2 else 0.0, 200)
    x = log["approach_displacement"][:, 0]
    held = (log.time > 0.1) & (log.time < 0.2)
    assert len(set(x[held].tolist())) == 1
    assert way(log) == [APPROACH]


@pytest.mark.parametrize("law", ["!RecursiveVrft {}", "!Governed {law: !RecursiveVrft {}}"])
def test_an_experiment_is_refused(law):
    tree = parse(f"controller: !Approach {{law: {law}}}", "own.yaml")
    with pytest.raises(BadInputError, match=r"controller\.law starts its experiment at the start of"):
        fc.build(tree)


def test_what_is_no_law_is_refused():
    with pytest.raises(BadInputError, match="is no force law: must have desired_force, measured_force"):
        ApproachConfig(law=_Other()).add_to(DiagramBuilder(), model())


class _Other:
    def add_to(self, builder, model):
        return builder.AddNamedSystem("law", PassThrough(1))


class _Approached(_Other):
    add_approached = _Other.add_to


@pytest.mark.parametrize(
    ("law", "says"),
    [
        (
            "!JointMoves {}",
            "JointPath cannot follow a guarded move: must be a force law, or a controller of joints with add_appro",
        ),
        (
            "!Hybrid {directions: {z: {}}}",
            "Hybrid cannot follow a guarded move: must be a force law, or a controller of joints w",
        ),
        ("!Approach {}", "ApproachForceLaw has a guarded move of its own: must be a law without one"),
    ],
)
def test_what_cannot_be_approached_is_named_in_one_line(law, says, tmp_path):
    path = tmp_path / "own.yaml"
    path.write_text(f"station: {{fidelity: Kinematic}}\ncontroller: !Approach {{law: {law}}}\n")
    with pytest.raises(BadInputError) as caught:
        fc.build(str(path))
    assert f"own.yaml:2: controller.law: {says}" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_controller_that_is_approached_has_the_ports_for_it():
    with pytest.raises(
        BadInputError, match=r"add_approached returns a PassThrough: must have the inputs desired_force, .*ap"
    ):
        ApproachConfig(law=_Approached()).add_to(DiagramBuilder(), model())


def wall(depth: float, stiffness: float) -> Diagram:
    """F = max(0, stiffness (-depth - x)) a tick later."""
    builder = DiagramBuilder()
    none, eye = np.zeros((1, 1)), np.eye(1)
    spring = builder.AddSystem(AffineSystem(D=-stiffness * eye, y0=[-stiffness * depth]))
    pushes = builder.AddSystem(Saturation([0.0], [np.inf]))
    delay = builder.AddSystem(LinearSystem(none, eye, eye, none, PERIOD))
    builder.Connect(spring.get_output_port(), pushes.get_input_port())
    builder.Connect(pushes.get_output_port(), delay.get_input_port())
    builder.ExportInput(spring.get_input_port(), "displacement")
    builder.ExportOutput(delay.get_output_port(), "contact_force")
    return builder.Build()


def station(stiffness: float, speed: float, law: Tagged, **overrides: object) -> dict[str, object]:
    return {
        "station": {
            "fidelity": "OneDimensional",
            "environment": Tagged({"stiffness": stiffness, "surface": {"gap": 0.005}}, "Surface"),
        },
        "controller": Tagged({"law": law, "speed": speed}, "Approach"),
        "reference": Tagged({"force": 15.0}, "Step"),
        "duration": 5.0,
        **overrides,
    }


@pytest.mark.slow
@pytest.mark.parametrize(("stiffness", "speed"), [(1e4, 0.05), (1e5, 0.005)])
def test_the_integral_law_takes_over_without_a_jump_and_keeps_the_contact(stiffness, speed):
    log = fc.run(station(stiffness, speed, Tagged({}, "Integral"))).log
    mode, command = log["approach_mode"].values.ravel(), log["displacement_command"].values.ravel()
    taken = int(np.argmax(mode == CONTACT))
    assert abs(command[taken] - command[taken - 1]) < 1e-5
    assert float(log["contact_force"][0]) == 0.0
    assert (log["contact_force"].values[taken:] > 0).all()
    assert float(log["contact_force"][-1]) == pytest.approx(15.0, abs=0.75)


def test_a_law_that_reads_the_motors_is_not_given_the_approach():
    """Of the same law with the move's displacement added to what its motors read: the same command, moved on."""
    config = ApproachConfig(law=PredictiveInvarianceConfig(), speed=0.02, rise_time=0.0)
    law = config.add_to(DiagramBuilder(), model())
    inputs = {"desired_force": 15.0, "measured_force": 0.0, "path_displacement": 0.0}
    following = {**inputs, "motor_displacement": lambda t: -0.02 * (round(t / PERIOD) + 1) * PERIOD}
    log = run_diagram(law, 0.2, period=PERIOD, inputs=following)
    np.testing.assert_allclose(log["displacement_command"], log["approach_displacement"], atol=1e-12)
    np.testing.assert_allclose(log["drive_offset"], 0.0, atol=1e-9)


@pytest.mark.parametrize("distance", [1e-4, 0.004, 0.03])
def test_the_time_for_a_distance_is_when_the_first_motion_is_there(distance):
    config = ApproachConfig(speed=0.02, rise_time=0.5)
    log = moves(0.0, 1200, speed=0.02, rise_time=0.5, timeout=5.0)
    there = log.time[np.flatnonzero(log["approach_displacement"][:, 0] <= -distance)[0]]
    assert there == pytest.approx(config.time_for(distance), abs=3 * PERIOD)
