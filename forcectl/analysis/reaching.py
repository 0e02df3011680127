"""Whether both arms reached their targets, and how: limits, distances, and use of the null space (Fig. 5.3)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from forcectl.analysis.slot import variants_of
from forcectl.arrays import Array
from forcectl.collision.distance import LinkDistance
from forcectl.collision.shapes import Obstacle, RobotShapes
from forcectl.diagrams.model import Setting
from forcectl.errors import BadInputError
from forcectl.framework.fields import Config, key
from forcectl.framework.rotation_vector import RotationVector
from forcectl.plant.plant_model import PlantModel
from forcectl.robot.arms_motion import ArmsMotion
from forcectl.tasks.coordinates import ArmTask
from forcectl.tasks.null_space import TowardsSmallMass
from forcectl.tasks.progress import Progress, TaskProgress
from forcectl.tasks.reactive_controller import Supervision
from forcectl.tasks.task_parts import start_motion

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(kw_only=True)
class ReachAnalysis(Config):
    """Scenario part `!Reaching`.

    For a run of `!ReactiveReaching` to whole poses. Other runs have none of its metrics.
    """

    mass_direction: list[float] = key(
        [0.0, 0.0, 1.0], "direction of the reflected mass, in W", bounds="not all zero", size=3
    )
    every: int = key(
        4,
        "number of ticks from one posture whose distances and reflected masses are computed to the next",
        unit="ticks",
        bounds="from 1 to 1000",
    )

    def metrics(self, log: Any, setting: Setting) -> dict[str, float | None]:
        """Those of `REACH_METRICS`."""
        if not self._whole_poses(log, setting.truth):
            return {}
        offset, angle = self._missed(log, setting.truth)
        reference, speed = log["joint_position_command"].values, log["joint_velocity_command"].values
        limits = setting.truth.known_robot().limits
        room = np.minimum(limits.position_upper - reference, reference - limits.position_lower)
        bend = np.diff(speed, axis=0) / setting.truth.period
        distance, mass = self._along(log, setting.truth)
        target = log["task_target"].values
        changed = np.flatnonzero((np.diff(target, axis=0) != 0).any(axis=1))
        return {
            **self._progress(log, setting.truth),
            "reach_offset_mm": 1e3 * offset,
            "reach_angle_deg": float(np.degrees(angle)),
            "retargets": float(len(changed)),
            "link_distance_mm": _millimetres(distance.min()),
            "acceleration_share": float((np.abs(bend) / limits.acceleration).max()),
            "active_share": float(np.mean(log["active_constraints"].values > 0)),
            "constraint_excess": float(log["constraint_violation"].values.max()),
            "holding_share": float(np.mean(log["holding"].values)),
            "joint_speed_rms": float(np.sqrt(np.mean(np.sum(speed**2, axis=1)))),
            "joint_travel_rad": float(np.linalg.norm(np.diff(reference, axis=0), axis=1).sum()),
            "mean_distance_mm": _millimetres(distance.mean()),
            "limit_room_deg": float(np.degrees(room.min())),
            "mean_room_deg": float(np.degrees(room.min(axis=1).mean())),
            "reflected_mass_kg": float(mass.mean()),
        }

    def figures(self, log: Any, setting: Setting, title: str) -> dict[str, Figure]:
        """Tool centre points and distances of the first variant; use of the null space in all of them."""
        from forcectl.figures.reaching import null_space_figure, reach_figure

        if not self._whole_poses(log, setting.truth):
            return {}
        runs = variants_of(log)
        found = {name: self._along(run, setting.truth) for name, run in runs.items()}
        first, limits = next(iter(runs)), setting.truth.known_robot().limits
        figures = {"reaching": reach_figure(runs[first], found[first][0], self.every, title)}
        if "variant" in log.dims:
            figures["null_space"] = null_space_figure(runs, found, limits, self.every, title)
        return figures

    def _whole_poses(self, log: Any, truth: PlantModel) -> bool:
        """Whether the tasks are the poses of all arms in the world, by comparison with the poses at the start."""
        if "task_target" not in log:
            return False
        robot = truth.known_robot()
        start = ArmsMotion(robot, robot.create_context(), truth.start, np.zeros(truth.num_joints))
        places = np.concatenate([[*start.arm(arm).position, 0.0, 0.0, 0.0] for arm in start.arm_names])
        first = log["task_position"].isel(time=0).values.reshape(-1, log["task_position"].shape[-1])[0]
        return len(first) == len(places) and np.allclose(first, places, atol=1e-3)

    def _missed(self, log: Any, truth: PlantModel) -> tuple[float, float]:
        """Distance and angle of the links from the target at the end [m, rad], of the worse arm."""
        robot = truth.known_robot()
        rest = np.zeros(truth.num_joints)
        start = ArmsMotion(robot, robot.create_context(), truth.start, rest)
        end = ArmsMotion(robot, robot.create_context(), log["link_position"].values[-1], rest)
        offsets, angles = [], []
        for arm, target in zip(start.arm_names, log["task_target"].values[-1].reshape(-1, 6), strict=True):
            wanted = RotationVector(start.arm(arm).rotation).rotation(target[3:])
            offsets.append(np.linalg.norm(end.arm(arm).position - target[:3]))
            turned = RotationVector(wanted).state(end.arm(arm).rotation, np.zeros(3)).value
            angles.append(np.linalg.norm(turned))
        return float(max(offsets)), float(max(angles))

    def _progress(self, log: Any, truth: PlantModel) -> dict[str, float | None]:
        """Whether each arm, and all, reached their last targets, and after which time."""
        robot, start = truth.known_robot(), start_motion(truth)
        context, found = robot.create_context(), dict[str, float | None]()
        signals = (log[f"joint_{name}_command"].values for name in ("position", "velocity"))
        motions = [ArmsMotion(robot, context, q, v) for q, v in zip(*signals, strict=True)]
        targets = np.split(log["task_target"].values, len(start.arm_names), axis=1)
        usual, last, ends = Supervision(), 0, list[int]()
        for arm, target in zip(start.arm_names, targets, strict=True):
            task = ArmTask(arm, orientation=RotationVector(start.arm(arm).rotation))
            tolerance = np.where(task.angular, usual.angle_tolerance, usual.position_tolerance)
            watch, progress = TaskProgress(tolerance, usual.patience, truth.period), None
            reached = []
            for motion, wanted in zip(motions, target, strict=True):
                state = task.state(motion)
                past = progress or Progress(np.full_like(wanted, np.nan), np.inf, 0.0, 0.0, 0.0)
                progress = watch.update(past, wanted, state.value, state.rate)
                reached.append(progress.reached)
            changes = np.flatnonzero((np.diff(target, axis=0) != 0).any(axis=1))
            begun = changes[-1] + 1 if len(changes) else 0
            there = np.flatnonzero(reached[begun:])
            last = max(last, begun)
            if len(there):
                ends.append(int(begun + there[0]))
            found |= {
                f"{arm}.reached": reached[-1],
                f"{arm}.stalled": progress.stalled if progress else 0.0,
                f"{arm}.time_reached_s": float(there[0] * truth.period) if len(there) else None,
            }
        every = [[found[f"{arm}.{name}"] or 0.0 for arm in start.arm_names] for name in ("reached", "stalled")]
        time = float(max(ends) - last) * truth.period if len(ends) == len(start.arm_names) else None
        return found | {"reached": min(every[0]), "stalled": max(every[1]), "time_reached_s": time}

    def _along(self, log: Any, truth: PlantModel) -> tuple[Array, Array]:
        """Least distance of the links [m] and reflected masses (k, arms) [kg], each `every` ticks.

        The distance is infinite for a robot without shapes that move against each other.
        """
        robot = truth.known_robot()
        pairs = []
        try:
            shapes = RobotShapes.load(*robot.source)
        except BadInputError:  # some are missing
            shapes = None
        if shapes is not None and shapes.pairs:
            pairs.append(LinkDistance(shapes))
        if shapes is not None and truth.obstacles:
            boxes = Obstacle.boxes(truth.obstacles)
            pairs.append(LinkDistance(shapes.against(boxes)))
        masses = [TowardsSmallMass(robot, arm, self.mass_direction) for arm in robot.parts.arms]
        context, rest = robot.create_context(), np.zeros(truth.num_joints)
        distances, found = [], []
        for q in log["link_position"].values[:: self.every]:
            distances.append(min((pair.distances(q).min() for pair in pairs), default=np.inf))
            motion = ArmsMotion(robot, context, q, rest)
            found.append([mass.mass(motion) for mass in masses])
        return np.array(distances), np.array(found)


def _millimetres(distance: float) -> float | None:
    """A distance [m] in mm; None if it is infinite."""
    return 1e3 * float(distance) if np.isfinite(distance) else None
