"""Motion as it is commanded: `drive: !Commanded`, of stations without dynamics."""

from __future__ import annotations

from dataclasses import dataclass

from pydrake.systems.framework import DiagramBuilder

from forcectl.diagrams.mechanics.site import Site
from forcectl.errors import BadInputError
from forcectl.framework.fields import Config
from forcectl.plant.drives.commanded import CommandedMotion


@dataclass(kw_only=True)
class CommandedDriveConfig(Config):
    """Scenario part `drive: !Commanded`: no lag, no friction; position and speed are those commanded, a tick later."""

    def add_to(self, builder: DiagramBuilder, site: Site) -> CommandedMotion:
        """Add the block `drive`.

        Raises:
            BadInputError: a fidelity with dynamics, in which motors have inertia.
        """
        workcell = site.workcell
        if workcell.has_dynamics:
            raise BadInputError(
                " = !Commanded: must have a fidelity without dynamics, such as OneDimensional", key="drive"
            )
        motion = CommandedMotion(workcell.num_joints, start=workcell.motor_start, period=workcell.period)
        return builder.AddNamedSystem("drive", motion)
