"""Draw pictures of the pages: the multibody station from its own geometry, and force steps on stiff, moving contact.

python docs/pictures.py
"""

from __future__ import annotations

import re
import sys
from pathlib import Path
from types import ModuleType

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
from forcectl.force.governor.scheme import EquivalentScheme
from forcectl.force.governor.stability import feedback_weight, spectral_radius
from forcectl.force.invariance.force_law import one_step_acceleration
from forcectl.force.invariance.functions import invariance_function, set_distance, set_distance_rate, taylor
from forcectl.motion.trajectory import Planner, Target, begin, limits_of

EYE, AT = np.array([2.5, -2.1, 1.6]), np.array([0.3, 0.0, 0.66])
WIDTH, HEIGHT, FIELD_OF_VIEW = 900, 900, 0.52


IMAGES = Path(__file__).parent / "images"


def main() -> None:
    """Write the pictures."""
    render_station(IMAGES / "station.png")
    draw_fast_contact(IMAGES / "fast_contact.png")
    draw_trajectory(IMAGES / "trajectory.png")
    draw_quartic(IMAGES / "fig_3_2.png")
    draw_invariant_set(IMAGES / "fig_3_3.png")
    draw_virtual_state(IMAGES / "fig_3_8.png")
    fc.graph(EquivalentScheme()).save(IMAGES / "fig_4_13.svg")
    draw_own_plant(IMAGES / "own_plant.svg")
    draw_governor_stability(IMAGES / "fig_4_13_poles.png")


def draw_own_plant(target: Path) -> None:
    """The diagram that the page on blocks builds around a plant of one's own."""
    page = (IMAGES.parent / "blocks.md").read_text(encoding="utf-8")
    for name in ("my_arm", "my_pressing"):
        (code,) = re.findall(rf"^```python\n# {name}.py\n(.*?)^```$", page, re.DOTALL | re.MULTILINE)
        module = sys.modules[name] = ModuleType(name)
        exec(code, vars(module))
    fc.graph(sys.modules["my_pressing"].build()).save(target)
    print(f"wrote {target.name}")


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


def draw_quartic(target: Path) -> None:
    """Fig. 3.2: the polynomial p of relative degree 4 for two states, and Phi, the largest it reaches from now on."""
    gamma, time = -24.0, np.linspace(-1.2, 3.2, 500)
    states = {"p' has one real root": [-1.5, 1.0, 2.0, 1.0], "p' has three real roots": [-1.0, 2.4, -11.6, 26.4]}
    figure = Figure(figsize=(9.0, 3.6), layout="constrained")
    for axes, (name, state) in zip(figure.subplots(1, 2), states.items(), strict=True):
        p, phi = taylor(state, gamma, time), float(invariance_function(state, gamma))
        axes.plot(time, np.where(time < 0, p, np.nan), color=COLOURS[0], lw=1.4, ls=(0, (4, 3)), label="p(τ), τ < 0")
        axes.plot(time, np.where(time >= 0, p, np.nan), color=COLOURS[0], lw=2.0, label="p(τ)")
        axes.axhline(phi, color=COLOURS[1], lw=1.4, label=f"Φ = {phi:.3g}")
        axes.plot([0.0], [state[0]], "o", color=COLOURS[0])
        axes.axhline(0.0, color="#707070", lw=1.0, ls=":")
        axes.set(title=name, xlabel="τ [s]", ylim=(-3.0, 1.5))
        frame(axes)
        axes.legend(frameon=False, loc="upper left")
    figure.savefig(target, dpi=110, metadata={"Software": None})
    print(f"wrote {target.name}")


