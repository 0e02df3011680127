"""Joint friction with an offset, a Coulomb part and viscous parts that differ with the direction::

    tau_F = tau_O + tau_C tanh(130 q') + D+ max(q', 0) + D- min(q', 0)                                 (5.2)
    thr   = tau_move + tau_still sech(30 q')                                                           (5.3)*

tau_F opposes the motion: B q'' + ... + tau_F = tau. (5.3) is printed with its two names exchanged. Friction at rest is
the most uncertain, so the threshold is largest there.

A controller can compute the tanh from a measured speed. In a simulated plant its slope, 130 tau_C, is far too stiff for
a step of 0.5 to 1 ms, and a joint would creep under load. There the Coulomb part has true static friction:

- on the motor side of a drive, by a step that is implicit in the speed: a sticking axis is exactly at rest
  (`forcectl.plant.drives.motor_motion`).

- in a multibody plant with rigid joints, by one more actuator per joint that regulates the speed to zero with an effort
  of at most tau_C (`add_coulomb_friction`). Drake solves it implicitly, with the contacts; a sticking joint creeps by a
  few 1e-6 rad/s, the resolution of the solver.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import Joint, JointActuator, ModelInstanceIndex, PdControllerGains
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import AffineSystem, MatrixGain, Saturation

from forcectl.arrays import Array
from forcectl.errors import BadInputError, invalid
from forcectl.framework.batch import batch_values
from forcectl.framework.block import PythonDiagram
from forcectl.framework.wiring import through
from forcectl.robot.parameters import ControlParameters

COULOMB_STEEPNESS = 130.0  # [s/rad] of (5.2)
THRESHOLD_STEEPNESS = 30.0  # [s/rad] of (5.3)
_STICKING = 1e7  # [Nms/rad] damping of a joint that sticks
_SPREAD = 1e-6  # [rad/s] least half change of speed over a tick in `mean_features`


class JointFriction:
    """Parameters of (5.2) for n joints.

    Attributes:
        size: n.
        offset: tau_O [Nm].
        coulomb: tau_C [Nm].
        viscous_forward, viscous_backward: D+, D- [Nms/rad]. Arrays of shape (n,), not to be changed.
    """

    def __init__(
        self,
        size: int,
        *,
        offset: ArrayLike = 0.0,
        coulomb: ArrayLike = 0.0,
        viscous_forward: ArrayLike = 0.0,
        viscous_backward: ArrayLike | None = None,
    ):
        """A number applies to every joint; `viscous_backward` is `viscous_forward` when it is None.

        Raises:
            BadInputError: a value of another shape or not finite, or a negative one except of `offset`.
        """
        self.size = size
        self.offset = batch_values("offset", offset, size)
        self.coulomb = _finite("coulomb", coulomb, size)
        self.viscous_forward = _finite("viscous_forward", viscous_forward, size)
        backward = viscous_forward if viscous_backward is None else viscous_backward
        self.viscous_backward = _finite("viscous_backward", backward, size)

    @classmethod
    def of_parameters(cls, parameters: ControlParameters) -> JointFriction:
        """The friction in the control parameters of a robot."""
        return cls(
            parameters.num_joints,
            offset=parameters.friction_offset,
            coulomb=parameters.coulomb_friction,
            viscous_forward=parameters.viscous_friction,
            viscous_backward=parameters.viscous_friction_backward,
        )

    def scaled(self, factor: float) -> JointFriction:
        """The friction of this model times `factor`, >= 0 [1], offset included."""
        parts = ("offset", "coulomb", "viscous_forward", "viscous_backward")
        return JointFriction(self.size, **{name: factor * getattr(self, name) for name in parts})


def _finite(name: str, value: ArrayLike, size: int) -> Array:
    return batch_values(name, batch_values(name, value, size, "not negative"), size)


def friction_torque(speed: Array, friction: JointFriction) -> Array:
    """tau_F of (5.2) [Nm] at joint speeds of shape (..., n) [rad/s]."""
    return viscous_friction_torque(speed, friction) + friction.coulomb * np.tanh(COULOMB_STEEPNESS * speed)


def viscous_friction_torque(speed: Array, friction: JointFriction) -> Array:
    """tau_F of (5.2) without its Coulomb part: offset and viscous friction [Nm]."""
    forward, backward = np.maximum(speed, 0.0), np.minimum(speed, 0.0)
    return friction.offset + friction.viscous_forward * forward + friction.viscous_backward * backward


def mean_features(before: Array, after: Array) -> tuple[Array, Array, Array]:
    """Means of tanh(130 q'), max(q', 0) and min(q', 0) over a tick in which the speed changes linearly.

    Exact also through a reversal, where the values at the ends of the tick are no measure of the mean.

    Args:
        before, after: joint speeds at the ends of the tick, any one shape [rad/s].
    """
    middle = 0.5 * (before + after)
    # The change of speed is kept above a small value, because the means are divided by it.
    half = np.maximum(0.5 * np.abs(after - before), _SPREAD)
    ends = np.array([middle - half, middle + half])
    # Integrals of tanh, log cosh up to a constant and without its overflow, and of |v|.
    steep = COULOMB_STEEPNESS * ends
    log_cosh, odd = np.logaddexp(steep, -steep), ends * np.abs(ends)
    over = 0.5 / half
    mean_sign = (log_cosh[1] - log_cosh[0]) * over / COULOMB_STEEPNESS
    sloped, curved = 0.25 * over * (odd[1] - odd[0]), 0.5 * middle
    return mean_sign, curved + sloped, curved - sloped


def friction_threshold(speed: Any, move: Any, still: Any) -> Any:
    """thr of (5.3)* [Nm]: `move` + `still` at rest, `move` at speed; arguments [rad/s], [Nm], [Nm]."""
    # sech without the overflow of cosh.
    decay = np.exp(-THRESHOLD_STEEPNESS * np.abs(speed))
    return move + still * 2.0 * decay / (1.0 + decay**2)


def add_coulomb_friction(
    plant: MultibodyPlant, joints: Sequence[Joint], friction: JointFriction, steepness: float = np.inf
) -> tuple[JointActuator, ...]:
    """Add the parts of (5.2) that a discrete plant can model itself: sticking Coulomb friction, common viscous part.

    The Coulomb part is one actuator `<joint>_friction` per joint, whose desired speed has to be zero: feed the
    `desired_state` input of the model instance through `desired_state_gain`. The smaller of D+ and D- becomes the
    damping of the joint. Connect the rest, `FrictionRest`, to the plant's `applied_generalized_force` input. Set rotor
    inertias before.

    Measure the torque of the motors at their controller: Drake's `net_actuation` output has the sum of all actuators of
    a joint, friction included, in each of their entries.

    Args:
        plant: discrete, not yet finalized.
        joints: n joints with one velocity each.
        steepness: [s/rad], for friction that creeps under load like that of (5.2), tau_C sat(steepness q'); infinite by
            default: it sticks.

    Raises:
        BadInputError: a steepness that is not positive, a plant that is continuous or finalized, or a wrong number of
            joints.
    """
    if plant.time_step() == 0 or plant.is_finalized():
        raise BadInputError("plant: must be discrete and not yet finalized to get sticking friction")
    if len(joints) != friction.size:
        raise BadInputError(f"joints: has {len(joints)} entries: must have {friction.size}, as the friction")
    if not steepness > 0:
        raise invalid("steepness", steepness, "positive")
    actuators = []
    common = np.minimum(friction.viscous_forward, friction.viscous_backward)
    for joint, coulomb, viscous in zip(joints, friction.coulomb, common, strict=True):
        joint.set_default_damping(joint.default_damping() + float(viscous))
        # Drake refuses an effort limit of zero.
        limit = max(float(coulomb), np.finfo(float).tiny)
        rotor, ratio = _rotor(plant, joint)
        actuator = plant.AddJointActuator(f"{joint.name()}_friction", joint, limit)
        # Of several actuators of a joint, Drake uses the rotor of the last one and ignores the others.
        actuator.set_default_rotor_inertia(rotor)
        actuator.set_default_gear_ratio(ratio)
        actuator.set_controller_gains(PdControllerGains(p=0.0, d=min(_STICKING, steepness * limit)))
        actuators.append(actuator)
    return tuple(actuators)


def _rotor(plant: MultibodyPlant, joint: Joint) -> tuple[float, float]:
    """Rotor inertia [kg m2] and gear ratio [1] of the last actuator of a joint; (0, 1) without an actuator."""
    found = (0.0, 1.0)
    for index in plant.GetJointActuatorIndices():
        actuator = plant.get_joint_actuator(index)
        if actuator.joint().index() == joint.index():
            found = actuator.default_rotor_inertia(), actuator.default_gear_ratio()
    return found


def desired_state_gain(
    plant: MultibodyPlant, instance: ModelInstanceIndex, actuators: Sequence[JointActuator]
) -> MatrixGain:
    """From [q; v] of the given actuators, (2n,), to the `desired_state` input of their instance; the rest is zero."""
    rows = _rows(plant, instance, actuators)
    return MatrixGain(np.kron(np.eye(2), rows))


def actuation_gain(
    plant: MultibodyPlant, instance: ModelInstanceIndex, actuators: Sequence[JointActuator]
) -> MatrixGain:
    """From the torques of the given actuators, (n,), to the `actuation` input of their instance; the rest is zero."""
    return MatrixGain(_rows(plant, instance, actuators))


def _rows(plant: MultibodyPlant, instance: ModelInstanceIndex, actuators: Sequence[JointActuator]) -> Array:
    every = [int(index) for index in plant.GetJointActuatorIndices(instance)]
    rows = np.zeros((len(every), len(actuators)))
    for column, actuator in enumerate(actuators):
        rows[every.index(int(actuator.index())), column] = 1.0
    return rows


class FrictionRest(PythonDiagram):
    """The parts of (5.2) without those of `add_coulomb_friction`: offset, difference of the viscous parts. C++ blocks.

    ```
    name: FrictionRest
    input_ports: [velocity]
    output_ports: [generalized_force]
    ```

    velocity: shape (n_v,), of the plant [rad/s]. generalized_force: shape (n_v,) [Nm]. Feedthrough.

    The force is explicit and held over a step: stable while dt `|D+ - D-|` stays below the inertia of the joint.

    Sampling: none; evaluated when read.

    Args:
        plant: finalized.
        joints: n joints, those of `add_coulomb_friction`.
    """

    def __init__(self, plant: MultibodyPlant, joints: Sequence[Joint], friction: JointFriction):
        super().__init__()
        n_v = plant.num_velocities()
        pick = np.zeros((len(joints), n_v))
        pick[np.arange(len(joints)), [joint.velocity_start() for joint in joints]] = 1.0
        common = np.minimum(friction.viscous_forward, friction.viscous_backward)
        unlimited, zero = np.full(n_v, np.inf), np.zeros(n_v)
        self.port_units = {"velocity": "rad/s", "generalized_force": "Nm"}
        builder = DiagramBuilder()
        velocity = builder.AddNamedSystem("velocity", MatrixGain(np.tile(np.eye(n_v), (2, 1))))
        halves = Saturation(np.append(zero, -unlimited), np.append(unlimited, zero))
        directions = through(builder, "forward_and_backward", halves, velocity.get_output_port())
        uncommon = np.hstack([np.diag(friction.viscous_forward - common), np.diag(friction.viscous_backward - common)])
        drag = AffineSystem(D=-pick.T @ uncommon @ np.kron(np.eye(2), pick), y0=-pick.T @ friction.offset)
        force = through(builder, "force", drag, directions)
        builder.ExportInput(velocity.get_input_port(), "velocity")
        builder.ExportOutput(force, "generalized_force")
        builder.BuildInto(self)
