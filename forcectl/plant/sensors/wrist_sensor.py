"""Wrist force/torque sensor: the wrench at the weld between flange and tool, digitised, minus the weight of the tool::

    w_S,load   = -(reaction at the weld, on the tool)  = environment + weight of everything beyond the sensor
    w_S        = digitised w_S,load - [p x R_WS' m g; R_WS' m g]

The weight is computed from the mass and centre of mass of the tool and the motor-side orientation of the sensor. A
sensor that was tared in the start posture already has that posture's weight in its zero.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypedDict

import numpy as np
from numpy.typing import ArrayLike
from pydrake.common.value import AbstractValue
from pydrake.multibody.math import SpatialForce
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import Frame, Joint
from pydrake.systems.framework import BasicVector, Context, DiscreteValues

from forcectl.arrays import Vector
from forcectl.errors import BadInputError
from forcectl.framework.batch import batch_values, check
from forcectl.framework.kernels import cross_matrix
from forcectl.plant.sensors.force_sensor import SensorElectronics
from forcectl.robot.model import RobotModel, has_moved, posture_cache, unit_normal


class Electronics(TypedDict):
    """Arguments of `SensorElectronics` for the six channels [torque; force], in [Nm, N]."""

    bias: ArrayLike
    drift: ArrayLike
    noise_std: ArrayLike
    quantum: ArrayLike
    range: ArrayLike
    tare: bool
    seed: int
    period: float


def weight_matrix(mass: float, p_SScm: Vector) -> Vector:
    """Wrench about the origin of S of a mass per acceleration of gravity, both in S, shape (6, 3) [kg m; kg].

    Args:
        mass: [kg].
        p_SScm: its centre of mass in S, shape (3,) [m].
    """
    return mass * np.vstack([cross_matrix(p_SScm), np.eye(3)])


class WristSensor(SensorElectronics):
    """Six-axis wrist sensor between flange and tool of a multibody plant, without its filter.

    ```
    name: WristSensor
    input_ports: [reaction_forces, motor_position]
    output_ports: [readings]
    parameters: [bias, noise_std, quantum, range, drift]
    ```

    reaction_forces: abstract, list of SpatialForce of the plant.
    motor_position: shape (n_q,), for the orientation of the sensor [rad].
    readings: shape (8,): the measured wrench of the environment on the tool at S in S, [torque; force] [Nm, N]; its
    force along n [N]; the true contact force [N], from the reaction in the mounting of the environment. Feedthrough of
    reaction_forces.

    All is in one output, because reading the reactions of a plant costs more than all the rest.

    Parameters (Context, shape (6,)), taring and noise: see `SensorElectronics`.

    Sampling: every `posture_period` [s] the orientation of the sensor, if the posture has changed; the noise is a
    function of (seed, channel, tick of `period`).

    Args:
        plant: whose reactions are read.
        mounting: weld of the environment, which is massless; its surface normal is +z.
        robot: kinematics and tool.
        n: unit normal in W, shape (3,).
        start: q_0, shape (n_q,) [rad].
        cross_talk: matrix from the true wrench to the channels, shape (6, 6), the identity or None without cross-talk,
            see `random_cross_talk`.
        electronics: bias, drift, noise_std, quantum, range, tare, seed and period of `SensorElectronics`; with `tare`
            the sensor was zeroed in the start posture, weight of the tool included.
    """

    REFRESHED = "posture"  # what its events renew, for block diagrams; the readings are not delayed by them

    def __init__(
        self,
        plant: MultibodyPlant,
        sensor_weld: Joint,
        mounting: Joint,
        robot: RobotModel,
        n: ArrayLike,
        start: Vector,
        *,
        posture_period: float = 0.01,
        cross_talk: Vector | None = None,
        electronics: Electronics,
    ):
        joints = list(plant.GetJointIndices())
        self._rows = joints.index(sensor_weld.index()), joints.index(mounting.index())
        self._load, self._gravity = tool_load(robot)
        self._robot, self._n = robot, unit_normal(n)
        self._start = batch_values("start", start, robot.num_joints)
        self._posture_period = check("posture_period", posture_period, "positive")
        self._zeroed = electronics["tare"]
        self._cross_talk = cross_talk
        super().__init__(6, unit="Nm,N", **electronics)

    def declare_ports(self, unit: str) -> None:
        """Inputs, output and the state of the sensor's orientation."""
        self.port_units = {"readings": "Nm,N"}
        self._reactions = self.DeclareAbstractInputPort("reaction_forces", AbstractValue.Make([SpatialForce.Zero()]))
        self._position = self.DeclareVectorInputPort("motor_position", self._robot.num_joints)
        self._posture = posture_cache(self, self._robot, self._position)
        context = self._robot.context_at(self._start)
        self._in_zero = np.zeros(6)
        orientation = self._orient(context)
        if self._zeroed:
            self._in_zero = orientation[3:].copy()
            orientation[3:] = 0.0
        # State: n in S, and the weight that is not in the sensor's zero; and the posture of the last renewal.
        self._orientation = self.DeclareDiscreteState(orientation)
        self._taken_at = self.DeclareDiscreteState(self._start)
        reads = self.reads | {self._reactions.ticket(), self.discrete_state_ticket(self._orientation)}
        self.DeclareVectorOutputPort("readings", 8, self._readings, prerequisites_of_calc=reads)
        self.DeclarePeriodicDiscreteUpdateEvent(
            period_sec=self._posture_period, offset_sec=0.0, update=self._renew_orientation
        )

    def _orient(self, plant_context: Context) -> Vector:
        R_SW = sensor_frame(self._robot).CalcPoseInWorld(plant_context).rotation().matrix().T
        return np.concatenate([R_SW @ self._n, self._load @ (R_SW @ self._gravity) - self._in_zero])

    def _renew_orientation(self, context: Context, next_state: DiscreteValues) -> None:
        q = self._position.Eval(context)
        if has_moved(q, context.get_discrete_state(self._taken_at).value()):
            next_state.set_value(self._orientation, self._orient(self._posture.Eval(context)))
            next_state.set_value(self._taken_at, q)

    def true_load(self, context: Context) -> Vector:
        """Load of the weld, from environment and weight of everything beyond the sensor, at S in S; with cross-talk."""
        return self._weld_load(self._reactions.Eval(context))

    def _weld_load(self, reactions: Sequence[SpatialForce]) -> Vector:
        carried: Vector = -reactions[self._rows[0]].get_coeffs()
        return carried if self._cross_talk is None else self._cross_talk @ carried

    def _readings(self, context: Context, output: BasicVector) -> None:
        reactions = self._reactions.Eval(context)
        orientation = context.get_discrete_state(self._orientation).value()
        readings = np.empty(8)
        readings[:6] = self.read(context, self._weld_load(reactions))
        readings[:6] -= orientation[3:]
        readings[6] = orientation[:3] @ readings[3:6]
        readings[7] = reactions[self._rows[1]].translational()[2]
        output.SetFromVector(readings)


