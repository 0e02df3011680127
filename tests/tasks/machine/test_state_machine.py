"""The machine against a plain one that is written from the words of its documentation, and in single cases."""

import math

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import LogVectorOutput, TrajectorySource, VectorLogSink

from forcectl.motion.references import held_trajectory
from forcectl.tasks.machine.state_machine import StateMachine
from forcectl.testing import assert_deterministic, assert_passes_no_nan, run_diagram
from forcectl.testing.runs import Log
from tests.examples.machines import (
    PEG_INPUTS,
    PEG_SIGNALS,
    PERIOD,
    cap_machine,
    end,
    exit_to,
    mode,
    peg,
    peg_machine,
    random_modes,
)

SIGNALS = {"x": ("x",), "p": ("u", "v", "w")}
US = 1_000_000
# The guards of `random_modes` in Python, and what they read.
GUARDS = {
    "x > 0.6": (lambda s: s["x"] > 0.6, "x", lambda s: s["x"]),
    "abs(p.u) < 0.3 and x < 0.9": (lambda s: abs(s["u"]) < 0.3 and s["x"] < 0.9, "ux", lambda s: abs(s["u"])),
    "p.w > 0.2 or p.u > 0.95": (
        lambda s: s["w"] > 0.2 or s["u"] > 0.95, "wu", lambda s: s["w"] if s["w"] > 0.2 else s["u"],
    ),
    "time > 0.04": (lambda s: s["time"] > 0.04, "", lambda s: s["time"]),
    "not (x > 0.2)": (lambda s: s["x"] <= 0.2, "x", lambda s: s["x"]),
    "visits * x > 1.2": (lambda s: s["visits"] * s["x"] > 1.2, "x", lambda s: s["visits"] * s["x"]),
    "elapsed > 0.3": (lambda s: s["elapsed"] > 0.3, "", lambda s: s["elapsed"]),
    "p.u > 0.5": (lambda s: s["u"] > 0.5, "u", lambda s: s["u"]),
    "x > 0.95 and p.u > 0.9": (lambda s: s["x"] > 0.95 and s["u"] > 0.9, "xu", lambda s: s["x"]),
}  # fmt: skip


def plain_machine(modes, samples, gap_us, always):
    """Mode, transitions, value, end, gripper and tare at every tick, in whole microseconds.

    Args:
        samples: dictionaries of x, u, w at the ticks.
        gap_us: longest gap of a signal.
        always: exits of every mode but ends.
    """
    tick_us = round(PERIOD * US)
    name, began, bad_ticks, true_since, visits = "a", 0, 0, {}, {"a": 1}
    count, value, gripper = 0, 0.0, modes["a"].grippers["left"]
    rows = []
    for k, sample in enumerate(samples):
        now, at, following = k * tick_us, modes[name], None
        if k > 0:
            signals = {**sample, "time": (now - began) / US, "visits": visits[name], "elapsed": now / US}
            exits = [*(exit_ for exit_ in always if exit_.to != name and not at.end), *at.exits]
            read = {letter for exit_ in exits for letter in GUARDS[exit_.when][1]}
            bad_ticks = bad_ticks + 1 if any(not math.isfinite(sample[letter]) for letter in read) else 0
            true_since = {i: since for i, since in true_since.items() if i in map(id, exits)}
            for exit_ in exits:
                i, (holds, letters, decides) = id(exit_), GUARDS[exit_.when]
                if all(math.isfinite(sample[letter]) for letter in letters) and holds(signals):
                    since = true_since.setdefault(i, now)
                    if following is None and now - since >= round(exit_.hold * US):
                        following = exit_.to, decides(signals)
                else:
                    true_since.pop(i, None)
            if following is None and bad_ticks * tick_us > gap_us and name != "blind":
                following = "blind", bad_ticks * tick_us / US
            if following is None and at.timeout is not None and now - began >= round(at.timeout * US):
                following = at.on_timeout, (now - began) / US
        if following is not None:
            (name, value), began, count = following, now, count + 1
            visits[name] = visits.get(name, 0) + 1
            gripper = modes[name].grippers.get("left", gripper)
        number = {"": 0, "success": 1, "failure": 2}[modes[name].end]
        row = list(modes).index(name), (now - began) / US, count, value, number, gripper == "closed", modes[name].tare
        rows.append(row)
    return np.array(rows, dtype=float)


NAMES = ("mode", "time_in_mode", "transition", "transition_value", "machine_end", "gripper_command", "tare")


