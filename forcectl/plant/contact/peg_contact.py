"""Contact of a tapered peg in a bore with a lead-in chamfer, without meshes: Kelvin-Voigt springs on four rings.

Both parts are turned. In the half plane of radius r and height z through an axis, the wall of the bore and the peg are
convex, each the set where a few planes have a depth of at least zero, and the depth of a point is the least of them.
They touch at an edge of one on a face of the other: the edges of the peg's tip and of its shoulder on the bore, the
edge of the bore and that of its mouth on the peg. An edge is a ring of points. Along the normals the forces on it are

    f_i = max(0, K d_i - D v_i) d_i/sum(d)        d depth, v speed of separation

so that its stiffness K does not depend on the number of points, and Coulomb's along the face, smooth below 1 mm/s.

A force that a discrete plant holds over a step h makes stiff contact unstable. So d and v are those that the peg will
have at the end of the step, when it has the velocity V+ relative to the bore. That follows from the mobility W of what
holds the two parts (its inverse is the inertia that is felt between them) and from the acceleration G by all but the
contact, which was felt over the last step:

    V+ - V = h W F(V+) + h G,    G = G- + ((V - V-)/h - W F- - G-)/2

with F linear in V+ (stiffness, damping and friction of the points that touch now). At rest the force is K d whatever W
is; W decides over stability only, and is taken with a margin.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, NamedTuple
from weakref import ref

import numpy as np
from numpy.typing import NDArray
from pydrake.common.value import AbstractValue
from pydrake.math import RigidTransform
from pydrake.multibody.math import SpatialForce, SpatialVelocity
from pydrake.multibody.plant import ExternallyAppliedSpatialForce, MultibodyPlant
from pydrake.multibody.tree import Frame, JacobianWrtVariable
from pydrake.systems.framework import BasicVector, Context, DiscreteValues, LeafSystem

from forcectl.errors import invalid
from forcectl.framework.batch import check
from forcectl.framework.cache import BlockCache
from forcectl.framework.fields import Config, key

Array = NDArray[np.float64]
SLIP = 1e-3  # [m/s] below which friction is less than Coulomb's
_TRUST = 0.5  # share of what was felt over the last step in what is taken for the next; 1 makes stiff contacts ring
_MARGIN = 2.0  # on the mobility: parts that move more easily than it says ring, those that move less easily only lag
_COUNT = 24  # points of a ring
_ANGLES = 2 * np.pi * (np.arange(_COUNT) + 0.5) / _COUNT


@dataclass(kw_only=True)
class PegInBoreConfig(Config):
    """Sizes and coefficients of a peg and a bore; the defaults are those of `models/parts`."""

    bore_radius: float = key(12.85e-3, "of the bore", unit="m", bounds="positive")
    chamfer: float = key(4e-3, "of the mouth, radially and along the axis", unit="m", bounds="positive")
    depth: float = key(96e-3, "from the mouth to the floor", unit="m", bounds="positive")
    clearance: float = key(0.5e-3, "in radius", unit="m", bounds="not negative")
    taper_length: float = key(8e-3, "of the peg's tip", unit="m", bounds="positive")
    taper_radius: float = key(5e-3, "by which the peg's tip is narrower", unit="m", bounds="positive")
    stiffness: float = key(2e5, "K of a ring", unit="N/m", bounds="positive")
    damping: float = key(40.0, "D of a ring", unit="N s/m", bounds="not negative")
    friction: float = key(0.15, "Coulomb's", bounds="not negative")

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.clearance + self.taper_radius < self.bore_radius:
            raise invalid("taper_radius", self.taper_radius, f"below {self.bore_radius - self.clearance:g}, the peg's")


def _cross_matrix(a: Array) -> Array:
    """The matrix of the product a x ..., several times as fast as `np.cross`."""
    x, y, z = a.tolist()
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def _ring(radius: float, z: float) -> Array:
    return np.column_stack([radius * np.cos(_ANGLES), radius * np.sin(_ANGLES), np.full(_COUNT, z)])


class PegProfile:
    """Rings of points and planes (a, b, c) of depth a r + b z + c of a peg and a bore.

    Args:
        config: sizes.
    """

    def __init__(self, config: PegInBoreConfig):
        R, c = config.bore_radius, config.chamfer
        peg, tip = R - config.clearance, R - config.clearance - config.taper_radius
        slope = config.taper_radius / config.taper_length
        steep, half = math.hypot(1.0, slope), math.sqrt(0.5)
        self.wall = np.array([[1.0, 0.0, -R], [half, -half, -half * (R + c)], [0.0, -1.0, 0.0]])
        self.peg = np.array([[-1.0, 0.0, peg], [-1 / steep, slope / steep, tip / steep], [0.0, 1.0, 0.0]])
        self.floor = -config.depth
        self.on_peg = np.vstack([_ring(tip, 0.0), _ring(peg, config.taper_length)])
        self.on_bore = np.vstack([_ring(R, -c), _ring(R + c, 0.0)])


def _depths(points: Array, planes: Array) -> tuple[Array, Array]:
    """Depth of each point in a turned part, shape (p,), and the outward normal there, (p, 3), in the part's frame."""
    radius = np.hypot(points[:, 0], points[:, 1])
    each = planes[:, :1] * radius + planes[:, 1:2] * points[:, 2] + planes[:, 2:]
    which = each.argmin(axis=0)
    normals = np.empty_like(points)
    a, b = planes[which, 0], planes[which, 1]
    normals[:, :2] = -(a / np.maximum(radius, 1e-9))[:, None] * points[:, :2]
    normals[:, 2] = -b
    return each[which, np.arange(len(which))], normals


