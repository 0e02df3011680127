"""Scenario part `environment: !Part`: a model that is fixed to the world or held by an arm through a compliant grasp.

A grasp consists of six springs and dampers between the TCP and the part, each up to its limit, beyond which the fingers
give way. While the gripper of the arm is open the part is free; `GripperOpening` says how it is grasped again.
"""

from __future__ import annotations

import math
import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from pydrake.common.eigen_geometry import AngleAxis
from pydrake.math import RigidTransform, RollPitchYaw, RotationMatrix

from forcectl.errors import BadInputError, invalid, unknown
from forcectl.framework.fields import Config, key
from forcectl.models import models_folder

_FILES = (".urdf", ".sdf")
_IN_HAND = 1.5  # [m] largest distance of a held part from the TCP
_TURN = "from -360 to 360"
_NEAR = "from -3 to 3"  # [m] beyond the reach of any arm


# Springs of a grasp: keys of stiffness, damping, and largest force or torque.
_SPRINGS = (
    ("stiffness", "damping", "force_limit"),
    ("rotational_stiffness", "rotational_damping", "torque_limit"),
)
# Deflection [m], [rad] of the springs at their limits: 0.02 mm for a clamp, centimetres for rubber fingers. A value
# outside is probably in the wrong unit. Likewise damping over stiffness [s], usually 1 to 50 ms.
_DEFLECTION = (1e-5, 0.3), (5e-4, 3.0)
_TIME_CONSTANT = 1e-4, 1.0
_TINY, _FLAT = 1e-4, 0.05  # [m], [deg] smallest tolerances on a pose in the hand


