"""The experiment in the slot of a force law: its sequence, in every loop, and what it does when the tuning fails."""

import math
from functools import cache

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator

import forcectl
from forcectl.diagrams.one_dimensional_loop import OneDimensionalLoopConfig, build_one_dimensional_loop
from forcectl.errors import BadInputError
from forcectl.estimation.recursive_vrft import GAINS
from forcectl.force.linear_law import EXCITE, REGULATE
from forcectl.force.vrft.experiment import ExperimentSequencer, RecursiveVrftConfig
from forcectl.motion.excitation import TrapezoidalMovesConfig
from forcectl.motion.references import StepConfig
from forcectl.plant.drives.servo import ServoConfig
from forcectl.testing import run_diagram

PERIOD = 0.002
SHORT = TrapezoidalMovesConfig(depths=[0.0, 1e-3, 2e-3, 0.0], rest=0.5, start_rest=0.1)


def modes(block: ExperimentSequencer, duration: float = 1.0, **inputs: object) -> np.ndarray:
    known = {"excitation": 0.0, "proportional_gain": -5e-5, "integral_gain": -2.5e-4}
    return run_diagram(block, duration, period=PERIOD, inputs=known | inputs)["mode"]


def test_it_hands_over_one_tick_after_its_time_and_for_good():
    mode = modes(ExperimentSequencer(1, hand_over_time=0.5))[:, 0]
    assert (mode[:251] == EXCITE).all()
    assert (mode[251:] == REGULATE).all()


def test_it_hands_over_once_the_gains_have_settled_and_the_excitation_rests():
    gain = {"integral_gain": lambda t: -2.5e-4 * min(1.0, 0.1 + 3 * t)}
    mode = modes(ExperimentSequencer(1, window=0.2, tolerance=0.001), **gain)[:, 0]
    assert mode.argmax() == pytest.approx((0.3 + 0.2) / PERIOD, abs=3)
    moving = gain | {"excitation": lambda t: -1e-3 * min(t, 0.8)}
    assert modes(ExperimentSequencer(1, window=0.2, tolerance=0.001), **moving)[:, 0].argmax() > 0.8 / PERIOD


@pytest.mark.parametrize("bad", [0.0, 1e-4, math.nan, -math.inf])
def test_there_is_no_hand_over_with_gains_that_cannot_regulate(bad):
    assert not modes(ExperimentSequencer(1, hand_over_time=0.2, window=0.2), integral_gain=bad).any()
    gains = [[-1e-4, bad]]
    elements = modes(ExperimentSequencer(2, hand_over_time=0.2), integral_gain=lambda t: gains[0])
    assert elements[-1].tolist() == [REGULATE, EXCITE]


def one_run(fidelity: str) -> forcectl.runs.run.RunResult:
    overrides = {
        "controller": RecursiveVrftConfig(excitation=SHORT),
        "reference": StepConfig(force=10.0, start_time=3.4),
        "duration": 6.8,
        "station.fidelity": fidelity,
    }
    return forcectl.run("table_4_1", variant="VRFT", overrides=overrides)


@cache
def kept_run(fidelity: str) -> forcectl.runs.run.RunResult:
    return one_run(fidelity)


@pytest.mark.slow
@pytest.mark.parametrize("fidelity", ["OneDimensional", "Kinematic", "Multibody"])
def test_it_tunes_hands_over_without_a_jump_and_regulates_on_every_fidelity(fidelity):
    result = kept_run(fidelity)
    (metrics,) = result.metrics.values()
    assert metrics["hand_over_time_s"] == pytest.approx(SHORT.end_time(), abs=2 * PERIOD)
    assert metrics["hand_over_jump_m"] < 1e-6
    # Short moves with a prefilter: the gains are those of the full experiment within a few percent.
    assert metrics["integral_gain"] == pytest.approx(-2.53e-4, rel=0.05)
    assert metrics["proportional_gain"] == pytest.approx(-5.4e-5, rel=0.15)
    assert metrics["overshoot_pct"] <= 2.0
    assert abs(metrics["steady_state_error_N"]) <= 0.2
    assert metrics["max_abs_model_error_N"] <= 0.15 * 10.0
    # In open loop the force is that of the environment alone: 2 mm on 5900 N/m.
    before = result.log["measured_force"].sel(time=slice(0.0, SHORT.end_time()))
    assert float(before.max()) == pytest.approx(11.8, rel=0.03)


