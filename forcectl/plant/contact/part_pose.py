"""Where the parts of an assembly are, and how they are turned."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.math import RigidTransform
from pydrake.multibody.tree import Frame
from pydrake.systems.framework import BasicVector, Context, LeafSystem


class PartPose(LeafSystem):
    """Poses of frames of a plant in the world.

    ```
    name: PartPose
    input_ports: [body_poses]
    output_ports: [part_position, part_orientation]
    ```

    body_poses: abstract, of the plant.
    part_position: shape (3m,), of the origins of m frames in the world [m].
    part_orientation: shape (4m,), of their axes in the world, quaternions [w, x, y, z] with w not negative [1].
    All outputs are feedthrough of body_poses.

    Sampling: none; evaluated when read.

    Args:
        frames: of the plant.
    """

    port_units = {"part_position": "m", "part_orientation": "1"}

    def __init__(self, frames: Sequence[Frame]):
        super().__init__()
        self._at = [(int(frame.body().index()), frame.GetFixedPoseInBodyFrame()) for frame in frames]
        self._poses = self.DeclareAbstractInputPort("body_poses", AbstractValue.Make([RigidTransform()]))
        for name, size, show in (("part_position", 3, self._position), ("part_orientation", 4, self._orientation)):
            self.DeclareVectorOutputPort(name, size * len(frames), show, prerequisites_of_calc={self._poses.ticket()})

    def _position(self, context: Context, output: BasicVector) -> None:
        poses = self._poses.Eval(context)
        output.SetFromVector(np.concatenate([poses[body] @ X_BF.translation() for body, X_BF in self._at]))

    def _orientation(self, context: Context, output: BasicVector) -> None:
        poses = self._poses.Eval(context)
        turns = [poses[body].rotation() @ X_BF.rotation() for body, X_BF in self._at]
        output.SetFromVector(np.concatenate([turn.ToQuaternion().wxyz() for turn in turns]))
