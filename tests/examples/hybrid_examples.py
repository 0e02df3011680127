"""Examples of hybrid control, see `block_examples`."""

import numpy as np
from pydrake.systems.framework import DiagramBuilder, System

from forcectl.diagrams.model import plant_model
from forcectl.force.adaptive_integral import AdaptiveIntegralConfig
from forcectl.force.hybrid.config import DirectionConfig, Hybrid, HybridConfig
from forcectl.force.hybrid.motion import HybridMotion
from forcectl.force.hybrid.surface_normal import SurfaceNormal
from forcectl.force.hybrid.task_axes import TaskAxes, TaskWrench
from forcectl.force.integral import IntegralConfig
from forcectl.plant.plant_model import PlantModel
from forcectl.testing.runs import Input
from tests.examples.block_example import Example, each
from tests.examples.block_examples_stations import pressing_workcell

OVER = np.diag([1.0, -1.0, -1.0])  # z out of the surface, against the axis of the tool


def model() -> PlantModel:
    return plant_model(pressing_workcell("Kinematic"))


def axes(**where: bool) -> TaskAxes:
    known = model()
    return TaskAxes(known.known_robot(), known.start, OVER, **where)


def hybrid(fixed_in: str = "tool", **directions: DirectionConfig) -> Hybrid:
    return HybridConfig(directions=directions, fixed_in=fixed_in).add_to(DiagramBuilder(), model())


def swing(t: float) -> np.ndarray:
    return model().start + 0.05 * np.sin(np.arange(1, 7) * (3 * t + 0.1))


def wrench(t: float) -> np.ndarray:
    return np.array([0.3, -0.2, 0.1, 1.0, 2.0, -15.0]) * (1 + np.sin(40 * t))


MOVED: dict[str, Input] = {"motor_position": swing, "unconstrained_reference": lambda t: swing(t) - swing(0.0)}
TURNING: dict[str, Input] = {"task_normal": lambda t: np.array([np.sin(t), 0.0, np.cos(t)])}
OF_A_FORCE = (  # feedthrough of hybrid control whose reference is a force along an axis
    each("joint_position_command", "measured_wrench", "motor_position", "unconstrained_reference", "desired_force")
    | each("near_singular", "measured_wrench", "motor_position", "unconstrained_reference", "desired_force")
    | each("task_wrench", "measured_wrench", "motor_position")
    | each("task_displacement", "measured_wrench", "motor_position", "desired_force")
)
ABOUT_X = DirectionConfig(law=IntegralConfig(), compliance=0.2)

HYBRID_EXAMPLES: dict[type[System], list[Example]] = {
    TaskWrench: [
        Example(
            lambda fixed=fixed: TaskWrench(axes(fixed_in_world=fixed)),
            each("task_wrench", "measured_wrench", "motor_position"),
            {"measured_wrench": wrench, "motor_position": swing},
        )
        for fixed in (False, True)
    ]
    + [
        Example(
            lambda: TaskWrench(axes(follow=True)),
            each("task_wrench", "measured_wrench", "motor_position", "task_normal"),
            {"measured_wrench": wrench, "motor_position": swing} | TURNING,
        )
    ],
    SurfaceNormal: [
        Example(
            lambda: SurfaceNormal(axes(follow=True)),
            each("task_normal", "measured_wrench", "motor_position"),
            {"measured_wrench": wrench, "motor_position": swing},
        )
    ],
    HybridMotion: [
        Example(
            lambda: HybridMotion(axes(follow=True), [5], model().start),
            each("joint_position_command", "displacement_command", "unconstrained_reference", "task_normal")
            | each("near_singular", "displacement_command", "unconstrained_reference", "task_normal")
            | each("motor_displacement", "motor_position", "task_normal"),
            MOVED | TURNING | {"displacement_command": lambda t: -0.01 * np.sin(20 * t)},
        ),
        Example(
            lambda: HybridMotion(axes(), [0, 5], model().start),
            each("joint_position_command", "displacement_command", "unconstrained_reference")
            | each("near_singular", "displacement_command", "unconstrained_reference")
            | each("motor_displacement", "motor_position"),
            MOVED | {"displacement_command": lambda t: np.array([0.1, -0.01]) * np.sin(20 * t)},
        ),
    ],
    Hybrid: [
        Example(
            lambda: hybrid(z=DirectionConfig(law=AdaptiveIntegralConfig()), rx=ABOUT_X),
            OF_A_FORCE,
            MOVED | {"measured_wrench": wrench, "desired_force": 15.0},
            periods={"period": 0.002},
        ),
        Example(
            lambda: hybrid(fixed_in="surface", z=DirectionConfig()),
            OF_A_FORCE,
            MOVED | {"measured_wrench": wrench, "desired_force": 15.0},
            periods={"period": 0.002},
        ),
        Example(
            lambda: hybrid(rx=ABOUT_X),
            each("joint_position_command", "measured_wrench", "motor_position", "unconstrained_reference")
            | each("near_singular", "measured_wrench", "motor_position", "unconstrained_reference")
            | each("task_wrench", "measured_wrench", "motor_position")
            | each("task_displacement", "measured_wrench", "motor_position"),
            MOVED | {"measured_wrench": wrench},
            periods={"period": 0.002},
        ),
    ],
}
