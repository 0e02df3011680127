"""Wrist force/torque sensor: the wrench at the weld between flange and tool, and the compensation of the tool's weight.

    w_S(raw)  = -(reaction at the weld, on the tool)  = environment + weight of everything beyond the sensor
    w_S       = w_S(raw) - [p x R_WS' m g; R_WS' m g]

The weight is known from the mass and centre of the tool and the motor-side orientation of the sensor. A sensor that was
tared in the start posture has that posture's weight in its zero already.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.common.value import AbstractValue
from pydrake.math import RotationMatrix
from pydrake.multibody.math import SpatialForce
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import Joint
from pydrake.systems.framework import BasicVector, Context, LeafSystem, ValueProducer

from forcectl.errors import BadInputError
from forcectl.robot import RobotModel

Vector = NDArray[np.float64]


def weight_wrench(R_WS: RotationMatrix, mass: float, p_SScm: Vector, gravity: Vector) -> Vector:
    """Wrench of a weight about the origin of S, in S, [torque; force], shape (6,) [Nm, N].

    Args:
        R_WS: orientation of the sensor in the world. mass [kg]. p_SScm: its centre in S, shape (3,) [m].
        gravity: in the world, shape (3,) [m/s^2].
    """
    force = R_WS.matrix().T @ gravity * mass
    return np.concatenate([np.cross(p_SScm, force), force])


class WeldWrench(LeafSystem):
    """Wrench on the far side of a weld, from the plant's reaction forces.

    ```
    name: WeldWrench
    input_ports: [reaction_forces]
    output_ports: [wrench]
    ```

    reaction_forces: abstract, list of SpatialForce of a MultibodyPlant.
    wrench: shape (6,), [torque; force] that the environment and the weight exert on what hangs at the weld, at the
        origin of the weld's child frame, in that frame [Nm, N]. Feedthrough.

    Before its first step a discrete plant has no reaction forces; the station starts at rest, so `at_rest` stands in.
    """

    def __init__(self, plant: MultibodyPlant, weld: Joint, at_rest: ArrayLike):
        super().__init__()
        self._at_rest = np.asarray(at_rest, dtype=float)
        self._index = list(plant.GetJointIndices()).index(weld.index())
        self._reactions = self.DeclareAbstractInputPort("reaction_forces", AbstractValue.Make([SpatialForce.Zero()]))
        self.DeclareVectorOutputPort("wrench", 6, self._wrench, prerequisites_of_calc={self._reactions.ticket()})

    def _wrench(self, context: Context, output: BasicVector) -> None:
        reaction = self._reactions.Eval(context)[self._index].get_coeffs()
        output.SetFromVector(-reaction if reaction.any() else self._at_rest)


class ToolCompensation(LeafSystem):
    """Takes the weight of the tool out of the measured wrench and projects it on n.

    ```
    name: ToolCompensation
    input_ports: [wrench, motor_position]
    output_ports: [measured_wrench, measured_force]
    ```

    wrench: shape (6,), sensor reading at S in S, [torque; force] [Nm, N].
    motor_position: shape (n_q,), for the orientation of S [rad].
    measured_wrench: shape (6,), of the environment on the tool at S in S [Nm, N]. Feedthrough.
    measured_force: shape (1,), its force along n [N]. Feedthrough.

    Args:
        tared_posture: q_0 [rad] in which the sensor was made zero, or None when it was not.
    """

    def __init__(self, robot: RobotModel, n: ArrayLike, tared_posture: Vector | None):
        super().__init__()
        if robot.parts.sensor_frame is None:
            raise BadInputError("tool: has no wrist sensor (its facts name no sensor_frame)")
        self._robot, self._n = robot, np.asarray(n, dtype=float)
        self._frame = robot.parts.sensor_frame
        self._mass, self._p_SScm, self._gravity = tool_load(robot)
        self._tared = np.zeros(6)
        if tared_posture is not None:
            context = robot.create_context()
            robot.set_positions(context, tared_posture)
            self._tared = self._weight(self._frame.CalcPoseInWorld(context).rotation())
        self._wrench = self.DeclareVectorInputPort("wrench", 6)
        self._position = self.DeclareVectorInputPort("motor_position", robot.num_joints)
        scratch = (robot.create_context(), RotationMatrix(), np.zeros(6))
        self._pose = self.DeclareCacheEntry(
            "orientation and weight",
            ValueProducer(allocate=lambda: AbstractValue.Make(scratch), calc=self._calc_pose),
            prerequisites_of_calc={self._position.ticket()},
        )
        reads: Any = {self._wrench.ticket(), self._pose.ticket()}
        self.DeclareVectorOutputPort("measured_wrench", 6, self._measured_wrench, prerequisites_of_calc=reads)
        self.DeclareVectorOutputPort("measured_force", 1, self._measured_force, prerequisites_of_calc=reads)

    def _weight(self, R_WS: RotationMatrix) -> Vector:
        return weight_wrench(R_WS, self._mass, self._p_SScm, self._gravity)

    def _calc_pose(self, context: Context, value: AbstractValue) -> None:
        plant_context = value.get_value()[0]
        self._robot.set_positions(plant_context, self._position.Eval(context))
        R_WS = self._frame.CalcPoseInWorld(plant_context).rotation()
        value.set_value((plant_context, R_WS, self._weight(R_WS) - self._tared))

    def _compensated(self, context: Context) -> tuple[RotationMatrix, Vector]:
        _, R_WS, weight = self._pose.Eval(context)
        return R_WS, self._wrench.Eval(context) - weight

    def _measured_wrench(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(self._compensated(context)[1])

    def _measured_force(self, context: Context, output: BasicVector) -> None:
        R_WS, wrench = self._compensated(context)
        output.SetAtIndex(0, float(self._n @ (R_WS.matrix() @ wrench[3:])))


def tool_load(robot: RobotModel) -> tuple[float, Vector, Vector]:
    """Mass [kg] and centre in S [m] of the body at the wrist sensor's weld, and gravity in the world [m/s^2].

    Raises:
        BadInputError: the tool has no wrist sensor.
    """
    parts, plant = robot.parts, robot.plant
    if parts.sensor_weld is None or parts.sensor_frame is None:
        raise BadInputError("tool: has no wrist sensor (its facts name no sensor_weld)")
    context = robot.create_context()
    tool = parts.sensor_weld.child_body()
    p_WTcm = plant.EvalBodyPoseInWorld(context, tool).multiply(tool.CalcCenterOfMassInBodyFrame(context))
    p_SScm = parts.sensor_frame.CalcPoseInWorld(context).inverse().multiply(p_WTcm)
    return tool.get_mass(context), p_SScm, plant.gravity_field().gravity_vector()
