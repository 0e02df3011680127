"""Draws the parts of assemblies: `python -m forcectl.models.make_parts` writes `models/parts` again.

Parts are made by the mesh library manifold3d (extra `test`), as closed surfaces whose shape is that of contact: a
facet is a flat of the part. Radii of the outlines are the mean of what a facet has at its corners and in its middle, so
that the clearance between two parts is the nominal one on average.

Lengths are in metres. Every part has a frame of contact: `mouth` in the opening, z out of it; `tip` in the front face
of what goes in, z backwards. The frames of aligned parts are parallel, and the depth is that of `tip` below `mouth`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import partial
from importlib.util import find_spec
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from manifold3d import Manifold

# Facets of a turned part. The time of a contact grows with them. With 24 the bore's radius is right to 0.055 mm, with
# 48 to 0.014 mm: for the plunger with 0.1 mm of clearance, which would jam in a coarse bore that is turned against it.
COARSE, FINE = 24, 48
DIGITS = 7  # metres are written to 0.1 um
Array = NDArray[np.float64]
Indices = NDArray[np.int64]
Outline = Sequence[tuple[float, float]]  # (radius, z) of a turned part, in order

BORE = 12.85e-3  # radius: 9 mm are 35 % of the inner diameter of the pipette's body
CHAMFER = 4e-3  # lead-in, radially and along the axis
STROKE = 96e-3  # from the mouth to the floor: 50 mL
CLEARANCES = {"1p0": 1.0e-3, "0p5": 0.5e-3, "0p3": 0.3e-3, "0p1": 0.1e-3}  # in radius, by the name of the plunger
TAPER = (8e-3, 5e-3)  # of the plunger's tip: along the axis, in radius
PLUNGER_LENGTH = 110e-3

# A bayonet of the size of a BNC connector.
BARREL, SLEEVE, CAP = 4.8e-3, 5.0e-3, 7.25e-3  # radii: of the mount, inside of the cap, outside of it
PIN, SLOT = 1.0e-3, 1.2e-3  # half widths
PIN_BEHIND = 5.0e-3  # the pins' axis behind the front face of the mount
FLOOR = 8.5e-3  # of the cap below its mouth: meets the pad of the mount when the pins are 3.5 mm deep
# Way of a pin: angle in the cap [deg] and depth below its mouth: pushed in, pulled in by turning, back into a notch.
WAY = ((0.0, -1e-3), (0.0, 3.0e-3), (60.0, 4.2e-3), (70.0, 3.9e-3))


def turned(outline: Outline, facets: int) -> Manifold:
    """A turned part with an outline of mean radii; closed along the axis."""
    from manifold3d import CrossSection

    mean = 2 / (1 + math.cos(math.pi / facets))
    points = np.array([(radius * mean, z) for radius, z in outline])
    return CrossSection([points]).revolve(facets)


def pipette_body(facets: int) -> Manifold:
    """Tube with a chamfered bore, a flange for the fingers and a nozzle."""
    inside = [(0.0, -STROKE), (BORE, -STROKE), (BORE, -CHAMFER), (BORE + CHAMFER, 0.0)]
    flange = [(18.5e-3, 0.0), (18.5e-3, -3e-3), (14.25e-3, -7e-3)]
    nozzle = [(14.25e-3, -98e-3), (4e-3, -104e-3), (3e-3, -116e-3), (0.0, -116e-3)]
    return turned([*inside, *flange, *nozzle][::-1], facets)


def pipette_plunger(clearance: float, facets: int) -> Manifold:
    """Convex plunger with a tapered tip, `clearance` narrower in radius than the bore."""
    radius = BORE - clearance
    along, across = TAPER
    end = [(radius, PLUNGER_LENGTH), (0.0, PLUNGER_LENGTH)]
    return turned([(0.0, 0.0), (radius - across, 0.0), (radius, along), *end], facets)


def bayonet_barrel() -> Manifold:
    """Convex post of the mount behind its pad; pins and pad are primitives."""
    return turned([(0.0, 1.5e-3), (3.8e-3, 1.5e-3), (BARREL, 2.5e-3), (BARREL, 16e-3), (0.0, 16e-3)], COARSE)


def bayonet_cap() -> Manifold:
    """Sleeve with two slots that guide the pins of the mount: in, along a ramp, and back a little into a notch."""
    from manifold3d import Manifold, OpType

    inside = [(0.0, -FLOOR), (SLEEVE, -FLOOR), (SLEEVE, -0.8e-3), (SLEEVE + 0.8e-3, 0.0)]
    sleeve = turned([*inside, (CAP, 0.0), (CAP, -11e-3), (0.0, -11e-3)][::-1], COARSE)
    slots = []
    for half_turn in (0.0, 180.0):
        places = [_cutter(angle + half_turn, depth) for angle, depth in _fine(WAY)]
        slots += [Manifold.batch_hull([a, b]) for a, b in pairwise(places)]
        wide, narrow = (_cutter(half_turn, depth, width) for depth, width in ((-0.5e-3, 2.2e-3), (1.0e-3, SLOT)))
        slots.append(Manifold.batch_hull([wide, narrow]))
    return sleeve - Manifold.batch_boolean(slots, OpType.Add)


def _fine(way: Outline) -> list[tuple[float, float]]:
    """The corners of a way and points between, at most 10 degrees apart."""
    points = [way[0]]
    for (a, z), (b, w) in pairwise(way):
        count = max(1, round(abs(b - a) / 10.0))
        points += [(a + (b - a) * i / count, z + (w - z) * i / count) for i in range(1, count + 1)]
    return points


def _cutter(angle: float, depth: float, half_width: float = SLOT) -> Manifold:
    """A radial pin through the sleeve, at an angle [deg] and a depth below the mouth."""
    from manifold3d import Manifold

    mean = 2 / (1 + math.cos(math.pi / 16))
    pin = Manifold.cylinder(4e-3, half_width * mean, circular_segments=16).rotate((0.0, 90.0, 0.0))
    return pin.translate((4.5e-3, 0.0, 0.0)).rotate((0.0, 0.0, angle)).translate((0.0, 0.0, -depth))


BODY = """\
<?xml version="1.0"?>
<!-- Body of a dispenser tip of 50 mL: a tube with a lead-in chamfer, turned with {facets} facets; written by
     `python -m forcectl.models.make_parts`. Frame `mouth`: in the opening, z out of the bore.
     Bore 25.7 mm in diameter (9 mm are 35 % of it, the only published dimension), all else estimated: chamfer 4 mm by
     45 degrees, bore 96 mm deep (50 mL over its area), wall 1.4 mm. Polypropylene, 905 kg/m3.

     Contact is that of surfaces (hydroelastic). A point contact takes the convex hull of a mesh, here a tube that is
     filled: no insertion. Drake falls back to points against shapes without hydroelastic properties. -->
