"""Replay of a run: robot, environment and forces in three dimensions, as one HTML page without any network access.

Drawn from the log alone, so it works for every fidelity. Motions are true to scale. An uneven surface moves by its
height under the tool, as the tool sees it; its grooves are dark lines on the plate. Blue bars are true forces, orange
ones estimates.
"""

from __future__ import annotations

import gc
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

from forcectl.diagrams.workcell import Contact, Workcell
from forcectl.models import add_packages
from forcectl.robot.parts import add_robot

FRAMES = 32.0  # pictures per second of simulated time
ARROW = 0.02  # [m/N] length of the bars that show forces
_LEAST = 0.05  # [N] of a force that is shown
_BLUE, _DARK = Rgba(0.0, 0.45, 0.7, 1.0), Rgba(0.15, 0.15, 0.17, 1.0)
_ORANGE, _WOOD = Rgba(0.84, 0.37, 0.0, 1.0), Rgba(0.75, 0.6, 0.42, 1.0)
_LOOKS = {"tip_wrench": (0.010, _BLUE), "estimated_wrench": (0.007, _ORANGE)}  # width [m], colour
_PLATE = 0.3, 0.2  # [m] length and width of the plate


def write_replay(log: xr.Dataset, workcell: Workcell, path: Path) -> None:
    """Write the replay of one variant.

    Args:
        log: over time, with `link_position` or `motor_position`, and forces.
        workcell: what was simulated.
        path: HTML file to write.
    """
    try:
        _draw(log, workcell, path)
    finally:
        # Drake ends the process when a Meshcat is destroyed in another thread than the one that made it, and a diagram
        # of Python is a cycle of references: left alone it would go in whichever thread collects it.
        gc.collect()


def _draw(log: xr.Dataset, workcell: Workcell, path: Path) -> None:
    builder = DiagramBuilder()
    plant, scene_graph = AddMultibodyPlantSceneGraph(builder, 0.0)
    parts = add_robot(plant, workcell.config.robot, workcell.config.tool)
    plates = [_Plate(plant, contact, i) for i, contact in enumerate(workcell.contacts)]
    plant.Finalize()
    scene = Scene(builder, plant, scene_graph)
    meshcat, own = scene.meshcat, scene.plant_context
    for i, obstacle in enumerate(workcell.obstacles.values()):
        meshcat.SetObject(f"obstacles/{i}", Box(*obstacle.size), _WOOD)
        meshcat.SetTransform(f"obstacles/{i}", obstacle.pose)
    for plate in plates:
        plate.draw_grooves(meshcat)
    if plates:
        tip = plates[0].X_WE.translation()
        meshcat.SetCameraPose(tip + np.array([0.3, -1.4, 0.3]), 0.85 * tip)
    bars = {
        name: [_ForceBar(meshcat, f"{name}/{arm}", *look) for arm in parts.arms]
        for name, look in _LOOKS.items()
        if name in log
    }
    beside = [_ForceBar(meshcat, plate.name("force"), 0.012, _BLUE) for plate in plates]
    joints = log["link_position" if "link_position" in log else "motor_position"].values
    positions, indices = plant.GetPositions(own), [joint.position_start() for joint in parts.joints]

    def draw(k: int, when: float) -> None:
        positions[indices] = joints[k]
        height = float(log["surface_height"].values[k]) if "surface_height" in log else 0.0
        for plate in plates:
            plate.move(meshcat, positions, height, when)
        plant.SetPositions(own, positions)
        tips = [part.tcp_frame.CalcPoseInWorld(own).translation() for part in parts.arms.values()]
        for name, of_arms in bars.items():
            forces = log[name].values[k].reshape(-1, 6)[:, 3:]
            for bar, tip, force in zip(of_arms, tips, forces, strict=True):
                bar.draw(tip - ARROW * force, force, when)  # it ends where the force acts
        pressed = np.atleast_1d(log["contact_force"].values[k]) if plates else ()
        for bar, plate, force in zip(beside, plates, pressed, strict=True):
            bar.draw(plate.foot, float(force) * plate.n, when)

    scene.record(log["time"].values, draw, path)


class _Plate:
    """The plate that the surface of a contact is drawn as; the plant is not finalized."""

    def __init__(self, plant: MultibodyPlant, contact: Contact, index: int):
        self.n, self._index = contact.n, index
        # The surface frame has its z axis along n, and its x axis along the path over an uneven surface.
        self._uneven = None if contact.surface is None or contact.surface.flat else contact.surface
        R_WE = RotationMatrix.MakeFromOneVector(self.n, 2)
        if self._uneven:
            d = self._uneven.direction_across(self.n)
            R_WE = RotationMatrix(np.column_stack([d, np.cross(self.n, d), self.n]))
        self.X_WE = RigidTransform(R_WE, contact.robot.pose(contact.robot.context_at(contact.start)).translation())
        # A bar stands beside the tool, where it does not go, and grows along n.
        self.foot = self.X_WE @ ([-0.12, 0.08, 0.0] if self._uneven else [0.1, 0.0, 0.0])
        parser = Parser(plant)
        parser.SetAutoRenaming(True)
        add_packages(parser.package_map())
        (plate,) = parser.AddModelsFromUrl("package://spring_plate/spring_plate.urdf")
        top = plant.GetFrameByName("surface", plate)
        self._slide = None
        if self._uneven:
            guide = plant.AddFrame(FixedOffsetFrame("surface_guide", plant.world_frame(), self.X_WE, plate))
            self._slide = plant.AddJoint(PrismaticJoint("surface_slide", guide, top, [0.0, 0.0, 1.0]))
        else:
            plant.WeldFrames(plant.world_frame(), top, self.X_WE)

    def name(self, what: str) -> str:
        return what if self._index == 0 else f"{what}_{self._index + 1}"

    def draw_grooves(self, meshcat: Meshcat) -> None:
        meshcat.SetTransform(self.name("grooves"), self.X_WE)
        if not self._uneven:
            return
        parts = [part for part in self._uneven.heights.values() if hasattr(part, "lines")]
        lines = [line for part in parts for line in part.lines(self._uneven.length)]
        for i, (centre, width) in enumerate(line for line in lines if abs(line[0]) < _PLATE[0] / 2):
            line = f"{self.name('grooves')}/lines/{i}"
            meshcat.SetObject(line, Box(width, _PLATE[1], 2e-4), _DARK)
            meshcat.SetTransform(line, RigidTransform([centre, 0.0, 0.0]))

    def move(self, meshcat: Meshcat, positions: NDArray[np.float64], height: float, when: float) -> None:
        """Raise it to a height [m]."""
        if self._slide is not None:
            positions[self._slide.position_start()] = height
            meshcat.SetTransform(f"{self.name('grooves')}/lines", RigidTransform([0.0, 0.0, height]), when)


class _ForceBar:
    """A bar of a width [m] that shows a force: `ARROW` long per newton, hidden below `_LEAST`."""

    def __init__(self, meshcat: Meshcat, path: str, width: float, colour: Rgba):
        self._meshcat, self._path = meshcat, path
        meshcat.SetObject(path, Box(width, width, 1.0), colour)

    def draw(self, start: NDArray[np.float64], force: NDArray[np.float64], when: float) -> None:
        """Draw it from a point (3,) [m] along a force (3,) [N], both in W, at a time [s] of the recording."""
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
        meshcat: for what is drawn beside the plant.
        plant_context: to set its positions in.
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
            times: of its samples [s].
            draw: sets `plant_context`, and what is drawn beside it, to sample k, at a time [s].
            path: HTML file to write.
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
