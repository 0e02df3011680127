"""Joint impedance control of a robot with a torque interface.

    tau = K_q (q_bar - q) + D_q (q_bar' - q') + g(q)

At rest a force F along n moves the tool by C_q F, C_q = n'J K_q^-1 J'n, in series with joints and links. With the
positions of the motors as q the torque is that of a spring, of a damper and of gravity compensation. But for its
sampling, the law is then passive in any contact. A motor of inertia B alone is stable under it with the period T when

    K_q T/2 < D_q < 2 B/T

Joints whose springs are not much stiffer than K_q can be damped only a little from the motor side: with K_q = K their
damping ratio is at most 0.2.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from pydrake.common.value import AbstractValue
from pydrake.systems.framework import Context, DiscreteValues

from forcectl.arrays import Vector
from forcectl.errors import BadInputError
from forcectl.framework.batch import BatchParameter, BatchValue, batch_values, check
from forcectl.framework.block import BlockCache, PythonBlock
from forcectl.framework.fields import Config, key
from forcectl.framework.sampled_block import Memory, SampledBatch
from forcectl.robot.model import RobotModel, has_moved


class JointImpedance(SampledBatch):
    """Joint impedance control of n joints.

    ```
    name: JointImpedance
    input_ports: [reference, motor_state, gravity_torque]
    output_ports: [torque_command]
    parameters: [stiffness, damping]
    ```

    reference: shape (2n,), q_bar and its rate [rad, rad/s]. motor_state: shape (2n,), q and its rate [rad, rad/s].
    gravity_torque: shape (n,), g(q), or any other torque that is fed forward [Nm].
    torque_command: shape (n,), tau [Nm], held over [t_k, t_k+1). Feedthrough of all inputs at the tick.

    Parameters (Context, shape (n,)): stiffness K_q [Nm/rad] >= 0, damping D_q [Nms/rad] >= 0.

    A joint whose reference is not finite is held at its last finite reference; one whose state or gravity torque is not
    finite keeps its last torque.

    Sampling: every `period` [s]; no delay from motor_state to torque_command, see `SampledBlock`.

    Args:
        initial_reference: q_bar at rest, shape (n,) or a number [rad].
        initial_torque: tau at rest [Nm].
    """

    port_units = {
        "reference": "rad,rad/s",
        "gravity_torque": "Nm",
        "torque_command": "Nm",
    }

    def __init__(
        self,
        size: int,
        *,
        stiffness: ArrayLike,
        damping: ArrayLike,
        initial_reference: ArrayLike = 0.0,
        initial_torque: ArrayLike = 0.0,
        period: float = 0.002,
    ):
        parameters = {
            "stiffness": BatchParameter(stiffness, "not negative", "Nm/rad"),
            "damping": BatchParameter(damping, "not negative", "Nms/rad"),
        }
        super().__init__(size, parameters)
        self.sample_delay = {("motor_state", "torque_command"): 0.0}
        sizes = {"reference": 2 * size, "motor_state": 2 * size, "gravity_torque": size}
        inputs = [self.DeclareVectorInputPort(name, width) for name, width in sizes.items()]
        self.declare_memory({"torque_command": initial_torque, "reference": initial_reference}, inputs, period)
        self.show("torque_command")

    def step(self, context: Context, memory: Memory, inputs: Memory) -> dict[str, BatchValue]:
        """One tick of the law."""
        m = self.math
        stiffness, damping = self.values(context)
        wanted, rate = inputs["reference"]
        q, speed = inputs["motor_state"]
        finite = abs(wanted) + abs(rate) < np.inf
        goal, rate = m.where(finite, wanted, memory["reference"]), m.where(finite, rate, 0.0)
        torque = stiffness * (goal - q) + damping * (rate - speed) + inputs["gravity_torque"]
        torque = m.where(abs(torque) < np.inf, torque, memory["torque_command"])
        return {"torque_command": torque, "reference": goal}


class GravityCompensation(PythonBlock):
    """Gravity torque of a robot with elastic joints, from the positions of its motors.

    g(q) with the link positions q = q_m - K^-1 g, where the deflection K^-1 g of the joint springs is that of the g of
    one renewal before.

    ```
    name: GravityCompensation
    input_ports: [motor_position]
    output_ports: [gravity_torque]
    ```

    motor_position: shape (n,), q_m [rad].
    gravity_torque: shape (n,), g [Nm]. State, no direct feedthrough.

    Sampling: every `period` [s] if the posture of the links has changed. A position that is not finite changes
    nothing.

    Args:
        robot: dynamics.
        start: link positions at the start, shape (n,) [rad].
        spring_stiffness: K of the joints, shape (n,) [Nm/rad], > 0.
    """

    port_units = {"gravity_torque": "Nm"}

    def __init__(self, robot: RobotModel, start: ArrayLike, spring_stiffness: ArrayLike, *, period: float = 0.002):
        super().__init__()
        n = robot.num_joints
        self._robot, self._stiffness = robot, batch_values("spring_stiffness", spring_stiffness, n, "positive")
        context = robot.create_context()
        links = batch_values("start", start, n)
        robot.set_positions(context, links)
        torque = robot.gravity_torque(context)
        self._position = self.DeclareVectorInputPort("motor_position", n)
        self._torque = self.DeclareDiscreteState(torque)
        self._taken_at = self.DeclareDiscreteState(links)
        reads: Any = {self._position.ticket(), self.discrete_state_ticket(self._torque)}
        self._posture = BlockCache(
            self,
            "posture of the links",
            lambda: AbstractValue.Make(robot.create_context()),
            lambda block, context, value: robot.set_positions(value.get_mutable_value(), block._links(context)),
            reads,
        )
        self.DeclareStateOutputPort("gravity_torque", self._torque)
        self.DeclarePeriodicDiscreteUpdateEvent(
            period_sec=check("period", period, "positive"), offset_sec=0.0, update=self._renew
        )

    def _links(self, context: Context) -> Vector:
        torque = context.get_discrete_state(self._torque).value()
        return self._position.Eval(context) - torque / self._stiffness

    def _renew(self, context: Context, next_state: DiscreteValues) -> None:
        links = self._links(context)
        if np.isfinite(links).all() and has_moved(links, context.get_discrete_state(self._taken_at).value()):
            next_state.set_value(self._torque, self._robot.gravity_torque(self._posture.Eval(context)))
            next_state.set_value(self._taken_at, links)


@dataclass(kw_only=True)
class JointImpedanceConfig(Config):
    """Scenario part `drive: !JointImpedance`: drives with a torque interface, under joint impedance control.

    An empty `stiffness` is replaced by gains in proportion to the motor inertias. D_q = 2 z sqrt(K_q I), with the
    inertia I of motor and link in the start posture.
    """

    stiffness: list[float] = key(
        [],
        "stiffness K_q of each joint; empty: `bandwidth`^2 B, with the motor inertia B",
        unit="Nm/rad",
        bounds="positive",
    )
    bandwidth: float = key(
        60.0,
        "natural frequency sqrt(K_q/B) of the motors alone, which gives the default stiffness",
        unit="rad/s",
        bounds="positive",
    )
    damping_ratio: float = key(0.7, "damping ratio z of the joints under impedance control", bounds="from 0.01 to 10")
    torque_gain: float = key(
        4.0,
        "gain k of the torque loop in the drives, which divides their friction by 1 + k; 0: no torque loop",
        bounds="not negative",
    )
    friction_bandwidth: float = key(
        100.0,
        "bandwidth of the friction observer in the drives; 0: no observer",
        unit="rad/s",
        bounds="from 0 to 10000",
    )

    def joint_stiffness(self, motor_inertia: Vector) -> Vector:
        """K_q, shape (n,) [Nm/rad].

        Args:
            motor_inertia: B, shape (n,), joint side [kg m^2].

        Raises:
            BadInputError: not as many values as joints.
        """
        if not self.stiffness:
            return self.bandwidth**2 * motor_inertia
        if len(self.stiffness) != len(motor_inertia):
            raise BadInputError(f" has {len(self.stiffness)} values: must have {len(motor_inertia)}", key="stiffness")
        return np.array(self.stiffness)

    def joint_damping(self, stiffness: Vector, inertia: Vector) -> Vector:
        """D_q, shape (n,) [Nms/rad].

        Args:
            stiffness: K_q, shape (n,) [Nm/rad].
            inertia: I of motor and link, shape (n,) [kg m^2].
        """
        return 2 * self.damping_ratio * np.sqrt(stiffness * inertia)
