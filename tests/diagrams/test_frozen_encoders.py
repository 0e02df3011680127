"""How far commands move while friction holds a joint, and readings that count as frozen beyond."""

from typing import Any

import numpy as np
import pytest

import forcectl as fc
from forcectl.diagrams.model import plant_model
from forcectl.diagrams.workcell import Workcell
from forcectl.framework.yaml_tree import Tagged
from tests.examples.joint_interface_runs import TICK, describe, run

Array = np.ndarray
SLOW = 4e-3  # [rad/s]
TURN = 3.0  # [s] from one reversal to the next


def triangle(workcell: Workcell) -> Any:
    """Slow motion of all joints to and fro."""

    def command(t: float) -> Array:
        there = SLOW * (TURN - abs(t % (2 * TURN) - TURN))
        return workcell.motor_start + there

    return command


def longest_travel(read: Array, command: Array) -> Array:
    """The farthest that the command of each joint moves while its reading repeats, shape (n,)."""
    found = np.zeros(read.shape[1])
    since = command[0].copy()
    for k in range(1, len(read)):
        since = np.where(read[k] == read[k - 1], since, command[k])
        found = np.maximum(found, np.abs(command[k] - since))
    return found


@pytest.mark.parametrize("elastic", [False, True])
@pytest.mark.parametrize(
    ("options", "least"), [({"servo": {"integral_gain": 0.0}}, 0.9), ({}, 0.1), ({"sensors": {"quantum": 1e-3}}, 0.1)]
)
def test_a_command_moves_no_farther_than_friction_and_the_quantum_hide(
    options: dict[str, Any], least: float, elastic: bool
) -> None:
    """Without integral it moves just as far: from one end of the Coulomb friction to the other."""
    workcell = describe(elastic_joints=elastic, **options)
    most = plant_model(workcell).unseen_travel
    inputs = {"joint_position_command": triangle(workcell)}
    read = run(workcell, 4 * TURN, **inputs)["joint_position"]
    if not elastic:  # in the plant's implicit step a joint that sticks creeps
        read = np.round(read / 1e-6) * 1e-6
    commands = np.array([inputs["joint_position_command"](k * TICK) for k in range(len(read))])
    travel = longest_travel(read, commands)
    assert (travel <= most + 1e-4).all()  # [rad] six ticks of the command
    if elastic:
        assert (travel >= least * most).all()


def test_a_dither_that_cancels_the_motion_hides_more_of_it() -> None:
    """At 0.02 to 0.2 rad/s the sum of command and dither reverses, and the joint sticks for some ticks."""
    by_friction, most = (plant_model(describe(dither={"amplitude": each})).unseen_travel for each in (0.0, 1.5e-3))
    np.testing.assert_allclose(most - by_friction, 0.012, rtol=1e-12)
    workcell = describe(dither={"amplitude": 1.5e-3}, elastic_joints=True, sensors={"quantum": 1e-5})
    speeds = np.linspace(0.02, 0.2, len(most))

    def command(t: float) -> Array:
        return workcell.motor_start + speeds * t

    read = run(workcell, 2.0, joint_position_command=command, joint_velocity_command=speeds)["joint_position"]
    travel = longest_travel(read, np.array([command(k * TICK) for k in range(len(read))]))
    assert (travel <= most).all()
    assert (travel > by_friction).any()


@pytest.mark.parametrize(
    ("chosen", "drive"), [(None, "JointInterface"), (0.012, "JointInterface"), (None, "JointImpedance")]
)
def test_a_reading_is_frozen_once_its_command_has_moved_farther(chosen: float | None, drive: str) -> None:
    """Twice as far as is hidden, or as the scenario says; 10 mrad with a drive that does not tell."""
    fault = {"kind": "frozen", "joint": "left_joint_2", "start": 0.4, "duration": 2.0}
    scenario = {
        "preset": "ideal",
        "station": {
            "fidelity": "Multibody",
            "robot": "yumi",
            "elastic_joints": True,
            "drive": Tagged({}, drive),
            "sensors": {"joints": Tagged({"quantum": 1e-5}, "JointReadings")},
            "environment": Tagged({}, "Parts" if drive == "JointInterface" else "Surface"),
            "faults": [fault],
        },
        "controller": Tagged({"random_moves": {"count": 1, "start": 0.1}}, "ReactiveReaching"),
        "duration": 1.0,
    }
    overrides = {} if chosen is None else {"controller.frozen_distance": chosen}
    loaded = fc.load_scenario(scenario, overrides=overrides)
    told = plant_model(loaded.build().workcell).unseen_travel
    allowed = chosen or (2 * told[1] if len(told) else 0.01)
    log = fc.run(loaded).log
    command, good = log["joint_position_command"].values[:, 1], log["reading_ok"].values
    assert (np.delete(good, 1, axis=1) == 1.0).all()
    # A tick judges by what the tick before it has commanded.
    begins, ends = int(np.searchsorted(log["time"].values, 0.4 - 1e-9)) - 2, int(np.argmin(good[:, 1])) - 1
    assert abs(command[ends - 1] - command[begins]) <= allowed < abs(command[ends] - command[begins])
