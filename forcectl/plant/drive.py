"""The drives of a robot with elastic joints: motor inertia, cascaded servo, friction, spring torque.

    B phi'' = B w_v [(v_r - phi') + w_i int(v_r - phi')] - S^-T tau_spring - b phi' - c sign(phi'),   v_r = K_v (r - phi) + r'

phi = S q_m are the motor angles divided by the gear ratios: S is the identity but for the couplings between motors, and
B = diag(J_m N^2) is the inertia of the rotors at the joints. The friction sticks exactly; see `forcectl.plant.servo`.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.systems.framework import Context, Diagram, DiagramBuilder, DiscreteValues
from pydrake.systems.primitives import MatrixGain

from forcectl.lanes import Lane, LaneBlock, Parameter, check
from forcectl.plant.servo import ServoGains, servo_gains, servo_steps
from forcectl.robot import RobotModel

Matrix = NDArray[np.float64]


class DriveCore(LaneBlock):
    """Servo and motor inertia of n axes in motor coordinates phi.

    ```
    name: DriveCore
    input_ports: [reference, spring_torque]
    output_ports: [state]
    parameters: [position_gain, velocity_gain, integral_gain, coulomb_friction, viscous_friction]
    ```

    reference: shape (2n,), joint reference and its rate [rad, rad/s].
    spring_torque: shape (n,), torque of the joint springs on the links [Nm]; the motors feel the opposite.
    state: shape (3n,), phi, phi' and the integral of the speed error [rad, rad/s, rad]. State, no direct feedthrough.

    Parameters (Context, shape (n,)): gains K_v, w_v, w_i [1/s]; coulomb_friction [Nm] and viscous_friction [Nms/rad] at
    the joint.

    Sampling: `period` [s], divided into `substeps` inner steps; the spring torque is held over the period.
    """

    def __init__(
        self,
        inertia: ArrayLike,
        joint_to_motor: Matrix,
        *,
        period: float,
        substeps: int,
        position_gain: ArrayLike,
        velocity_gain: ArrayLike,
        integral_gain: ArrayLike,
        coulomb_friction: ArrayLike,
        viscous_friction: ArrayLike,
        initial_position: Matrix,
        initial_torque: Matrix,
    ):
        self._inertia = np.asarray(inertia, dtype=float)
        n = len(self._inertia)
        self._substeps = substeps
        self._step = check("period", period, "positive") / substeps
        super().__init__(
            n,
            {
                "position_gain": Parameter(position_gain, "positive", "1/s"),
                "velocity_gain": Parameter(velocity_gain, "positive", "1/s"),
                "integral_gain": Parameter(integral_gain, "positive", "1/s"),
                "coulomb_friction": Parameter(coulomb_friction, "not negative", "Nm"),
                "viscous_friction": Parameter(viscous_friction, "not negative", "Nms/rad"),
            },
        )
        self.port_units = {"reference": "rad,rad/s", "state": "rad,rad/s,rad"}
        self._reference = self.DeclareVectorInputPort("reference", 2 * n)
        self._torque = self.DeclareVectorInputPort("spring_torque", n)
        self._to_motor = joint_to_motor
        self._push = -(self._step / self._inertia)[:, None] * np.linalg.inv(joint_to_motor).T
        # At rest the integral of the servo carries the springs' torque.
        w_v, w_i = np.broadcast_to(velocity_gain, n), np.broadcast_to(integral_gain, n)
        integral = np.linalg.inv(joint_to_motor).T @ initial_torque / (self._inertia * w_v * w_i)
        start = np.concatenate([joint_to_motor @ initial_position, np.zeros(n), integral])
        self._state = self.DeclareDiscreteState(start)
        self.DeclareStateOutputPort("state", self._state)
        self.DeclarePeriodicDiscreteUpdateEvent(period_sec=period, offset_sec=0.0, update=self._update)

    def derive(self, values: tuple[Lane, ...]) -> ServoGains:
        """Coefficients of one inner step."""
        position, velocity, integral, coulomb, viscous = values
        return servo_gains(
            position, velocity, integral, coulomb / self._inertia, viscous / self._inertia, self._step
        )

    def _update(self, context: Context, next_state: DiscreteValues) -> None:
        r, rate = self._reference.Eval(context).reshape(2, -1) @ self._to_motor.T
        push = self._push @ self._torque.Eval(context)
        x, v, i = self.lanes(context.get_discrete_state(self._state).value())
        gains = self._values.Eval(context)
        next_state.set_value(self.stack(*servo_steps(x, v, i, r, rate, push, gains, self._substeps, self.math)))


class Drive(Diagram):
    """`DriveCore` with its outputs on the joint side.

    ```
    name: Drive
    input_ports: [reference, spring_torque]
    output_ports: [motor_state, motor_position, motor_velocity]
    ```

    motor_state: shape (2n,), q_m and its rate [rad, rad/s]: the desired state of the joint springs.
    motor_position, motor_velocity: its halves.
    """

    def __init__(self, core: DriveCore, joint_to_motor: Matrix):
        super().__init__()
        self.port_units = {"reference": "rad,rad/s"}
        back, zero = np.linalg.inv(joint_to_motor), np.zeros((core.size, core.size))
        builder = DiagramBuilder()
        builder.AddNamedSystem("core", core)
        builder.ExportInput(core.GetInputPort("reference"), "reference")
        builder.ExportInput(core.GetInputPort("spring_torque"), "spring_torque")
        for name, rows in (
            ("motor_state", [[back, zero, zero], [zero, back, zero]]),
            ("motor_position", [[back, zero, zero]]),
            ("motor_velocity", [[zero, back, zero]]),
        ):
            gain = builder.AddNamedSystem(name, MatrixGain(np.block(rows)))
            builder.Connect(core.GetOutputPort("state"), gain.get_input_port())
            builder.ExportOutput(gain.get_output_port(), name)
        builder.BuildInto(self)


def joint_to_motor(robot: RobotModel) -> Matrix:
    """S: motor angles over gear ratios per joint angles, shape (n, n) [1]."""
    matrix: Matrix = robot.motor_from_joint / robot.facts.gear_ratio[:, None]
    return matrix
