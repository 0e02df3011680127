"""Controllers behind their guard, in the loop of one dimension: what a fault of the sensor or of the model comes to."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Context, DiagramBuilder, System
from pydrake.systems.primitives import LogVectorOutput, TrajectorySource
from pydrake.trajectories import PiecewisePolynomial

import forcectl as fc
from forcectl.diagrams.model import plant_model
from forcectl.diagrams.sensors import WristForceConfig
from forcectl.errors import BadInputError
from forcectl.force.guard.config import GuardConfig
from forcectl.framework.sampled_block import Memory, SampledBlock
from forcectl.plant.plant_model import PlantModel
from forcectl.plant.sensors.force_fault import ForceFaultConfig
from forcectl.runs.simulate import VariantOutcome, simulate
from forcectl.scenario.scenario import build, load_scenario
from tests.examples.block_examples_stations import two_tables

VRFT = {"proportional_gain": -1.446e-05, "integral_gain": -2.951e-05, "derivative_gain": 1.388e-08}
INTEGRAL, ADAPTIVE = fc.force.IntegralConfig(), fc.force.AdaptiveIntegralConfig()
INVARIANCE = fc.force.InvarianceConfig()
HOLD, SLOW, RETREAT, STOP = 100, 200, 300, 400


def outcome(controller: Any, duration: float, faults: Any = (), **changed: Any) -> VariantOutcome:
    """15 N on 5e4 N/m."""
    sensor = WristForceConfig(faults=[ForceFaultConfig(**fault) for fault in faults])
    station = {"fidelity": "OneDimensional", "environment": {"stiffness": 5e4}, "sensors": {"force": sensor}}
    scenario = load_scenario(
        {"station": station, "controller": controller, "reference": {"force": 15.0}, "duration": duration} | changed
    )
    return simulate(scenario, build(scenario), "default")


def signal(run: VariantOutcome, name: str) -> np.ndarray:
    return run.log[name].values.reshape(run.log.sizes["time"], -1)[:, 0]


def kinds(run: VariantOutcome) -> set[str]:
    return {finding.kind for finding in run.findings}


class Law(SampledBlock):
    """Goes into the surface at a speed; from 0.2 s on its command is what `spoil` makes of it."""

    def __init__(self, speed: float, spoil: float, period: float):
        super().__init__()
        self._speed, self._spoil = speed, spoil
        forces = [self.DeclareVectorInputPort(name, 1) for name in ("desired_force", "measured_force")]
        self.declare_memory({"displacement_command": 0.0}, forces, period)
        self.show("displacement_command")

    def step(self, context: Context, memory: Memory, inputs: Memory) -> dict[str, float]:
        time = context.get_time()
        return {"displacement_command": -self._speed * time + (self._spoil if time > 0.2 else 0.0)}


@dataclass
class LawConfig:
    """A law of a user's own."""

    speed: float = 0.0
    spoil: float = 0.0

    def add_to(self, builder: DiagramBuilder, model: PlantModel) -> System:
        return builder.AddNamedSystem("law", Law(self.speed, self.spoil, model.period))


@pytest.mark.parametrize("controller", [INTEGRAL, INVARIANCE, fc.force.GovernedConfig()])
def test_a_sound_run_is_the_same_bit_for_bit_without_the_guard(controller):
    with_guard, without = outcome(controller, 0.5), outcome(controller, 0.5, guard=None)
    for name in without.log:
        assert with_guard.log[name].values.tobytes() == without.log[name].values.tobytes(), name
    assert not signal(with_guard, "status").any()
    assert not {"guarded", "guard_stopped"} & kinds(with_guard)


@pytest.fixture(scope="module", params=[ADAPTIVE, fc.force.GovernedConfig()])
def guarded(request):
    arguments = {"controller": request.param, "duration": 0.4, "guard": GuardConfig(maximum_force=40.0)}
    return arguments, outcome(**arguments)


