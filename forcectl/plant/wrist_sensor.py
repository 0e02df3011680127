"""Wrist force/torque sensor: the wrench at the weld between flange and tool, and the compensation of the tool's weight.

    w_S(raw)  = -(reaction at the weld, on the tool)  = environment + weight of everything beyond the sensor
    w_S       = w_S(raw) - [p x R_WS' m g; R_WS' m g]

The weight is known from the mass and centre of the tool and the motor-side orientation of the sensor. A sensor that was
tared in the start posture has that posture's weight in its zero already.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.common.value import AbstractValue
from pydrake.multibody.math import SpatialForce
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import Frame, Joint
from pydrake.systems.framework import BasicVector, Context, DiscreteValues, LeafSystem

from forcectl.errors import BadInputError
from forcectl.lanes import check, lane_values
from forcectl.robot import RobotModel, has_moved, posture_cache, unit_normal

Vector = NDArray[np.float64]


def weight_matrix(mass: float, p_SScm: Vector) -> Vector:
    """Wrench about the origin of S of a mass per acceleration of gravity, both in S, shape (6, 3) [kg m; kg].

    Args:
        mass [kg]. p_SScm: its centre in S, shape (3,) [m].
    """
    x, y, z = p_SScm
    return mass * np.vstack([[[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]], np.eye(3)])


class WeldWrenches(LeafSystem):
    """Wrenches on the far side of k welds, from the plant's reaction forces.

    ```
    name: WeldWrenches
    input_ports: [reaction_forces]
    output_ports: [wrenches]
    ```

    reaction_forces: abstract, list of SpatialForce of a MultibodyPlant.
    wrenches: shape (6k,), for each weld [torque; force] that the environment and the weight exert on what hangs at it,
        at the origin of the weld's child frame, in that frame [Nm, N]. Feedthrough.
    """

    def __init__(self, plant: MultibodyPlant, welds: Sequence[Joint]):
        super().__init__()
        joints = list(plant.GetJointIndices())
        self._rows = [joints.index(weld.index()) for weld in welds]
        self.port_units = {"wrenches": "Nm,N"}
        self._reactions = self.DeclareAbstractInputPort("reaction_forces", AbstractValue.Make([SpatialForce.Zero()]))
        self.DeclareVectorOutputPort(
            "wrenches", 6 * len(self._rows), self._wrenches, prerequisites_of_calc={self._reactions.ticket()}
        )

    def _wrenches(self, context: Context, output: BasicVector) -> None:
        reactions = self._reactions.Eval(context)
        output.SetFromVector(-np.concatenate([reactions[row].get_coeffs() for row in self._rows]))


class ToolCompensation(LeafSystem):
    """Takes the weight of the tool out of the measured wrench and projects it on n.

    ```
    name: ToolCompensation
    input_ports: [wrench, motor_position]
    output_ports: [measured_wrench, measured_force]
    ```

    wrench: shape (6,), sensor reading at S in S, [torque; force] [Nm, N].
    motor_position: shape (n_q,), for the orientation of S [rad].
    measured_wrench: shape (6,), of the environment on the tool at S in S [Nm, N]. Feedthrough of wrench.
    measured_force: shape (1,), its force along n [N]. Feedthrough of wrench.

    Sampling: the orientation of the sensor is state, renewed every `period` [s] if the posture has changed.

    Args:
        start: q_0 [rad]. tared: the sensor was made zero in that posture, weight of the tool included.
    """

    def __init__(self, robot: RobotModel, n: ArrayLike, start: Vector, *, tared: bool, period: float = 0.01):
        super().__init__()
        self._load, self._gravity = tool_load(robot)
        self._robot, self._n = robot, unit_normal(n)
        self._wrench = self.DeclareVectorInputPort("wrench", 6)
        self._position = self.DeclareVectorInputPort("motor_position", robot.num_joints)
        self._posture = posture_cache(self, robot, self._position)
        context = robot.create_context()
        start = lane_values("start", start, robot.num_joints)
        robot.set_positions(context, start)
        self._tared = np.zeros(6)
        n_S, weight = self._orient(context)
        if tared:
            self._tared, weight = weight, np.zeros(6)
        # n in S, and the weight that is not in the sensor's zero.
        self._state = self.DeclareDiscreteState(np.concatenate([n_S, weight]))
        self._taken_at = self.DeclareDiscreteState(start)
        reads: Any = {self._wrench.ticket(), self.discrete_state_ticket(self._state)}
        self.DeclareVectorOutputPort("measured_wrench", 6, self._measured_wrench, prerequisites_of_calc=reads)
        self.DeclareVectorOutputPort("measured_force", 1, self._measured_force, prerequisites_of_calc=reads)
        self.DeclarePeriodicDiscreteUpdateEvent(
            period_sec=check("period", period, "positive"), offset_sec=0.0, update=self._renew
        )

    def _orient(self, plant_context: Context) -> tuple[Vector, Vector]:
        R_SW = sensor_frame(self._robot).CalcPoseInWorld(plant_context).rotation().matrix().T
        return R_SW @ self._n, self._load @ (R_SW @ self._gravity) - self._tared

    def _renew(self, context: Context, next_state: DiscreteValues) -> None:
        q = self._position.Eval(context)
        if has_moved(q, context.get_discrete_state(self._taken_at).value()):
            next_state.set_value(self._state, np.concatenate(self._orient(self._posture.Eval(context))))
            next_state.set_value(self._taken_at, q)

    def _measured_wrench(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(self._wrench.Eval(context) - context.get_discrete_state(self._state).value()[3:])

    def _measured_force(self, context: Context, output: BasicVector) -> None:
        state = context.get_discrete_state(self._state).value()
        output.SetAtIndex(0, (state[:3] @ (self._wrench.Eval(context)[3:] - state[6:])).item())


def sensor_frame(robot: RobotModel) -> Frame:
    """The frame S of the robot's wrist sensor.

    Raises:
        BadInputError: the tool has no wrist sensor.
    """
    if robot.parts.sensor_frame is None or robot.parts.sensor_weld is None:
        raise BadInputError("tool: has no wrist sensor: its facts must name a sensor_frame and a sensor_weld")
    return robot.parts.sensor_frame


def tool_load(robot: RobotModel) -> tuple[Vector, Vector]:
    """`weight_matrix` of what hangs at the wrist sensor, and gravity in the world [m/s^2].

    Raises:
        BadInputError: the tool has no wrist sensor.
    """
    frame, plant = sensor_frame(robot), robot.plant
    context = robot.create_context()
    tool = robot.parts.sensor_weld.child_body()  # type: ignore[union-attr]
    p_WTcm = plant.EvalBodyPoseInWorld(context, tool).multiply(tool.CalcCenterOfMassInBodyFrame(context))
    p_SScm = frame.CalcPoseInWorld(context).inverse().multiply(p_WTcm)
    return weight_matrix(tool.get_mass(context), p_SScm), plant.gravity_field().gravity_vector()
