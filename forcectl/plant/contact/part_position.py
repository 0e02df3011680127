"""Where the parts of an assembly are."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.math import RigidTransform
from pydrake.multibody.tree import Frame
from pydrake.systems.framework import BasicVector, Context, LeafSystem


class PartPosition(LeafSystem):
    """Positions of frames of a plant in the world.

    ```
    name: PartPosition
    input_ports: [body_poses]
    output_ports: [part_position]
    ```

    body_poses: abstract, of the plant. part_position: shape (3m,), of the origins of m frames in the world [m].
    Feedthrough.

    Sampling: none; evaluated when read.

    Args:
        frames: of the plant.
    """

    port_units = {"part_position": "m"}

    def __init__(self, frames: Sequence[Frame]):
        super().__init__()
        self._at = [(int(frame.body().index()), frame.GetFixedPoseInBodyFrame().translation()) for frame in frames]
        self._poses = self.DeclareAbstractInputPort("body_poses", AbstractValue.Make([RigidTransform()]))
        self.DeclareVectorOutputPort(
            "part_position", 3 * len(frames), self._show, prerequisites_of_calc={self._poses.ticket()}
        )

    def _show(self, context: Context, output: BasicVector) -> None:
        poses = self._poses.Eval(context)
        output.SetFromVector(np.concatenate([poses[body] @ point for body, point in self._at]))
