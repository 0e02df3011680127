"""Default contexts for the examination of a diagram and of its single blocks, with fixed inputs."""

from __future__ import annotations

import numpy as np
from pydrake.geometry import SceneGraph
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.framework import Context, System

from forcectl.framework.wiring import optional_inputs
from forcectl.inspect.wiring import Wiring, context_of, is_vector

# A failed precondition in C++ can raise SystemExit, which must not end the process.
FAILURES = (Exception, SystemExit)


def is_library_plant(system: System) -> bool:
    """Whether the block is a plant or scene graph of Drake: many ports, most of them optional by design."""
    return isinstance(system, MultibodyPlant | SceneGraph)


class StartValues:
    """Default contexts of the whole diagram and of single blocks, with unconnected vector inputs fixed to zero."""

    def __init__(self, wiring: Wiring):
        self.wiring = wiring
        self.root: Context | None = None
        if wiring.root is not None:
            self.root = wiring.root.CreateDefaultContext()
            fix_open_inputs(wiring, self.root)

    def block_context(self, path: str) -> Context:
        """A context of one block alone, with its inputs fixed to their values at the start of the whole diagram."""
        system = self.wiring.systems[path]
        context = system.CreateDefaultContext()
        here = None if self.root is None else context_of(system, self.wiring.root, self.root)
        for address in self.wiring.inputs(path):
            port = self.wiring.port(address)
            try:
                if here is not None and port.HasValue(here):
                    port.FixValue(context, port.EvalAbstract(here).Clone())
                    continue
            except FAILURES:
                pass  # the block that feeds this input fails; it is reported on its own
            if here is None and is_vector(port) and port.get_name() not in optional_inputs(system):
                port.FixValue(context, np.zeros(port.size()))
        return context


def fix_open_inputs(wiring: Wiring, root: Context) -> None:
    """Fix unconnected vector inputs of a diagram and of its blocks to zero; inputs that have a value keep it."""
    for reader in [*wiring.inputs(""), *wiring.leaf_inputs()]:
        system, port = wiring.systems[reader.system], wiring.port(reader)
        fed = bool(reader.system) and wiring.source(reader) is not None
        # An unconnected input of a plant means that nothing is applied; a zero could enable a function of the plant.
        optional = bool(reader.system) and (is_library_plant(system) or port.get_name() in optional_inputs(system))
        context = context_of(system, wiring.root, root)
        if is_vector(port) and not fed and not optional and not port.HasValue(context):
            port.FixValue(context, np.zeros(port.size()))