<robot name="{name}" xmlns:drake="http://drake.mit.edu">
  <link name="body">
    <inertial>
      <origin xyz="0 0 -0.0552"/>
      <mass value="0.0148"/>
      <inertia ixx="1.97e-5" iyy="1.97e-5" izz="2.5e-6" ixy="0" ixz="0" iyz="0"/>
    </inertial>
    <visual name="body">
      <geometry><mesh filename="meshes/{name}.obj"/></geometry>
      <material><color rgba="0.85 0.90 0.95 0.55"/></material>
    </visual>
    <collision name="body">
      <geometry><mesh filename="meshes/{name}.obj"/></geometry>
      <drake:proximity_properties>
        <!-- Rigid: only a rigid mesh need not be convex. The compliance of the pair is that of the plunger. -->
        <drake:rigid_hydroelastic/>
        <!-- Of polypropylene on polyethylene, wet; dry it is 0.2 to 0.35. Drake takes 2ab/(a + b) of both parts. -->
        <drake:mu_dynamic value="0.15"/>
        <drake:mu_static value="0.15"/>
        <!-- See pipette_plunger_1p0.urdf; Drake adds the times, and a rigid part has none. -->
        <drake:relaxation_time value="0"/>
        <drake:hunt_crossley_dissipation value="0"/>
      </drake:proximity_properties>
    </collision>
  </link>
  <frame name="mouth" link="body" xyz="0 0 0" rpy="0 0 0"/>
</robot>
"""
PLUNGER = """\
<?xml version="1.0"?>
<!-- Plunger of the dispenser tip, {clearance:g} mm narrower in radius than the bore of {body};
     written by `python -m forcectl.models.make_parts`. Frame `tip`: in its front face, z backwards. A convex rod of
     110 mm; its tip tapers by 5 mm in radius over 8 mm. 40 g: polyethylene with ribs (estimated); full it would weigh
     54 g. -->
