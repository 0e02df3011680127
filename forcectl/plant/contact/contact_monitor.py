"""Contact state and contact loss as an event.

mode: APPROACH -> CONTACT when F > threshold;  CONTACT -> LOST when F <= 0;  LOST -> CONTACT when F > threshold
"""

from __future__ import annotations

from enum import IntEnum
from typing import Any, ClassVar

import numpy as np
from pydrake.systems.framework import Context

from forcectl.framework.batch import BatchValue, check
from forcectl.framework.sampled_block import Memory, SampledBatch


class ContactMode(IntEnum):
    """Mode of a contact; the numbers are the values of the port `contact_state`."""

    APPROACH = 0
    CONTACT = 1
    LOST = 2


CONTACT_FORCE = 1e-9  # [N] smallest force that counts as contact and not as rounding
_CONTACT, _LOST = float(ContactMode.CONTACT), float(ContactMode.LOST)


def next_mode(mode: BatchValue, force: BatchValue, threshold: BatchValue, m: Any = np) -> BatchValue:
    """The mode after a sample of the true contact force [N]."""
    lost = m.where((mode == _CONTACT) & (force <= 0), _LOST, mode)
    return m.where(force > threshold, _CONTACT, lost)


class ContactMonitor(SampledBatch):
    """Contact mode of a batch of n contacts, and the count of their losses.

    ```
    name: ContactMonitor
    input_ports: [contact_force]
    output_ports: [contact_state, contact_losses]
    ```

    contact_force: shape (n,), truth [N].
    contact_state: shape (n,), see `ContactMode` [1]. contact_losses: shape (n,), how many so far [1].
    All outputs are state, no direct feedthrough.

    Contact begins when the force exceeds `threshold` [N] and is lost when the force is no longer positive.

    Sampling: every `period` [s]; the outputs change one tick after the force.
    """

    port_meanings: ClassVar = {"contact_state": tuple(mode.name.lower() for mode in ContactMode)}

    def __init__(self, size: int, *, period: float = 0.002, threshold: float = CONTACT_FORCE):
        super().__init__(size, {})
        self._threshold = check("threshold", threshold, "not negative")
        force = self.DeclareVectorInputPort("contact_force", size)
        self.declare_memory({"contact_state": 0.0, "contact_losses": 0.0}, [force], period)
        self.show_held("contact_state")
        self.show_held("contact_losses")

    def step(self, context: Context, memory: Memory, inputs: Memory) -> dict[str, BatchValue]:
        """The mode and the losses after a sample."""
        mode, losses = memory["contact_state"], memory["contact_losses"]
        after = next_mode(mode, inputs["contact_force"], self._threshold, self.math)
        return {"contact_state": after, "contact_losses": losses + (after == _LOST) * (after != mode)}