@dataclass(kw_only=True)
class GraspConfig(Config):
    """Springs of a grasp along and about the axes of the TCP; rotations about x, the turned y, then the turned z."""

    stiffness: list[float] = key(
        [1000.0, 1000.0, 2000.0],
        "stiffness of the grasp along each axis of the TCP",
        unit="N/m",
        bounds="positive",
        size=3,
    )
    damping: list[float] = key(
        [30.0, 30.0, 60.0],
        "damping of the grasp along each axis of the TCP",
        unit="Ns/m",
        bounds="from 0 to 100000",
        size=3,
    )
    force_limit: list[float] = key(
        [20.0, 20.0, 20.0],
        "largest force of the grasp along each axis of the TCP",
        unit="N",
        bounds="from 0.1 to 1e5",
        size=3,
    )
    rotational_stiffness: list[float] = key(
        [3.0, 3.0, 3.0],
        "stiffness of the grasp about each axis of the TCP",
        unit="Nm/rad",
        bounds="positive",
        size=3,
    )
    rotational_damping: list[float] = key(
        [0.1, 0.1, 0.1],
        "damping of the grasp about each axis of the TCP",
        unit="Nms/rad",
        bounds="from 0 to 1000",
        size=3,
    )
    torque_limit: list[float] = key(
        [1.0, 1.0, 1.0],
        "largest torque of the grasp about each axis of the TCP",
        unit="Nm",
        bounds="positive",
        size=3,
    )
    released_at: float | None = key(
        None,
        "time at which the gripper releases the part for good; null: only on command",
        unit="s",
        bounds="not negative",
    )
    # Above the deflection of the springs at their limits, 20 mm with the defaults: a part that only gives way is kept.
    largest_offset: float = key(
        0.025,
        "displacement of the part from where it was taken, beyond which the gripper has lost it",
        unit="m",
        bounds="above 0 and at most 0.5",
    )
    reach: float = key(
        0.005,
        "distance of the part from its place in the hand, up to which a closing gripper takes it",
        unit="m",
        bounds="from 0 to 0.2",
    )
    reach_deg: float = key(
        5.0,
        "angle of the part to its orientation in the hand, up to which a closing gripper takes it",
        unit="deg",
        bounds="from 0 to 180",
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        for (stiff, damped, limit), (least, most), unit in zip(_SPRINGS, _DEFLECTION, ("m", "rad"), strict=True):
            for i, stiffness in enumerate(getattr(self, stiff)):
                stretch, spent = getattr(self, limit)[i] / stiffness, getattr(self, damped)[i] / stiffness
                if not least <= stretch <= most:
                    allowed = f"from {least:g} to {most:g} {unit}, not {stretch:.3g} {unit}"
                    raise invalid(f"{stiff}.{i}", stiffness, f"such that {limit} divided by it is {allowed}")
                if spent and not _TIME_CONSTANT[0] <= spent <= _TIME_CONSTANT[1]:
                    allowed = f"0, or {_TIME_CONSTANT[0]:g} to {_TIME_CONSTANT[1]:g} s times {stiff}, not {spent:.3g} s"
                    raise invalid(f"{damped}.{i}", getattr(self, damped)[i], allowed)
        for name, smallest in (("largest_offset", _TINY), ("reach", _TINY), ("reach_deg", _FLAT)):
            if 0 < getattr(self, name) < smallest:
                raise invalid(
                    name, getattr(self, name), f"at least {smallest:g}" + ", or 0" * (name != "largest_offset")
                )


@dataclass(kw_only=True)
class MisplacementConfig(Config):
    """Placement error of a part: how its pose differs from the one that its task assumes."""

    offset: float = key(
        0.0, "position error of the frame, perpendicular to its z axis", unit="m", bounds="from 0 to 0.1"
    )
    direction_deg: float | None = key(
        None,
        "direction of the position error, from the frame's x towards its y axis; null: drawn with the seed",
        unit="deg",
        bounds=_TURN,
    )
    tilt_deg: float = key(
        0.0, "angle by which the frame's z axis is tilted, about its origin", unit="deg", bounds="from 0 to 60"
    )
    tilt_direction_deg: float | None = key(
        None,
        "direction towards which the z axis tilts, from the frame's x towards its y axis; null: drawn with the seed",
        unit="deg",
        bounds=_TURN,
    )

    def drawn(self, rng: np.random.Generator) -> RigidTransform:
        """Pose of the actual frame in the intended one.

        Args:
            rng: draws the directions that are not given.
        """
        drawn = rng.uniform(0.0, 360.0, 2)
        given = (self.direction_deg, self.tilt_direction_deg)
        along, towards = (np.radians(d if g is None else g) for d, g in zip(drawn, given, strict=True))
        axis = np.array([-np.sin(towards), np.cos(towards), 0.0])
        turned = AngleAxis(np.radians(self.tilt_deg), axis)
        return RigidTransform(RotationMatrix(turned), self.offset * np.array([np.cos(along), np.sin(along), 0.0]))


@dataclass(kw_only=True)
class PartConfig(Config):
    """Scenario part `!Part`: a model of one body or of bodies welded together.

    Its name among the `!Parts` is that of its model instance in the plant, for `!ContactTruth`.
    """

    model: str = key(meaning="shipped part, such as pipette_body, or path of a URDF or SDF file")
    frame: str = key("", "frame of the model whose pose is given; empty: that of its first body")
    arm: str = key("", "arm that holds the part at its TCP, or can take it there; empty: it is fixed to the world")
    position: list[float] = key(
        [0.0, 0.0, 0.0],
        "position of the part's frame in the TCP of its arm, or in the world without an arm",
        unit="m",
        bounds=_NEAR,
        size=3,
    )
    rotation_deg: list[float] = key(
        [0.0, 0.0, 0.0],
        "roll, pitch and yaw of the part's frame in the TCP of its arm, or in the world without an arm",
        unit="deg",
        size=3,
    )
    misplaced: MisplacementConfig = key(MisplacementConfig, "placement error of the part in the hand or the world")
    grasp: GraspConfig = key(GraspConfig, "how the arm holds the part")
    lies_at: list[float] = key(
        [],
        "position of the part's frame in the world at the start, if its arm does not hold it then; empty: it does",
        unit="m",
        bounds=_NEAR,
        size=3,
    )
    lies_rotation_deg: list[float] = key(
        [0.0, 0.0, 0.0],
        "roll, pitch and yaw of the part's frame in the world at the start, with lies_at",
        unit="deg",
        size=3,
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        for name, value, rest in (("grasp", self.grasp, GraspConfig()), ("lies_at", self.lies_at, [])):
            if not self.arm and value != rest:
                raise BadInputError("must be left out where no arm holds the part", key=name)
        if any(self.lies_rotation_deg) and not self.lies_at:
            raise BadInputError("must be left out without lies_at", key="lies_rotation_deg")
        if self.arm and (away := math.hypot(*self.position)) > _IN_HAND:
            raise invalid("position", self.position, f"within {_IN_HAND:g} m of the TCP: it is {away:.3g} m away")

    @property
    def hand(self) -> str:
        """Name of the arm that holds the part at the start; "" when no arm does."""
        return "" if self.lies_at else self.arm

    def occupies(self) -> tuple[object, ...]:
        """Values that no other part may have as well: the pose in a hand, or model and pose in the world."""
        if self.hand:
            return "hand", self.hand, *self.position, *self.rotation_deg
        if self.lies_at:
            return self.model, self.frame, *self.lies_at, *self.lies_rotation_deg
        return self.model, self.frame, *self.position, *self.rotation_deg

    @property
    def placement(self) -> RigidTransform:
        """Intended pose of the frame in the TCP or the world."""
        return RigidTransform(RollPitchYaw(np.radians(self.rotation_deg)), np.array(self.position))

    @property
    def lying(self) -> RigidTransform | None:
        """Pose of the frame in the world at the start; None for a part that starts in the hand, or is fixed."""
        if not self.lies_at:
            return None
        return RigidTransform(RollPitchYaw(np.radians(self.lies_rotation_deg)), np.array(self.lies_at))

    def file(self) -> Path:
        """The model's file.

        Raises:
            BadInputError: neither a shipped part nor such a file.
        """
        shipped = {file.stem: file for file in sorted((models_folder() / "parts").glob("*.urdf"))}
        if self.model in shipped:
            return shipped[self.model]
        path = Path(os.path.expanduser(self.model))
        if path.suffix.lower() not in _FILES:
            raise unknown("part (neither shipped nor a URDF or SDF file)", self.model, shipped).at("model")
        if not os.path.isfile(path):
            raise BadInputError(f" = {self.model!r}: there is no such file", key="model")
        return path
