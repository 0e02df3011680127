"""The shapes of the YuMi and its gripper, each link a housing across its joint and a shell towards the next one.

Sizes follow the extents of the real links; the rest is drawn. See `make_meshes`.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from forcectl.models.lofts import Array, Mesh, along, circle, loft, rounded, slab, tube

X, Y, Z = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
BACK = -0.36  # the flat rear of the torso


def torso() -> Mesh:
    """Plinth with the controller inside, column, and the round head that carries both shoulders; robot base frame."""

    def slice_at(z: float, front: float, half_width: float, corner: float) -> tuple[float, Array]:
        return z, rounded(front - BACK, 2 * half_width, corner, (front + BACK) / 2)

    def head_at(z: float) -> tuple[float, Array]:
        radius = float(np.sqrt(0.1**2 - (z - 0.37) ** 2))
        return slice_at(z, radius - 0.04, radius + 0.02, radius)

    return loft(
        along(
            "z",
            [
                slice_at(-0.100, 0.128, 0.195, 0.03),
                slice_at(-0.094, 0.134, 0.200, 0.03),
                slice_at(0.040, 0.134, 0.200, 0.03),
                slice_at(0.052, 0.128, 0.195, 0.03),
                slice_at(0.0595, 0.110, 0.180, 0.03),
                slice_at(0.0600, 0.030, 0.160, 0.04),
                slice_at(0.076, 0.020, 0.150, 0.05),
                slice_at(0.086, -0.020, 0.135, 0.05),
                slice_at(0.090, -0.127, 0.110, 0.04),
                slice_at(0.110, -0.135, 0.106, 0.04),
                slice_at(0.245, -0.135, 0.104, 0.04),
                slice_at(0.270, -0.138, 0.098, 0.04),
                slice_at(0.310, -0.150, 0.060, 0.04),
            ],
        ),
        along("z", [head_at(z) for z in (0.272, 0.278, 0.290, 0.310, 0.340, 0.370, 0.400, 0.430, 0.450, 0.462, 0.468)]),
    )


def shoulder() -> Mesh:
    """Link 1: a foot on axis 1 that leans over to the housing of joint 2, on the left of it."""
    shell = tube(
        ((0, 0, 0.036), Z, 0.0535),
        ((0, 0, 0.042), Z, 0.0590),
        ((0, 0, 0.085), Z, 0.0605),
        ((-0.008, 0.010, 0.115), (-0.2, 0.3, 1), 0.0590),
        ((-0.020, 0.026, 0.145), (-0.3, 0.5, 0.8), 0.0540),
        ((-0.029, 0.037, 0.166), (-0.3, 0.6, 0.7), 0.0440),
    )
    return loft(shell, slab("y", circle(0.0486, 0.166, -0.030), 0.002, 0.077, 0.014))


def upper_arm() -> Mesh:
    """Link 2: from the housing of joint 2, on the right of it, up to the sleeve on axis 7."""
    shell = tube(
        ((-0.001, -0.033, -0.012), (0.1, 0.2, 1), 0.0400),
        ((0.003, -0.029, 0.012), (0.2, 0.3, 1), 0.0455),
        ((0.014, -0.019, 0.050), (0.25, 0.33, 1), 0.0535),
        ((0.025, -0.007, 0.090), (0.2, 0.25, 1), 0.0550),
        ((0.030, 0.0, 0.125), Z, 0.0540),
        ((0.030, 0.0, 0.164), Z, 0.0530),
        ((0.030, 0.0, 0.171), Z, 0.0490),
    )
    return loft(shell, slab("y", circle(0.0482), -0.077, -0.002, 0.014))


def elbow() -> Mesh:
    """Link 7: from axis 7 to the housing of joint 3, on the left of it."""
    shell = tube(
        ((0, 0, 0.150), Z, 0.0430),
        ((0, 0, 0.176), Z, 0.0430),
        ((0, 0, 0.178), Z, 0.0470),
        ((0.004, 0.005, 0.200), (0.15, 0.2, 1), 0.0475),
        ((0.017, 0.017, 0.225), (0.5, 0.4, 0.9), 0.0470),
        ((0.032, 0.031, 0.244), (0.6, 0.5, 0.6), 0.0420),
        ((0.040, 0.038, 0.2515), (0.6, 0.5, 0.6), 0.0330),
    )
    return loft(shell, slab("y", circle(0.0482, 0.2515, 0.0405), 0.002, 0.078, 0.014))


def forearm() -> Mesh:
    """Link 3: from the housing of joint 3, on the right of it, forward to the sleeve on axis 4."""
    shell = tube(
        ((-0.010, -0.036, -0.006), (1, 0.3, 0.4), 0.0400),
        ((0.012, -0.030, 0.006), (1, 0.3, 0.4), 0.0465),
        ((0.048, -0.014, 0.024), (1, 0.4, 0.45), 0.0480),
        ((0.082, -0.003, 0.037), (1, 0.2, 0.25), 0.0470),
        ((0.115, 0.0, 0.0405), X, 0.0460),
        ((0.157, 0.0, 0.0405), X, 0.0450),
        ((0.164, 0.0, 0.0405), X, 0.0410),
    )
    return loft(shell, slab("y", circle(0.0476), -0.077, -0.002, 0.014))


def lower_arm() -> Mesh:
    """Link 4: from axis 4 to the housing of joint 5, on the left of it."""
    shell = tube(
        ((0.140, 0, 0), X, 0.0350),
        ((0.168, 0, 0), X, 0.0350),
        ((0.170, 0, 0), X, 0.0412),
        ((0.192, 0.006, -0.003), (1, 0.3, -0.2), 0.0412),
        ((0.222, 0.020, -0.012), (1, 0.45, -0.35), 0.0385),
        ((0.250, 0.034, -0.022), (1, 0.45, -0.35), 0.0320),
        ((0.266, 0.040, -0.027), (1, 0.4, -0.3), 0.0230),
    )
    return loft(shell, slab("y", circle(0.0318, -0.027, 0.263), 0.016, 0.069, 0.009))


def wrist() -> Mesh:
    """Link 5: the housing of joint 5, on the right of it, under the motor of axis 6."""
    motor = along(
        "x",
        [
            (-0.0645, circle(0.024, 0.0, 0.027)),
            (-0.0610, circle(0.033, 0.0, 0.027)),
            (-0.0530, circle(0.039, 0.0, 0.027)),
            (-0.0350, circle(0.0408, 0.0, 0.027)),
            (0.0120, circle(0.0408, 0.0, 0.027)),
            (0.0290, circle(0.0385, 0.0, 0.027)),
            (0.0335, circle(0.0345, 0.0, 0.027)),
        ],
    )
    neck = tube(
        ((-0.004, -0.036, -0.004), (0, 0.6, 1), 0.0280),
        ((-0.006, -0.018, 0.012), (0, 0.6, 1), 0.0350),
        ((-0.008, -0.004, 0.027), (0, 0.6, 1), 0.0300),
    )
    return loft(motor, neck, slab("y", circle(0.0325), -0.066, 0.012, 0.010))


def flange() -> Mesh:
    """Link 6: the turning flange, without the pin that centres the tool."""
    return loft(slab("x", circle(0.0285), 0.0, 0.030, 0.003), slab("x", circle(0.0315), 0.020, 0.036, 0.002))


def housing() -> Mesh:
    """Gripper: the housing on the flange, in the frame of tool0."""
    collar = slab("z", circle(0.0315), 0.0, 0.014, 0.002)
    body = along(
        "z",
        [
            (0.008, rounded(0.060, 0.054, 0.020, 0.004, 0.0095)),
            (0.014, rounded(0.074, 0.062, 0.018, 0.004, 0.0095)),
            (0.026, rounded(0.082, 0.068, 0.014, 0.004, 0.0095)),
            (0.070, rounded(0.082, 0.068, 0.012, 0.004, 0.0095)),
            (0.076, rounded(0.078, 0.064, 0.012, 0.004, 0.0095)),
        ],
    )
    return loft(collar, body)


def guide() -> Mesh:
    """Gripper: the guide of the fingers below the housing."""
    return loft(slab("z", rounded(0.082, 0.034, 0.006, 0.0, 0.0), 0.070, 0.0925, 0.002))


def finger() -> Mesh:
    """Gripper: a finger that closes towards +x, its inner face at x = 0."""
    block = slab("z", rounded(0.035, 0.0210, 0.004, -0.0177, 0.0065), 0.0005, 0.017, 0.0015)
    blade = along(
        "z",
        [
            (0.010, rounded(0.0240, 0.0180, 0.003, -0.0125, 0.0065)),
            (0.022, rounded(0.0160, 0.0160, 0.003, -0.0085, 0.0065)),
            (0.036, rounded(0.0110, 0.0140, 0.002, -0.0058, 0.0065)),
            (0.0505, rounded(0.0085, 0.0130, 0.002, -0.0044, 0.0065)),
            (0.0523, rounded(0.0070, 0.0110, 0.002, -0.0044, 0.0065)),
        ],
    )
    return loft(block, blade)


MESHES: dict[str, Callable[[], Mesh]] = {
    "yumi/meshes/torso.obj": torso,
    "yumi/meshes/link_1.obj": shoulder,
    "yumi/meshes/link_2.obj": upper_arm,
    "yumi/meshes/link_7.obj": elbow,
    "yumi/meshes/link_3.obj": forearm,
    "yumi/meshes/link_4.obj": lower_arm,
    "yumi/meshes/link_5.obj": wrist,
    "yumi/meshes/link_6.obj": flange,
    "yumi_gripper/meshes/housing.obj": housing,
    "yumi_gripper/meshes/guide.obj": guide,
    "yumi_gripper/meshes/finger.obj": finger,
}
