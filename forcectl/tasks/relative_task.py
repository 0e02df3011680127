"""Leader and follower: the motion of one frame relative to another that moves as well::

    p = R_L' d,    R = R_L' R_F,    d = p_F - p_L
    V = [R_L' (w_F - w_L); R_L' (d' - w_L x d)] = J q'
    J'q' = [R_L' (a_F - a_L - w_L x w_F); R_L' (d'' - a_L x d - 2 w_L x d' + w_L x (w_L x d))]

with the angular velocities w, angular accelerations a and the derivatives of d in the world; in J'q' all are taken
without joint accelerations. Results are in the axes of the leader L, as p and R are. V is the velocity of p and R in
these axes, so that V' = J u + J'q' is its derivative.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import Any

import numpy as np
from pydrake.multibody.tree import Frame
from pydrake.systems.framework import Context

from forcectl.arrays import Array
from forcectl.errors import BadInputError, invalid
from forcectl.estimation.wrench_between import moved_wrench, opposite_mean
from forcectl.framework.block import scratch
from forcectl.framework.euler_angles import angles_of
from forcectl.framework.kernels import cross, cross_matrix
from forcectl.framework.sampled_block import Memory, SampledBlock
from forcectl.robot.arms_motion import ArmsMotion
from forcectl.robot.model import RobotModel
from forcectl.robot.robot_motion import TipPose
from forcectl.tasks.coordinates import COORDINATES, ArmTask, Orientation
from forcectl.tasks.task_frame import Spatial, TaskFrame


class RelativeMotion:
    """The motion of a follower's frame in a leader's, in the axes of the leader; see the module's documentation.

    Args:
        leader, follower: motions of the two frames in the world, with Jacobians for the same joints.

    Attributes:
        position, rotation: p and R, (3,) [m] and (3, 3).
        velocity: V, (6,) [rad/s; m/s].
    """

    def __init__(self, leader: Spatial, follower: Spatial):
        self._leader, self._follower = leader, follower
        turn = leader.rotation.T
        d = follower.position - leader.position
        self.position: Array = turn @ d
        self.rotation: Array = turn @ follower.rotation
        # V = F V_F - L V_L, with the spatial velocities in the world.
        self._of_follower, self._of_leader = np.zeros((6, 6)), np.zeros((6, 6))
        for map_ in (self._of_follower, self._of_leader):
            map_[:3, :3] = map_[3:, 3:] = turn
        self._of_leader[3:, :3] = -turn @ cross_matrix(d)
        self._offset = d
        self.velocity: Array = self._of_follower @ follower.velocity - self._of_leader @ leader.velocity

    @cached_property
    def jacobian(self) -> Array:
        """J, (6, n) [1; m]."""
        return self._of_follower @ self._follower.jacobian - self._of_leader @ self._leader.jacobian

    @cached_property
    def bias(self) -> Array:
        """J'q', (6,) [rad/s^2; m/s^2]."""
        leader, follower = self._leader, self._follower
        w, rate = leader.velocity[:3], follower.velocity[3:] - leader.velocity[3:]
        turning = cross(w, follower.velocity[:3])
        moving = cross(w, 2.0 * rate - cross(w, self._offset))
        # The derivatives of the maps.
        plain: Array = self._of_follower @ follower.bias - self._of_leader @ leader.bias
        plain[:3] -= leader.rotation.T @ turning
        plain[3:] -= leader.rotation.T @ moving
        return plain


class RelativeTask(ArmTask):
    """Task coordinates of a frame of one arm in a frame of another, the leader, see `ArmTask`.

    Args:
        leader, follower: names of two arms.
        coordinates, orientation, priority: see `ArmTask`.
        follower_frame: frame with these coordinates, given in the follower's TCP frame; None: that frame itself.
        leader_frame: frame in which they are expressed, given in the leader's TCP frame; None: that frame itself.

    Raises:
        BadInputError: see `ArmTask`; or leader and follower are the same arm.
    """

    def __init__(
        self,
        leader: str,
        follower: str,
        coordinates: Sequence[str] = COORDINATES,
        orientation: Orientation | None = None,
        priority: int = 1,
        *,
        follower_frame: TaskFrame | None = None,
        leader_frame: TaskFrame | None = None,
    ):
        if leader == follower:
            raise invalid("follower", follower, "another arm than the leader")
        super().__init__(follower, coordinates, orientation, priority, follower_frame)
        self.leader, self.leader_frame = leader, leader_frame

    def tool(self, motion: ArmsMotion) -> RelativeMotion:
        """The motion of the follower's frame in the leader's."""
        leader: Spatial = motion.arm(self.leader)
        if self.leader_frame is not None:
            leader = self.leader_frame.motion(leader)
        return RelativeMotion(leader, super().tool(motion))

    def external_wrench(
        self, tips: Mapping[str, TipPose], wrenches: Mapping[str, Array], *, of_both: bool = True
    ) -> tuple[Array, Array]:
        """The wrench on the follower, in the axes of the leader's frame, see `ArmTask`."""
        rotation, wrench = super().external_wrench(tips, wrenches)
        tip = tips[self.leader]
        back = (tip if self.leader_frame is None else self.leader_frame.pose(tip)).rotation.T
        if of_both:
            follower = tips[self.arm]
            offset = follower.position - tip.position
            if self.frame is not None:
                offset = offset + follower.rotation @ self.frame.position
            wrench = opposite_mean(moved_wrench(wrenches[self.leader], offset), wrench)
        return back @ rotation, np.concatenate([back @ wrench[:3], back @ wrench[3:]])


