"""Replay of a run: robot, environment and forces in three dimensions, as one HTML page without any network access.

Drawn from the log alone, so it works for every fidelity. Motions are true to scale. An uneven surface is moved as a
whole by its height under the tool; its grooves are dark lines on the plate. A surface whose normal varies stands still
and is drawn in strips. Blue arrows are true forces, orange ones estimates; the page labels them and shows the time and
the mode of a state machine.
"""

from __future__ import annotations

import gc
import logging
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
import xarray as xr
from pydrake.common.eigen_geometry import Quaternion
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
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import FixedOffsetFrame, PrismaticJoint
from pydrake.systems.framework import Context, DiagramBuilder

from forcectl.analysis.transitions import stays
from forcectl.arrays import Array, Indices
from forcectl.diagrams.mechanics.placed_part import parse_part
from forcectl.diagrams.workcell import Contact, Workcell
from forcectl.models import add_packages
from forcectl.plant.contact.part import PartConfig
from forcectl.plant.contact.surface import SurfaceProfile
from forcectl.robot.parts import add_plant, add_robot
from forcectl.runs.replay.forces import BESIDE, Arrow, ShownForce, forces_of
from forcectl.runs.replay.page import with_panel
from forcectl.tasks.coordinates import ArmTask

FRAMES = 32.0  # pictures per second of simulated time
_DARK, _WOOD = Rgba(0.15, 0.15, 0.17, 1.0), Rgba(0.75, 0.6, 0.42, 1.0)
_PLATE = 0.3, 0.2  # [m] length and width of the plate
_STRIPS, _THICK = 60, 1e-3  # strips of a curved surface: number, thickness [m]


def write_replay(
    log: xr.Dataset, workcell: Workcell, path: Path, *, title: str = "", tasks: Mapping[str, ArmTask] | None = None
) -> None:
    """Write the replay of one variant.

    Args:
        log: over time, with `link_position` or `motor_position`, and forces.
        workcell: what was simulated.
        path: HTML file to write.
        title: heading.
        tasks: those of `task_wrench` in the log, by name, in their order.
    """
    try:
        path.write_text(_drawn(log, workcell, title, tasks or {}), encoding="utf-8")
    finally:
        # Drake ends the process when a Meshcat is destroyed in another thread than the one that made it, and a diagram
        # of Python is a cycle of references, which any thread may collect later.
        gc.collect()


def _drawn(log: xr.Dataset, workcell: Workcell, title: str, tasks: Mapping[str, ArmTask]) -> str:
    builder = DiagramBuilder()
    plant, scene_graph = add_plant(builder, 0.0)
    parts = add_robot(plant, workcell.config.robot, workcell.config.tool)
    plates = [_Plate(plant, contact, i) for i, contact in enumerate(workcell.contacts)]
    placed = [_MovedPart(plant, name, part) for name, part in workcell.parts.items()]
    plant.Finalize()
    scene = Scene(builder, plant, scene_graph)
    meshcat, own = scene.meshcat, scene.plant_context
    # A background of one colour: a gradient shows edges unless it is seen from the side.
    for end in ("top_color", "bottom_color"):
        meshcat.SetProperty("/Background/<object>", end, [0.93, 0.93, 0.96])
    for i, obstacle in enumerate(workcell.obstacles.values()):
        meshcat.SetObject(f"obstacles/{i}", Box(*obstacle.size), _WOOD)
        meshcat.SetTransform(f"obstacles/{i}", obstacle.pose)
    for plate in plates:
        plate.draw_grooves(meshcat)
    shown = [*forces_of(log, workcell, tasks, plant, parts, own)]
    of = [f" {contact.name}" if len(plates) > 1 else "" for contact in workcell.contacts]
    shown += [plate.pressed(log, f"true, surface{name}") for plate, name in zip(plates, of, strict=True)]
    arrows = [Arrow(meshcat, force.path, force.look) for force in shown]
    joints = log["link_position" if "link_position" in log else "motor_position"].values
    positions, indices = plant.GetPositions(own), [joint.position_start() for joint in parts.joints]

    def draw(k: int, when: float) -> None:
        positions[indices] = joints[k]
        height = float(log["surface_height"].values[k]) if "surface_height" in log else 0.0
        for plate in plates:
            plate.move(meshcat, positions, height, when)
        plant.SetPositions(own, positions)
        for i, part in enumerate(placed):
            place, turn = log["part_position"].values[k], log["part_orientation"].values[k]
            part.move(own, place[3 * i : 3 * i + 3], turn[4 * i : 4 * i + 4])
        for arrow, force in zip(arrows, shown, strict=True):
            arrow.draw(*force.at(k), when)

    times = log["time"].values
    wanted = np.arange(0.0, times[-1] - times[0] + 0.5 / FRAMES, 1 / FRAMES)
    pictures = np.searchsorted(times, times[0] + wanted).clip(max=len(times) - 1)
    positions[indices] = joints[0]
    plant.SetPositions(own, positions)
    tip = np.mean([arm.tcp_frame.CalcPoseInWorld(own).translation() for arm in parts.arms.values()], axis=0)
    if plates:
        tip = plates[0].X_WE.translation()
        meshcat.SetCameraPose(tip + np.array([0.3, -1.4, 0.3]), 0.85 * tip)
    else:
        beside = tip + np.array([-0.05, -0.09, 0.0])  # the panel stands at the left
        meshcat.SetCameraPose(beside + np.array([0.6, -0.35, 0.3]), beside)
    return with_panel(scene.record(times, pictures, draw), title, times, pictures, stays(log), shown)


