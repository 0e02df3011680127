"""Stations and closed loops for tests: short ways to build them, to run them and to compute what they should do."""

from functools import lru_cache
from typing import Any

import numpy as np
import xarray as xr
from scipy.linalg import expm

import forcectl
from forcectl.arrays import Vector
from forcectl.diagrams.sensors import WristForceConfig
from forcectl.diagrams.station import StationConfig
from forcectl.diagrams.workcell import Workcell
from tests.examples.stations import pressing

PERIOD = 0.002  # control tick [s]
FORCE = 15.0  # height of the steps [N]
FILTER, SENSOR = 75.4, 12.6  # bandwidths of joint-reference filter and force filter [rad/s]
SPRINGS = 5.9e3  # [N/m]

# Postures far from singular ones, all but the first with a rolled wrist [deg].
POSTURES = (
    (0.0, 0.0, -90.0, 0.0, 90.0, 0.0),
    (20.0, -10.0, -80.0, 30.0, 70.0, 40.0),
    (-40.0, 15.0, -110.0, -60.0, 60.0, 100.0),
    (60.0, 30.0, -70.0, 90.0, 80.0, -45.0),
    (-90.0, -20.0, -100.0, 150.0, -70.0, 20.0),
)
NORMALS = ((0.0, 0.0, 1.0), (1.0, 0.0, 0.0), (0.3, -0.8, 0.5))


def quiet_sensor(**changes: Any) -> WristForceConfig:
    """A force sensor without noise and quantisation."""
    return WristForceConfig(**({"noise_std": 0.0, "quantum": 0.0} | changes))


def multibody(**changes: Any) -> StationConfig:
    """A multibody station without sensor noise."""
    return pressing(**({"fidelity": "Multibody", "force_sensor": quiet_sensor()} | changes))


@lru_cache(maxsize=64)
def _run(key: tuple[tuple[str, Any], ...]) -> xr.Dataset:
    changes = {name: list(value) if isinstance(value, tuple) else value for name, value in key}
    return forcectl.run({"reference": {"force": FORCE}}, overrides=changes).log.squeeze()


def closed_loop(**changes: Any) -> xr.Dataset:
    """Log of a closed loop with the integral law; keys are scenario keys with "__" for ".", lists as tuples.

    Runs are kept, so that tests may look at the same one twice.
    """
    return _run(tuple(sorted((name.replace("__", "."), value) for name, value in changes.items())))


def signal(log: xr.Dataset, name: str) -> Vector:
    """One signal of a log as an array over time."""
    return log[name].values


def command_for(workcell: Workcell, displacement: float) -> Vector:
    """Joint positions that move the motor side by `displacement` [m] along n, shape (n_q,) [rad]."""
    return workcell.motor_start + workcell.contact.direction * displacement


def compliance_of(workcell: Workcell) -> float:
    """n'(J K^-1 J' + C_L) n + C_E [m/N], from the robot's Jacobian and the stiffness in its parameters."""
    robot, context = workcell.robot, workcell.start_context()
    row = workcell.contact.n @ robot.jacobian(context)[3:]
    links = 0.0
    p_WT = robot.pose(context).translation()
    for name, X_WD in robot.link_poses(context).items():
        # A force along n at T, and the moments it has about the link's frame, in that frame's axes.
        to_frame = X_WD.rotation().matrix().T
        moment = to_frame @ np.cross(p_WT - X_WD.translation(), workcell.contact.n)
        links += np.concatenate([moment, to_frame @ workcell.contact.n]) ** 2 @ robot.link_compliance[name]
    return float(row**2 @ (1 / robot.joint_stiffness) + links + 1 / workcell.config.environment.stiffness)


def sampled_reference(
    count: int, gain: float, *, period: float = PERIOD, force: float = FORCE, damping_time: float = 0.0
) -> Vector:
    """Measured force of the ideal loop, integrated exactly: sampled integral law, held command, continuous plant.

        x'' = w_f^2 (u - x) - 2 w_f x',   F = -(x + T x')/C_T,   f'' = w_s^2 (F - f) - 2 w_s f'

    The compliance cancels, because the law knows it.

    Args:
        count: ticks.
        gain: K_I [1/s].
        damping_time: T = D_E/K_E of the environment [s].
    """
    a = np.zeros((5, 5))  # x, x', f, f' and the held command, all but f in newtons: -x/C_T
    a[0, 1] = a[2, 3] = 1.0
    a[1] = [-(FILTER**2), -2 * FILTER, 0.0, 0.0, FILTER**2]
    a[3] = [SENSOR**2, damping_time * SENSOR**2, -(SENSOR**2), -2 * SENSOR, 0.0]
    step, z, measured = expm(a * period), np.zeros(5), np.zeros(count + 1)
    for k in range(count + 1):
        measured[k] = z[2]
        z[4] += gain * period * (force - z[2])
        z = step @ z
    return measured


def continuous_reference(times: Vector, gain: float, force: float = FORCE) -> Vector:
    """Measured force of the ideal loop with a continuous integral law, u' = K_I (F_bar - f)."""
    a = np.zeros((6, 6))  # as above, then the reference as a constant state
    a[0, 1] = a[2, 3] = 1.0
    a[1, :5] = [-(FILTER**2), -2 * FILTER, 0.0, 0.0, FILTER**2]
    a[3, :4] = [SENSOR**2, 0.0, -(SENSOR**2), -2 * SENSOR]
    a[4, 2], a[4, 5] = -gain, gain
    start = np.array([0.0, 0.0, 0.0, 0.0, 0.0, force])
    return np.array([(expm(a * t) @ start)[2] for t in times])
