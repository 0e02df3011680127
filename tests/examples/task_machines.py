"""Controllers `!TaskMachine` of both arms, bare flanges, alone: with readings and wrenches that a test gives."""

from functools import cache

import numpy as np
from pydrake.systems.framework import DiagramBuilder, System

import forcectl as fc
from forcectl.diagrams.model import plant_model
from forcectl.diagrams.workcell import describe
from forcectl.framework.yaml_tree import parse
from forcectl.plant.plant_model import PlantModel
from forcectl.tasks.controllers.task_machine import TaskMachine, TaskMachineConfig
from forcectl.testing.runs import Input
from tests.examples.block_example import Example
from tests.examples.reactive_examples import REACTIVE_INPUTS, REFERENCE_OUTPUTS, every, outputs
from tests.examples.stations import free

LOWER = """
controller: !TaskMachine
  tasks:
    touch: !ArmTask {arm: right, coordinates: [x, y, z]}
    hold: !ArmTask {arm: left}
  link_distance: 0.0
  on_bad_signal: blind
  modes:
    wait:
      tare: true
      grippers: {left: closed, right: closed}
      exits: [{when: time > 0.05, to: lower}]
      timeout: 0.2
      on_timeout: late
    lower:
      references: {touch: {z: {velocity: -0.05}, x: {comply: true}}}
      exits:
        - {when: touch_force.force_z > 1 and touch.speed_z < 0, to: press}
        - {when: gripper_holds.right < 0.5, hold: 0.02, to: lost}
      timeout: 0.5
      on_timeout: late
    press:
      references: {touch: {z: {by: -0.002}}}
      exits: [{when: reached > 0.5, to: let_go}]
      timeout: 1.0
      on_timeout: late
    let_go: {end: success, grippers: {right: open}}
    late: {end: failure, reason: nothing was met}
    lost: {end: failure, reason: the part was lost}
    blind: {end: failure, reason: a signal was no number}
"""
MODES = ("wait", "lower", "press", "let_go", "late", "lost", "blind")
INPUTS: dict[str, Input] = {name: REACTIVE_INPUTS[name] for name in ("joint_position", "joint_velocity")} | {
    "estimated_wrench": lambda t: np.arange(12.0) * t,
    "gripper_holds": lambda t: [1.0, 1.0],
}


def config(text: str = LOWER) -> TaskMachineConfig:
    made = fc.load_scenario(parse(text, "machine.yaml")).controller
    assert isinstance(made, TaskMachineConfig)
    return made


@cache
def model() -> PlantModel:
    return plant_model(describe(free(tool=None)))


def task_machine(text: str = LOWER) -> TaskMachine:
    made = config(text).add_to(DiagramBuilder(), model())
    assert isinstance(made, TaskMachine)
    return made


_FELT = ("joint_position", "estimated_wrench")
_MACHINE = {"mode", "time_in_mode", "transition", "transition_value", "machine_end", "gripper_command"}
TASK_MACHINE_EXAMPLES: dict[type[System], list[Example]] = {
    TaskMachine: [
        Example(
            task_machine,
            every(outputs(), INPUTS)
            | every(_MACHINE | {REFERENCE_OUTPUTS[0], *REFERENCE_OUTPUTS[3:]}, (*_FELT, "gripper_holds"))
            | every({"task_force", "task_wrench"}, _FELT),
            INPUTS,
            periods={"period": 0.004},
        )
    ],
}
