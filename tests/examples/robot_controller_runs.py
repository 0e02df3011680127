"""The robot's invariance controller run tick by tick against a spring that follows its command."""

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
from pydrake.systems.analysis import Simulator

from forcectl.diagrams.model import plant_model
from forcectl.diagrams.station import StationConfig
from forcectl.diagrams.workcell import describe
from forcectl.force.invariance.controller import InvarianceController
from forcectl.plant.plant_model import PlantModel
from forcectl.robot.model import JointLimits

PERIOD, COMPLIANCE = 0.002, 2e-4
N = 6


@cache
def robot_plant_model(fidelity: str = "Kinematic", **station: Any) -> PlantModel:
    return plant_model(describe(StationConfig(fidelity=fidelity, **station)))


def make(fidelity: str = "Kinematic", **changes: Any) -> InvarianceController:
    return InvarianceController(robot_plant_model(fidelity), **{"compliance": COMPLIANCE} | changes)


Signal = Callable[[int], Any]


def drive(
    controller: InvarianceController,
    ticks: int,
    *,
    desired: Signal | float = 15.0,
    measured: Callable[[int, float], float] | None = None,
    reference: Signal | None = None,
    compliance: Signal | None = None,
    approach: Signal | None = None,
    stiffness: float = 1 / COMPLIANCE,
) -> dict[str, np.ndarray]:
    """Every output of the controller over time, shape (ticks,) or (ticks, n).

    Args:
        desired, reference, compliance, approach: inputs by tick.
        measured: force by tick and displacement command of the tick before; None: a spring that is always in contact.
    """
    context = controller.CreateDefaultContext()
    simulator = Simulator(controller, context)
    names = [controller.get_output_port(i).get_name() for i in range(controller.num_output_ports())]
    ports = {name: controller.GetOutputPort(name) for name in names}
    for name in ("motor_position", "motor_velocity"):
        controller.GetInputPort(name).FixValue(context, np.zeros(N))
    log: dict[str, list[Any]] = {name: [] for name in names}
    dx = 0.0
    for k in range(ticks):
        if k:
            simulator.AdvanceTo(k * PERIOD)  # before the event of this tick, which the next call handles
        force = measured(k, dx) if measured else -dx * stiffness
        values = {
            "desired_force": [desired(k) if callable(desired) else desired],
            "measured_force": [force],
            "unconstrained_reference": reference(k) if reference else np.zeros(N),
        }
        if compliance:
            values["compliance"] = [compliance(k)]
        if approach:
            values["approach_displacement"] = [approach(k)]
        for name, value in values.items():
            controller.GetInputPort(name).FixValue(context, np.asarray(value, dtype=float))
        if k == 0:
            simulator.Initialize()
        for name, port in ports.items():
            log[name].append(port.Eval(context))
        dx = log["displacement_command"][-1].item()
    return {name: np.squeeze(np.array(values)) for name, values in log.items()}


def accelerations(log: dict[str, np.ndarray], start: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Joint speeds at the ends of the ticks and the accelerations in them, from the command alone (ticks, n)."""
    q = np.vstack([start, log["joint_position_command"]])
    v = np.zeros((len(q), q.shape[1]))
    u = np.zeros((len(q) - 1, q.shape[1]))
    for k in range(len(u)):
        u[k] = 2 * (q[k + 1] - q[k] - PERIOD * v[k]) / PERIOD**2
        v[k + 1] = v[k] + PERIOD * u[k]
    return v[1:], u


def limits(**changes: Any) -> JointLimits:
    own = robot_plant_model().robot.limits
    names = ("position_lower", "position_upper", "velocity", "acceleration", "torque")
    return JointLimits(**{name: changes.get(name, getattr(own, name)) for name in names})


def tips(log: dict[str, np.ndarray]) -> np.ndarray:
    """Displacement of the tool from the start (ticks, 3) [m]."""
    model = robot_plant_model()
    context = model.robot.create_context()
    places = []
    for q in [model.start, *log["joint_position_command"]]:
        model.robot.set_positions(context, q)
        places.append(model.robot.tip_position(context))
    return np.array(places[1:]) - places[0]


def turns(log: dict[str, np.ndarray]) -> np.ndarray:
    """Rotation vector of the tool from the start (ticks, 3) [rad]."""
    model = robot_plant_model()
    context = model.robot.create_context()
    rotations = []
    for q in [model.start, *log["joint_position_command"]]:
        model.robot.set_positions(context, q)
        rotations.append(model.robot.pose(context).rotation())
    angles = [(rotation @ rotations[0].inverse()).ToAngleAxis() for rotation in rotations[1:]]
    return np.array([each.angle() * each.axis() for each in angles])


def assert_smooth(log: dict[str, np.ndarray], used: JointLimits | None = None) -> None:
    """Everything is finite, and the command keeps the joint limits: its speed is continuous."""
    used = used or limits()
    assert all(np.isfinite(values).all() for values in log.values())
    v, u = accelerations(log, robot_plant_model().start)
    assert (np.abs(u) <= used.acceleration * (1 + 1e-6) + 1e-6).all()
    assert (np.abs(v) <= used.velocity * (1 + 1e-9)).all()
    q = log["joint_position_command"]
    assert (q <= used.position_upper + 1e-9).all()
    assert (q >= used.position_lower - 1e-9).all()