class _Plate:
    """The plate that represents the surface of a contact, added to a plant that is not finalized."""

    def __init__(self, plant: MultibodyPlant, contact: Contact, index: int):
        self.n, self._index = contact.n, index
        # The surface frame has its z axis along n, and its x axis along the path over an uneven surface.
        self._uneven = None if contact.surface is None or contact.surface.flat else contact.surface
        R_WE = RotationMatrix.MakeFromOneVector(self.n, 2)
        if self._uneven:
            d = self._uneven.direction_across(self.n)
            R_WE = RotationMatrix(np.column_stack([d, np.cross(self.n, d), self.n]))
        self.X_WE = RigidTransform(R_WE, contact.robot.pose(contact.robot.context_at(contact.start)).translation())
        # The arrow stands beside the path of the tool, along n.
        self._foot = self.X_WE @ ([-0.12, 0.08, 0.0] if self._uneven else [0.1, 0.0, 0.0])
        self._slide = None
        if self._uneven and self._uneven.turning:
            return
        parser = Parser(plant)
        parser.SetAutoRenaming(True)
        add_packages(parser.package_map())
        (plate,) = parser.AddModelsFromUrl("package://spring_plate/spring_plate.urdf")
        top = plant.GetFrameByName("surface", plate)
        if self._uneven:
            guide = plant.AddFrame(FixedOffsetFrame("surface_guide", plant.world_frame(), self.X_WE, plate))
            self._slide = plant.AddJoint(PrismaticJoint("surface_slide", guide, top, [0.0, 0.0, 1.0]))
        else:
            plant.WeldFrames(plant.world_frame(), top, self.X_WE)

    def pressed(self, log: xr.Dataset, label: str) -> ShownForce:
        """The force of the surface on the tool."""
        normals = self.n
        if "surface_tilt" in log:
            tilt, along = log["surface_tilt"].values.reshape(-1, 1), self.X_WE.rotation().col(0)
            normals = np.cos(tilt) * self.n - np.sin(tilt) * along
        forces = log["contact_force"].values.reshape(log.sizes["time"], -1)[:, [self._index]] * normals
        return ShownForce(label, self.name("force"), BESIDE, forces, lambda k: (self._foot, forces[k]))

    def name(self, what: str) -> str:
        return what if self._index == 0 else f"{what}_{self._index + 1}"

    def draw_grooves(self, meshcat: Meshcat) -> None:
        meshcat.SetTransform(self.name("grooves"), self.X_WE)
        if not self._uneven:
            return
        if self._uneven.turning:
            self._draw_strips(meshcat, self._uneven.profile(0.0))
            return
        parts = [part for part in self._uneven.heights.values() if hasattr(part, "lines")]
        lines = [line for part in parts for line in part.lines(self._uneven.length)]
        for i, (centre, width) in enumerate(line for line in lines if abs(line[0]) < _PLATE[0] / 2):
            line = f"{self.name('grooves')}/lines/{i}"
            meshcat.SetObject(line, Box(width, _PLATE[1], 2e-4), _DARK)
            meshcat.SetTransform(line, RigidTransform([centre, 0.0, 0.0]))

    def _draw_strips(self, meshcat: Meshcat, profile: SurfaceProfile) -> None:
        edges = np.linspace(-_PLATE[0] / 2, _PLATE[0] / 2, _STRIPS + 1)
        ends = np.column_stack([edges, profile.height(edges)])
        for i, ((s, h), (along, up)) in enumerate(zip(ends, np.diff(ends, axis=0), strict=False)):
            strip = f"{self.name('grooves')}/strips/{i}"
            meshcat.SetObject(strip, Box(float(np.hypot(along, up)), _PLATE[1], _THICK), _WOOD)
            turned = RotationMatrix.MakeYRotation(-np.arctan2(up, along))
            meshcat.SetTransform(strip, RigidTransform(turned, [s + along / 2, 0.0, h + up / 2 - _THICK / 2]))

    def move(self, meshcat: Meshcat, positions: Array, height: float, when: float) -> None:
        """Move the surface to a height [m]."""
        if self._slide is not None:
            positions[self._slide.position_start()] = height
            meshcat.SetTransform(f"{self.name('grooves')}/lines", RigidTransform([0.0, 0.0, height]), when)


class _MovedPart:
    """A part of an assembly, added to a plant that is not finalized."""

    def __init__(self, plant: MultibodyPlant, name: str, config: PartConfig):
        self._plant = plant
        self._body, self._frame = parse_part(plant, name, config)

    def move(self, context: Context, position: Array, orientation: Array) -> None:
        """Put its frame at a position (3,) [m] and a quaternion (4,) in the world."""
        X_WF = RigidTransform(Quaternion(orientation), position)
        X_BF = self._frame.CalcPose(context, self._body.body_frame())
        self._plant.SetFloatingBaseBodyPoseInWorldFrame(context, self._body, X_WF @ X_BF.inverse())


class Scene:
    """A plant with its visualization in a replay.

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

    def record(self, times: Array, pictures: Indices, draw: Callable[[int, float], None]) -> str:
        """A page with pictures of a log.

        Args:
            times: of its samples [s].
            pictures: which of them are shown.
            draw: sets `plant_context`, and what is drawn beside it, to sample k, at a time [s].
        """
        self._visualizer.StartRecording()
        for k in pictures:
            when = float(times[k])
            self._root.SetTime(when)
            draw(k, when)
            self._diagram.ForcedPublish(self._root)
        self._visualizer.StopRecording()
        self._visualizer.PublishRecording()
        return str(self.meshcat.StaticHtml())


def _quiet_meshcat() -> Meshcat:
    """A Meshcat that does not log the address of its server, and is reachable from this machine only."""
    logger = logging.getLogger("drake")
    level = logger.level
    logger.setLevel(logging.WARNING)
    try:
        return Meshcat(MeshcatParams(host="localhost"))
    finally:
        logger.setLevel(level)
