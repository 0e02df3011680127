"""Task state machines as data: peg and cap of the thesis (Fig. 6.7 and 6.14), and random ones."""

import math
from typing import Any

import numpy as np
from pydrake.systems.framework import System

from forcectl.tasks.machine.modes import ExitConfig, MachineModeConfig, Modes
from forcectl.tasks.machine.state_machine import StateMachine
from forcectl.testing.runs import Input
from tests.examples.block_example import Example

PERIOD = 0.004
PEG_SIGNALS = {"touch": ("force_x", "force_z"), "insert": ("z", "z_speed")}
CAP_SIGNALS = {"touch": ("force_z", "torque_z")}


def exit_to(to: str, when: str, hold: float = 0.0) -> ExitConfig:
    return ExitConfig(to=to, when=when, hold=hold)


def mode(
    *exits: ExitConfig, timeout: float | None = 1.0, on_timeout: str = "failed", **changes: Any
) -> MachineModeConfig:
    return MachineModeConfig(exits=list(exits), timeout=timeout, on_timeout=on_timeout, **changes)


def end(kind: str, reason: str = "") -> MachineModeConfig:
    return MachineModeConfig(end=kind, reason=reason)


def peg() -> dict[str, MachineModeConfig]:
    """Fig. 6.7, with a timeout of every mode and a named failure for each."""
    held = {"left": "closed", "right": "closed"}
    return {
        "approach": mode(
            exit_to("compliant", "insert.z < 0.002"), timeout=5.0, on_timeout="missed", grippers=held, tare=True
        ),
        "compliant": mode(exit_to("stopping", "abs(touch.force_z) > 1"), timeout=3.0, on_timeout="no_contact"),
        "stopping": mode(
            exit_to("compliant", "abs(touch.force_z) < 0.5"),
            exit_to("opening", "abs(touch.force_z) >= 0.5 and abs(insert.z_speed) < 0.001"),
            timeout=1.0,
            on_timeout="stuck",
        ),
        "opening": mode(exit_to("inserted", "time > 0.2"), timeout=0.5, on_timeout="stuck", grippers={"right": "open"}),
        "inserted": end("success"),
        "missed": end("failure", "the hole was not reached"),
        "no_contact": end("failure", "nothing touched the peg: is the part there?"),
        "stuck": end("failure", "the peg did not come to rest"),
    }


def cap() -> dict[str, MachineModeConfig]:
    """Fig. 6.14."""
    return {
        "approach": mode(exit_to("compliant", "time > 1"), timeout=40.0),
        "compliant": mode(exit_to("rotation", "abs(touch.force_z) > 0.5"), timeout=5.0),
        "rotation": mode(exit_to("stopping", "abs(touch.torque_z) > 0.08", hold=0.04), timeout=20.0),
        "stopping": mode(exit_to("opening", "time > 0.1"), timeout=1.0),
        "opening": mode(exit_to("locked", "time > 0.2"), timeout=1.0),
        "locked": end("success"),
        "failed": end("failure", "a mode took too long"),
        "no_reading": end("failure", "no force was estimated"),
    }


def cap_machine() -> StateMachine:
    return StateMachine(cap(), start="approach", signals=CAP_SIGNALS, on_bad_signal="no_reading", period=PERIOD)


def peg_machine() -> StateMachine:
    return StateMachine(peg(), start="approach", signals=PEG_SIGNALS, arms=("left", "right"), period=PERIOD)


def random_modes(rng: np.random.Generator) -> Modes:
    """Five modes and two ends, with guards of all kinds; timeouts lead on to the ends, guards anywhere."""
    names, guards = list("abcde"), ["x > 0.6", "abs(p.u) < 0.3 and x < 0.9", "p.w > 0.2 or p.u > 0.95",
                                    "time > 0.04", "not (x > 0.2)", "visits * x > 1.2"]  # fmt: skip
    modes = {}
    for i, name in enumerate(names):
        others = [other for other in [*names, "done"] if other != name]
        exits = [
            exit_to(str(rng.choice(others)), str(guard), float(rng.choice([0.0, 0.0, 0.008, 0.02])))
            for guard in rng.choice(guards, rng.integers(0, 3), replace=False)
        ]
        if name == "d":
            exits.insert(0, exit_to("done", "x > 0.95 and p.u > 0.9"))
        following = [*names, "failed"][i + 1]  # so that all modes can be reached
        timeout = float(rng.choice([0.044, 0.06, 0.2]))
        named = name == "a" or rng.random() < 0.3
        grippers = {"left": str(rng.choice(["open", "closed"]))} if named else {}
        tare = bool(rng.random() < 0.3)
        modes[name] = mode(*exits, timeout=timeout, on_timeout=following, tare=tare, grippers=grippers)
    failures = {"failed": end("failure", "tried too often"), "blind": end("failure", "no signal")}
    return {**modes, "done": end("success"), **failures}


PEG_INPUTS: dict[str, Input] = {
    "touch": lambda t: [0.0, 1.5 * (t > 0.02)],
    "insert": lambda t: [0.01 * (t < 0.01), 0.05 * math.exp(-t / 0.005)],
}
_SHOWN = ("mode", "time_in_mode", "transition", "transition_value", "machine_end")
MACHINE_EXAMPLES: dict[type[System], list[Example]] = {
    StateMachine: [
        Example(
            peg_machine,
            {(output, name) for output in (*_SHOWN, "gripper_command", "tare") for name in PEG_SIGNALS},
            PEG_INPUTS,
        ),
        Example(cap_machine, {(output, "touch") for output in _SHOWN}, {"touch": lambda t: [1.0, 0.01 * math.sin(t)]}),
    ]
}
