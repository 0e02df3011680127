"""The uneven surface of a station: path coordinate of the tool, height of the surface there.

    s = d'(p(q) - p(q_0)),    what the contact gets is dx - h(s)

A flat surface adds no block.
"""

from __future__ import annotations

from pydrake.systems.framework import DiagramBuilder, OutputPort
from pydrake.systems.primitives import Adder, Gain

from forcectl.diagrams.parts import affine
from forcectl.diagrams.station import Cell, Vector
from forcectl.plant.surface import SurfaceHeight, SurfaceProfile
from forcectl.plant.tip_kinematics import TipDisplacement


def surface_profile(cell: Cell) -> SurfaceProfile:
    """The surface as the ball of the cell's tool meets it."""
    tool = cell.robot.tool_facts
    return cell.config.environment.surface.profile(tool.contact_ball_radius if tool else 0.0)


def add_surface_height(
    builder: DiagramBuilder, cell: Cell, joint_position: OutputPort, start: Vector
) -> OutputPort | None:
    """Add the path coordinate and the height of the surface there, shape (1,) [m]; nothing when it is flat.

    Args:
        joint_position: of the side that counts as the tool's, shape (n_q,) [rad]. start: where it starts, s = 0.
    """
    if cell.config.environment.surface.flat:
        return None
    d = cell.config.environment.surface.direction_across(cell.n)
    if cell.config.fidelity == "OneDimensional":
        row = (d @ cell.robot.jacobian(cell.start_context())[3:]).reshape(1, -1)
        path = builder.AddNamedSystem("path_position", affine(row, -row @ start))
    else:
        tangent = TipDisplacement(cell.robot, d, start, period=cell.config.posture_period)
        path = builder.AddNamedSystem("path_position", tangent)
    height = builder.AddNamedSystem("surface_height", SurfaceHeight(surface_profile(cell)))
    builder.Connect(joint_position, path.get_input_port(0))
    builder.Connect(path.get_output_port(0), height.GetInputPort("path_position"))
    return height.GetOutputPort("surface_height")


def add_depth(builder: DiagramBuilder, displacement: OutputPort, height: OutputPort) -> OutputPort:
    """dx - h, shape (1,) [m]."""
    negative = builder.AddNamedSystem("negative_height", Gain(-1.0, 1))
    depth = builder.AddNamedSystem("depth", Adder(2, 1))
    builder.Connect(height, negative.get_input_port())
    builder.Connect(displacement, depth.get_input_port(0))
    builder.Connect(negative.get_output_port(), depth.get_input_port(1))
    return depth.get_output_port()
