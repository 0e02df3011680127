"""The trajectory generator as a block: its ticks, its inputs, and that nothing of it stays behind."""

import gc
import math
import weakref

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Context, DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource, LogVectorOutput, ZeroOrderHold

from forcectl.errors import BadInputError
from forcectl.motion.trajectory import Planner, Target, begin, limits_of
from forcectl.motion.trajectory_generator import TrajectoryGenerator
from tests.examples.motion_examples import LIMITS, trajectory_generator

TICK = 0.004
OUTPUTS = ("position", "velocity", "acceleration", "arrived", "braking")


class Bench:
    """A block alone, ticked by hand."""

    def __init__(self, block: TrajectoryGenerator):
        self.block = block
        self.simulator = Simulator(block)
        self.context: Context = self.simulator.get_mutable_context()
        self.tick = 0

    def __call__(self, **inputs: object) -> dict[str, np.ndarray]:
        """Advance to the next tick with these inputs; what is put out then."""
        if self.tick > 0:  # at time zero the tick is part of the start, with the inputs that are there then
            self.simulator.AdvanceTo(self.tick * TICK)
        for name, value in inputs.items():
            self.block.GetInputPort(name).FixValue(self.context, np.atleast_1d(np.asarray(value, dtype=float)))
        if self.tick == 0:
            self.simulator.Initialize()
        self.tick += 1
        return {name: self.block.GetOutputPort(name).Eval(self.context) for name in OUTPUTS}


@pytest.mark.parametrize("size", [1, 2])
def test_it_follows_the_trajectory_of_the_planner(size):
    bench = Bench(trajectory_generator(size, initial_position=0.1))
    limits = limits_of(size, *(LIMITS.values() if size == 2 else (1.0, 1.0, 1.0)))
    planner, state = Planner(limits), begin(np.full(size, 0.1))
    rng = np.random.default_rng(1)
    for tick in range(200):
        target = Target(rng.normal(size=size) if tick % 40 < 3 else np.full(size, 0.3), np.zeros(size), np.zeros(size))
        state = planner.follow(state, target, TICK)
        out = bench(target_position=target.position)
        for name in OUTPUTS:
            np.testing.assert_array_equal(out[name], getattr(state, name))


def test_what_is_put_out_is_held_between_ticks_and_of_the_end_of_the_tick():
    builder = DiagramBuilder()
    generator = builder.AddSystem(trajectory_generator())
    goal = builder.AddSystem(ConstantVectorSource([0.2, -0.1]))
    builder.Connect(goal.get_output_port(), generator.GetInputPort("target_position"))
    log = LogVectorOutput(generator.GetOutputPort("position"), builder, publish_period=TICK / 4)
    diagram = builder.Build()
    simulator = Simulator(diagram)
    simulator.AdvanceTo(0.2)
    position = log.FindLog(simulator.get_context()).data()[:, :-1]
    np.testing.assert_array_equal(position[:, ::4], position[:, 3::4])
    # From rest the jerk is at its limit, and the first tick ends with J Ts^3/6.
    np.testing.assert_allclose(position[0, 0], 80.0 * TICK**3 / 6, rtol=1e-6)


def test_inputs_that_are_not_connected_mean_rest_and_position():
    alone, told = Bench(trajectory_generator()), Bench(trajectory_generator())
    for _ in range(300):
        plain = alone(target_position=[0.2, -0.1])
        full = told(target_position=[0.2, -0.1], target_velocity=[0.0, 0.0], velocity_mode=[0.0, 0.0])
        np.testing.assert_array_equal(plain["position"], full["position"])
    np.testing.assert_allclose(plain["position"], [0.2, -0.1], atol=1e-8)
    np.testing.assert_array_equal(plain["arrived"], [1, 1])


def test_bad_targets_keep_the_last_one():
    spoilt, plain = Bench(trajectory_generator()), Bench(trajectory_generator())
    for tick in range(200):
        good = [0.2, -0.1]
        bad = good if tick % 5 == 0 else [math.nan, math.inf]
        np.testing.assert_array_equal(spoilt(target_position=bad)["position"], plain(target_position=good)["position"])
    before_any = Bench(trajectory_generator(initial_position=[0.5, 0.6]))
    for _ in range(3):
        np.testing.assert_array_equal(before_any(target_position=[math.nan, 0.6])["position"], [0.5, 0.6])


