"""Examples of the blocks of surfaces, see `block_examples`."""

import math

import numpy as np
from pydrake.systems.framework import System

from forcectl.plant.contact.surface import GrooveConfig, SurfaceConfig, SurfaceHeight
from forcectl.plant.contact.surface_materials import MaterialsConfig, SegmentConfig, SurfaceMaterial
from forcectl.plant.contact.surface_spring import SurfaceSpring
from forcectl.plant.contact.turning_surface import ArcConfig, TurningSurface
from tests.examples.block_example import Example, each
from tests.examples.block_examples_stations import pressing_workcell


def material(**changes: float) -> SurfaceMaterial:
    segments = [
        SegmentConfig(material="plastic", start=-0.1, end=0.02),
        SegmentConfig(material="wood", start=0.02, end=0.1, **changes),
    ]
    return SurfaceMaterial(MaterialsConfig(segments=segments, blend=0.01).path(), damped="damping" in changes)


WORKCELL = pressing_workcell("Kinematic")
START = WORKCELL.start
ALONG = np.array([0.0, 0.3, 0.1, 0.0, 0.0, 0.0])


def turning() -> TurningSurface:
    contact, surface = WORKCELL.contact, SurfaceConfig(turning=True, heights={"arc": ArcConfig()})
    profile = surface.profile(0.01)
    return TurningSurface(contact.robot, contact.n, [1.0, 0.0, 0.0], START, profile, 0.01)


SURFACE_EXAMPLES: dict[type[System], list[Example]] = {
    SurfaceHeight: [
        Example(
            lambda: SurfaceHeight(SurfaceConfig(slope=0.01, heights={"grooves": GrooveConfig()}).profile(0.01)),
            each("surface_height", "path_position"),
            {"path_position": lambda t: 0.5 * t},
        )
    ],
    TurningSurface: [
        Example(
            turning,
            each("surface_height", "link_position")
            | each("surface_tilt", "link_position")
            | each("plane_state", "link_position"),
            {"link_position": lambda t: START + t * ALONG},
        )
    ],
    SurfaceMaterial: [
        Example(
            lambda: material(damping=20.0),
            each("surface_stiffness", "path_position") | each("surface_damping", "path_position"),
            {"path_position": lambda t: 0.5 * t},
        ),
        Example(material, each("surface_stiffness", "path_position"), {"path_position": lambda t: 0.5 * t}),
    ],
    SurfaceSpring: [
        Example(
            lambda: SurfaceSpring(3e5, 50.0, further_compliance=1e-6, uneven=True),
            each("desired_state", "carrier_state", "surface_stiffness", "surface_damping", "surface_height"),
            {
                "carrier_state": lambda t: [-1e-4 * math.sin(30 * t), -3e-3 * math.cos(30 * t)],
                "surface_stiffness": lambda t: 1e5 * (1 + t),
                "surface_damping": lambda t: 100 * t,
                "surface_height": lambda t: 1e-3 * t,
            },
        ),
        Example(
            lambda: SurfaceSpring(3e5),
            each("desired_state", "carrier_state", "surface_stiffness"),
            {"carrier_state": lambda t: [-1e-3 * t, -1e-3], "surface_stiffness": lambda t: 1e5 * (1 + t)},
        ),
    ],
}