@pytest.mark.parametrize(("kind", "value"), [("inf", 0.0), ("value", -3e5), ("value", 250.0), ("nan", 0.0)])
def test_one_bad_reading_is_passed_over(guarded, kind, value):
    run = outcome(faults=[{"kind": kind, "value": value, "start": 0.2, "duration": 0.002}], **guarded[0])
    assert run.failure is None
    assert np.abs(np.diff(signal(run, "displacement_command"))).max() < 1e-4
    assert abs(signal(run, "contact_force") - signal(guarded[1], "contact_force")).max() < 0.2
    assert set(signal(run, "status")) == {0.0, HOLD + 10.0}
    assert "guarded" in kinds(run)


@pytest.mark.parametrize("controller", [ADAPTIVE, fc.force.VrftConfig(**VRFT), INVARIANCE])
@pytest.mark.parametrize(
    ("kind", "value", "causes"), [("frozen", 0.0, {20}), ("value", 0.0, {10, 20}), ("nan", 0.0, {10})]
)
def test_a_dead_sensor_ends_in_a_stop_away_from_the_surface(controller, kind, value, causes):
    run = outcome(controller, 1.3, [{"kind": kind, "value": value, "start": 0.25}])
    assert signal(run, "contact_force").max() < 20
    assert signal(run, "contact_force")[-1] == 0
    assert signal(run, "status")[-1] in {STOP + each for each in causes}
    assert signal(run, "displacement_command")[-1] > 0
    stopped = run.log["time"].values[np.argmax(signal(run, "status") >= STOP)]
    assert stopped < 0.25 + 1.0
    assert "guard_stopped" in kinds(run)


def test_a_sensor_without_noise_that_stands_still_is_found_by_the_motion():
    quiet = WristForceConfig(noise_std=0.0, quantum=0.0, faults=[ForceFaultConfig(kind="frozen", start=0.25)])
    station = {"fidelity": "OneDimensional", "environment": {"stiffness": 5e4}, "sensors": {"force": quiet}}
    run = outcome(fc.force.IntegralConfig(integral_gain=4.0), 2.0, station=station)
    assert signal(run, "contact_force").max() < 40
    assert signal(run, "status")[-1] == STOP + 20


def test_a_wrong_sign_ends_in_a_stop():
    run = outcome(fc.force.IntegralConfig(integral_gain=3.0), 1.5, [{"kind": "scale", "value": -1.0, "start": 0.1}])
    assert signal(run, "contact_force").max() < 30
    assert signal(run, "status")[-1] == STOP + 10


@pytest.mark.parametrize("scale", [0.3, 0.85, 1.4])
@pytest.mark.parametrize("controller", [INTEGRAL, fc.force.VrftConfig(**VRFT), INVARIANCE])
def test_a_sensor_that_goes_over_to_another_force_ends_in_a_stop(controller, scale):
    """No filter shows a jump, whatever is read after it. A law with an integral would go on to 50, 17.6 or 10.7 N."""
    run = outcome(controller, 1.9, [{"kind": "scale", "value": scale, "start": 1.0}])
    assert signal(run, "contact_force").max() < 1.05 * 15.0
    assert signal(run, "contact_force")[-1] == 0
    assert signal(run, "status")[-1] == STOP + 10


sound = pytest.fixture(scope="module")(lambda: outcome(INTEGRAL, 1.6))


@pytest.mark.parametrize(("kind", "value"), [("scale", 0.5), ("value", 0.0), ("nan", 0.0)])
def test_a_sensor_that_comes_back_is_believed_again(sound, kind, value):
    run = outcome(INTEGRAL, 1.6, [{"kind": kind, "value": value, "start": 1.0, "duration": 0.08}])
    assert {HOLD + 10.0} <= set(signal(run, "status")) <= {0.0, HOLD + 10.0, SLOW + 10.0}
    assert signal(run, "status")[-1] == 0.0
    assert abs(signal(run, "contact_force") - signal(sound, "contact_force")).max() < 0.5


@pytest.mark.parametrize("controller", [INTEGRAL, ADAPTIVE, fc.force.VrftConfig(**VRFT)])
def test_a_sensor_that_is_read_twice_as_often_as_it_measures_is_no_alarm(controller):
    """Every other reading is the last one again: as steps these rises would look like 40 N to come."""
    run = outcome(controller, 1.0, [{"kind": "lost", "start": 0.0}], guard=GuardConfig(maximum_force=25.0))
    assert signal(run, "contact_force")[-1] > 10.0
    assert not signal(run, "status").any()


