"""Positions and orientations of the parts of an assembly."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.math import RigidTransform
from pydrake.multibody.tree import Frame
from pydrake.systems.framework import BasicVector, Context

from forcectl.framework.block import PythonBlock, values_of_tick


class PartPose(PythonBlock):
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

    def __init__(self, frames: Sequence[Frame]):
        super().__init__()
        self._at = [(int(frame.body().index()), frame.GetFixedPoseInBodyFrame()) for frame in frames]
        self._poses = self.DeclareAbstractInputPort("body_poses", AbstractValue.Make([RigidTransform()]))
        # Reading the list of all body poses takes longer than the rest, so it is done once for both ports.
        self._here = values_of_tick(self, {self._poses.ticket()})
        made = {self._here.ticket()}
        for name, size, show in (("part_position", 3, self._position), ("part_orientation", 4, self._orientation)):
            self.DeclareVectorOutputPort(name, size * len(frames), show, prerequisites_of_calc=made)

    def _compute(self, context: Context) -> list[RigidTransform]:
        poses = self._poses.Eval(context)
        return [poses[body] @ X_BF for body, X_BF in self._at]

    def _position(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(np.concatenate([pose.translation() for pose in self._here.Eval(context)]))

    def _orientation(self, context: Context, output: BasicVector) -> None:
        turns = [pose.rotation().ToQuaternion().wxyz() for pose in self._here.Eval(context)]
        output.SetFromVector(np.concatenate(turns))