<robot name="pipette_plunger_{name}" xmlns:drake="http://drake.mit.edu">
  <link name="plunger">
    <inertial>
      <origin xyz="0 0 0.0564"/>
      <mass value="0.04"/>
      <inertia ixx="4.0e-5" iyy="4.0e-5" izz="3.0e-6" ixy="0" ixz="0" iyz="0"/>
    </inertial>
    <visual name="plunger">
      <geometry><mesh filename="meshes/pipette_plunger_{name}.obj"/></geometry>
      <material><color rgba="0.25 0.45 0.75 1"/></material>
    </visual>
    <collision name="plunger">
      <geometry><mesh filename="meshes/pipette_plunger_{name}.obj"><drake:declare_convex/></mesh></geometry>
      <drake:proximity_properties>
        <!-- Compliant: it bears the compliance of the pair, and a convex one is the cheaper field of pressure. -->
        <drake:compliant_hydroelastic/>
        <!-- Not Young's modulus: the pressure at the rod's centre, falling to zero at its surface. Pressed 0.05 mm into
             the wall with 4, 10 or 30 mm engaged the contact has 50, 120 or 360 kN/m: far above any grasp or arm, so
             that forces of insertion are those of the grasp. -->
        <drake:hydroelastic_modulus value="2e7"/>
        <!-- Zero, on purpose: with a margin Drake widens the field of pressure, and the surface where it is zero is no
             longer that of the part; at clearances of 0.1 to 0.3 mm that is felt. -->
        <drake:hydroelastic_margin value="0"/>
        <!-- As of the body. -->
        <drake:mu_dynamic value="0.15"/>
        <drake:mu_static value="0.15"/>
        <!-- Damping: force = K (depth + time rate) with the solver of the stations. Short beside a step of 1 ms, which
             damps by itself: at an edge the faces of a mesh approach and part while the parts slide, and with 1 ms that
             added 10 % to the force of insertion; with Drake's default of 0.1 s a peg would also glide 1.1 mm above the
             wall. The Hunt-Crossley value [s/m] is for plants whose solver takes that one. -->
        <drake:relaxation_time value="0.0002"/>
        <drake:hunt_crossley_dissipation value="5"/>
      </drake:proximity_properties>
    </collision>
  </link>
  <frame name="tip" link="plunger" xyz="0 0 0" rpy="0 0 0"/>
</robot>
"""


def _bore_for(clearance: str) -> str:
    return "pipette_body_fine" if clearance == "0p1" else "pipette_body"


BODIES = {"pipette_body": COARSE, "pipette_body_fine": FINE}  # facets by name
MESHES: dict[str, Callable[[], Manifold]] = {
    **{name: partial(pipette_body, facets) for name, facets in BODIES.items()},
    **{
        f"pipette_plunger_{name}": partial(pipette_plunger, clearance, BODIES[_bore_for(name)])
        for name, clearance in CLEARANCES.items()
    },
    "bayonet_barrel": bayonet_barrel,
    "bayonet_cap": bayonet_cap,
}


def without_fans(vertices: Array, faces: Indices) -> Indices:
    """Triangles (n, 3) with every flat disc around the axis cut into few: a square, and strips beside it.

    Each pair of facets of two parts that touch is a point of contact, and its time grows with them. As fans around
    their middles, the plunger's face and the floor of the bore made 317 points, and 148 so.
    """
    for middle in np.flatnonzero(np.hypot(*vertices[:, :2].T) == 0.0):
        fan = (faces == middle).any(axis=1)
        if np.ptp(vertices[faces[fan], 2]) > 0.0:
            continue
        following = {a: b for _, a, b in (np.roll(face, -int(np.argmax(face == middle))) for face in faces[fan])}
        ring = [int(faces[fan].max())]
        while (corner := following[ring[-1]]) != ring[0]:
            ring.append(corner)
        side = len(ring) // 4
        a, b, c, d = ring[::side]
        cut = [(a, b, c), (a, c, d)]
        for start in range(0, len(ring), side):
            first, *others = (ring * 2)[start : start + side + 1]
            cut += [(first, *pair) for pair in pairwise(others)]
        faces = np.vstack([faces[~fan], cut])
    return faces


def as_obj(solid: Manifold) -> str:
    """Vertices, rounded and sorted, and triangles as Wavefront OBJ."""
    mesh = solid.to_mesh64()
    rounded = np.round(np.asarray(mesh.vert_properties)[:, :3], DIGITS) + 0.0  # no negative zero
    vertices, index = np.unique(rounded, axis=0, return_inverse=True)
    faces = index.reshape(-1)[np.asarray(mesh.tri_verts)]
    faces = without_fans(vertices, faces[[len(set(face.tolist())) == 3 for face in faces]])
    used, index = np.unique(faces, return_inverse=True)
    vertices, faces = vertices[used], index.reshape(-1, 3)
    faces = np.array([np.roll(face, -int(np.argmin(face))) for face in faces])
    faces = faces[np.lexsort(faces.T[::-1])]
    lines = [f"v {x:.9g} {y:.9g} {z:.9g}" for x, y, z in vertices]
    return "\n".join(lines + [f"f {a} {b} {c}" for a, b, c in faces + 1]) + "\n"


def draw_all() -> dict[str, str]:
    """Every file that is drawn, by its path below `models/parts`."""
    meshes = {f"meshes/{name}.obj": as_obj(make()) for name, make in MESHES.items()}
    bodies = {f"{name}.urdf": BODY.format(name=name, facets=facets) for name, facets in BODIES.items()}
    return (
        meshes
        | bodies
        | {
            f"pipette_plunger_{name}.urdf": PLUNGER.format(name=name, clearance=1e3 * clearance, body=_bore_for(name))
            for name, clearance in CLEARANCES.items()
        }
    )


if __name__ == "__main__":
    if find_spec("manifold3d") is None:
        raise SystemExit("error: drawing parts needs manifold3d: install it with pip install 'forcectl[test]'")
    for path, text in draw_all().items():
        (Path(__file__).parent / "parts" / path).write_text(text, encoding="utf-8")
