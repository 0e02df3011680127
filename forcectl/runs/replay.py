"""Replay of a run: robot, surface and contact force in three dimensions, as one HTML page without any network access.

Drawn from the log alone, so it works for every fidelity. Motions are true to scale. An uneven surface moves by its
height under the tool, as the tool sees it; its grooves are dark lines on the plate.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from pathlib import Path

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from pydrake.geometry import (
    Box,
    Meshcat,
    MeshcatParams,
    MeshcatVisualizer,
    MeshcatVisualizerParams,
    Rgba,
    Role,
    SceneGraph,
)
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph, MultibodyPlant
from pydrake.multibody.tree import FixedOffsetFrame, PrismaticJoint
from pydrake.systems.framework import Context, DiagramBuilder

from forcectl.diagrams.station import StationConfig, describe
from forcectl.models import add_packages
from forcectl.robot.model import add_robot

FRAMES = 32.0  # pictures per second of simulated time
ARROW = 0.02  # [m/N] length of the bars that show forces
_LEAST = 0.05  # [N] of a force that is shown
_BLUE, _DARK = Rgba(0.0, 0.45, 0.7, 1.0), Rgba(0.15, 0.15, 0.17, 1.0)
_PLATE = np.array([0.3, 0.2])  # [m] length and width of the plate


def write_replay(log: xr.Dataset, station: StationConfig, path: Path) -> None:
    """Write the replay of one variant.

    Args:
        log: over time, with `motor_position`, `contact_force` and, for an uneven surface, `surface_height`.
        station: what was simulated.
        path: HTML file to write.
    """
    cell = describe(station)
    context = cell.robot.create_context()
    cell.robot.set_positions(context, cell.start)
    # The surface frame has its z axis along n, and its x axis along the path over an uneven surface.
    surface = station.environment.surface
    uneven = None if surface.flat else surface
    R_WE = RotationMatrix.MakeFromOneVector(cell.n, 2)
    if uneven:
        d = uneven.direction_across(cell.n)
        R_WE = RotationMatrix(np.column_stack([d, np.cross(cell.n, d), cell.n]))
    X_WE = RigidTransform(R_WE, cell.robot.pose(context).translation())
    builder = DiagramBuilder()
    plant, scene_graph = AddMultibodyPlantSceneGraph(builder, 0.0)
    joints = add_robot(plant, station.robot, station.tool).joints
    parser = Parser(plant)
    add_packages(parser.package_map())
    (plate,) = parser.AddModelsFromUrl("package://spring_plate/spring_plate.sdf")
    top = plant.GetFrameByName("surface", plate)
    if uneven:
        guide = plant.AddFrame(FixedOffsetFrame("surface_guide", plant.world_frame(), X_WE))
        plant.AddJoint(PrismaticJoint("surface_slide", guide, top, [0.0, 0.0, 1.0]))
    else:
        plant.WeldFrames(plant.world_frame(), top, X_WE)
    plant.Finalize()
    scene = Scene(builder, plant, scene_graph)
    meshcat, own = scene.meshcat, scene.plant_context
    positions, indices = plant.GetPositions(own), [joint.position_start() for joint in joints]
    # The bar stands beside the tool, where it does not go, and grows along n.
    bar, foot = ForceBar(meshcat, "force", 0.012, _BLUE), X_WE @ ([-0.12, 0.08, 0.0] if uneven else [0.1, 0.0, 0.0])
    meshcat.SetTransform("grooves", X_WE)
    if uneven and uneven.grooves:
        on_plate = (c for c in uneven.grooves.centres(uneven.length) if abs(c) < _PLATE[0] / 2)
        for i, centre in enumerate(on_plate):
            meshcat.SetObject(f"grooves/lines/{i}", Box(uneven.grooves.width, _PLATE[1], 2e-4), _DARK)
            meshcat.SetTransform(f"grooves/lines/{i}", RigidTransform([centre, 0.0, 0.0]))
    tip = X_WE.translation()
    meshcat.SetCameraPose(tip + np.array([0.3, -1.4, 0.3]), 0.85 * tip)

    def draw(k: int, when: float) -> None:
        positions[indices] = log["motor_position"].values[k]
        if uneven:
            height = float(log["surface_height"].values[k])
            positions[plant.GetJointByName("surface_slide").position_start()] = height
            meshcat.SetTransform("grooves/lines", RigidTransform([0.0, 0.0, height]), when)
        plant.SetPositions(own, positions)
        bar.draw(foot, float(log["contact_force"].values[k]) * cell.n, when)

    scene.record(log["time"].values, draw, path)


class ForceBar:
    """A bar that shows a force: `ARROW` long per newton, hidden below `_LEAST`.

    Args:
        meshcat: to draw in.
        path: of the bar in the page; nothing else may be drawn there.
        width: of its square section [m].
        colour: of the bar.
    """

    def __init__(self, meshcat: Meshcat, path: str, width: float, colour: Rgba):
        self._meshcat, self._path = meshcat, path
        meshcat.SetObject(path, Box(width, width, 1.0), colour)

    def draw(self, start: NDArray[np.float64], force: NDArray[np.float64], when: float) -> None:
        """Draw it from a point along a force.

        Args:
            start: in W (3,) [m].
            force: in W (3,) [N].
            when: time in the recording [s].
        """
        size = float(np.linalg.norm(force))
        shown = size > _LEAST
        self._meshcat.SetProperty(self._path, "visible", shown, when)
        if shown:  # the place of a hidden bar is nowhere, also in the log of a run that ended in NaN
            X_WF = RigidTransform(RotationMatrix.MakeFromOneVector(force, 2), start)
            length = ARROW * size
            self._meshcat.SetTransform(self._path, X_WF @ RigidTransform([0.0, 0.0, length / 2]), when)
            # Scaled are the axes of the shape itself. Those of a box are Drake's; a cylinder of Meshcat's lies along y.
            self._meshcat.SetProperty(f"{self._path}/<object>", "scale", [1.0, 1.0, length], when)


class Scene:
    """A plant as it is seen in a replay.

    Args:
        builder: holds `plant` and `scene_graph` only; it is built here.

    Attributes:
        meshcat: for what is drawn beside the plant. plant_context: to set its positions in.
    """

    def __init__(self, builder: DiagramBuilder, plant: MultibodyPlant, scene_graph: SceneGraph):
        self.meshcat = _quiet_meshcat()
        self._visualizer = MeshcatVisualizer.AddToBuilder(
            builder, scene_graph, self.meshcat, MeshcatVisualizerParams(role=Role.kIllustration)
        )
        self._diagram = builder.Build()
        self._root = self._diagram.CreateDefaultContext()
        self.plant_context: Context = plant.GetMyMutableContextFromRoot(self._root)

    def record(self, times: NDArray[np.float64], draw: Callable[[int, float], None], path: Path) -> None:
        """Write the pictures of a log.

        Args:
            times: of its samples [s]. draw: sets `plant_context`, and what is drawn beside it, to sample k, at a time
                [s]. path: HTML file to write.
        """
        self._visualizer.StartRecording()
        wanted = np.arange(0.0, times[-1] - times[0] + 0.5 / FRAMES, 1 / FRAMES)
        for k in np.searchsorted(times, times[0] + wanted).clip(max=len(times) - 1):
            when = float(times[k])
            self._root.SetTime(when)
            draw(k, when)
            self._diagram.ForcedPublish(self._root)
        self._visualizer.StopRecording()
        self._visualizer.PublishRecording()
        path.write_text(self.meshcat.StaticHtml(), encoding="utf-8")


def _quiet_meshcat() -> Meshcat:
    """A Meshcat that does not announce the address of a server that nobody is meant to visit, nor let others in."""
    logger = logging.getLogger("drake")
    level = logger.level
    logger.setLevel(logging.WARNING)
    try:
        return Meshcat(MeshcatParams(host="localhost"))
    finally:
        logger.setLevel(level)