def test_it_goes_on_from_the_start_it_is_given():
    bench = Bench(trajectory_generator())
    led = dict.fromkeys(("start_position", "start_velocity", "start_acceleration"), np.zeros(2))
    last = bench(target_position=[math.nan, math.nan], **(led | {"start_position": [1.0, 2.0]}))
    np.testing.assert_array_equal(last["position"], [1.0, 2.0])
    for tick in range(400):
        start = {name: last[name.removeprefix("start_")] for name in led}
        if tick == 100:  # a constraint held it back
            start["start_velocity"] = 0.5 * start["start_velocity"]
        if tick == 120:
            start["start_velocity"] = np.array([math.nan, 0.0])
        out = bench(target_position=[1.2, 1.9], **start)
        allowed = LIMITS["jerk_limit"] * TICK * (1 + 1e-9)
        assert (np.abs(out["acceleration"] - last["acceleration"]) <= allowed).all()
        last = out
    np.testing.assert_allclose(last["position"], [1.2, 1.9], atol=1e-8)


def test_limits_may_change_while_it_moves():
    bench = Bench(trajectory_generator(1, jerk_limit=100.0, acceleration_limit=5.0))
    for _ in range(150):
        fast = bench(target_position=5.0)
    assert fast["velocity"][0] > 0.9
    bench.block.set_parameter(bench.context, "velocity_limit", 0.2)
    for _ in range(150):
        slow = bench(target_position=5.0)
    assert slow["velocity"][0] == pytest.approx(0.2)
    with pytest.raises(BadInputError, match="from rest"):
        bench.block.set_parameter(bench.context, "velocity_limit", 1e4)


def test_what_cannot_be_planned_is_shown():
    bench = Bench(trajectory_generator())
    for _ in range(100):
        out = bench(target_position=[1e100, 0.1])
    np.testing.assert_array_equal(out["braking"], [1, 0])
    np.testing.assert_array_equal(out["velocity"][0], 0.0)


def test_nothing_stays_behind(monkeypatch):
    planners = []
    original = Planner.__init__

    def noted(self: Planner, *arguments: object) -> None:
        original(self, *arguments)
        planners.append(weakref.ref(self))

    monkeypatch.setattr(Planner, "__init__", noted)

    def run() -> None:
        builder = DiagramBuilder()
        generator = builder.AddSystem(trajectory_generator())
        goal = builder.AddSystem(ConstantVectorSource([0.2, -0.1]))
        builder.Connect(goal.get_output_port(), generator.GetInputPort("target_position"))
        hold = builder.AddSystem(ZeroOrderHold(TICK, 2))
        builder.Connect(generator.GetOutputPort("position"), hold.get_input_port())
        Simulator(builder.Build()).AdvanceTo(0.1)

    run()
    gc.collect()
    assert planners
    assert [planner() for planner in planners] == [None] * len(planners)


def test_groups_are_planned_apart_and_each_as_if_it_were_alone():
    together = Bench(trajectory_generator(4, groups=[1, 3]))
    alone = [Bench(trajectory_generator(size, **dict.fromkeys(LIMITS, 1.0))) for size in (1, 3)]
    rng = np.random.default_rng(5)
    one, three = 0.3, rng.normal(size=3)
    for tick in range(120):
        if tick == 30:
            one = -0.2  # a new target of one group leaves the other on its plan
        if tick == 60:
            three = rng.normal(size=3)
        out = together(target_position=[one, *three])
        apart = [bench(target_position=goal) for bench, goal in zip(alone, (one, three), strict=True)]
        for name in OUTPUTS:
            np.testing.assert_array_equal(out[name], np.concatenate([each[name] for each in apart]))


def test_a_start_that_is_no_number_leaves_the_other_groups_alone():
    bench = Bench(trajectory_generator(2, groups=[1, 1]))
    rest = {"start_velocity": [0.0, 0.0], "start_acceleration": [0.0, 0.0]}
    out = bench(target_position=[0.1, 0.6], start_position=[math.nan, 0.5], **rest)
    assert abs(out["position"][0]) < 1e-3
    assert out["position"][1] == pytest.approx(0.5, abs=1e-3)


@pytest.mark.parametrize("groups", [[1, 2], [2, 0], [1.0, 1.0], []])
def test_groups_that_do_not_add_up_are_refused(groups):
    with pytest.raises(BadInputError, match="groups"):
        trajectory_generator(2, groups=groups)


def test_a_target_position_must_be_connected():
    block = trajectory_generator()
    with pytest.raises(RuntimeError, match="target_position"):
        block.GetOutputPort("position").Eval(block.CreateDefaultContext())
