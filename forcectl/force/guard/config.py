"""Scenario part `guard`: the block between every controller and the robot that checks readings and commands."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from forcectl.arrays import Array
from forcectl.errors import BadInputError, bound, invalid
from forcectl.force.guard.estimate import estimate_of, largest_jump, live_repeats, quiet_bandwidth
from forcectl.force.guard.first_touch import BEGINS, TURNS, touch_gain
from forcectl.force.guard.guard import ControllerGuard
from forcectl.force.guard.limits import GuardLimits
from forcectl.force.guard.passes import passes
from forcectl.force.guard.steps import DisplacementSteps, JointSteps
from forcectl.force.kinematic_inversion import joint_direction
from forcectl.framework.fields import Config, key
from forcectl.plant.plant_model import PlantModel

_LARGEST = 1e4  # [N] largest plausible force where the sensor's range is infinite
_MEASURED = 0.9  # of the sensor's range: default of maximum_force
_PULL = 0.02  # of the sensor's range: a larger pull is implausible where the surface cannot pull
_SETTLES = 0.08  # [s] time constant, plus the sensor's lag, with which the force should follow the command
_EXPLAINED = 0.1  # [s] time constant with which the rate explained by a displacement of the command decays
_FORGOTTEN = 2.0  # [s] time constant with which the energy that went into a surface decays
_OVER = 1.2  # of maximum_force: allowed in the first touch of a surface stiffer than the model's
_LOSSES = 8  # number of contact losses that do not count as bouncing
_DEEPER = 0.05  # of the sensor's range: its reading must change over the displacement that gives this force
_LONGEST_RETREAT = 60.0  # [s]


@dataclass(kw_only=True)
class GuardConfig(Config):
    """Scenario part `guard`; `guard: null` leaves it out."""

    maximum_force: float | None = key(
        None,
        "largest true contact force, estimated ahead of the sensor's lag; null: 0.9 of the sensor's range",
        unit="N",
        bounds="positive",
    )
    reaction_time: float = key(
        0.12,
        "prediction horizon: the guard retreats if a rising force would pass maximum_force within it",
        unit="s",
        bounds="from 0 to 1",
    )
    maximum_speed: float = key(
        25.0,
        "largest accepted speed of a force law's displacement command, derivative kicks included",
        unit="m/s",
        bounds="from 1e-06 to 10000",
    )
    joint_speed: float = key(
        5.0,
        "largest accepted speed of joint commands, as a multiple of the joint speed limits",
        bounds="from 0.01 to 1000",
    )
    slow_speed: float = key(
        0.02,
        "initial speed into the surface at which the guarded command catches up with the controller's; joint commands "
        "catch up at the same number in rad/s",
        unit="m/s",
        bounds="from 1e-06 to 1",
    )
    frozen_time: float = key(
        0.1,
        "time for which a sensor with noise may repeat its reading before it counts as frozen",
        unit="s",
        bounds="from 0.01 to 10",
    )
    least_response: float = key(
        0.25,
        "smallest accepted ratio of the measured force to the one the model predicts for the displacement into the "
        "surface; 0: no check",
        bounds="from 0 to 1",
    )
    energy: float = key(
        2.0,
        "largest energy into the surface within about 2 s, beyond the elastic energy at maximum_force",
        unit="J",
        bounds="from 0.001 to 1000",
    )
    stiffness_margin: float = key(
        10.0,
        "stiffest surface of an approach, in multiples of the model's stiffness: its first touch must stay below 1.2 "
        "times maximum_force",
        bounds="from 1 to 1000",
    )
    search_distance: float = key(
        0.01,
        "largest displacement beyond the last contact in search of a surface that was lost",
        unit="m",
        bounds="above 0 and at most 1",
    )
    patience: float = key(
        0.3, "time for which the guard holds a command before it retreats", unit="s", bounds="from 0 to 60"
    )
    retreat_distance: float = key(
        0.01, "largest distance of a retreat along the surface normals", unit="m", bounds="from 0.0001 to 1"
    )
    retreat_speed: float = key(0.05, "speed of a retreat from the surface", unit="m/s", bounds="from 0.001 to 2")
    retreats: int = key(
        3, "number of retreats from too large a force, before the guard stops for good", bounds="from 0 to 1000"
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.slow_speed > self.maximum_speed:
            raise invalid("slow_speed", self.slow_speed, f"at most maximum_speed = {self.maximum_speed:g} m/s")
        if self.retreat_distance > (most := _LONGEST_RETREAT * self.retreat_speed):
            allowed = f"at most {most:g} m, {_LONGEST_RETREAT:g} s at retreat_speed = {self.retreat_speed:g} m/s"
            raise invalid("retreat_distance", self.retreat_distance, allowed)

    def limits(self, model: PlantModel, index: int = 0) -> GuardLimits:
        """The limits and filter coefficients of the guard of one loop.

        Args:
            model: of the plant.
            index: of the loop.
        """
        period, range_ = model.period, min(model.sensor_range, _LARGEST)
        compliance = float(np.min(model.total_compliance)) if model.size else math.inf
        force = _MEASURED * model.sensor_range if self.maximum_force is None else self.maximum_force
        own = float(model.total_compliance[index]) if model.size else math.inf
        settles = _SETTLES + model.sensor_lag
        ahead = 0.0 if self.maximum_force is None else self.reaction_time + model.sensor_delay
        noise = math.hypot(model.sensor_noise, model.sensor_quantum / math.sqrt(12))
        repeats = live_repeats(model.sensor_noise, model.sensor_quantum, model.sensor_bandwidth, period)
        most = quiet_bandwidth(noise, force, ahead, period)
        lag, square, share = estimate_of(model.sensor_bandwidth, model.sensor_damping_ratio, period, most)
        return GuardLimits(
            period=period,
            highest=range_ * 1.001,
            lowest=-range_ * (1.001 if model.pulls else _PULL),
            jump=largest_jump(model.sensor_bandwidth, period, range_),
            desired=range_,
            force=force,
            lag=lag,
            square=square,
            share=share,
            ahead=ahead,
            turn=min(ahead, TURNS + model.sensor_delay),
            settle_own=1.0 - math.exp(-period / (TURNS + model.sensor_delay)),
            keep_own=math.exp(-period / _EXPLAINED),
            repeats=repeats,
            same=max(self.frozen_time / period, repeats),
            deeper=compliance * range_ * _DEEPER,
            compliance=own,
            gap=float(np.broadcast_to(model.gap, model.size)[index]) if model.size else 0.0,
            settle=1.0 - math.exp(-period / settles),
            response=self.least_response,
            energy=self.energy + 0.5 * own * force**2,
            keep=math.exp(-period / _FORGOTTEN),
            # Contact with a surface that pulls cannot be lost.
            search=math.inf if model.pulls else self.search_distance,
            losses=math.inf if model.pulls else _LOSSES,
            patience=max(self.patience / period, 1.0),
            retreats=self.retreats,
            retreat=self.retreat_distance,
            back=self.retreat_speed * period,
        )

    def check_approach(self, model: PlantModel, key: str, speed: float) -> None:
        """Refuse an approach speed at which even a retreat cannot keep the force of the first touch within its limit.

        The limit is `maximum_force`; on a surface `stiffness_margin` times as stiff as the model's, 1.2 times as much.

        Args:
            model: of the plant.
            key: of the speed.
            speed: of the tool when it meets the surface [m/s].

        Raises:
            BadInputError: with the numbers.
        """
        if self.maximum_force is None or not model.size:
            return
        gains = [
            (touch_gain(model, TURNS + model.sensor_delay, stiffer=stiffer), stiffer, over)
            for stiffer, over in ((1.0, 1.0), (self.stiffness_margin, _OVER))
        ]
        gain, stiffer, over = max(gains, key=lambda each: each[0] / each[2])
        strictest = gain / over
        if strictest * speed > self.maximum_force:
            stiffness = stiffer / float(np.min(model.environment_compliance))
            margin = f", {stiffer:g} times the model's (guard.stiffness_margin)" if stiffer > 1.0 else ""
            fault = (
                f" = {speed:g} m/s: the first touch comes to {gain * speed:.3g} N on {stiffness:.4g} N/m{margin}: "
                f"must be at most {bound(self.maximum_force / strictest, math.floor)} m/s with guard.maximum_force = "
                f"{self.maximum_force:g} N"
            )
            raise BadInputError(fault, key=key)

    def check_closing(
        self, truth: PlantModel, key: str, displacement: float, duration: float, force: float, *, links: bool
    ) -> None:
        """Refuse a surface that moves closer so fast that the force passes `maximum_force` before a command can act.

        Args:
            truth: the plant with the one surface.
            key: of the duration.
            displacement: of the surface towards the tool [m].
            duration: of that displacement [s].
            force: contact force before it [N].
            links: whether the links of the robot have mass.

        Raises:
            BadInputError: with the numbers.
        """
        if self.maximum_force is None:
            return
        acts = BEGINS + truth.sensor_delay
        more = touch_gain(truth, min(acts, duration), links=links) * displacement / duration
        if force + more > self.maximum_force:
            stiffness, room = 1.0 / float(truth.environment_compliance[0]), max(self.maximum_force - force, 1e-3)
            fault = (
                f" = {duration:g} s: {1e3 * displacement:g} mm towards the tool on {stiffness:.4g} N/m raises the "
                f"force from {force:g} N to {force + more:.3g} N before any command can act: must be at least "
                f"{bound(touch_gain(truth, acts, links=links) * displacement / room, math.ceil)} s with "
                f"guard.maximum_force = {self.maximum_force:g} N"
            )
            raise BadInputError(fault, key=key)

    def of_law(self, model: PlantModel, rates: bool = False) -> ControllerGuard:
        """The guard of a force law; `rates`: whether the law also outputs the velocity of its command."""
        period = model.period
        steps = DisplacementSteps(self.maximum_speed * period, self.slow_speed * period)
        return ControllerGuard(self._each(model), steps, np.zeros(model.size), loops=model.size, rates=rates)

    def _each(self, model: PlantModel) -> list[GuardLimits]:
        """The limits of each loop."""
        return [self.limits(model, index) for index in range(max(model.size, 1))]

    def passes(self, model: PlantModel, desired: Array, measured: Array, command: Array) -> bool:
        """Whether the guard of a force law would have passed every tick of a run without a guard; see `passes`."""
        return passes(self.limits(model), self.maximum_speed * model.period, desired, measured, command)

    def of_joints(self, model: PlantModel, loops: int, rates: bool = False) -> ControllerGuard:
        """The guard of a controller of joints.

        Args:
            model: of the plant.
            loops: number of force loops whose forces the controller reads; with 0, `maximum_force` limits the
                estimated force on each arm.
            rates: whether the controller also outputs the velocity of its command.
        """
        robot, start, period = model.known_robot(), model.start, model.period
        largest = self.joint_speed * robot.limits.velocity * period
        rows, direction = _along_normals(model, loops)
        slow = np.full(model.num_joints, self.slow_speed * period)
        steps = JointSteps(largest, slow, start, rows, direction)
        arms = 0 if loops or self.maximum_force is None else len(robot.parts.arms)
        return ControllerGuard(self._each(model), steps, start, loops=loops, rates=rates, arms=arms)


def _along_normals(model: PlantModel, loops: int) -> tuple[Array, Callable[[Array], Array]]:
    """Displacement along each normal per joint motion at the start (k, n) [m/rad], and joint motion along normals."""

    def each(position: Array) -> list[tuple[Array, Array]]:
        found = []
        for i in range(loops):
            one = model.loop(i)
            robot = one.known_robot()
            found.append((robot.jacobian(robot.context_at(position)), one.n))
        return found

    def direction(position: Array) -> Array:
        return sum((joint_direction(jacobian, n) for jacobian, n in each(position)), np.zeros(len(position)))

    rows = np.array([n @ jacobian[3:] for jacobian, n in each(model.start)]).reshape(loops, model.num_joints)
    return rows, direction
