"""Replay of a motion loop: robot, obstacles and the forces at its tool centre points, as one HTML page."""

from __future__ import annotations

from pathlib import Path

import xarray as xr
from pydrake.geometry import Box, Rgba
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.systems.framework import DiagramBuilder

from forcectl.diagrams.research_cell import ResearchStationConfig
from forcectl.robot.model import add_robot
from forcectl.runs.replay import ARROW, ForceBar, Scene

_TRUE, _ESTIMATED = Rgba(0.0, 0.45, 0.7, 1.0), Rgba(0.84, 0.37, 0.0, 1.0)
_WOOD = Rgba(0.75, 0.6, 0.42, 1.0)


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
    looks = {"tip_wrench": (0.010, _TRUE), "estimated_wrench": (0.007, _ESTIMATED)}
    bars = {
        name: [ForceBar(meshcat, f"{name}/{arm}", *look) for arm in parts.arms]
        for name, look in looks.items()
        if name in log
    }
    positions, indices = plant.GetPositions(own), [joint.position_start() for joint in parts.joints]

    def draw(k: int, when: float) -> None:
        positions[indices] = log["link_position"].values[k]
        plant.SetPositions(own, positions)
        tips = [part.tcp_frame.CalcPoseInWorld(own).translation() for part in parts.arms.values()]
        for name, of_arms in bars.items():
            forces = log[name].values[k].reshape(-1, 6)[:, 3:]
            for bar, tip, force in zip(of_arms, tips, forces, strict=True):
                bar.draw(tip - ARROW * force, force, when)  # it ends where the force acts

    scene.record(log["time"].values, draw, path)
