"""Contact of a cap that is turned on a mount, without meshes: feet on a wavy face, and a lock as a torsional spring.

The mount has n feet at a radius r in its face, evenly spaced; the cap's face is in its mouth, with waves of the height
h = A sin(N angle) around its axis. Each foot has the stiffness k, and all are on a seat that is compliant along the
mouth's axis only: it deflects by s, with the stiffness K_s. Each foot has its share of the damping D, and Coulomb
friction, regularised below 1 mm/s::

    f_i = max(0, k (h_i - z_i - s) + D (h_i' - z_i')/n),    K_s s = sum of max(0, k (h_i - z_i - s)),
    1/K = 1/K_s + 1/(n k)

so that K is the stiffness of the aligned contact. The tilting stiffness is n k r^2/2 while all feet touch; otherwise
the resultant force is at one foot or between two, at least r cos(pi/n) from the axis. The slope of the waves, N A/r,
0.04 with the defaults, is neglected. While a foot touches, the lock is a torsional spring beyond its angle. Contact
ends where the mount is r/2 behind the face or r beside its axis, and when a gripper releases one of the parts. If they
are locked then, turned beyond the angle of the lock with a foot in contact, they hold each other from then on, with the
stiffness K along and that of the lock about all axes, see `locked_parts`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import Frame
from pydrake.systems.framework import Context

from forcectl.arrays import Array
from forcectl.errors import invalid
from forcectl.framework.fields import Config, key
from forcectl.framework.kernels import cross_matrix
from forcectl.plant.contact.pairs.locked_parts import displacement, holding_wrench
from forcectl.plant.contact.pairs.pair_contact import EndMotion, PairContact, check_roles
from forcectl.plant.contact.pairs.step_ahead import STATE_SIZE, StepAhead
from forcectl.robot.joint_tree import cross

_SLIP = 1e-3  # [m/s] slip speed below which friction is regularised, smaller than Coulomb's


@dataclass(kw_only=True)
class CapOnMountConfig(Config):
    """Scenario part `!CapOnMount`: contact of two `!Part`s by `CapContact`, in place of the contact of their shapes."""

    mount: str = key(meaning="name of the part with the feet")
    cap: str = key(meaning="name of the part with the face")
    tip: str = key("tip", "frame of the mount in the middle of its feet, z pointing into the mount")
    mouth: str = key("mouth", "frame of the cap in the middle of its face, z pointing out of the cap")
    radius: float = key(12e-3, "distance r of the feet from the axis", unit="m", bounds="positive")
    stiffness: float = key(
        1450.0, "stiffness K along the axis of all that is between the arms", unit="N/m", bounds="positive"
    )
    feet: int = key(3, "number n of feet", bounds="from 3 to 24")
    foot_stiffness: float = key(2e4, "stiffness k of each foot on the face; above K/n", unit="N/m", bounds="positive")
    damping: float = key(0.0, "damping D of all feet together", unit="N s/m", bounds="not negative, at most 100000")
    friction: float = key(0.15, "Coulomb friction coefficient of the feet", bounds="not negative and at most 2")
    waves: int = key(
        9, "number N of waves of the face per turn; a multiple of n lifts all feet alike", bounds="from 0 to 1000"
    )
    waviness: float = key(0.05e-3, "amplitude A of the waves of the face", unit="m", bounds="not negative")
    lock_deg: float = key(
        45.0,
        "angle of the mount in the cap, beyond which the lock acts as a torsional spring",
        unit="deg",
        bounds="from -170 to 170",
    )
    lock_stiffness: float = key(
        5.0, "torsional stiffness of the lock against further turning", unit="Nm/rad", bounds="not negative"
    )
    lock_torque: float = key(0.6, "largest torque of the lock, at which it yields", unit="Nm", bounds="positive")

    roles: ClassVar[tuple[str, str]] = ("mount", "cap")

    def __post_init__(self) -> None:
        super().__post_init__()
        check_roles(self)
        if not self.feet * self.foot_stiffness > self.stiffness:
            allowed = f"above {self.stiffness / self.feet:g} N/m, the stiffness divided by the number of feet"
            raise invalid("foot_stiffness", self.foot_stiffness, allowed)

    def check_models(self, tip: str, mouth: str) -> None:
        """Any models fit; see `PairContactPart`."""

    def contact(self, plant: MultibodyPlant, tip: Frame, mouth: Frame, time_step: float) -> PairContact:
        """See `PairContactPart`."""
        return CapContact(plant, tip, mouth, self, time_step=time_step)


class CapContact(PairContact):
    """Contact between a mount and a cap, each fixed to a body of a plant.

    ```
    name: CapContact
    input_ports: [body_poses, body_velocities, released (optional)]
    output_ports: [spatial_forces, body_contact_wrench, contact_pair]
    ```

    body_poses, body_velocities: abstract, of the plant.
    released: shape (2,), of mount and cap, 1 while its gripper has released it, else 0; held if not connected [1].
    spatial_forces: abstract, on both bodies, for the plant's `applied_spatial_force` input. Feedthrough.
    body_contact_wrench: shape (6,), on the mount at the mouth in the mouth's frame, [torque; force] [Nm, N].
    Feedthrough.
    contact_pair: abstract, tuple of no or one `BodyContact`, between the bodies of cap and mount. Feedthrough.

    Sampling: every `time_step` [s] the values for the next step, and whether and where the parts are locked; the
    outputs are evaluated when read. A discrete plant holds the force of the feet over its step h: for parts that are
    held softly, K h^2 must be well below their mass. This does not apply to locked parts.

    Args:
        plant: finalized, see `StepAhead`.
        tip: frame of the mount.
        mouth: frame of the cap.
        config: sizes and coefficients.
        time_step: h of the plant [s].
    """

    def __init__(self, plant: MultibodyPlant, tip: Frame, mouth: Frame, config: CapOnMountConfig, *, time_step: float):
        # State: values of `StepAhead`, then whether the parts are locked, and the locked orientation and position.
        super().__init__(tip, mouth, STATE_SIZE + 13, time_step)
        angles = 2.0 * np.pi * np.arange(config.feet) / config.feet
        feet = np.column_stack([np.cos(angles), np.sin(angles), np.zeros(config.feet)])
        self._config, self._feet = config, config.radius * feet
        self._ahead = StepAhead(plant, tip, mouth, self._step)
        self._holding = np.repeat([config.lock_stiffness, config.stiffness], 3)

    def wrench(self, context: Context, tip: EndMotion, mouth: EndMotion) -> tuple[Array, Array]:
        """See `PairContact`."""
        R, p = mouth.R.T @ tip.R, mouth.R.T @ (tip.p - mouth.p)
        own, before = self._ahead.own_velocities(tip, mouth), context.get_discrete_state(self.memory).value()
        released, lock = self.released(context), before[STATE_SIZE:]
        if any(released):
            wrench = np.zeros(6)
            if lock[0]:
                mobility, free = self._ahead.free(R, p, own, before[:STATE_SIZE], released)
                displaced = displacement(R, p, lock[1:10].reshape(3, 3), lock[10:])
                wrench = holding_wrench(self._holding, displaced, mobility, free, self._step)
            return wrench, np.concatenate([self._ahead.step_state(own, wrench, released), lock])
        turning = mouth.R.T @ (tip.w - mouth.w)
        # Velocity of the mount's point at the mouth, relative to the cap.
        moving = mouth.R.T @ (tip.v - mouth.v - cross_matrix(tip.w) @ (tip.p - mouth.p))
        wrench, lock = np.zeros(6), np.zeros(13)
        if self._near(p):
            wrench = cap_wrench(self._config, self._feet @ R.T + p, R, turning, moving)
        if wrench.any() and beyond_lock(self._config, R) > 0:
            lock = np.concatenate([[1.0], R.ravel(), p])
        return wrench, np.concatenate([self._ahead.step_state(own, wrench, released), lock])

    def _near(self, p: Array) -> bool:
        r = self._config.radius
        return bool(-0.5 * r < p[2] < r + self._config.waviness and math.hypot(p[0], p[1]) < r)


def beyond_lock(config: CapOnMountConfig, rotation: Array) -> float:
    """How far the mount is turned beyond the angle of the lock, at least 0 [rad].

    Args:
        config: sizes and coefficients.
        rotation: of the mount in the cap, shape (3, 3).
    """
    psi, direction = math.atan2(rotation[1, 0], rotation[0, 0]), math.copysign(1.0, config.lock_deg)
    return max(direction * psi - abs(math.radians(config.lock_deg)), 0.0)


def cap_wrench(config: CapOnMountConfig, feet: Array, rotation: Array, turning: Array, moving: Array) -> Array:
    """Wrench on the mount at the mouth, [torque; force], all in the mouth's frame, shape (6,) [Nm, N].

    Args:
        config: sizes and coefficients.
        feet: positions of the feet, shape (n, 3) [m].
        rotation: of the mount in the cap, shape (3, 3).
        turning: angular velocity of the mount in the cap [rad/s].
        moving: velocity of the mount's point at the mouth [m/s].
    """
    speed = moving - feet @ cross_matrix(turning)
    angle = config.waves * np.arctan2(feet[:, 1], feet[:, 0])
    height = config.waviness * np.sin(angle)
    around = (feet[:, 0] * speed[:, 1] - feet[:, 1] * speed[:, 0]) / np.maximum(feet[:, 0] ** 2 + feet[:, 1] ** 2, 1e-9)
    rising = config.waviness * config.waves * np.cos(angle) * around
    firm, overlap, n = config.foot_stiffness, height - feet[:, 2], len(feet)
    seat = 1.0 / (1.0 / config.stiffness - 1.0 / (n * firm))
    # The number of feet in contact is the one for which the seat deflects the most.
    seat_deflection = max(0.0, float((np.cumsum(-np.sort(-overlap)) / (seat / firm + np.arange(1, n + 1))).max()))
    pressing = firm * (overlap - seat_deflection) + config.damping * (rising - speed[:, 2]) / n
    forces = np.zeros((n, 3))
    forces[:, 2] = np.where(overlap > seat_deflection, np.maximum(pressing, 0.0), 0.0)
    if not forces.any():
        return np.zeros(6)
    slip = speed[:, :2]
    smooth = np.sqrt((slip**2).sum(axis=1) + _SLIP**2)
    forces[:, :2] = -(config.friction * forces[:, 2] / smooth)[:, None] * slip
    torque = cross(feet, forces).sum(axis=0)
    back = min(config.lock_stiffness * beyond_lock(config, rotation), config.lock_torque)
    torque[2] -= math.copysign(back, config.lock_deg)
    return np.concatenate([torque, forces.sum(axis=0)])
