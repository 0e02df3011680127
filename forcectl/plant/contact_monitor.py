"""Contact state and contact loss as an event.

    mode: APPROACH -> CONTACT when F > threshold;  CONTACT -> LOST when F <= 0;  LOST -> CONTACT when F > threshold
"""

from __future__ import annotations

from enum import Enum

from pydrake.common.value import AbstractValue
from pydrake.systems.framework import BasicVector, Context, LeafSystem, State

from forcectl.lanes import check


class ContactMode(Enum):
    """Where a contact stands."""

    APPROACH = 0
    CONTACT = 1
    LOST = 2


def next_mode(mode: ContactMode, force: float, threshold: float) -> ContactMode:
    """The mode after a sample of the true contact force [N]."""
    if force > threshold:
        return ContactMode.CONTACT
    if mode is ContactMode.CONTACT and force <= 0:
        return ContactMode.LOST
    return mode


class ContactMonitor(LeafSystem):
    """Keeps the contact mode of n lanes and counts the losses.

    ```
    name: ContactMonitor
    input_ports: [contact_force]
    output_ports: [contact_state, contact_losses]
    ```

    contact_force: shape (n,), truth [N].
    contact_state: shape (n,), value of `ContactMode` (0 approach, 1 contact, 2 lost). State, no direct feedthrough.
    contact_losses: shape (n,), number of times the contact was lost so far. State, no direct feedthrough.

    The mode is abstract state, changed by a declared event every `period` [s]; a loss shows in the same tick.
    """

    def __init__(self, size: int, *, period: float = 0.002, threshold: float = 1e-9):
        super().__init__()
        self._threshold = check("threshold", threshold, "not negative")
        self._force = self.DeclareVectorInputPort("contact_force", size)
        self._modes = self.DeclareAbstractState(AbstractValue.Make([ContactMode.APPROACH] * size))
        self._losses = self.DeclareDiscreteState(size)
        self.DeclareVectorOutputPort(
            "contact_state",
            size,
            self._state_output,
            prerequisites_of_calc={self.abstract_state_ticket(self._modes)},
        )
        self.DeclareStateOutputPort("contact_losses", self._losses)
        self.DeclarePeriodicUnrestrictedUpdateEvent(period_sec=period, offset_sec=0.0, update=self._update)

    def _update(self, context: Context, state: State) -> None:
        forces = self._force.Eval(context).tolist()
        modes = context.get_abstract_state(int(self._modes)).get_value()
        after = [next_mode(mode, force, self._threshold) for mode, force in zip(modes, forces, strict=True)]
        if after == modes:
            return
        losses = context.get_discrete_state(self._losses).value() + [
            float(a is ContactMode.LOST and b is not a) for b, a in zip(modes, after, strict=True)
        ]
        state.get_mutable_abstract_state(int(self._modes)).set_value(after)
        state.get_mutable_discrete_state(self._losses).SetFromVector(losses)

    def _state_output(self, context: Context, output: BasicVector) -> None:
        modes = context.get_abstract_state(int(self._modes)).get_value()
        output.SetFromVector([float(mode.value) for mode in modes])
