"""What several stations end in: the contact state."""

from __future__ import annotations

import numpy as np
from pydrake.systems.framework import DiagramBuilder, OutputPort
from pydrake.systems.primitives import Gain, Saturation

CONTACT_FORCE = 1e-9  # [N] from here on it is contact and not rounding


def add_contact_state(builder: DiagramBuilder, force: OutputPort) -> OutputPort:
    """1 while there is contact, else 0: the force in units of `CONTACT_FORCE`, limited to 1.

    Two C++ primitives, because every run logs it; `forcectl.plant.contact.contact_monitor` turns losses into events.
    """
    count = force.size()
    scaled = builder.AddNamedSystem("contact_scale", Gain(1 / CONTACT_FORCE, count))
    state = builder.AddNamedSystem("contact_state", Saturation(np.zeros(count), np.ones(count)))
    builder.Connect(force, scaled.get_input_port())
    builder.Connect(scaled.get_output_port(), state.get_input_port())
    return state.get_output_port()
