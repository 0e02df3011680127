"""Draw pictures of the pages: the multibody station from its own geometry, and force steps on stiff, moving contact.

python docs/pictures.py
"""

from __future__ import annotations

from pathlib import Path

import matplotlib.image
import numpy as np
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
from forcectl.diagrams.station import StationConfig, describe
from forcectl.diagrams.station_multibody import MultibodyStation
from forcectl.viz.figures import force_figure

EYE, AT = np.array([2.5, -2.1, 1.6]), np.array([0.3, 0.0, 0.66])
WIDTH, HEIGHT, FIELD_OF_VIEW = 900, 900, 0.52


IMAGES = Path(__file__).parent / "images"


def main() -> None:
    """Write the pictures."""
    render_station(IMAGES / "station.png")
    draw_fast_contact(IMAGES / "fast_contact.png")


def draw_fast_contact(target: Path) -> None:
    """Force over time of the experiment `fast_sliding` on its stiffest surface."""
    log = fc.run("fast_sliding", fidelity="Multibody", overrides={"expect": []}).log
    stiff = [name for name in log["variant"].values if str(name).startswith("1e6 N/m")]
    figure = force_figure(log.sel(variant=stiff), "1e6 N/m, sliding at 20 mm/s, multibody robot")
    figure.savefig(target, metadata={"Software": None})
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
