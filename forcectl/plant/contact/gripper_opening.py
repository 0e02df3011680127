"""Which held parts are released, over time."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from pydrake.systems.framework import BasicVector, Context, LeafSystem

_ROUNDING = 1e-9  # [s] of the times of ticks


class GripperOpening(LeafSystem):
    """Which of the parts held at the start are released.

    ```
    name: GripperOpening
    input_ports: []
    output_ports: [part_released]
    ```

    part_released: shape (h,), of h parts, 0 while the part is held and 1 from its time on [1]. Function of time.

    Sampling: none; evaluated when read.

    Args:
        times: when the gripper of each part opens [s]; None: never.
    """

    def __init__(self, times: Sequence[float | None]):
        super().__init__()
        self._times = np.array([np.inf if time is None else time for time in times])
        self.DeclareVectorOutputPort(
            "part_released", len(times), self._show, prerequisites_of_calc={self.time_ticket()}
        )

    def _show(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector((context.get_time() > self._times - _ROUNDING).astype(float))
