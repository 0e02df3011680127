"""Force of a first touch, from which the guard limits the speed of an approach, or of a surface that comes closer::

    M w'' + D w' + K_J w = J'n F,    F = K_E (v t - n'J w),    w = w' = 0 at the touch                 until t = T

The drives move on at the speed v for the time T until sensor, estimate and drives have reversed the motion. The links
are on the springs K_J and dampers D of the joints, with the deflection w. The surface stops the links at once, so the
force oscillates around the ramp v t/(C_R + C_E) of the springs alone. F is linear in v; its largest value until T is
taken. A surface that comes closer at the speed v adds F to the force that is there.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import expm

from forcectl.arrays import Array
from forcectl.plant.plant_model import PlantModel

# T [s]: the drives of the COMAU reverse after 0.021 to 0.030 s on 1e4 to 1e6 N/m.
TURNS = 0.030
# T [s] of a surface that comes closer: the drives are at rest, and begin to retreat after 0.008 to 0.015 s.
BEGINS = 0.015
_STEP = 2e-4  # [s] time step of the search for the largest force


def swinging_gain(mass: Array, damping: Array, springs: Array, row: Array, stiffness: float, duration: float) -> float:
    """Largest force of a touch per speed of the drives, with the links on the joint springs [N s/m].

    Args:
        mass: M, shape (n, n) [kg m2].
        damping: D, shape (n,) [Nms/rad].
        springs: K_J, shape (n,) [Nm/rad].
        row: n'J, shape (n,) [m/rad].
        stiffness: K_E [N/m].
        duration: T [s].
    """
    n = len(row)
    w, speed, depth, v = slice(0, n), slice(n, 2 * n), 2 * n, 2 * n + 1
    rates = np.zeros((2 * n + 2, 2 * n + 2))
    rates[w, speed] = np.eye(n)
    rates[speed, w] = -np.linalg.solve(mass, np.diag(springs) + stiffness * np.outer(row, row))
    rates[speed, speed] = -np.linalg.solve(mass, np.diag(damping))
    rates[speed, depth] = np.linalg.solve(mass, stiffness * row)
    rates[depth, v] = 1.0
    step, state = expm(_STEP * rates), np.eye(2 * n + 2)[v]
    largest = 0.0
    for _ in range(round(duration / _STEP)):
        state = step @ state
        largest = max(largest, stiffness * float(state[depth] - row @ state[w]))
    return largest


def touch_gain(model: PlantModel, duration: float, *, stiffer: float = 1.0, links: bool = True) -> float:
    """Largest force of a first touch per speed, over all surfaces [N s/m].

    Args:
        model: of the plant.
        duration: T [s].
        stiffer: stiffness of the surfaces in multiples of the model's.
        links: whether the links of the robot have mass.
    """
    gains = []
    for i in range(model.size):
        own = model.loop(i)
        compliance, robot_compliance = float(own.environment_compliance[0]) / stiffer, float(own.robot_compliance[0])
        gains.append(duration / (compliance + robot_compliance))
        if links and own.robot is not None and robot_compliance > 0:
            robot, context = own.robot, own.robot.context_at(own.start)
            row = own.n @ robot.jacobian(context)[3:]
            # Scaled to the model's C_R along the normal, which includes the compliance of the drives.
            springs = robot.joint_stiffness * np.sum(row**2 / robot.joint_stiffness) / robot_compliance
            damping = np.broadcast_to(robot.parameters.transmission_damping, row.shape)
            mass = robot.mass_matrix(context)
            gains[-1] = max(gains[-1], swinging_gain(mass, damping, springs, row, 1.0 / compliance, duration))
    return max(gains)