@pytest.mark.parametrize(("approaches", "start"), [(False, 0.8), (True, 0.02)])
def test_a_wrong_sign_of_a_force_below_two_percent_of_the_range_is_found(approaches, start):
    """A reading of -8 N is one that tool and electronics can show, but not where it was 8 N, nor where it falls on."""
    law = fc.force.IntegralConfig(integral_gain=3.0)
    faulty = WristForceConfig(faults=[ForceFaultConfig(kind="scale", value=-1.0, start=start)])
    surface = {"stiffness": 2.5e4, "surface": {"gap": 0.002 * approaches}}
    station = {"fidelity": "OneDimensional", "environment": surface, "sensors": {"force": faulty}}
    controller = fc.force.ApproachConfig(law=law, speed=0.01) if approaches else law
    run = outcome(controller, 1.5, station=station, reference={"force": 8.0}, guard=GuardConfig(maximum_force=16.0))
    assert 7.0 < signal(run, "contact_force").max() < 1.2 * 16.0
    assert signal(run, "status")[-1] == STOP + 10


def test_a_spring_that_pulls_is_never_lost():
    """An unstable loop, in which the command goes 10 mm beyond where the force was last above zero."""
    linear = {"fidelity": "OneDimensional", "environment": {"stiffness": 5.9e3, "one_sided": False}}
    run = outcome(fc.force.IntegralConfig(integral_gain=20.0), 1.0, station=linear, preset="linear")
    assert signal(run, "contact_force").min() < -15.0
    assert not signal(run, "status").any()


