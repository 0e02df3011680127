"""References by modes: one coordinate at a time against plain arithmetic, and switches of modes that are not felt."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator

from forcectl.errors import BadInputError
from forcectl.framework.rotation_vector import RotationVector
from forcectl.tasks.compliance.parts import (
    AdmittanceGainsConfig,
    DampingOverConfig,
    ReferenceConfig,
    SwingConfig,
    mode_references,
)
from forcectl.tasks.compliance.references import CompliantReferences
from forcectl.tasks.coordinates import ArmTask
from forcectl.tasks.reactive_motion import MotionLimitsConfig

PERIOD = 0.004
TASKS = {
    "peg": ArmTask("right", ["x", "y", "z", "phi", "theta"], RotationVector()),
    "lead": ArmTask("left", ["x", "y"]),
}
ROWS = {(name, each): i for i, (name, each) in enumerate((n, c) for n, task in TASKS.items() for c in task.coordinates)}
START = np.array([0.01, -0.02, 0.3, 0.1, -0.1, 0.5, 0.6])
Z, PHI = ROWS["peg", "z"], ROWS["peg", "phi"]
PUSH = {"comply": True, "force": 7.0, "speed_limit": [-0.03, 0.02], "damping": 60.0}
NAMES = ("task_position_reference", "task_velocity_reference", "task_acceleration_reference")


def mode(peg: Mapping[str, Any] | None = None, **further: Any) -> Any:
    """What the coordinates of the peg do; the others stay."""
    said = {"peg": {name: ReferenceConfig(**each) for name, each in peg.items()}} if peg else {}
    options = {"gains": AdmittanceGainsConfig(), "limits": MotionLimitsConfig(), "period": PERIOD}
    return mode_references(said, TASKS, **(options | further))


class Loop:
    """A controller that does what it is asked to, or that and a disturbance."""

    def __init__(self, modes: Sequence[Any], start: np.ndarray = START):
        self.block = CompliantReferences(modes, [5, 2], start, period=PERIOD)
        self.simulator = Simulator(self.block)
        self.context = self.simulator.get_mutable_context()
        self.motion = [start.copy(), np.zeros(7), np.zeros(7)]
        self.seen: dict[str, list[np.ndarray]] = {}

    def tick(self, number: float = 0.0, force: Any = 0.0, pushed: Any = 0.0) -> np.ndarray:
        """The position reference for the next tick; then that is the motion, pushed aside."""
        block, context = self.block, self.context
        for name, value in zip(("position", "velocity", "acceleration"), self.motion, strict=True):
            block.GetInputPort(f"start_{name}").FixValue(context, value)
        if block.HasInputPort("task_force"):
            block.GetInputPort("task_force").FixValue(context, np.broadcast_to(force, 7).astype(float))
        block.GetInputPort("mode").FixValue(context, [number])
        for i in range(block.num_output_ports()):
            port = block.get_output_port(i)
            self.seen.setdefault(port.get_name(), []).append(port.Eval(context))
        self.simulator.AdvanceTo(PERIOD * len(self.seen["task_force_ok"]))
        self.motion = [self.seen[name][-1] for name in NAMES]
        self.motion[0] = self.motion[0] + pushed
        return self.motion[0]

    def run(self, ticks: int, number: float = 0.0, force: Callable[[np.ndarray], Any] = lambda x: 0.0) -> np.ndarray:
        """The same, with a force that depends on the position; the last one."""
        for _ in range(ticks):
            self.tick(number, force(self.motion[0]))
        return self.motion[0]

    def log(self, name: str) -> np.ndarray:
        return np.array(self.seen[name])


def along(row: int, value: float) -> np.ndarray:
    every = np.zeros(7)
    every[row] = value
    return every


# --- giving way ------------------------------------------------------------------------------------------------------


def test_one_coordinate_gives_way_as_the_equations_say():
    """(6.3), (6.5), (6.10) in floats, of a commanded motion that is not quite the reference; x_gen is at rest."""
    H, D, wanted = 0.4, 30.0, 2.0
    loop = Loop([mode({"z": {"comply": True, "force": wanted, "inertia": H, "damping": D}})])
    rng, x_gen, x, v = np.random.default_rng(1), START[Z], START[Z], 0.0
    loop.tick(0, along(Z, wanted))  # from here on the filter is not eased in any more
    for _ in range(200):
        F, pushed = rng.normal(scale=8.0), rng.normal(scale=1e-4)
        dx = x - x_gen
        a = (F - wanted - D * v) / H
        dx, v = dx + PERIOD * v + PERIOD**2 / 2 * a, v + PERIOD * a
        x = x_gen + dx + pushed
        assert loop.tick(0, along(Z, F), along(Z, pushed))[Z] == pytest.approx(x, abs=1e-12)
        assert loop.motion[1][Z] == pytest.approx(v, abs=1e-12)
        assert loop.motion[2][Z] == pytest.approx(a, abs=1e-9)
        assert loop.seen["task_displacement"][-1][Z] == pytest.approx(dx, abs=1e-12)
    assert (np.delete(loop.log(NAMES[0]), Z, axis=1) == np.delete(START, Z)).all()


@pytest.mark.slow
def test_noise_within_the_hysteresis_does_not_turn_the_motion_round():
    """A steady force with noise that rises, turns back and ends; along an angle a torque like it."""
    h, noise = 0.2, 0.1
    gains = AdmittanceGainsConfig(hysteresis=h, turn_hysteresis=h)
    loop = Loop([mode({"z": {"comply": True}, "phi": {"comply": True}}, gains=gains)])
    rng, ticks = np.random.default_rng(7), 800
    for i, (level, way) in enumerate(((1.0, 1), (3.0, 1), (2.0, -1), (0.0, -1))):
        for _ in range(ticks):
            loop.tick(0, (along(Z, 1.0) + along(PHI, 1.0)) * (level + noise * rng.uniform(-1, 1) * (level > 0)))
        accelerations = loop.log(NAMES[2])[i * ticks :, [Z, PHI]]
        assert (way * accelerations > -1e-9).all()
        followed = level - way * (h - noise) if level else 0.0
        np.testing.assert_allclose(loop.motion[1][[Z, PHI]] * [30.0, 0.2], followed, atol=0.05 * noise)


def wall(stiffness: float) -> Callable[[np.ndarray], np.ndarray]:
    """A spring below the start along z."""
    return lambda x: along(Z, stiffness * max(START[Z] - 0.005 - x[Z], 0.0))


@pytest.mark.parametrize("stiffness", [500.0, 2000.0, 8000.0])
def test_a_push_ends_at_the_desired_force(stiffness):
    """H and D within docs/admittance.md for these springs."""
    loop = Loop([mode({"z": PUSH})])
    x = loop.run(1500, force=wall(stiffness))
    assert wall(stiffness)(x)[Z] == pytest.approx(7.0, rel=1e-3)
    assert loop.log(NAMES[1])[:, Z].min() == pytest.approx(-0.03, abs=1e-12)  # on the way there


def test_a_speed_into_the_surface_ends_at_the_force_that_stops_it():
    """The admittance gives way as fast as the generator goes: F = D v."""
    loop = Loop([mode({"z": {"comply": True, "velocity": -0.075, "damping": 40.0}})])
    x = loop.run(1500, force=wall(2000.0))
    assert wall(2000.0)(x)[Z] == pytest.approx(40.0 * 0.075, rel=1e-3)


@pytest.mark.parametrize("force", [-3.0, 0.0, 4.0, 6.5, 7.5, 20.0])
def test_a_force_driven_push_is_a_speed_between_limits(force):
    loop = Loop([mode({"z": PUSH})])
    loop.run(400, force=lambda x: along(Z, force))
    assert loop.motion[1][Z] == pytest.approx(-np.clip((7.0 - force) / 60.0, -0.02, 0.03), abs=1e-9)
    positions, speeds = loop.log(NAMES[0])[:, Z], loop.log(NAMES[1])[:, Z]
    np.testing.assert_allclose(np.diff(positions), 0.5 * PERIOD * (speeds[1:] + speeds[:-1]), atol=1e-12)


@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_what_gives_way_too_fast_for_the_next_mode_slows_down_within_the_acceleration_limit(sign):
    loop = Loop([mode({"z": {"comply": True}}), mode({"z": {"comply": True, "speed_limit": [-0.02, 0.02]}})])
    loop.run(100, 0, lambda x: along(Z, 3.0 * sign))
    assert loop.motion[1][Z] == pytest.approx(0.1 * sign)
    loop.run(50, 1, lambda x: along(Z, 3.0 * sign))
    assert loop.motion[1][Z] == pytest.approx(0.02 * sign)
    assert np.abs(np.diff(loop.log(NAMES[1])[99:, Z])).max() == pytest.approx(2.0 * PERIOD)


@pytest.mark.parametrize(("force", "after"), [(4.6, -0.03), (6.4, -0.01), (0.0, -0.03)])
def test_a_push_that_begins_in_motion_only_slows_down(force, after):
    """The push asks for a speed that the motion has more than enough of: it goes down to that within the jerk limit."""
    limits = MotionLimitsConfig()
    loop = Loop([mode({"z": {"velocity": -0.075}}), mode({"z": PUSH})])
    loop.run(100)
    loop.run(100, 1, lambda x: along(Z, force))
    speeds, accelerations = loop.log(NAMES[1])[99:, Z], loop.log(NAMES[2])[99:, Z]
    assert speeds[[0, -1]] == pytest.approx([-0.075, after], abs=1e-9)
    assert (np.diff(speeds) > -1e-12).all()
    assert np.abs(np.diff(accelerations)).max() <= limits.jerk * PERIOD + 1e-9


@pytest.mark.parametrize(("z", "factor"), [(0.5, 1.0), (0.3, 1.0), (0.25, 3.0), (0.2, 5.0), (0.1, 5.0)])
def test_damping_grows_with_another_coordinate(z, factor):
    table = DampingOverConfig(coordinate="z", at=[0.2, 0.3], factor=[5.0, 1.0])
    start = np.where(np.arange(7) == Z, z, START)
    loop = Loop([mode({"phi": {"comply": True, "damping": 0.2, "damping_over": table}})], start)
    loop.run(400, force=lambda x: along(PHI, 0.1))
    assert loop.motion[1][PHI] == pytest.approx(0.1 / (0.2 * factor), rel=1e-9)


def test_without_a_number_for_the_force_it_stops_and_says_so():
    sides = {"x": {"position": 0.2}, "y": {"position": 0.5, "comply": True}}
    loop = Loop([mode({"z": {"comply": True, "velocity": -0.075}, **sides})])
    loop.run(100, force=lambda x: along(Z, 0.3))
    for bad in (np.nan, np.inf, 1e9):
        loop.run(200, force=lambda x, bad=bad: along(Z, bad) + along(1, bad))
        assert np.abs(loop.motion[1][[1, Z]]).max() < 1e-6
        assert loop.seen["task_force_ok"][-1].tolist() == [1, 0, 0, 1, 1, 1, 1]
    accelerations = np.diff(loop.log(NAMES[1])[:, Z]) / PERIOD
    assert np.abs(accelerations).max() < 2.0 + (0.3 + 30.0 * 0.01) / 0.4  # generator and filter
    assert loop.motion[0][0] == pytest.approx(0.2)  # the others go on
    assert loop.motion[0][1] < 0.4
    loop.run(400)
    assert loop.motion[0][1] == pytest.approx(0.5)
    assert loop.motion[1][Z] == pytest.approx(-0.075, rel=1e-3)
    assert loop.seen["task_force_ok"][-1].all()


def test_without_a_number_for_the_force_a_swing_ends_and_begins_anew():
    loop = Loop([mode({"phi": {"comply": True, "swing": SwingConfig(amplitude=0.02, frequency=2.5)}})])
    for ticks, force in ((333, 0.0), (100, np.nan), (300, 0.0)):
        loop.run(ticks, force=lambda x, force=force: along(PHI, force))
    x, speed = (loop.log(name)[:, PHI] for name in NAMES[:2])
    assert np.abs(speed[400:433]).max() < 1e-12
    assert np.ptp(x[533:]) == pytest.approx(0.04, rel=1e-2)
    assert np.abs(np.diff(speed)).max() / PERIOD < 6.0 + 0.02 * (5 * np.pi) ** 2


# --- where coordinates go --------------------------------------------------------------------------------------------


def test_coordinates_go_where_the_mode_says():
    loop = Loop([mode({"x": {"position": 0.05}, "y": {"by": -0.03}, "z": {"velocity": -0.06}})])
    x = loop.run(300)
    assert x[:2] == pytest.approx([0.05, START[1] - 0.03], abs=1e-9)
    assert loop.motion[1] == pytest.approx(along(Z, -0.06), abs=1e-9)
    assert x[3:] == pytest.approx(START[3:], abs=1e-12)
    target = loop.seen["task_target"][-1]
    assert target[[0, 1, 3]] == pytest.approx([0.05, START[1] - 0.03, START[3]])
    assert target[Z] == pytest.approx(x[Z] + 0.06 * PERIOD)  # what was commanded at this tick
    assert not loop.log("task_displacement").any()


def test_without_a_limit_of_jerk_velocities_are_those_of_algorithm_3():
    loop = Loop([mode({"z": {"velocity": -0.075}}, limits=MotionLimitsConfig(acceleration=2.0, jerk=1e6))])
    loop.run(20)
    time = PERIOD * (1 + np.arange(20))
    np.testing.assert_allclose(loop.log(NAMES[1])[:, Z], -np.minimum(2.0 * time, 0.075), atol=5e-6)


def test_what_nothing_is_said_of_stops_and_stays_there():
    """... also where it is pushed away; `by: 0` goes back to where the mode began."""
    loop = Loop([mode({"z": {"velocity": -0.1}, "x": {"velocity": 0.1}}), mode({"x": {"by": 0.0}})])
    began = loop.run(100)
    loop.run(200, 1)
    stopped = loop.log(NAMES[0])[-1]
    speed = loop.log(NAMES[1])[100:, Z]
    assert speed.max() <= 1e-9  # no way back
    assert stopped[Z] < began[Z] - 1e-3
    assert stopped[0] == pytest.approx(began[0], abs=1e-9)
    for _ in range(100):
        loop.tick(1, pushed=along(Z, 5e-5))
    loop.run(200, 1)
    assert loop.motion[0][Z] == pytest.approx(stopped[Z], abs=1e-9)


def test_a_swing_begins_at_rest_and_is_a_circle_about_the_start():
    circle = {
        "phi": {"swing": SwingConfig(amplitude=0.026, frequency=2.5)},
        "theta": {"swing": SwingConfig(amplitude=0.026, frequency=2.5, phase_deg=90.0)},
    }
    circle["phi"]["comply"] = True
    loop = Loop([mode(circle), mode({"phi": {"comply": True}})])
    loop.run(400)
    angles, rates, second = (loop.log(name)[:, 3:5] for name in NAMES)
    time = PERIOD * (1 + np.arange(400))
    later = time > 0.4
    expected = 0.026 * np.array([np.sin(5 * np.pi * time), np.cos(5 * np.pi * time)]).T
    np.testing.assert_allclose((angles - START[3:5])[later], expected[later], atol=1e-12)
    np.testing.assert_allclose(rates[1:-1], (angles[2:] - angles[:-2]) / (2 * PERIOD), atol=3e-3)
    np.testing.assert_allclose(second[1:-1], (rates[2:] - rates[:-2]) / (2 * PERIOD), atol=5e-2)
    assert np.abs(rates[0]).max() < 2e-3
    np.testing.assert_array_equal(loop.log("task_target")[1:, 3:5], angles[:-1])  # no target to reach
    loop.run(300, 1)
    assert np.abs(loop.motion[1]).max() < 1e-9
    assert np.abs(loop.log("task_displacement")).max() < 1e-12


@pytest.mark.parametrize("delay", [0.0, 0.4])
def test_a_spiral_grows_from_its_begin_on(delay):
    spiral = {
        name: {"swing": SwingConfig(growth=1e-3, frequency=1.0, phase_deg=phase, delay=delay)}
        for name, phase in (("x", 0.0), ("y", 90.0))
    }
    loop = Loop([mode(spiral)])
    loop.run(750)
    time = PERIOD * (1 + np.arange(750)) - delay
    radius = np.hypot(*(loop.log(NAMES[0])[:, :2] - START[:2]).T)
    np.testing.assert_allclose(radius[time > 1.0], 1e-3 * time[time > 1.0], atol=1e-12)
    np.testing.assert_array_equal(radius[time <= 0.0], 0.0)


# --- modes -----------------------------------------------------------------------------------------------------------

LIMITS = MotionLimitsConfig()


def test_switches_in_motion_keep_the_limits():
    """Nothing complies: acceleration and jerk are those of the generator at every tick, through 40 switches."""
    modes = [
        mode({"z": {"velocity": -0.2}, "phi": {"position": 0.5}}),
        mode({"z": {"by": 0.1}, "x": {"velocity": 0.1}}),
        mode(),
        mode({"x": {"position": 0.0}, "z": {"velocity": 0.3}, "theta": {"by": -0.4}}),
    ]
    loop, rng = Loop(modes), np.random.default_rng(3)
    for _ in range(40):
        loop.run(int(rng.integers(1, 60)), float(rng.integers(4)))
    position, velocity, acceleration = (loop.log(name) for name in NAMES)
    limits = LIMITS.of(list(TASKS.values()))
    assert (np.abs(acceleration) / limits.acceleration).max() <= 1 + 1e-9
    assert (np.abs(np.diff(acceleration, axis=0)) / limits.jerk).max() <= PERIOD * (1 + 1e-6)
    missed = np.diff(velocity, axis=0) - 0.5 * PERIOD * (acceleration[1:] + acceleration[:-1])
    assert np.abs(missed).max() <= 0.25 * PERIOD**2 * limits.jerk.max()  # the jerk turns round within a tick
    missed = np.diff(position, axis=0) - 0.5 * PERIOD * (velocity[1:] + velocity[:-1])
    assert np.abs(missed).max() <= PERIOD**3 * limits.jerk.max()
    assert np.abs(velocity).max() > 0.2


def test_switches_of_what_complies_are_not_felt():
    """Speed changes by what generator, filter and swing may, and position by the speed, whatever the modes."""
    gives, H, D, largest = {"comply": True}, 0.4, 30.0, 4.0
    modes = [
        mode({"z": {"velocity": -0.1, **gives}, "x": gives}),
        mode({"z": {"force": 2.0, "speed_limit": [-0.02, 0.01], **gives}}),
        mode({"z": gives, "x": {"by": 0.05, **gives}}),
        mode({"z": {"by": 0.02}, "x": {"swing": SwingConfig(amplitude=0.004, frequency=2.0), **gives}}),
    ]
    loop, rng = Loop(modes), np.random.default_rng(4)
    for _ in range(60):
        number, force = float(rng.integers(4)), rng.uniform(-largest, largest, 7)
        loop.run(int(rng.integers(1, 40)), number, lambda x, force=force: force)
    position, velocity, _ = (loop.log(name)[:, [0, Z]] for name in NAMES)
    fastest = (largest + 2.0) / D  # of the filter
    swinging = 0.004 * (4 * np.pi) ** 2 * 2.5
    allowed = 2 * LIMITS.acceleration + (largest + 2.0 + D * fastest) / H + swinging
    assert np.abs(np.diff(velocity, axis=0)).max() <= PERIOD * allowed
    missed = np.diff(position, axis=0) - 0.5 * PERIOD * (velocity[1:] + velocity[:-1])
    assert np.abs(missed).max() <= PERIOD**3 * 400.0  # a jump of the position would be 0.1 mm and more
    assert np.abs(velocity).max() > 0.1


def test_the_displacement_is_since_the_mode_began():
    loop = Loop([mode({"z": {"comply": True}}), mode({"z": {"comply": True, "by": 0.0}}), mode()])
    force = along(Z, 3.0)
    loop.run(100, 0, lambda x: force)
    began = loop.motion[0][Z]
    assert loop.seen["task_displacement"][-1][Z] == pytest.approx(began - START[Z])
    loop.run(500, 1, lambda x: 0.0 * force)
    assert (loop.log("task_target") - loop.log("task_displacement"))[100:, Z] == pytest.approx(began, abs=1e-12)
    drift = loop.seen["task_displacement"][-1][Z]
    assert drift == pytest.approx(0.1 * (0.4 / 30.0 - PERIOD / 2), rel=1e-6)  # dv dies out with H/D, from 3 N/30 N s/m
    assert loop.motion[0][Z] == pytest.approx(began + drift, abs=1e-9)
    loop.run(200, 2)
    assert loop.seen["task_displacement"][-1][Z] == 0.0
    assert loop.motion[0][Z] == pytest.approx(began + drift, abs=1e-9)


def test_a_task_that_is_not_followed_starts_from_the_motion():
    loop = Loop([mode(followed=["peg"]), mode()])
    for _ in range(50):
        loop.tick(0, pushed=along(ROWS["lead", "x"], 1e-3))
    led = loop.motion[0].copy()
    assert led[ROWS["lead", "x"]] == pytest.approx(START[ROWS["lead", "x"]] + 0.05)
    np.testing.assert_allclose(loop.run(100, 1), led, atol=1e-9)


def test_a_task_that_was_not_followed_goes_on_at_its_speed_also_when_it_complies():
    loop, moving = Loop([mode(followed=["lead"]), mode({"z": {"comply": True}})]), along(Z, 0.1)
    for _ in range(10):
        loop.motion[1] = moving
        loop.tick(0)
    loop.tick(1)
    assert loop.motion[1][Z] == pytest.approx(0.1, abs=2.0 * PERIOD)


@pytest.mark.parametrize("number", [np.nan, -1.0, 2.0, 0.5])
def test_a_number_of_no_mode_keeps_the_last(number):
    modes = [mode(), mode({"z": {"velocity": 0.1}})]
    both = [Loop(modes), Loop(modes)]
    for loop, last in zip(both, (number, 1.0), strict=True):
        loop.run(50, 1.0)
        loop.run(50, last)
    np.testing.assert_array_equal(both[0].log(NAMES[0]), both[1].log(NAMES[0]))
    first = Loop(modes)
    first.run(5, number)
    np.testing.assert_array_equal(first.motion[0], START)


def test_a_slower_mode_is_reached_without_a_way_back():
    slow = MotionLimitsConfig(speed=0.02)
    loop = Loop([mode({"z": {"position": 0.6}}), mode({"z": {"position": 0.6}}, limits=slow)])
    loop.run(50)
    assert loop.motion[1][Z] > 0.2
    loop.run(150, 1)
    assert loop.log(NAMES[1])[50:, Z].min() >= 0.02 * (1 - 1e-6)
    assert loop.motion[1][Z] == pytest.approx(0.02, rel=1e-6)
    acceleration = loop.log(NAMES[2])[:, Z]
    assert np.abs(np.diff(acceleration)).max() <= 20.0 * PERIOD * (1 + 1e-6)


def test_modes_that_do_not_fit_are_refused():
    with pytest.raises(BadInputError, match="modes"):
        CompliantReferences([], [7], START)
    with pytest.raises(BadInputError, match="groups"):
        CompliantReferences([mode()], [5, 3], np.zeros(8))
