"""A system and the blocks it was added with, as one diagram with the ports of the system."""

from __future__ import annotations

from pydrake.systems.framework import Diagram, DiagramBuilder, System

from forcectl.framework.wiring import export_all_outputs


class Enclosed(Diagram):
    """What a configuration added to a builder of its own.

    ```
    name: Enclosed
    input_ports: [(further inputs of the system)]
    output_ports: [(further outputs of the system)]
    ```

    The ports are those of the system. All outputs are feedthrough of all inputs when those of the system are.

    Sampling: every `period` [s] the system and the blocks that belong to it.

    Args:
        builder: holds the system and whatever blocks belong to it; it is built into this diagram.
        system: whose ports are exported.
    """

    def __init__(self, builder: DiagramBuilder, system: System):
        super().__init__()
        self.optional_inputs = tuple(getattr(system, "optional_inputs", ()))
        for port in map(system.get_input_port, range(system.num_input_ports())):
            builder.ExportInput(port, port.get_name())
        export_all_outputs(builder, system)
        builder.BuildInto(self)
