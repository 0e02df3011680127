"""Parts of assemblies in a station: their grasps, the grippers, their poses, and contacts without meshes."""

from __future__ import annotations

import numpy as np
from pydrake.multibody.plant import ExternallyAppliedSpatialForceMultiplexer, MultibodyPlant
from pydrake.systems.framework import DiagramBuilder, OutputPort
from pydrake.systems.primitives import MatrixGain

from forcectl.diagrams.mechanics.assembly import Assembly, selector
from forcectl.diagrams.mechanics.site import Site
from forcectl.framework.wiring import through
from forcectl.plant.contact.gripper_opening import Grasp, GripperOpening
from forcectl.plant.contact.part_pose import PartPose


def add_parts(assembly: Assembly, site: Site) -> None:
    """Add the grasps of parts, and the poses of the parts."""
    builder, plant, arms, held = assembly.builder, site.plant, list(site.parts.arms), site.held
    if held:
        grasps = [Grasp(arms.index(part.config.arm), part.config.grasp, not part.config.lies_at) for part in held]
        opening = GripperOpening(grasps, len(arms), period=site.period)
        builder.AddNamedSystem("gripper_opening", opening)
        rows = [joint.position_start() for part in held for joint in part.springs]
        offset = selector(plant.num_multibody_states(), rows, "grasp_offset")
        state = plant.get_state_output_port()
        builder.Connect(through(builder, "grasp_offset", offset, state), opening.GetInputPort("grasp_offset"))
        for i, part in enumerate(held):
            desired = opening.GetOutputPort(f"desired_state_{i + 1}")
            builder.Connect(desired, plant.get_desired_state_input_port(part.grasp))
        for name in ("part_released", "gripper_holds"):
            assembly.offer(name, opening.GetOutputPort(name))
        assembly.require("gripper_command", opening.GetInputPort("gripper_command"))
    if site.placed:
        assembly.add(builder.AddNamedSystem("part_pose", PartPose([part.frame for part in site.placed])))


def add_pairs(assembly: Assembly, site: Site) -> list[OutputPort]:
    """Add contacts of parts without meshes; returns their forces on the plant."""
    builder, plant, held, forces = assembly.builder, site.plant, site.held, []
    for i, each in enumerate(site.pairs):
        contact = each.config.contact(plant, each.tip, each.mouth, site.workcell.config.time_step)
        block = builder.AddNamedSystem(f"{each.name}_contact", contact)
        builder.Connect(assembly.signals["body_poses"], block.GetInputPort("body_poses"))
        builder.Connect(plant.get_body_spatial_velocities_output_port(), block.GetInputPort("body_velocities"))
        if held:
            gain = np.array([[float(part is end) for part in held] for end in each.ends])
            rows = through(builder, f"{each.name}_released", MatrixGain(gain), assembly.signals["part_released"])
            builder.Connect(rows, block.GetInputPort("released"))
        assembly.offer(f"contact_pair_{i + 1}", block.GetOutputPort("contact_pair"))
        forces.append(block.GetOutputPort("spatial_forces"))
    return forces


def apply_forces(builder: DiagramBuilder, plant: MultibodyPlant, forces: list[OutputPort]) -> None:
    """Connect lists of spatial forces to the plant."""
    if len(forces) > 1:
        every = builder.AddNamedSystem("spatial_forces", ExternallyAppliedSpatialForceMultiplexer(len(forces)))
        for i, port in enumerate(forces):
            builder.Connect(port, every.get_input_port(i))
        forces = [every.get_output_port()]
    for port in forces:
        builder.Connect(port, plant.get_applied_spatial_force_input_port())