class RelativePose(SampledBlock):
    """Pose and velocity of one frame of a robot relative to another that moves as well, for logs and state machines.

    ```
    name: RelativePose
    input_ports: [joint_position, joint_velocity]
    output_ports: [relative_position, relative_angles, relative_velocity]
    ```

    joint_position: shape (n,) [rad]. joint_velocity: shape (n,) [rad/s].
    relative_position: shape (3,), p of the follower's origin in the leader's axes [m].
    relative_angles: shape (3,), Euler angles phi, theta, psi of R [rad], see
    `forcectl.framework.euler_angles.angles_of`; continuous but for the singularity.
    relative_velocity: shape (6,), V in the leader's axes, [rotation; translation] [rad/s, m/s].
    All outputs are feedthrough of all inputs at the tick, and held.

    With inputs that are not finite the outputs keep the values of the last tick.

    Sampling: every `period` [s]; no delay, see `SampledBlock`.

    Args:
        robot: the inputs are its joint state.
        leader, follower: frames of its plant.

    Raises:
        BadInputError: a frame of another plant.
    """

    port_units = {"relative_position": "m", "relative_angles": "rad", "relative_velocity": "rad/s,m/s"}

    def __init__(self, robot: RobotModel, leader: Frame, follower: Frame, *, period: float = 0.004):
        super().__init__()
        for frame in (leader, follower):
            if frame.GetParentPlant() is not robot.plant:
                raise BadInputError(f"frame {frame.name()!r}: must be of the plant of the robot")
        self._robot, self._leader, self._follower = robot, leader, follower
        self._scratch = scratch(self, "plant context", robot.create_context)
        names = ("joint_position", "joint_velocity")
        inputs = [self.DeclareVectorInputPort(name, robot.num_joints) for name in names]
        memory = {"relative_position": np.zeros(3), "relative_angles": np.zeros(3), "relative_velocity": np.zeros(6)}
        self.declare_memory(memory, inputs, period)
        self.show(*memory)

    def step(self, context: Context, memory: Memory, inputs: Memory) -> dict[str, Any]:
        """The pose and velocity of a tick."""
        q, v = inputs["joint_position"], inputs["joint_velocity"]
        if not (np.isfinite(q).all() and np.isfinite(v).all()):
            return dict(memory)
        plant_context = self._scratch.Eval(context)
        self._robot.set_positions(plant_context, q)
        self._robot.set_velocities(plant_context, v)
        pose = self._follower.CalcPose(plant_context, self._leader)
        velocity = self._follower.CalcSpatialVelocity(plant_context, self._leader, self._leader)
        return {
            "relative_position": pose.translation(),
            "relative_angles": angles_of(pose.rotation().matrix(), memory["relative_angles"]),
            "relative_velocity": velocity.get_coeffs(),
        }
