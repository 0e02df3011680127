"""Contact state and contact loss as an event.

mode: APPROACH -> CONTACT when F > threshold;  CONTACT -> LOST when F <= 0;  LOST -> CONTACT when F > threshold
"""

from __future__ import annotations

from enum import IntEnum
from typing import Any

import numpy as np
from pydrake.systems.framework import Context, Diagram, DiagramBuilder, DiscreteValues
from pydrake.systems.primitives import Demultiplexer

from forcectl.framework.batch import BatchBlock, BatchValue, check


class ContactMode(IntEnum):
    """Where a contact stands; the numbers are those of the port `contact_state`."""

    APPROACH = 0
    CONTACT = 1
    LOST = 2


_CONTACT, _LOST = float(ContactMode.CONTACT), float(ContactMode.LOST)


def next_mode(mode: BatchValue, force: BatchValue, threshold: BatchValue, m: Any = np) -> BatchValue:
    """The mode after a sample of the true contact force [N]."""
    lost = m.where((mode == _CONTACT) & (force <= 0), _LOST, mode)
    return m.where(force > threshold, _CONTACT, lost)


class ContactMonitorCore(BatchBlock):
    """Keeps the contact mode of a batch of n and counts the losses.

    ```
    name: ContactMonitorCore
    input_ports: [contact_force]
    output_ports: [state]
    ```

    contact_force: shape (n,), truth [N].
    state: shape (2n,), mode (`ContactMode`) and number of losses so far [1]. State, no direct feedthrough.

    There is contact while the force exceeds `threshold` [N].

    Sampling: every `period` [s]; the state changes one tick after the force it is from.

    The mode is a number in discrete state, not an abstract value: abstract Python state is copied deeply at every
    unrestricted event of the whole diagram (10 us a tick).
    """

    def __init__(self, size: int, *, period: float = 0.002, threshold: float = 1e-9):
        super().__init__(size, {})
        check("period", period, "positive")
        self._threshold = check("threshold", threshold, "not negative")
        self._force = self.DeclareVectorInputPort("contact_force", size)
        self.DeclareStateOutputPort("state", self.DeclareDiscreteState(2 * size))
        self.DeclarePeriodicDiscreteUpdateEvent(period_sec=period, offset_sec=0.0, update=self._update)

    def _update(self, context: Context, next_state: DiscreteValues) -> None:
        mode, losses = self.unstack(context.get_discrete_state_vector().value())
        after = next_mode(mode, self.batch_value(self._force.Eval(context)), self._threshold, self.math)
        changed = after != mode
        if np.any(changed) if self._size > 1 else changed:
            next_state.set_value(self.stack(after, losses + (after == _LOST) * changed))


class ContactMonitor(Diagram):
    """`ContactMonitorCore` with its state taken apart.

    ```
    name: ContactMonitor
    input_ports: [contact_force]
    output_ports: [contact_state, contact_losses]
    ```

    contact_force: shape (n,), truth [N].
    contact_state: shape (n,), see `ContactMode` [1]. contact_losses: shape (n,), how many so far [1].
    All outputs are state, no direct feedthrough.

    Sampling: every `period` [s]; the outputs change one tick after the force they are from.
    """

    def __init__(self, size: int, *, period: float = 0.002, threshold: float = 1e-9):
        super().__init__()
        builder = DiagramBuilder()
        core = builder.AddNamedSystem("core", ContactMonitorCore(size, period=period, threshold=threshold))
        parts = builder.AddNamedSystem("parts", Demultiplexer([size] * 2))
        builder.Connect(core.GetOutputPort("state"), parts.get_input_port())
        builder.ExportInput(core.GetInputPort("contact_force"), "contact_force")
        builder.ExportOutput(parts.get_output_port(0), "contact_state")
        builder.ExportOutput(parts.get_output_port(1), "contact_losses")
        builder.BuildInto(self)