@pytest.mark.parametrize("stiffness", [5e4, 3e5])
@pytest.mark.parametrize("maximum", [25.0, 40.0])
def test_the_true_force_stays_below_its_maximum(stiffness, maximum):
    """A law that goes on at 20 mm/s, on a surface ten times as stiff as the model's."""
    changes = {
        "station.environment.stiffness": stiffness,
        "model.environment_compliance": 10.0,
        "guard.maximum_force": maximum,
    }
    base = {"station": {"fidelity": "OneDimensional"}, "controller": LawConfig(0.02), "duration": 1.5}
    scenario = load_scenario(base, overrides=changes)
    run = simulate(scenario, build(scenario), "default")
    assert signal(run, "contact_force").max() < 1.2 * maximum
    assert signal(run, "status")[-1] == STOP + 50
    assert (np.diff(signal(run, "status") // 100 == 3) > 0).sum() <= 8  # begins and ends of four retreats


def test_a_law_that_only_knows_the_compliance_rests_below_the_maximum():
    """It would press with 36 N for ever."""
    run = outcome(
        INVARIANCE,
        1.2,
        model={"environment_compliance": 5.0},
        guard=GuardConfig(maximum_force=20.0),
    )
    assert 0 < signal(run, "contact_force")[-1] < 20
    assert signal(run, "contact_force").max() < 24
    assert signal(run, "status")[-1] == 0


@pytest.mark.parametrize("spoil", [-0.07, 0.03])
def test_a_command_that_jumps_is_followed_slowly_into_the_surface(spoil):
    run = outcome(LawConfig(spoil=spoil), 0.3, guard={"maximum_speed": 2.5})
    steps = np.diff(signal(run, "displacement_command"))
    assert steps.min() > -1e-4
    assert steps.max() <= 5.001e-3
    assert 260 in signal(run, "status")


def test_the_derivative_kick_of_a_step_is_no_jump():
    law = fc.force.VrftConfig(**VRFT | {"derivative_gain": -3.6e-6})
    run = outcome(law, 0.1)
    assert signal(run, "displacement_command")[0] < -0.005  # more than 2.5 m/s from rest
    assert not signal(run, "status").any()


def test_a_command_that_is_no_number_is_held():
    run = outcome(LawConfig(speed=1e-3, spoil=math.nan), 0.9)
    assert np.isfinite(signal(run, "displacement_command")).all()
    assert run.failure is None
    assert signal(run, "status")[-1] == STOP + 60


@pytest.mark.slow
def test_joint_commands_are_guarded():
    """The robot's own controller has no force law: dead sensor, then what it costs."""
    run = outcome(fc.force.InvarianceRobotConfig(), 1.0, [{"kind": "value", "value": 0.0, "start": 0.3}])
    assert signal(run, "contact_force")[-1] == 0
    assert signal(run, "status")[-1] == STOP + 10


NO_NOISE = {"noise_std": 0.0}


@pytest.mark.parametrize(
    ("controller", "scale", "maximum", "sensor"),
    [(INTEGRAL, 0.0, 30.0, NO_NOISE), (INTEGRAL, 0.05, 30.0, {}), (fc.force.PidConfig(), 0.2, 20.0, {})],
)
def test_a_sensor_that_shows_too_little_from_the_start_ends_in_a_stop(controller, scale, maximum, sensor):
    """Without the guard the true force rises to 89, 78 and 63 N."""
    kind = "scale" if scale else "value"
    faulty = WristForceConfig(faults=[ForceFaultConfig(kind=kind, value=scale)], **sensor)
    station = {"fidelity": "OneDimensional", "environment": {"stiffness": 5e4}, "sensors": {"force": faulty}}
    run = outcome(controller, 2.2, station=station, guard=GuardConfig(maximum_force=maximum))
    assert signal(run, "contact_force").max() < 1.3 * maximum
    assert signal(run, "contact_force")[-1] == 0
    assert signal(run, "status")[-1] == STOP + 70


@pytest.mark.parametrize(
    ("controller", "stiffness"), [(fc.force.VrftConfig(), 2e5), (fc.force.GovernedConfig(), 1.9e4)]
)
def test_the_quick_rise_of_a_law_is_no_alarm(controller, stiffness):
    """It comes to 0.8 or 0.9 of the largest force, and its rate to more than that in the reaction time."""
    station = {"fidelity": "OneDimensional", "environment": {"stiffness": stiffness}}
    run = outcome(controller, 0.6, station=station, reference={"force": 9.0}, guard=GuardConfig(maximum_force=18.0))
    assert 14.0 < signal(run, "contact_force").max() < 18.0
    assert not signal(run, "status").any()


@pytest.mark.slow
def test_what_the_way_is_worth_may_be_left_unasked():
    """The surface is ten times softer than the model's, which looks like a sensor that shows a tenth."""
    soft = {"fidelity": "OneDimensional", "environment": {"stiffness": 5e3}}
    ends = []
    for share in (0.25, 0.0):
        guard = GuardConfig(maximum_force=20.0, least_response=share)
        run = outcome(ADAPTIVE, 1.8, station=soft, model={"environment_compliance": 0.05}, guard=guard)
        ends.append(signal(run, "status")[-1])
    assert ends == [STOP + 70, 0]


@pytest.mark.parametrize("maximum", [30.0, 20.0, 18.0])
def test_a_stiff_surface_that_comes_closer_is_left_in_time(maximum):
    """Ten times as stiff as the model's, at 20 mm/s; less than 17.6 N is refused."""
    moves = [{"start": 0.8, "distance": 0.005, "duration": 0.25}]
    station = {"fidelity": "OneDimensional", "environment": {"stiffness": 5e5, "surface": {"moves": moves}}}
    changes = {"reference": {"force": maximum / 2}, "model": {"environment_compliance": 10.0}}
    run = outcome(INTEGRAL, 1.1, station=station, guard=GuardConfig(maximum_force=maximum), **changes)
    assert signal(run, "contact_force").max() < 1.2 * maximum
    assert RETREAT + 50 in signal(run, "status")


@pytest.mark.parametrize("law", [fc.force.AdaptiveAdmittanceConfig(), LawConfig(20e-3)])
@pytest.mark.parametrize(("stiffness", "start"), [(9e4, 0.1), (2e5, 0.1), (2e5, 0.06), (9e4, 0.0), (2e5, 0.0)])
def test_a_dead_sensor_is_held_by_the_way_that_it_does_not_show(law, stiffness, start):
    """10 N are asked and 14 N allowed; dead for 0.1 s a sensor let these laws come to 17 to 53 N."""
    faults = [ForceFaultConfig(kind="frozen", start=start) if start else ForceFaultConfig(kind="value", value=0.0)]
    sensors = {"force": WristForceConfig(faults=faults)}
    station = {"fidelity": "OneDimensional", "environment": {"stiffness": stiffness}, "sensors": sensors}
    run = outcome(law, 0.5, station=station, reference={"force": 10.0}, guard=GuardConfig(maximum_force=14.0))
    assert signal(run, "contact_force").max() < 1.2 * 14.0
    assert signal(run, "status")[-1] // 10 % 10 == 2


def test_a_sensor_that_is_dead_from_the_start_is_retreated_from_at_once():
    """The first command of this law alone is worth more than is allowed: held for `patience` it came to 40 N."""
    run = outcome(fc.force.GovernedConfig(), 0.4, [{"kind": "value", "value": 0.0}], guard={"maximum_force": 20.0})
    assert signal(run, "contact_force").max() < 1.2 * 20.0
    assert set(signal(run, "status")) == {0, RETREAT + 20, STOP + 20}


@pytest.mark.slow
def test_readings_in_coarse_steps_are_no_frozen_sensor():
    """A step is 3.3 times the noise: without a filter readings repeat themselves for 0.1 s every few seconds."""
    sensor = WristForceConfig(bandwidth=1e5, noise_std=0.03, quantum=0.1)
    station = {"fidelity": "OneDimensional", "environment": {"stiffness": 5e4}, "sensors": {"force": sensor}}
    run = outcome(fc.force.IntegralConfig(integral_gain=1.0), 8.0, station=station, reference={"force": 10.0})
    assert not signal(run, "status").any()


@pytest.mark.parametrize(("energy", "status"), [(1e-3, RETREAT + 80), (2.0, 0)])
def test_energy_that_goes_into_a_surface_is_bounded(energy, status):
    """The law goes after a surface that gives way at 5 mm/s under 15 N."""
    moves = [{"start": 0.156, "distance": -4.2e-3, "duration": 0.844}]
    station = {"fidelity": "OneDimensional", "environment": {"stiffness": 5e4, "surface": {"moves": moves}}}
    run = outcome(LawConfig(5e-3), 1.0, station=station, guard=GuardConfig(maximum_force=30.0, energy=energy))
    assert signal(run, "contact_force").max() < 20
    assert set(signal(run, "status")) - {STOP + 80} == {0, status}


def test_a_largest_force_of_arms_needs_their_estimated_forces():
    with pytest.raises(BadInputError, match=r"guard.maximum_force = 30.0: must be null, or .* output estimated_wrench"):
        fc.build("fig_5_3", overrides={"guard.maximum_force": 30.0})


@pytest.mark.parametrize(
    ("size", "lasts", "expected"),
    [(25.0, 0.5, {0}), (50.0, 0.1, {0, HOLD + 50, 200 + 50}), (50.0, 0.5, {0, HOLD + 50, STOP + 50})],
)
def test_a_force_on_an_arm_holds_the_joints_and_then_stops_them(size, lasts, expected):
    """A force from 0.1 s on, on the second arm, while the joints move."""
    model = plant_model(two_tables())
    builder = DiagramBuilder()
    guard = builder.AddSystem(GuardConfig(maximum_force=30.0).of_joints(model, 0))
    way = PiecewisePolynomial.FirstOrderHold([0.0, 1.0], np.array([model.start, model.start + 0.05]).T)
    push = np.zeros((12, 4))
    push[9:, 1] = size / np.sqrt(3.0)
    force = PiecewisePolynomial.ZeroOrderHold([0.0, 0.1, 0.1 + lasts, 2.0], push)
    for source, name in ((way, "command"), (force, "estimated_wrench")):
        builder.Connect(builder.AddSystem(TrajectorySource(source)).get_output_port(), guard.GetInputPort(name))
    log = LogVectorOutput(guard.GetOutputPort("guarded"), builder, model.period)
    simulator = Simulator(builder.Build())
    simulator.AdvanceTo(0.8)
    found = log.FindLog(simulator.get_context()).data()
    joints, status = found[: model.num_joints], found[model.num_joints]
    assert set(status) == expected
    moves = np.abs(np.diff(joints, axis=1)).max(axis=0)
    assert not moves[status[1:] == HOLD + 50].any()
    assert moves.max() < 1e-3