def draw_invariant_set(target: Path) -> None:
    """Fig. 3.3: the invariant set of relative degree 2, level sets of V, and of V' under the law (3.33)*."""
    gamma = -1.0
    y, rate = np.meshgrid(np.linspace(-2.0, 0.6, 400), np.linspace(-1.6, 2.2, 400))
    inside = invariance_function(np.stack([y, rate], axis=-1), gamma) <= 0
    distance = np.where(inside, set_distance(y, rate, gamma), np.nan)
    # With -2 gamma as the largest acceleration; with -gamma V' would be zero below y' = 0.
    acceleration = one_step_acceleration(y, rate, gamma, -2 * gamma, 1e-3)
    change = np.where(inside, set_distance_rate(rate, acceleration, gamma), np.nan)
    edge = np.linspace(0.0, 2.2, 100)
    figure = Figure(figsize=(9.0, 4.0), layout="constrained")
    for axes, (name, values) in zip(figure.subplots(1, 2), {"V": distance, "V'": change}.items(), strict=True):
        drawn = axes.contour(y, rate, values, levels=10, colors=COLOURS[0] if name == "V" else COLOURS[1])
        # Labels off the edge of the set and of the picture: Matplotlib's own places lie on them.
        if name == "V":
            row = int(np.searchsorted(rate[:, 0], -1.3))
            low = np.interp(drawn.levels, values[row][::-1], y[row][::-1], left=np.nan, right=np.nan)
            places = [(-v, 0.4) if v < 2.0 else (x, -1.3) for v, x in zip(drawn.levels, low, strict=True) if v > 0.0]
        else:
            edge_of = [(v, max(v * v / (2 * gamma) - 0.3, v * v / (4 * gamma) - 1.0)) for v in -drawn.levels]
            places = [at for v, x in edge_of if 0.1 < v < 1.7 for at in ((x, v), (-0.8, -v)) if at[1] > -1.5]
        axes.clabel(drawn, fontsize=7, manual=[at for at in places if at[0] > -1.9])
        axes.plot(0.5 * edge**2 / gamma, edge, color="#303030", lw=1.8, label="Φ = 0")
        axes.plot([0.0, 0.0], [-1.6, 0.0], color="#303030", lw=1.8)
        axes.set(title=f"level sets of {name}", xlabel="y", ylabel="y'", xlim=(-2.0, 0.6))
        frame(axes)
        axes.legend(frameon=False, loc="upper right")
    figure.savefig(target, dpi=110, metadata={"Software": None})
    print(f"wrote {target.name}")


def draw_virtual_state(target: Path) -> None:
    """Fig. 3.8: the polynomial p of a state and of its virtual states, and the largest value of each, Phi."""
    gamma, time = -24.0, np.linspace(0.0, 3.6, 500)
    y, *rates = -1.5, 0.5, 0.6, 0.5
    figure = Figure(figsize=(7.0, 3.8), layout="constrained")
    axes = figure.subplots()
    for alpha, colour in zip((0.0, 1.0, 3.0), COLOURS, strict=False):
        state = [y, *((1 + alpha) * rate for rate in rates)]
        phi = float(invariance_function(state, gamma))
        name = "the state" if alpha == 0 else f"virtual state, α = {alpha:g}"
        axes.plot(time, taylor(state, gamma, time), color=colour, lw=2.0, label=f"{name}: Φ = {phi:.3g}")
        axes.axhline(phi, color=colour, lw=1.0, ls=(0, (4, 3)))
    axes.axhline(0.0, color="#707070", lw=1.0, ls=":")
    axes.set(xlabel="τ [s]", ylabel="p(τ)", ylim=(-2.0, 2.5))
    frame(axes)
    axes.legend(frameon=False, loc="upper left")
    figure.savefig(target, dpi=110, metadata={"Software": None})
    print(f"wrote {target.name}")


def draw_governor_stability(target: Path) -> None:
    """The poles of the scheme of Fig. 4.13: spectral radius over the true delay, for the governors that are shipped."""
    pole, true = 0.997, np.arange(0, 161)
    governors = {
        "printed: N = 40, horizon 1": (40, 1e-3, 1),
        "N = 0": (0, 1e-3, 1),
        "N = 80": (80, 1e-3, 1),
        "horizon 20, printed weights": (40, 1e-3, 20),
        "horizon 20, Q_r = 0.05": (40, 0.05, 20),
    }
    figure = Figure(figsize=(7.5, 4.0), layout="constrained")
    axes = figure.subplots()
    for (name, (n, weight, horizon)), colour in zip(governors.items(), COLOURS, strict=False):
        alpha = feedback_weight(pole, n, 1.0, weight, horizon=horizon)
        radius = [spectral_radius(pole, alpha, n, int(ticks)) for ticks in true]
        axes.plot(0.002 * true, radius, color=colour, lw=1.8, label=f"{name}: α = {alpha:.3g}")
    axes.axhline(1.0, color="#303030", lw=1.0, ls=":")
    axes.set(xlabel="true delay of the inner loop [s]", ylabel="spectral radius")
    frame(axes)
    figure.legend(*axes.get_legend_handles_labels(), ncols=2, frameon=False, loc="outside upper center")
    figure.savefig(target, dpi=110, metadata={"Software": None})
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
