"""Running a station behind its joint interface by itself: constant or timed inputs, and its outputs at every tick."""

from collections.abc import Callable
from typing import Any

import numpy as np
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder, LeafSystem

from forcectl.diagrams import workcell
from forcectl.diagrams.fidelities.multibody import MultibodyStation
from forcectl.diagrams.workcell import Workcell
from forcectl.robot.arms_motion import ArmsMotion
from forcectl.robot.model import RobotModel
from tests.examples.stations import free

Array = np.ndarray
TICK = 0.004
INTERFACE_OUTPUTS = (
    "joint_position",
    "joint_velocity",
    "motor_torque",
    "link_position",
    "link_velocity",
    "external_torque",
    "tip_wrench",
    "arm_contact_force",
)


def torque_elsewhere(degrees: list[float]) -> dict[tuple[str, int], Array]:
    """What 1 N at the origin of a link makes along the motion that leaves the hand of its arm, by arm and link [Nm].

    Of a force along that motion, and along x, y and z of the world, shape (4,); links from shoulder to hand.
    """
    robot, q = RobotModel.load("yumi", "yumi_gripper"), np.radians(degrees)
    context, found = robot.context_at(q), {}
    for side, arm in robot.parts.arms.items():
        own = ArmsMotion(robot, robot.create_context(), q, 0 * q).arm(side).jacobian[:, arm.joints]
        null = np.linalg.svd(own)[2][6]
        for link in (2, 7, 3, 4, 5, 6):
            frame = robot.plant.GetBodyByName(f"{side}_link_{link}").body_frame()
            torque = np.abs(robot.jacobian_of(context, frame)[3:][:, arm.joints] @ null)
            found[side, link] = np.append(np.linalg.norm(torque), torque)
    return found


class Timed(LeafSystem):
    """A function of time."""

    def __init__(self, function: Callable[[float], Array], size: int):
        super().__init__()
        self.DeclareVectorOutputPort(
            "y", size, lambda c, out: out.SetFromVector(function(c.get_time())), {self.time_ticket()}
        )


def describe(**options: Any) -> Workcell:
    """A workcell of one arm without tool and with perfect sensors, unless said otherwise."""
    known = {"robot": "yumi/left", "tool": None, "time_step": 0.001, "sensors": {"quantum": 0.0}}
    return workcell.describe(free(**{**known, **options}))


def whole_robot(**options: Any) -> Workcell:
    """A workcell of both arms with their grippers, unless said otherwise."""
    return workcell.describe(free(**options))


def run(workcell: Workcell, duration: float, *, seed: int = 0, every: float = TICK, **inputs: Any) -> dict[str, Array]:
    """All outputs over time, and `time`; inputs are arrays or functions of time, the reference stays at the start."""
    builder = DiagramBuilder()
    station = builder.AddSystem(MultibodyStation(workcell, seed))
    inputs = {"joint_position_command": workcell.motor_start, **inputs}
    for name, value in inputs.items():
        port = station.GetInputPort(name)
        function = value if callable(value) else (lambda t, value=value: np.asarray(value))
        source = builder.AddSystem(Timed(function, port.size()))
        builder.Connect(source.get_output_port(), port)
    diagram = builder.Build()
    simulator = Simulator(diagram)
    context = simulator.get_mutable_context()
    own = station.GetMyContextFromRoot(context)
    simulator.Initialize()
    ports = [station.GetOutputPort(name) for name in INTERFACE_OUTPUTS]
    rows: list[list[Array]] = []
    times = every * np.arange(round(duration / every) + 1)
    for t in times:
        simulator.AdvanceTo(t)
        rows.append([port.Eval(own) for port in ports])
    log = {name: np.array([row[i] for row in rows]) for i, name in enumerate(INTERFACE_OUTPUTS)}
    return log | {"time": times}
