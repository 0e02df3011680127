"""Replay of a motion loop: robot, obstacles and the forces at its tool centre points, as one HTML page."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import xarray as xr
from pydrake.geometry import Box, Cylinder, Rgba
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.systems.framework import DiagramBuilder

from forcectl.diagrams.research_cell import ResearchStationConfig
from forcectl.robot import add_robot
from forcectl.simulation.replay import ARROW, Scene

_TRUE, _ESTIMATED = Rgba(0.0, 0.45, 0.7, 1.0), Rgba(0.84, 0.37, 0.0, 1.0)
_WOOD = Rgba(0.75, 0.6, 0.42, 1.0)
_LEAST = 0.05  # [N] shorter bars are not drawn


def write_motion_replay(log: xr.Dataset, station: ResearchStationConfig, path: Path) -> None:
    """Write the replay of one variant: blue bars are true forces, orange ones estimates.

    Args:
        log: over time, with `link_position`, `tip_wrench` and perhaps `estimated_wrench`.
        station: what was simulated. path: HTML file to write.
    """
    builder = DiagramBuilder()
    plant, scene_graph = AddMultibodyPlantSceneGraph(builder, 0.0)
    parts = add_robot(plant, station.robot, station.tool)
    plant.Finalize()
    scene = Scene(builder, plant, scene_graph)
    meshcat, own = scene.meshcat, scene.plant_context
    for i, obstacle in enumerate(station.obstacles):
        meshcat.SetObject(f"obstacles/{i}", Box(*obstacle.size), _WOOD)
        meshcat.SetTransform(f"obstacles/{i}", obstacle.pose)
    bars = [("tip_wrench", _TRUE, 0.006)]
    if "estimated_wrench" in log:
        bars.append(("estimated_wrench", _ESTIMATED, 0.004))
    for name, colour, radius in bars:
        for arm in parts.arms:
            meshcat.SetObject(f"{name}/{arm}/bar", Cylinder(radius, 1.0), colour)
    positions, indices = plant.GetPositions(own), [joint.position_start() for joint in parts.joints]

    def draw(k: int, when: float) -> None:
        positions[indices] = log["link_position"].values[k]
        plant.SetPositions(own, positions)
        for name, _, _ in bars:
            wrenches = log[name].values[k].reshape(-1, 6)
            for (arm, part), wrench in zip(parts.arms.items(), wrenches, strict=True):
                force, tip = wrench[3:], part.tcp_frame.CalcPoseInWorld(own).translation()
                size = float(np.linalg.norm(force))
                along = RotationMatrix.MakeFromOneVector(force, 2) if size > _LEAST else RotationMatrix()
                length = ARROW * size if size > _LEAST else 1e-4
                # It ends where the force acts.
                X_WB = RigidTransform(along, tip) @ RigidTransform([0.0, 0.0, -0.5 * length])
                meshcat.SetTransform(f"{name}/{arm}", X_WB, when)
                meshcat.SetProperty(f"{name}/{arm}/bar/<object>", "scale", [1.0, 1.0, length], when)

    scene.record(log["time"].values, draw, path)
