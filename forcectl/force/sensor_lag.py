"""Sensor-lag lead: the displacement that the measured force does not show yet, from the filter and delay of the
sensor::

    lead = (p if p > 0 else p/4) + max(T d', 0)/2,    p = H dx_motor - min(dx_bar, dx_motor),
    d = C_T_hat F + H dx_motor

with H the filter and delay of the sensor and T their lag; in the unit of C_T_hat F/2, see `ForceLimit`. p is the depth
that is commanded, or reached, beyond what the sensor shows. A retreat, p < 0, counts a quarter, which is half of its
modelled value. d is the displacement that the motion does not explain, such as a surface that rises; its rate is
assumed to last for the lag.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from pydrake.systems.primitives import LinearSystem

from forcectl.framework.batch import whole_multiple
from forcectl.framework.linear_batch import LinearBatch, behind_delay, state_space
from forcectl.plant.plant_model import PlantModel
from forcectl.plant.sensors.force_sensor import filter_matrices, sensor_filter

if TYPE_CHECKING:
    from scipy.signal import StateSpace

_RETREAT_WEIGHT = 0.25  # of p < 0
_SMOOTHING = 0.25  # time constant of the filter of d', in sensor lags
_MAX_DISPLACEMENT = 10.0  # [m] a larger one is implausible


def sensor_model(model: PlantModel, size: int) -> LinearSystem | LinearBatch:
    """The modelled filter and delay of the force sensor, for `size` signals."""
    return sensor_filter(
        size, model.sensor_bandwidth, model.sensor_damping_ratio, model.period, _sensor_delay_ticks(model)
    )


def sensor_response(model: PlantModel) -> StateSpace:
    """The modelled filter and delay as a sampled linear system, from a force to the measured one."""
    matrices = filter_matrices(model.sensor_bandwidth, model.sensor_damping_ratio, model.period)
    lag = behind_delay(*matrices, _sensor_delay_ticks(model), model.period)
    return state_space(lag.A(), lag.B(), lag.C(), lag.D(), model.period)


def _sensor_delay_ticks(model: PlantModel) -> int:
    return whole_multiple("delay", model.sensor_delay, model.period, "period")


class SensorLag:
    """Lead for the modelled filter and delay of the force sensor.

    It has no state of its own: the caller keeps `size` numbers, zeros at rest at 0.

    Args:
        bandwidth: [rad/s], > 0.
        damping_ratio: [-], > 0.
        period: tick [s].
        delay_ticks: transport delay in samples.
    """

    def __init__(self, bandwidth: float, damping_ratio: float, period: float, delay_ticks: int = 0):
        a, b, _, d = filter_matrices(bandwidth, damping_ratio, period)
        self._a, self._b, self._direct = a.ravel().tolist(), b.ravel().tolist(), d.item()
        lag = 2 * damping_ratio / bandwidth + delay_ticks * period
        self._share = min(period / (_SMOOTHING * lag), 1.0)
        self.size = 3 + delay_ticks

    @classmethod
    def of(cls, model: PlantModel) -> SensorLag:
        """The sensor of a loop's model."""
        return cls(model.sensor_bandwidth, model.sensor_damping_ratio, model.period, _sensor_delay_ticks(model))

    def lead(self, memory: list[float], command: float, moved: float, depth: float) -> tuple[float, list[float]]:
        """The lead, to be added to C_T_hat F/2 [m], and the memory of the next tick.

        Args:
            memory: `size` numbers.
            command: dx_bar [m].
            moved: dx_motor [m]; if it is not a number, the command is used.
            depth: C_T_hat F of the measured force [m]; if it is not a number, the surface is assumed to be at rest.
        """
        x, rate, surface, *line = memory
        if not abs(moved) < _MAX_DISPLACEMENT:
            moved = command
        line.append(moved)
        late = line.pop(0)
        (a, b, c, d), (e, f) = self._a, self._b
        shown = x + self._direct * late
        rise = depth + shown - surface  # _SMOOTHING T d'
        if not abs(rise) < _MAX_DISPLACEMENT:
            rise = 0.0
        beyond = shown - min(command, moved)
        lead = (beyond if beyond > 0.0 else _RETREAT_WEIGHT * beyond) + max(rise, 0.0) / (2 * _SMOOTHING)
        following = [a * x + b * rate + e * late, c * x + d * rate + f * late, surface + self._share * rise]
        return lead, following + line