@pytest.mark.parametrize("seed", range(6))
def test_random_walks_are_those_of_a_plain_machine(seed):
    rng = np.random.default_rng(seed)
    ticks, seen = 120, set[int]()
    for _ in range(8):
        modes = random_modes(rng)
        watched = [exit_to("c", "p.u > 0.5", 0.04), exit_to("failed", "elapsed > 0.3")]
        always = watched[: rng.integers(0, 3)]
        values = np.sin(np.cumsum(rng.normal(0.0, 0.4, (ticks, 4)), axis=0))
        for begin, length in zip(rng.integers(0, ticks, 4), rng.integers(1, 12, 4), strict=True):
            values[begin : begin + length, rng.integers(0, 4)] = rng.choice([np.nan, np.inf])
        options = {"arms": ["left"], "on_bad_signal": "blind", "longest_gap": 0.02, "always": always}
        machine = StateMachine(modes, start="a", signals=SIGNALS, period=PERIOD, **options)
        columns = {"x": slice(0, 1), "p": slice(1, 4)}
        inputs = {
            name: lambda t, v=values[:, columns[name]]: v[round(t / PERIOD)]
            for name in (machine.get_input_port(i).get_name() for i in range(machine.num_input_ports()))
        }
        log = run_diagram(machine, (ticks - 1) * PERIOD, period=PERIOD, inputs=inputs)
        wanted = plain_machine(modes, [{"x": row[0], "u": row[1], "w": row[3]} for row in values], 20_000, always)
        for i, name in enumerate(NAMES):
            if name in log.values:
                np.testing.assert_allclose(log[name][:, 0], wanted[:, i], rtol=0, atol=1e-9, err_msg=name)
        seen |= set(wanted[:, 0].astype(int))
    assert len(seen) >= 7  # of the eight modes: the walks go somewhere


def words(log: Log, modes) -> list[str]:
    names = list(modes)
    return [names[int(number)] for number in log["mode"][:, 0]]


def test_the_peg_goes_its_way():
    """Order of events of Fig. 6.7, each at the tick at which its guard holds."""
    log = run_diagram(peg_machine(), 0.4, period=PERIOD, inputs=PEG_INPUTS)
    found = words(log, peg())
    begins = [k for k in range(len(found)) if k == 0 or found[k] != found[k - 1]]
    assert [found[k] for k in begins] == ["approach", "compliant", "stopping", "opening", "inserted"]
    # z = 0 from 0.012 s on; the force is there from 0.024 s on, with a speed below 0.001 m/s; 0.2 s of opening.
    np.testing.assert_allclose(log.time[begins], [0.0, 0.012, 0.024, 0.028, 0.232], atol=1e-9)
    np.testing.assert_allclose(log["transition_value"][begins, 0], [0.0, 0.0, 1.5, 1.5, 0.204], atol=1e-9)
    assert log["machine_end"][begins, 0].tolist() == [0, 0, 0, 0, 1]
    assert log["transition"][-1] == 4
    assert log["gripper_command"][begins].tolist() == [[1, 1], [1, 1], [1, 1], [1, 0], [1, 0]]
    assert log["tare"][begins, 0].tolist() == [1, 0, 0, 0, 0]


def test_the_peg_slips_back_into_compliant_motion():
    inputs = PEG_INPUTS | {"touch": lambda t: [0.0, -1.2 if 0.02 < t < 0.04 else -0.2], "insert": [0.0, 0.1]}
    found = words(run_diagram(peg_machine(), 0.06, period=PERIOD, inputs=inputs), peg())
    assert found == ["approach"] + 5 * ["compliant"] + 4 * ["stopping"] + 6 * ["compliant"]


def two(*exits, **changes):
    return {"first": mode(*exits, **changes), "done": end("success"), "failed": end("failure", "too late")}


def run_two(x, *exits, duration=0.1, gap=0.05, bad="", **changes):
    modes = two(*exits, **changes) | ({"blind": end("failure", "no x")} if bad else {})
    machine = StateMachine(
        modes, start="first", signals={"x": ("x",)}, on_bad_signal=bad, longest_gap=gap, period=PERIOD
    )
    log = run_diagram(machine, duration, period=PERIOD, inputs={"x": x} if machine.num_input_ports() else {})
    found = words(log, modes)
    last = found.index(found[-1])
    return found[-1], round(float(log.time[last]), 6), float(log["transition_value"][-1, 0])


@pytest.mark.parametrize(
    ("breaks_at", "at"),
    [(None, 0.06), (0.056, 0.1), (0.06, 0.104), (0.064, 0.06)],
)
def test_a_guard_must_hold_without_a_break(breaks_at, at):
    """x is above 1 from 0.02 s on, for 40 ms."""
    found = run_two(
        lambda t: [2.0 * (t > 0.0199) - 2.0 * (breaks_at is not None and abs(t - breaks_at) < 1e-6)],
        exit_to("done", "x > 1", hold=0.04),
        duration=0.2,
    )
    assert found == ("done", at, 2.0)


def test_the_first_of_the_exits_that_hold_counts_and_the_timeout_comes_last():
    exits = exit_to("failed", "x > 3"), exit_to("done", "x > 1"), exit_to("failed", "x > 0")
    assert run_two([2.0], *exits) == ("done", 0.004, 2.0)
    assert run_two(lambda t: [2.0 * (t > 0.019)], exits[1], timeout=0.02) == ("done", 0.02, 2.0)
    assert run_two([0.0], exits[1], timeout=0.02) == ("failed", 0.02, 0.02)


