"""Contact of a cap that is turned on a mount, without meshes: three feet on a wavy face, and a stop that is the lock.

The mount has three feet at a radius r in its face, 120 degrees apart; the cap's face is in its mouth, with waves of the
height h = A sin(N angle) around its axis. Each foot i is a spring and a damper along the mouth's axis, with a third of
K and D, and has Coulomb's friction, smooth below 1 mm/s::

    f_i = max(0, K (h_i - z_i)/3 + D (h_i' - z_i')/3)

so that K is the stiffness of the aligned contact, and K r^2/2 that against tilting. The slope of the waves is left
out: N A/r, 0.04 with the defaults. While a foot touches, the lock is a torsional spring beyond its angle. Contact ends
where the mount is r/2 beyond the face or r beside its axis, and where a gripper lets one of the parts go: what the
locked parts do then is not modelled.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import Frame
from pydrake.systems.framework import Context

from forcectl.framework.fields import Config, key
from forcectl.framework.kernels import cross_matrix
from forcectl.plant.contact.pairs.pair_contact import EndMotion, PairContact, check_roles

Array = NDArray[np.float64]
_SLIP = 1e-3  # [m/s] below which friction is less than Coulomb's
_FEET = np.array([[math.cos(angle), math.sin(angle), 0.0] for angle in 2 * np.pi * np.arange(3) / 3])


@dataclass(kw_only=True)
class CapOnMountConfig(Config):
    """Scenario part `!CapOnMount`: the contact of two `!Part`s by `CapContact`, in place of that of their shapes."""

    mount: str = key(meaning="name of the part with the feet")
    cap: str = key(meaning="name of the part with the face")
    tip: str = key("tip", "frame of the mount, in the middle of its feet, z backwards")
    mouth: str = key("mouth", "frame of the cap, in the middle of its face, z out of it")
    radius: float = key(12e-3, "r of the feet from the axis", unit="m", bounds="positive")
    stiffness: float = key(1450.0, "K", unit="N/m", bounds="positive")
    damping: float = key(0.0, "D", unit="N s/m", bounds="not negative")
    friction: float = key(0.15, "Coulomb's", bounds="not negative")
    waves: int = key(9, "N, waves of the face in a turn; a multiple of 3 lifts all feet alike", bounds="not negative")
    waviness: float = key(0.05e-3, "A, height of the waves", unit="m", bounds="not negative")
    lock_deg: float = key(
        45.0, "angle of the mount in the cap from which on the lock turns back", unit="deg", bounds="from -170 to 170"
    )
    lock_stiffness: float = key(5.0, "of the lock, against turning on", unit="Nm/rad", bounds="not negative")
    lock_torque: float = key(0.6, "with which the lock gives way", unit="Nm", bounds="positive")

    roles: ClassVar[tuple[str, str]] = ("mount", "cap")

    def __post_init__(self) -> None:
        super().__post_init__()
        check_roles(self)

    def check_models(self, tip: str, mouth: str) -> None:
        """Any models fit; see `PairContactPart`."""

    def contact(self, plant: MultibodyPlant, tip: Frame, mouth: Frame, time_step: float) -> PairContact:
        """See `PairContactPart`."""
        return CapContact(tip, mouth, self)


class CapContact(PairContact):
    """Contact between a mount and a cap, each fixed to a body of a plant.

    ```
    name: CapContact
    input_ports: [body_poses, body_velocities, released (optional)]
    output_ports: [spatial_forces, body_contact_wrench, contact_pair]
    ```

    body_poses, body_velocities: abstract, of the plant.
    released: shape (2,), 1 where what holds the mount, the cap lets it go; held where it is not connected [1].
    spatial_forces: abstract, on both bodies, for the plant's `applied_spatial_force` input. Feedthrough.
    body_contact_wrench: shape (6,), on the mount at the mouth in the mouth's frame, [torque; force] [Nm, N].
    Feedthrough.
    contact_pair: abstract, tuple of no or one `BodyContact`, between the bodies of cap and mount. Feedthrough.

    Sampling: none; evaluated when read. A discrete plant holds the force over its step h: parts that are held softly
    need K h^2 well below their mass.

    Args:
        tip: frame of the mount.
        mouth: frame of the cap.
        config: sizes and coefficients.
    """

    def __init__(self, tip: Frame, mouth: Frame, config: CapOnMountConfig):
        super().__init__(tip, mouth)
        self._config, self._feet = config, config.radius * _FEET

    def wrench(self, context: Context, tip: EndMotion, mouth: EndMotion) -> tuple[Array, Array]:
        """See `PairContact`."""
        nothing = np.zeros(6), np.zeros(0)
        R, p = mouth.R.T @ tip.R, mouth.R.T @ (tip.p - mouth.p)
        r = self._config.radius
        near = -0.5 * r < p[2] < r + self._config.waviness and math.hypot(p[0], p[1]) < r
        if not near or any(self.released(context)):
            return nothing
        turning = mouth.R.T @ (tip.w - mouth.w)
        # Of the mount's point in the mouth, seen from the cap.
        moving = mouth.R.T @ (tip.v - mouth.v - cross_matrix(tip.w) @ (tip.p - mouth.p))
        found = cap_wrench(self._config, self._feet @ R.T + p, R, turning, moving)
        return (found, np.zeros(0)) if found.any() else nothing


def cap_wrench(config: CapOnMountConfig, feet: Array, rotation: Array, turning: Array, moving: Array) -> Array:
    """Wrench on the mount at the mouth, [torque; force], all in the mouth's frame, shape (6,) [Nm, N].

    Args:
        config: sizes and coefficients.
        feet: where they are, shape (3, 3) [m].
        rotation: of the mount in the cap, shape (3, 3).
        turning: angular velocity of the mount in the cap [rad/s].
        moving: velocity of its point in the mouth [m/s].
    """
    speed = moving - feet @ cross_matrix(turning)
    angle = config.waves * np.arctan2(feet[:, 1], feet[:, 0])
    height = config.waviness * np.sin(angle)
    around = (feet[:, 0] * speed[:, 1] - feet[:, 1] * speed[:, 0]) / np.maximum(feet[:, 0] ** 2 + feet[:, 1] ** 2, 1e-9)
    rising = config.waviness * config.waves * np.cos(angle) * around
    pressing = config.stiffness * (height - feet[:, 2]) + config.damping * (rising - speed[:, 2])
    forces = np.zeros((3, 3))
    forces[:, 2] = np.where(height > feet[:, 2], np.maximum(pressing, 0.0), 0.0) / 3.0
    if not forces.any():
        return np.zeros(6)
    slip = speed[:, :2]
    smooth = np.sqrt((slip**2).sum(axis=1) + _SLIP**2)
    forces[:, :2] = -(config.friction * forces[:, 2] / smooth)[:, None] * slip
    torque = np.cross(feet, forces).sum(axis=0)
    psi, way = math.atan2(rotation[1, 0], rotation[0, 0]), math.copysign(1.0, config.lock_deg)
    beyond = max(way * psi - abs(math.radians(config.lock_deg)), 0.0)
    torque[2] -= way * min(config.lock_stiffness * beyond, config.lock_torque)
    return np.concatenate([torque, forces.sum(axis=0)])