@pytest.mark.slow
def test_a_second_run_and_another_order_of_calls_give_the_same_numbers():
    first, second = (run("OneDimensional").log["measured_force"].values for run in (kept_run, one_run))
    np.testing.assert_array_equal(first, second)


@pytest.mark.slow
def test_without_contact_nothing_is_learnt_and_the_law_does_not_take_over():
    """The surface is out of reach: the force is noise, and whatever comes out of it must not run the robot away."""
    controller = RecursiveVrftConfig(excitation=TrapezoidalMovesConfig(depths=[0.0, 1e-3, 2e-3, 0.0], rest=0.2))
    overrides = {"controller": controller, "duration": 4.0, "station.sensors.force.noise_std": 0.0}
    overrides |= {"station.fidelity": "Kinematic", "station.environment.surface.gap": 0.05}
    result = forcectl.run("table_4_1", variant="VRFT", overrides=overrides)
    assert not result.log["mode"].values.any()
    assert float(result.log["displacement_command"].values[-1].item()) == pytest.approx(0.0, abs=1e-9)


@pytest.mark.slow
def test_batch_elements_of_the_scalar_loop_are_experiments_of_their_own():
    """Two contacts of different stiffness in one bundle, each tuned and regulated like alone."""
    config = OneDimensionalLoopConfig(
        controller=RecursiveVrftConfig(excitation=SHORT), reference=StepConfig(force=10.0, start_time=3.4)
    )
    logs = {}
    for size in (1, 2):
        loop = build_one_dimensional_loop(config, size=size)
        simulator = Simulator(loop.diagram)
        simulator.AdvanceTo(6.0)
        data = loop.sink.FindLog(simulator.get_context()).data()
        logs[size] = data[loop.signals["measured_force"].rows]
    np.testing.assert_allclose(logs[2][0], logs[1][0], atol=1e-9)
    assert logs[2][1, -1] == pytest.approx(10.0, abs=0.3)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("reference_bandwidth", 0.0),
        ("initial_covariance", -1.0),
        ("forgetting", 1.5),
        ("data_resolution", -1.0),
        ("hand_over_time", -1.0),
        ("convergence_window", 0.0),
        ("convergence_tolerance", -0.1),
        ("derivative_filter", math.nan),
        ("prefilter", 1),
        ("lower_limit", 0.0),
    ],
)
def test_bad_values_are_refused_by_name(name, value):
    with pytest.raises(BadInputError, match=name):
        RecursiveVrftConfig(**{name: value})


@pytest.mark.slow
def test_gains_are_logged_under_their_names():
    log = kept_run("OneDimensional").log
    for name in (*GAINS, "mode", "controller_output"):
        assert name in log


def test_an_excitation_from_a_file_is_found_beside_the_scenario(tmp_path, monkeypatch):
    (tmp_path / "profile.csv").write_text("time,displacement\n0,0\n0.5,0\n0.8,-1e-3\n2,-1e-3\n2.2,0\n3,0\n")
    scenario = tmp_path / "own.yaml"
    scenario.write_text(
        "controller: !RecursiveVrft {excitation: !ExcitationFile {path: profile.csv}}\n"
        "reference: !Step {force: 10.0, start_time: 3.19}\nduration: 3.2\nstation: {fidelity: OneDimensional}\n"
    )
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    (metrics,) = forcectl.run(scenario).metrics.values()
    assert metrics["hand_over_time_s"] == pytest.approx(3.0, abs=2 * PERIOD)
    assert metrics["peak_force_N"] == pytest.approx(5.9, rel=0.05)


@pytest.mark.slow
def test_from_motor_positions_the_gains_are_those_of_drives_that_do_not_stick():
    def gain(learn_from: str, friction: float) -> float:
        config = RecursiveVrftConfig(excitation=SHORT, input=learn_from, hand_over_time=5.0)
        servo = ServoConfig(coulomb_friction=friction)
        loop = build_one_dimensional_loop(OneDimensionalLoopConfig(controller=config, servo=servo))
        simulator = Simulator(loop.diagram)
        simulator.AdvanceTo(SHORT.end_time())
        log = loop.sink.FindLog(simulator.get_context()).data()
        return float(log[loop.signals["proportional_gain"].rows][0, -1])

    free = gain("command", 0.0)
    assert gain("motor", 4.8) == pytest.approx(free, rel=0.03)
    assert abs(gain("command", 4.8) / free - 1) > 0.05
