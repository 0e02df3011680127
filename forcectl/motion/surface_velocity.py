"""Motion along the surface by speeds over time: the velocity generator (Algorithm 3) on a straight line.

target speed -> VelocityGenerator -> path coordinate s -> LinePosture -> dq_uc(s) of (2.12)
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from pydrake.systems.framework import BasicVector, Context, DiagramBuilder
from pydrake.trajectories import PiecewisePolynomial

from forcectl.arrays import Vector
from forcectl.errors import BadInputError, invalid
from forcectl.framework.block import PythonBlock, PythonDiagram
from forcectl.framework.fields import key
from forcectl.motion.references import Reference, held_trajectory
from forcectl.motion.tangential import LineConfig, line_postures
from forcectl.motion.velocity_generator import VelocityGenerator
from forcectl.robot.model import RobotModel

_KNOT = 1e-3  # distance of the points of the line at which inverse kinematics is solved [m]
_LONGEST = 2.0  # longest path [m]


class LinePosture(PythonBlock):
    """Joint motion that moves the tool along a line.

    ```
    name: LinePosture
    input_ports: [path_position]
    output_ports: [unconstrained_reference]
    ```

    path_position: shape (1,), s [m]. unconstrained_reference: shape (n_q,), from the start posture [rad]. Feedthrough.
    Beyond the ends of the line the joints stay in the end postures.

    Sampling: none; evaluated when read.

    Args:
        line: joint motion over s [rad], (n_q, 1).
    """

    port_units = {"path_position": "m"}

    def __init__(self, line: PiecewisePolynomial):
        super().__init__()
        self._line = line
        self._position = self.DeclareVectorInputPort("path_position", 1)
        reads = {self._position.ticket()}
        self.DeclareVectorOutputPort("unconstrained_reference", line.rows(), self._motion, prerequisites_of_calc=reads)

    def _motion(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(self._line.value(self._position.Eval(context).item()).ravel())


class SurfaceVelocity(PythonDiagram):
    """Motion along a line by speeds over time.

    ```
    name: SurfaceVelocity
    input_ports: []
    output_ports: [unconstrained_reference]
    ```

    unconstrained_reference: shape (n_q,), joint motion from the start posture [rad]. A function of time.

    Sampling: every `period` [s] of the generator.

    Args:
        target: speed over time [m/s], (1, 1).
        generator: of one component.
        line: joint motion over the path [rad], (n_q, 1).
    """

    def __init__(self, target: PiecewisePolynomial, generator: VelocityGenerator, line: PiecewisePolynomial):
        super().__init__()
        builder = DiagramBuilder()
        add, connect = builder.AddNamedSystem, builder.Connect
        source = add("target_velocity", Reference("target_velocity", target))
        add("generator", generator)
        posture = add("line", LinePosture(line))
        connect(source.get_output_port(), generator.GetInputPort("target_velocity"))
        connect(generator.GetOutputPort("position"), posture.GetInputPort("path_position"))
        builder.ExportOutput(posture.get_output_port(), "unconstrained_reference")
        builder.BuildInto(self)


@dataclass(kw_only=True)
class SurfaceVelocityConfig(LineConfig):
    """Scenario part `!VelocityAlongSurface`: target speeds along the surface, reached at the acceleration limit."""

    times: list[float] = key(meaning="start time of each of the target speeds: the first one 0, increasing", unit="s")
    velocities: list[float] = key(
        meaning="target speeds along the line, one per time; negative: backwards; the last one zero", unit="m/s"
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if not any(self.velocities) or self.velocities[-1] != 0:
            raise invalid("velocities", self.velocities, "speeds that are not all zero, the last one zero")
        if len(self.times) != len(self.velocities) or self.times[0] != 0 or not (np.diff(self.times) > 0).all():
            raise invalid("times", self.times, f"{len(self.velocities)} increasing numbers from 0 on, like velocities")

    def interval(self) -> tuple[float, float]:
        """Begin and end of the motion [s]."""
        first = next(time for time, value in zip(self.times, self.velocities, strict=True) if value)
        return first, self.times[-1] + max(abs(value) for value in self.velocities) / self.acceleration

    def add_to(self, builder: DiagramBuilder, robot: RobotModel, start: Vector, n: Vector) -> SurfaceVelocity:
        """Add the block `motion`; its ticks are the control ticks of the robot."""
        period = robot.parameters.period
        wanted = held_trajectory(self.times, self.velocities)
        generator = VelocityGenerator(1, acceleration_limit=self.acceleration, period=period)
        line = self._line(robot, start, self.per_metre(n), self._ends(period))
        return builder.AddNamedSystem("motion", SurfaceVelocity(wanted, generator, line))

    def _ends(self, period: float) -> tuple[float, float]:
        """Lowest and highest path coordinate, with a margin for the sampling [m]."""
        s, v, passed = 0.0, 0.0, [0.0]
        seen = [_tick(time, period) for time in self.times]
        for begin, end, target in zip(seen, [*seen[1:], math.inf], self.velocities, strict=True):
            a = math.copysign(self.acceleration, target - v)
            ramp = min(abs(target - v) / self.acceleration, end - begin)
            turn = -v / a
            if 0 < turn < ramp:
                passed.append(s + 0.5 * v * turn)
            s, v = s + ramp * (v + 0.5 * a * ramp), v + a * ramp
            passed.append(s)
            if end < math.inf:
                s += v * (end - begin - ramp)
                passed.append(s)
        if not max(passed) - min(passed) < _LONGEST:
            raise invalid("velocities", self.velocities, f"those of a path of at most {_LONGEST:g} m")
        # In the last tick of each ramp the acceleration is below the limit.
        late = 0.125 * self.acceleration * period**2 * len(seen)
        margin = period * max(abs(value) for value in self.velocities) + late
        return min(passed) - margin, max(passed) + margin

    @staticmethod
    def _line(robot: RobotModel, start: Vector, per_metre: Vector, ends: tuple[float, float]) -> PiecewisePolynomial:
        """Joint motion over the path coordinate [rad]; each side is solved from the start outwards."""
        sides = []
        for end in ends:
            knots = np.linspace(0.0, end, math.ceil(abs(end) / _KNOT) + 1)
            try:
                sides.append((knots, line_postures(robot, start, knots[:, None] * per_metre) - start))
            except BadInputError as error:
                raise error.at("velocities") from None
        (back, back_motion), (ahead, ahead_motion) = sides
        knots = np.concatenate([back[:0:-1], ahead])
        motion = np.vstack([back_motion[:0:-1], ahead_motion])
        return PiecewisePolynomial.CubicShapePreserving(knots, motion.T)


def _tick(time: float, period: float) -> float:
    """The first tick at or after a time [s]."""
    number = math.ceil(time / period - 0.5)  # the one before it, or itself
    return period * (number + (number * period < time))