@pytest.mark.parametrize("guard", ["x > 1", "not (x > 1)", "x != 1", "x > 1 or time > 0"])
@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_a_bad_signal_never_holds_and_leads_to_its_own_end(guard, value):
    """The fourteenth bad tick is the first beyond 0.05 s; without a mode for it there is the timeout."""
    assert run_two([value], exit_to("done", guard), bad="blind") == ("blind", 0.056, 0.056)
    assert run_two([value], exit_to("done", guard), timeout=0.02) == ("failed", 0.02, 0.02)


def test_the_mode_for_bad_signals_goes_on_while_they_stay_bad():
    """It reads them, too; its timeout ends it, or a guard once they are good again."""
    retreat = mode(exit_to("done", "x > 1"), timeout=0.1)
    modes = two(exit_to("done", "x > 1")) | {"retreat": retreat}
    machine = StateMachine(modes, start="first", signals={"x": ("x",)}, on_bad_signal="retreat", period=PERIOD)
    found = words(run_diagram(machine, 0.2, period=PERIOD, inputs={"x": [math.nan]}), modes)
    assert found == 14 * ["first"] + 25 * ["retreat"] + 12 * ["failed"]
    back = run_diagram(machine, 0.2, period=PERIOD, inputs={"x": lambda t: [math.nan if t < 0.099 else 2.0]})
    assert words(back, modes)[20:27] == 5 * ["retreat"] + 2 * ["done"]


def test_times_are_whole_ticks_in_spite_of_rounding():
    """0.035 / 0.005 is a little more than 7 in floating point numbers, and 0.07 / 0.005 more than 14."""
    modes = two(exit_to("done", "x > 1", hold=0.035), timeout=0.07)
    machine = StateMachine(modes, start="first", signals={"x": ("x",)}, period=0.005)
    held = run_diagram(machine, 0.1, period=0.005, inputs={"x": [2.0]})
    assert words(held, modes) == 8 * ["first"] + 13 * ["done"]
    late = run_diagram(machine, 0.1, period=0.005, inputs={"x": [0.0]})
    assert words(late, modes) == 14 * ["first"] + 7 * ["failed"]


def test_a_short_gap_of_a_signal_is_passed_over():
    assert run_two(lambda t: [math.nan if t < 0.05 else 2.0], exit_to("done", "x > 1"), bad="blind")[0] == "done"


@pytest.mark.parametrize("guard", ["1 / x > 5", "(x - 1) ** 0.5 > 0", "x * 1e200 * 1e200 > 1"])
def test_a_guard_without_a_value_does_not_hold(guard):
    x = 1.0 if "e200" in guard else 0.0
    assert run_two([x], exit_to("done", guard), timeout=0.02) == ("failed", 0.02, 0.02)


def test_a_task_is_tried_again_so_many_times():
    modes = {
        "attempt": mode(exit_to("failed", "visits > 3"), exit_to("again", "time > 0.01"), timeout=1.0),
        "again": mode(exit_to("attempt", "time > 0.01"), exit_to("done", "visits > 9"), timeout=2.0),
        "done": end("success"),
        "failed": end("failure", "three attempts were not enough"),
    }
    machine = StateMachine(modes, start="attempt", signals={}, period=PERIOD)
    log = run_diagram(machine, 0.2, period=PERIOD)
    assert words(log, modes)[-1] == "failed"
    assert float(log["transition"][-1, 0]) == 7
    assert machine.num_input_ports() == 0


def test_only_signals_that_guards_read_are_inputs():
    machine = cap_machine()
    assert [machine.get_input_port(i).get_name() for i in range(machine.num_input_ports())] == ["touch"]
    signals = {"extra": ("a",), **PEG_SIGNALS}
    machine = StateMachine(peg(), start="approach", signals=signals, arms=("left", "right"))
    assert [machine.get_input_port(i).get_name() for i in range(machine.num_input_ports())] == ["touch", "insert"]


def test_bits_are_the_same_in_every_run():
    assert_deterministic(peg_machine, duration=0.3, period=PERIOD, inputs=PEG_INPUTS)


def test_no_nan_comes_out():
    assert_passes_no_nan(peg_machine(), duration=0.2, period=PERIOD, inputs=PEG_INPUTS)


def test_a_block_behind_the_machine_sees_the_mode_at_the_tick_at_which_it_begins():
    """Between ticks the mode is held, whatever the inputs do."""
    builder = DiagramBuilder()
    times = [0.0, 0.009, 0.012, 0.03]
    source = builder.AddSystem(TrajectorySource(held_trajectory(times, np.array([[0.0, 2.0, 0.0, 0.0]]))))
    modes = two(exit_to("done", "x > 1"), timeout=0.02)
    machine = builder.AddSystem(StateMachine(modes, start="first", signals={"x": ("x",)}, period=PERIOD))
    builder.Connect(source.get_output_port(), machine.get_input_port())
    sink: VectorLogSink = LogVectorOutput(machine.GetOutputPort("mode"), builder, 0.001)
    diagram = builder.Build()
    simulator = Simulator(diagram)
    simulator.AdvanceTo(0.03)
    log = sink.FindLog(simulator.get_context())
    # x is above 1 between two ticks only: the machine times out, at 0.02 s.
    np.testing.assert_array_equal(log.data()[0], np.where(log.sample_times() > 0.0199, 2.0, 0.0))
