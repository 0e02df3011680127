"""Admittance control: a force moves a reference as it would move a mass with a damper::

    mu = H a + D dv                                                                               (6.3)
    a[k] = (mu[k] - D dv[k])/H,    dv[k+1] = dv[k] + Ts a[k],    dx[k+1] = dx[k] + Ts dv[k] + Ts^2/2 a[k]      (6.5)
    x[k+1] = x_gen[k+1] + dx[k+1],    x'[k+1] = x_gen'[k+1] + dv[k+1]                             (6.2)

component by component, with mu a force or torque and x_gen the motion of a trajectory generator. At every tick the
state of the filter is reset to the difference between the actual command and the generator::

    dx[k] = x[k] - x_gen[k],    dv[k] = x'[k] - x_gen'[k]                                         (6.10)*

so that the filter agrees with the command where a limit, or a quadratic program that cannot follow, has changed it.
There are two arrangements of generator and filter (the table in docs/admittance.md says when they are stable):

`consistent`: the generator continues from its own state, dx as above.
`increment`, of the printed (6.7): the generator starts from x[k], x'[k], so dx starts from 0 in every tick.

As a force law, mu = F - F_bar and x = dx_bar: the tool retreats where the force is too large. After the time H/D it is
an integral law, dx_bar' = (F - F_bar)/D. On a surface of the total compliance C_T that is (2.11)* with K_I = 1/(C_T D).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike
from pydrake.systems.framework import Context, DiagramBuilder, System
from pydrake.systems.primitives import ConstantVectorSource, MatrixGain, Multiplexer

from forcectl.arrays import Array
from forcectl.errors import invalid, unknown
from forcectl.framework.batch import BatchParameter, BatchValue, batch_values, check, check_order
from forcectl.framework.block import PythonDiagram
from forcectl.framework.fields import Config, key
from forcectl.framework.linear_batch import state_space
from forcectl.framework.sampled_block import Memory, SampledBatch
from forcectl.framework.wiring import through
from forcectl.motion.trajectory_generator import TrajectoryGenerator
from forcectl.motion.velocity_generator import VelocityGenerator
from forcectl.plant.plant_model import PlantModel

if TYPE_CHECKING:
    from scipy.signal import StateSpace

ARRANGEMENTS = ("consistent", "increment")
GENERATORS = ("velocity", "position")
_LIMITS = ("velocity_limit", "acceleration_limit")  # of both generators
_LARGEST_SIZE = 6  # components of a task


def admittance_step(
    displacement: BatchValue,
    velocity: BatchValue,
    force: BatchValue,
    inertia: BatchValue,
    damping: BatchValue,
    period: float,
) -> tuple[BatchValue, BatchValue]:
    """One tick of the filter. (6.5)

    Args:
        displacement, velocity: dx[k], dv[k] [u, u/s].
        force: mu[k] [N or Nm].
        inertia: H [kg or kg m^2/rad].
        damping: D [N s/m or Nms/rad].
        period: Ts [s].

    Returns:
        dx[k+1], dv[k+1] [u, u/s].
    """
    acceleration = (force - damping * velocity) / inertia
    moved = displacement + period * velocity + 0.5 * period**2 * acceleration
    return moved, velocity + period * acceleration


def admittance_response(inertia: float, damping: float, period: float, arrangement: str = "consistent") -> StateSpace:
    """One component from mu to [x, x'] at the same tick, the generator at rest and without limits.

    Args:
        inertia: H [kg or kg m^2/rad].
        damping: D [N s/m or Nms/rad].
        period: Ts [s].
        arrangement: one of `ARRANGEMENTS`.
    """
    # The generator stops from x'[k] within the tick, x'[k] Ts/2 further on: Algorithm 3.
    stopping = 0.5 * period if arrangement == "increment" else 0.0
    columns = [admittance_step(x, v, mu, inertia, damping, period) for x, v, mu in ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0))]
    a: Array = np.transpose(columns)
    a[0, 1] += stopping
    b = np.reshape(admittance_step(0.0, 0.0, 1.0, inertia, damping, period), (2, 1))
    return state_space(a, b, a, b, period)


class AdmittanceFilter(SampledBatch):
    """The admittance filter (6.2), (6.5) with the state update (6.10)*, for n components, one to six of a task.

    ```
    name: AdmittanceFilter
    input_ports: [generated_position, generated_velocity, force, commanded_position (optional),
    commanded_velocity (optional)]
    output_ports: [position, velocity, last_position, last_velocity]
    parameters: [inertia, damping, lower_limit, upper_limit]
    ```

    Units u per component: [m] or [rad].

    generated_position, generated_velocity: shape (n,), x_gen[k+1], x_gen'[k+1], at the END of the tick [u, u/s].
    force: shape (n,), mu[k] along the components [N or Nm].
    commanded_position, commanded_velocity: shape (n,), the actual command of the tick before, x[k], x'[k] [u, u/s]. The
    ports exist with `corrected`; without them the last output of this block is used.
    position, velocity: shape (n,), x[k+1], x'[k+1] [u, u/s]. Feedthrough of all inputs at the tick, and held.
    last_position, last_velocity: shape (n,), the same of the tick before [u, u/s], from which the generator starts in
    the arrangement `increment`. State, no direct feedthrough.

    Parameters (Context, shape (n,)): inertia H [kg or kg m^2/rad] and damping D [N s/m or Nms/rad], positive, with H >
    D Ts/2: else the filter alone is unstable. lower_limit and upper_limit of the position [u], where it stops.

    A force or a generated motion that is not a number holds the position, with a velocity of zero. A commanded position
    or velocity that is not a number is replaced by the last output of this block.

    Sampling: every `period` [s]; no delay from force to position, see `SampledBlock`.

    Args:
        size: n.
        arrangement: `consistent` or `increment`, see the module.
        corrected: whether the actual command of the tick before comes from ports.
        initial_position: of generator and filter, shape (n,) [u].
    """

    def __init__(
        self,
        size: int,
        *,
        inertia: ArrayLike,
        damping: ArrayLike,
        arrangement: str = "consistent",
        corrected: bool = False,
        lower_limit: ArrayLike = -np.inf,
        upper_limit: ArrayLike = np.inf,
        initial_position: ArrayLike = 0.0,
        period: float = 0.004,
    ):
        if arrangement not in ARRANGEMENTS:
            raise unknown("arrangement", arrangement, ARRANGEMENTS)
        if not 1 <= size <= _LARGEST_SIZE:
            raise invalid("size", size, f"from 1 to {_LARGEST_SIZE}, the components of a task")
        self._period = check("period", period, "positive")
        self._consistent, self._corrected = arrangement == "consistent", corrected
        super().__init__(
            size,
            {
                "inertia": BatchParameter(inertia, "positive and finite", "kg"),
                "damping": BatchParameter(damping, "positive and finite", "N s/m"),
                "lower_limit": BatchParameter(lower_limit, "a number", "m"),
                "upper_limit": BatchParameter(upper_limit, "a number", "m"),
            },
        )
        self.sample_delay = {("force", "position"): 0.0}
        names = ["generated_position", "generated_velocity", "force"]
        names += ["commanded_position", "commanded_velocity"] * corrected
        start = batch_values("initial_position", initial_position, size)
        memory = {"position": start, "velocity": 0.0, "generated_position": start, "generated_velocity": 0.0}
        self.declare_memory(memory, [self.DeclareVectorInputPort(name, size) for name in names], period)
        self.show("position", "velocity")
        for name in ("position", "velocity"):
            self.show_held(f"last_{name}", name)

    def check_together(self, values: Mapping[str, Array]) -> None:
        """Check that the filter alone is stable, and that the limits are in order."""
        least = 0.5 * self._period * values["damping"]
        if not np.all(values["inertia"] > least):
            allowed = f"above damping times half a tick, {least.tolist()}: else the filter alone is unstable"
            raise invalid("inertia", values["inertia"].tolist(), allowed)
        check_order("lower_limit", "upper_limit", values)

    def step(self, context: Context, memory: Memory, inputs: Memory) -> dict[str, BatchValue]:
        """One tick of the filter."""
        m, inf = self.math, np.inf
        inertia, damping, lower, upper = self.values(context)
        x, v = memory["position"], memory["velocity"]
        if self._corrected:
            given_x, given_v = inputs["commanded_position"], inputs["commanded_velocity"]
            good = (abs(given_x) < inf) & (abs(given_v) < inf)
            x, v = m.where(good, given_x, x), m.where(good, given_v, v)
        generated, speed, force = inputs["generated_position"], inputs["generated_velocity"], inputs["force"]
        finite = (abs(generated) < inf) & (abs(speed) < inf)
        dx = x - memory["generated_position"] if self._consistent else 0.0
        dv = v - memory["generated_velocity"]
        dx, dv = admittance_step(dx, dv, force, inertia, damping, self._period)
        free, speed_free = generated + dx, speed + dv
        good = finite & (abs(free) < inf) & (abs(speed_free) < inf)
        position = m.minimum(m.maximum(m.where(good, free, x), lower), upper)
        stopped = ((free > upper) & (speed_free > 0)) | ((free < lower) & (speed_free < 0))
        return {
            "position": position,
            "velocity": m.where(good, m.where(stopped, 0.0, speed_free), 0.0),
            "generated_position": m.where(finite, generated, memory["generated_position"]),
            "generated_velocity": m.where(finite, speed, memory["generated_velocity"]),
        }


class AdmittanceForceLaw(PythonDiagram):
    """Admittance control of n independent forces: generator and filter (Figs. 6.3 and 6.4).

    ```
    name: AdmittanceForceLaw
    input_ports: [desired_force, measured_force]
    output_ports: [displacement_command, displacement_velocity_command]
    ```

    desired_force, measured_force: shape (n,) [N]. displacement_command: shape (n,), dx_bar [m], held over [t_k, t_k+1).
    displacement_velocity_command: shape (n,), velocity of the filter at the end of the tick [m/s].
    All outputs are feedthrough of all inputs at the tick.

    The blocks inside have the parameters: see `AdmittanceFilter`, and `VelocityGenerator` with the target velocity 0 or
    `TrajectoryGenerator` with the target position 0.

    Sampling: every `period` [s]; no delay from measured_force to displacement_command.

    Args:
        admittance: the filter of the displacements.
        generator: a `VelocityGenerator` or a `TrajectoryGenerator` of as many components.
        from_command: whether the generator starts from the last command, as in the arrangement `increment`.
    """

    def __init__(self, admittance: AdmittanceFilter, generator: System, *, from_command: bool):
        super().__init__()
        n = admittance.size
        self.sample_delay = {("measured_force", "displacement_command"): 0.0}
        builder = DiagramBuilder()
        add, connect = builder.AddNamedSystem, builder.Connect
        forces = add("forces", Multiplexer([n, n]))
        difference = MatrixGain(np.hstack([-np.eye(n), np.eye(n)]))
        error = through(builder, "force_error", difference, forces.get_output_port())
        zero = add("zero", ConstantVectorSource(np.zeros(n)))
        add("generator", generator)
        add("admittance", admittance)
        connect(error, admittance.GetInputPort("force"))
        target = "target_velocity" if isinstance(generator, VelocityGenerator) else "target_position"
        connect(zero.get_output_port(), generator.GetInputPort(target))
        for name in ("position", "velocity"):
            connect(generator.GetOutputPort(name), admittance.GetInputPort(f"generated_{name}"))
            if from_command:
                connect(admittance.GetOutputPort(f"last_{name}"), generator.GetInputPort(f"start_{name}"))
        if from_command and generator.HasInputPort("start_acceleration"):
            connect(zero.get_output_port(), generator.GetInputPort("start_acceleration"))
        builder.ExportInput(forces.get_input_port(0), "desired_force")
        builder.ExportInput(forces.get_input_port(1), "measured_force")
        builder.ExportOutput(admittance.GetOutputPort("position"), "displacement_command")
        builder.ExportOutput(admittance.GetOutputPort("velocity"), "displacement_velocity_command")
        builder.BuildInto(self)


@dataclass(kw_only=True)
class AdmittanceConfig(Config):
    """Scenario part `!Admittance`: the force error moves a mass with a damper.

    The default is an integral law with K_I = 1.2 1/s on the springs of 5.9e3 N/m.
    """

    must_be_stable: ClassVar = True  # see `forcectl.force.slot`
    inertia: float = key(40.0, "mass H of the admittance filter", unit="kg", bounds="positive")
    damping: float = key(
        4000.0,
        "damping D of the admittance filter: a constant force error moves the tool at force error / D",
        unit="N s/m",
        bounds="positive",
    )
    arrangement: str = key(
        "consistent",
        "start of the motion generator in each tick; consistent: its own state; increment: the last command, as in "
        "(6.7)",
        choices=ARRANGEMENTS,
    )
    generator: str = key(
        "velocity",
        "motion generator; velocity: comes to rest, Algorithm 3; position: returns to the start, which leaves a force "
        "error with increment",
        choices=GENERATORS,
    )
    velocity_limit: float = key(
        1.0, "largest velocity of the motion generator; does not limit the command", unit="m/s", bounds="positive"
    )
    acceleration_limit: float = key(
        1000.0,
        "largest acceleration of the motion generator; does not limit the command",
        unit="m/s^2",
        bounds="positive",
    )
    jerk_limit: float = key(1e9, "largest jerk of the position generator", unit="m/s^3", bounds="positive")
    lower_limit: float = key(
        -0.1, "lower limit of the displacement command, into the surface", unit="m", bounds="from -10 to -0.000001"
    )
    upper_limit: float = key(
        0.1, "upper limit of the displacement command, off the surface", unit="m", bounds="from 0.000001 to 10"
    )

    def unused(self) -> tuple[tuple[str, ...], str]:
        """Limits that the generator never reaches, and why."""
        if self.arrangement == "consistent":
            return (*_LIMITS, "jerk_limit"), "by itself the generator rests, and the command has no such limit"
        if self.generator == "velocity":
            return ("velocity_limit", "jerk_limit"), "a generator of velocities that stops has none"
        return (), ""

    def law(self, model: PlantModel) -> AdmittanceForceLaw:
        """The block.

        Raises:
            BadInputError: the filter alone is unstable.
        """
        n, period = model.size, model.period
        limits: dict[str, Any] = {name: getattr(self, name) for name in _LIMITS}
        if self.generator == "velocity":
            generator: System = VelocityGenerator(n, **limits, period=period)
        else:
            # No synchronisation of the components.
            generator = TrajectoryGenerator(n, **limits, jerk_limit=self.jerk_limit, groups=[1] * n, period=period)
        admittance = AdmittanceFilter(
            n,
            inertia=self.inertia,
            damping=self.damping,
            arrangement=self.arrangement,
            lower_limit=self.lower_limit,
            upper_limit=self.upper_limit,
            period=period,
        )
        return AdmittanceForceLaw(admittance, generator, from_command=self.arrangement == "increment")

    def sampled_response(self, model: PlantModel) -> StateSpace:
        """From the measured force to displacement and rate of the command, without limits and at rest."""
        return admittance_response(self.inertia, self.damping, model.period, self.arrangement)

    def add_to(self, builder: DiagramBuilder, model: PlantModel) -> AdmittanceForceLaw:
        """Add the law."""
        return builder.AddNamedSystem("force_law", self.law(model))
