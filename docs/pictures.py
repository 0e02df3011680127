"""Draw pictures of the pages: the multibody station from its own geometry, and force steps on stiff, moving contact.

python docs/pictures.py
"""

from __future__ import annotations

from pathlib import Path

import matplotlib.image
import numpy as np
from matplotlib.figure import Figure
from pydrake.geometry import (
    ClippingRange,
    ColorRenderCamera,
    LightParameter,
    MakeRenderEngineVtk,
    RenderCameraCore,
    RenderEngineVtkParams,
)
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.systems.sensors import CameraInfo

import forcectl as fc
from forcectl.diagrams.fidelities.multibody import MultibodyStation
from forcectl.diagrams.station import StationConfig
from forcectl.diagrams.workcell import describe
from forcectl.figures.force import COLOURS, force_figure, frame
from forcectl.motion.trajectory import Planner, Target, begin, limits_of

EYE, AT = np.array([2.5, -2.1, 1.6]), np.array([0.3, 0.0, 0.66])
WIDTH, HEIGHT, FIELD_OF_VIEW = 900, 900, 0.52


IMAGES = Path(__file__).parent / "images"


def main() -> None:
    """Write the pictures."""
    render_station(IMAGES / "station.png")
    draw_fast_contact(IMAGES / "fast_contact.png")
    draw_trajectory(IMAGES / "trajectory.png")


def draw_fast_contact(target: Path) -> None:
    """Force over time of the experiment `fast_sliding` on its stiffest surface."""
    log = fc.run("fast_sliding", fidelity="Multibody", overrides={"expect": []}).log
    stiff = [name for name in log["variant"].values if str(name).startswith("1e6 N/m")]
    figure = force_figure(log.sel(variant=stiff), "1e6 N/m, sliding at 20 mm/s, multibody robot")
    figure.savefig(target, metadata={"Software": None})
    print(f"wrote {target.name}")


def draw_trajectory(target: Path) -> None:
    """Position, velocity and acceleration of two components whose targets change on the way."""
    planner, period = Planner(limits_of(2, 0.5, 2.0, 20.0)), 0.004
    state, rows, goals = begin([0.0, 0.0]), [], []
    for tick in range(700):
        goal = np.array([[0.4, 0.2], [0.1, 0.3], [0.3, -0.1]][(tick > 150) + (tick > 320)])
        state = planner.follow(state, Target(goal, np.zeros(2), np.zeros(2)), period)
        rows.append(state.motion)
        goals.append(goal)
    time, motion = period * np.arange(1, len(rows) + 1), np.array(rows)
    figure = Figure(figsize=(8.0, 5.6), layout="constrained")
    panels = figure.subplots(3, sharex=True)
    labels = ("position [u]", "velocity [u/s]", "acceleration [u/s²]")
    for i, (axes, label, limit) in enumerate(zip(panels, labels, (None, 0.5, 2.0), strict=True)):
        for j, colour in enumerate(COLOURS[:2]):
            axes.plot(time, motion[:, i, j], color=colour, lw=1.8, label=f"component {j + 1}")
            if i == 0:
                axes.plot(time, np.array(goals)[:, j], color=colour, lw=1.0, ls=(0, (5, 3)), label=f"target {j + 1}")
        for sign in (-1, 1) if limit else ():
            axes.axhline(sign * limit, color="#707070", lw=1.0, ls=":")
        axes.set_ylabel(label)
        frame(axes)
    figure.legend(*panels[0].get_legend_handles_labels(), ncols=4, frameon=False, loc="outside upper center")
    panels[-1].set_xlabel("time [s]")
    figure.savefig(target, dpi=120, metadata={"Software": None})
    print(f"wrote {target.name}")


def render_station(target: Path) -> None:
    """Render the station at its start."""
    station = MultibodyStation(describe(StationConfig(fidelity="Multibody")), seed=0)
    scene_graph = station.scene_graph
    lights = [
        LightParameter(type="directional", direction=direction, frame="world", intensity=intensity)
        for direction, intensity in (([-0.6, 0.5, -1.0], 0.9), ([-0.5, -0.9, -0.3], 0.6), ([-1.0, 0.8, 0.1], 0.6))
    ]
    parameters = RenderEngineVtkParams(default_clear_color=[1.0, 1.0, 1.0], lights=lights)
    scene_graph.AddRenderer("vtk", MakeRenderEngineVtk(parameters))
    z = (AT - EYE) / np.linalg.norm(AT - EYE)
    x = np.cross(z, [0.0, 0.0, 1.0]) / np.linalg.norm(np.cross(z, [0.0, 0.0, 1.0]))
    X_WC = RigidTransform(RotationMatrix(np.column_stack([x, np.cross(z, x), z])), EYE)
    lens = RenderCameraCore(
        "vtk", CameraInfo(WIDTH, HEIGHT, FIELD_OF_VIEW), ClippingRange(0.05, 20.0), RigidTransform()
    )
    context = scene_graph.GetMyContextFromRoot(station.CreateDefaultContext())
    query = scene_graph.get_query_output_port().Eval(context)
    image = query.RenderColorImage(ColorRenderCamera(lens), scene_graph.world_frame_id(), X_WC)
    matplotlib.image.imsave(target, np.ascontiguousarray(image.data[:, :, :3]))
    print(f"wrote {target.name}")


if __name__ == "__main__":
    main()