class Touch(NamedTuple):
    """Points of a peg that touch a bore now, in the mouth's frame.

    Attributes:
        points: where, shape (p, 3) [m].
        normals: of the faces there, towards the peg, shape (p, 3).
        depths: shape (p,) [m].
        shares: of the stiffness of their rings, shape (p,).
    """

    points: Array
    normals: Array
    depths: Array
    shares: Array


def touching(profile: PegProfile, R: Array, p: Array) -> Touch | None:
    """Where a peg touches a bore; None where it does not.

    Args:
        profile: of both.
        R, p: orientation and place of the peg's tip in the mouth's frame, shapes (3, 3) and (3,) [m].
    """
    peg_points = profile.on_peg @ R.T + p
    if peg_points[:, 2].min() > 0.0:
        return None
    depth, normals = _depths(peg_points, profile.wall)
    below = profile.floor - peg_points[:, 2]
    if below.max() > 0:  # the floor is a part of its own
        low = below > 0
        depth, normals = np.where(low, below, depth), np.where(low[:, None], [0.0, 0.0, 1.0], normals)
    other_depth, other_normals = _depths((profile.on_bore - p) @ R, profile.peg)
    depths = np.maximum(np.concatenate([depth, other_depth]), 0.0)
    active = np.flatnonzero(depths)
    if not active.size:
        return None
    sums = depths.reshape(4, _COUNT).sum(axis=1)
    points = np.concatenate([peg_points, profile.on_bore])[active]
    normals = np.concatenate([normals, -other_normals @ R.T])[active]
    return Touch(points, normals, depths[active], depths[active] / sums[active // _COUNT])


def forces_at(touch: Touch, config: PegInBoreConfig, twist: Array, ahead: float) -> Array:
    """Forces on the peg at the points that touch, shape (p, 3) [N].

    Args:
        touch: the points.
        config: coefficients.
        twist: velocity of the peg at the mouth in its frame, shape (6,) [rad/s, m/s].
        ahead: time over which it moves from where it is [s].
    """
    velocity = twist[3:] - touch.points @ _cross_matrix(twist[:3])
    apart = np.einsum("ij,ij->i", velocity, touch.normals)
    spring = config.stiffness * touch.depths - (config.damping + config.stiffness * ahead) * apart
    normal = np.maximum(spring, 0.0) * touch.shares
    slip = velocity - apart[:, None] * touch.normals
    speed = np.sqrt(np.einsum("ij,ij->i", slip, slip) + SLIP**2)
    forces: Array = normal[:, None] * touch.normals - (config.friction * normal / speed)[:, None] * slip
    return forces


def resultant(touch: Touch, forces: Array) -> Array:
    """[torque; force] of forces at the points that touch, at the mouth, shape (6,) [Nm, N]."""
    m = touch.points.T @ forces
    torque = [m[1, 2] - m[2, 1], m[2, 0] - m[0, 2], m[0, 1] - m[1, 0]]
    return np.concatenate([torque, forces.sum(axis=0)])


def next_twist(
    touch: Touch, config: PegInBoreConfig, mobility: Array, twist: Array, others: Array, step: float
) -> Array:
    """Velocity of the peg at the end of a step, its contact included, shape (6,) [rad/s, m/s].

    Args:
        touch: the points.
        config: coefficients.
        mobility: W at the mouth, shape (6, 6).
        twist: its velocity there now [rad/s, m/s].
        others: acceleration by all but the contact [rad/s^2, m/s^2].
        step: h [s].
    """
    x, n, c = touch.points, touch.normals, config
    velocity = twist[3:] - x @ _cross_matrix(twist[:3])
    slip = velocity - np.einsum("ij,ij->i", velocity, n)[:, None] * n
    speed = np.sqrt(np.einsum("ij,ij->i", slip, slip) + SLIP**2)
    elastic = c.stiffness * touch.depths * touch.shares
    along = c.friction * elastic / speed  # as a damper
    rows = np.empty((len(x), 6))
    rows[:, 3:] = n
    for i, (j, k) in enumerate(((1, 2), (2, 0), (0, 1))):
        rows[:, i] = x[:, j] * n[:, k] - x[:, k] * n[:, j]
    normal = (c.damping + c.stiffness * step) * touch.shares
    damper = (rows * (normal - along)[:, None]).T @ rows
    # Of dampers in all directions: sums of J'J with J = [-x cross, 1].
    sums, products = along @ x, (x * along[:, None]).T @ x
    cross = _cross_matrix(sums)
    damper[:3, :3] += np.trace(products) * np.eye(3) - products
    damper[:3, 3:] += cross
    damper[3:, :3] -= cross
    damper[3:, 3:] += along.sum() * np.eye(3)
    free = twist + step * (mobility @ (rows.T @ elastic) + others)
    found: Array = np.linalg.solve(np.eye(6) + step * mobility @ damper, free)
    return found


def mobility_between(plant: MultibodyPlant, tip: Frame, mouth: Frame, step: float) -> Array:
    """Velocity that an impulse between two frames gives one relative to the other, in the default posture.

    Springs and dampers of actuators count with what an implicit step makes of them.

    Args:
        plant: finalized.
        tip: the frame that moves; reference point and axes.
        mouth: the frame it moves against.
        step: of the plant [s].

    Returns:
        W = J M^-1 J', shape (6, 6).
    """
    context = plant.CreateDefaultContext()
    mass = plant.CalcMassMatrix(context)
    for index in plant.GetJointActuatorIndices():
        actuator = plant.get_joint_actuator(index)
        if actuator.has_controller():
            gains, row = actuator.get_controller_gains(), actuator.joint().velocity_start()
            mass[row, row] += step * gains.d + step**2 * gains.p
    J = plant.CalcJacobianSpatialVelocity(context, JacobianWrtVariable.kV, tip, np.zeros(3), mouth, tip)
    found: Array = J @ np.linalg.solve(mass, J.T)
    return found


class PegContact(LeafSystem):
    """Contact between a peg and a bore, each fixed to a body of a discrete plant.

    ```
    name: PegContact
    input_ports: [body_poses, body_velocities]
    output_ports: [spatial_forces, body_contact_wrench]
    ```

    body_poses, body_velocities: abstract, of the plant.
    spatial_forces: abstract, on both bodies, for the plant's `applied_spatial_force` input. Feedthrough.
    body_contact_wrench: shape (6,), on the peg at the mouth in the mouth's frame, [torque; force] [Nm, N]. Feedthrough.

    Sampling: every `time_step` [s] what the next step needs of this one; the outputs are evaluated when read.

    Args:
        plant: finalized; its default posture is about that of the contact.
        tip: frame of the plant in the peg's front face, z backwards.
        mouth: frame of the plant in the opening of the bore, z out of it.
        config: sizes and coefficients.
        time_step: h of the plant [s].
    """

    port_units = {"body_contact_wrench": "Nm,N"}

    def __init__(self, plant: MultibodyPlant, tip: Frame, mouth: Frame, config: PegInBoreConfig, *, time_step: float):
        super().__init__()
        self._config, self._profile = config, PegProfile(config)
        self._step = check("time_step", time_step, "positive")
        self._ends = [(frame.body().index(), frame.GetFixedPoseInBodyFrame()) for frame in (tip, mouth)]
        self._mobility = _MARGIN * mobility_between(plant, tip, mouth, time_step)
        self._poses = self.DeclareAbstractInputPort("body_poses", AbstractValue.Make([RigidTransform()]))
        self._velocities = self.DeclareAbstractInputPort(
            "body_velocities", AbstractValue.Make([SpatialVelocity.Zero()])
        )
        self._before = self.DeclareDiscreteState(
            18
        )  # velocity of the peg, wrench of the contact, acceleration by all else
        self.DeclarePeriodicDiscreteUpdateEvent(period_sec=time_step, offset_sec=0.0, update=self._remember)
        block: Any = ref(self)  # Drake keeps a block whose method it is given here
        self._values = BlockCache(
            self,
            "velocity, wrench, acceleration; torque and force in the world, tip from mouth",
            lambda: AbstractValue.Make(BasicVector(27)),
            lambda owner, context, value: value.get_mutable_value().SetFromVector(owner._touch(context)),
            {self._poses.ticket(), self._velocities.ticket(), self.discrete_state_ticket(self._before)},
        )
        reads = {self._values.ticket()}
        self.DeclareAbstractOutputPort(
            "spatial_forces",
            lambda: AbstractValue.Make([ExternallyAppliedSpatialForce()]),
            lambda context, output: block()._apply(context, output),
            prerequisites_of_calc=reads,
        )
        self.DeclareVectorOutputPort("body_contact_wrench", 6, self._show, prerequisites_of_calc=reads)

    def _motion(self, poses: Any, velocities: Any, end: int) -> tuple[Array, Array, Array, Array]:
        """Orientation, place, angular and linear velocity of the tip (0) or the mouth (1) in the world."""
        body, X_BF = self._ends[end]
        X_WB, V_WB = poses[int(body)], velocities[int(body)]
        R_WB = X_WB.rotation().matrix()
        arm, angular = R_WB @ X_BF.translation(), V_WB.rotational()
        linear = V_WB.translational() + _cross_matrix(angular) @ arm
        return R_WB @ X_BF.rotation().matrix(), X_WB.translation() + arm, angular, linear

    def _touch(self, context: Context) -> Array:
        bodies = self._poses.Eval(context), self._velocities.Eval(context)
        R_WT, p_WT, w_T, v_T = self._motion(*bodies, 0)
        R_WM, p_WM, w_M, v_M = self._motion(*bodies, 1)
        R, p = R_WM.T @ R_WT, R_WM.T @ (p_WT - p_WM)
        twist = np.empty(6)
        twist[:3] = R_WM.T @ (w_T - w_M)
        # Of the peg's point in the mouth, seen from the bore, which may move.
        twist[3:] = R_WM.T @ (v_T - v_M - _cross_matrix(w_T) @ (p_WT - p_WM))
        touch = touching(self._profile, R, p)
        if touch is None:
            return np.concatenate([twist, np.zeros(21)])
        before, wrench_before, others = context.get_discrete_state(self._before).value().reshape(3, 6)
        # Of a velocity at the tip in its axes to that of the peg's point in the mouth.
        move = np.zeros((6, 6))
        move[:3, :3] = move[3:, 3:] = R
        move[3:, :3] = _cross_matrix(p) @ R
        mobility = move @ self._mobility @ move.T
        felt = (twist - before) / self._step - mobility @ wrench_before
        others = others + _TRUST * (felt - others)
        then = next_twist(touch, self._config, mobility, twist, others, self._step)
        wrench = resultant(touch, forces_at(touch, self._config, then, self._step))
        return np.concatenate([twist, wrench, others, R_WM @ wrench[:3], R_WM @ wrench[3:], p_WT - p_WM])

    def _remember(self, context: Context, next_state: DiscreteValues) -> None:
        next_state.set_value(self._before, self._values.Eval(context).value()[:18])

    def _apply(self, context: Context, output: AbstractValue) -> None:
        torque, force, apart = self._values.Eval(context).value()[18:].reshape(3, 3)
        forces = []
        if force.any():
            # Each at the origin of its own frame.
            both = ((torque - _cross_matrix(apart) @ force, force), (-torque, -force))
            for (body, X_BF), (moment, push) in zip(self._ends, both, strict=True):
                one = ExternallyAppliedSpatialForce()
                one.body_index, one.p_BoBq_B = body, X_BF.translation()
                one.F_Bq_W = SpatialForce(moment, push)
                forces.append(one)
        output.set_value(forces)

    def _show(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(self._values.Eval(context).value()[6:12])