def random_cross_talk(largest: float, scale: Vector, seed: int) -> Vector:
    """Random cross-talk matrix of the channels of a sensor, shape (n, n), the same for the same seed.

    Args:
        largest: largest reading of a channel, relative to its range, when another one is at the end of its range [1].
        scale: ranges of the channels relative to each other, shape (n,).
        seed: of the relative readings, which are uniform in +-largest.
    """
    n = len(scale)
    shares = np.random.default_rng((seed, n)).uniform(-largest, largest, (n, n)) * np.outer(scale, 1 / scale)
    np.fill_diagonal(shares, 1.0)
    return shares


def sensor_frame(robot: RobotModel) -> Frame:
    """The frame S of the robot's wrist sensor.

    Raises:
        BadInputError: the tool has no wrist sensor.
    """
    if robot.arm.sensor_frame is None or robot.arm.sensor_weld is None:
        raise BadInputError(
            "has no wrist sensor: its parameters must name a sensor_frame and a sensor_weld", key="tool"
        )
    return robot.arm.sensor_frame


def tool_load(robot: RobotModel) -> tuple[Vector, Vector]:
    """`weight_matrix` of the tool at the wrist sensor, and gravity in the world [m/s^2].

    Raises:
        BadInputError: the tool has no wrist sensor.
    """
    frame, plant = sensor_frame(robot), robot.plant
    context = robot.create_context()
    tool = robot.arm.sensor_weld.child_body()  # type: ignore[union-attr]
    p_WTcm = plant.EvalBodyPoseInWorld(context, tool).multiply(tool.CalcCenterOfMassInBodyFrame(context))
    p_SScm = frame.CalcPoseInWorld(context).inverse().multiply(p_WTcm)
    return weight_matrix(tool.get_mass(context), p_SScm), plant.gravity_field().gravity_vector()
