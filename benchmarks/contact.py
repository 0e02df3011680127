"""Two arms that hold a plunger and a tube, in a loop with estimator and reactive controller: real-time factors.

The left hand leads the plunger into the bore, 2 mm and 3 degrees off, from 10 to 60 mm deep; or past it, where the tube
is held beside. Links that touch each other push each other, joints are elastic, everything is logged. Times are of the
CPU. The shares come from taking parts away: the contact, the estimator, and the controller from a loop that stands.

A trial is `peg_in_hole` up to 3 s: with the shapes of the parts, and with `!PegInBore` in their place.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

# Found also when this file is run as a script, from a checkout.
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks._measure import Row, interleaved_medians, main

DURATION = 2.0  # [s]
TRIAL = 3.0  # [s]
DEEP, SPEED = 0.010, 0.025  # at the start [m], of the left hand [m/s]
LEFT = [-50.997, -41.655, 85.036, 18.127, -30.028, 69.708, -116.149]  # the hands face each other along y
RIGHT = [50.997, -41.655, -85.036, 18.127, 30.028, 69.708, 116.149]
HAND = [0.42, 0.0825, 0.25]  # TCP of the left arm [m]


def benchmark(repeats: int) -> Iterator[Row]:
    cases: list[tuple[str, str, dict[str, Any]]] = [
        ("free, 1 ms", "2", {"contact": "free"}),
        ("hydroelastic contact, 1 ms", "0.8", {"contact": "shapes"}),
        ("hydroelastic contact, 2 ms", "1.2", {"contact": "shapes", "step": 0.002}),
        ("analytic contact, 1 ms", "2", {"contact": "rings"}),
        ("analytic contact, 2 ms", "", {"contact": "rings", "step": 0.002}),
        ("free, without estimator, 1 ms", "", {"contact": "free", "estimator": False}),
        ("free, standing, without estimator, 1 ms", "", {"contact": "free", "estimator": False, "controller": False}),
    ]
    runs = [_runner(scenario(**options), DURATION) for _, _, options in cases]
    trials = [_runner(trial(rings), TRIAL) for rings in (False, True)]
    *times, with_shapes, with_rings = interleaved_medians([*runs, *trials], repeats, time.process_time)
    yield Row("trial of peg_in_hole, 3 s, hydroelastic contact", with_shapes, "s", goal="4")
    yield Row("trial of peg_in_hole, 3 s, analytic contact", with_rings, "s")
    yield Row("  as fast as with hydroelastic contact", with_shapes / with_rings, "times", goal="2")
    for (name, goal, _), spent in zip(cases, times, strict=True):
        yield Row(name, DURATION / spent, "x real time", goal=goal)
    free, shapes, _, rings, _, unobserved, standing = times
    for name, whole in (("hydroelastic", shapes), ("analytic", rings)):
        yield Row(f"share of the {name} contact, 1 ms", 100 * (whole - free) / whole, "%")
        yield Row("  of the reactive controller", 100 * (unobserved - standing) / whole, "%")
        yield Row("  of the estimator", 100 * (free - unobserved) / whole, "%")


def _runner(of: Any, duration: float) -> Callable[[], None]:
    from pydrake.systems.analysis import Simulator

    diagram = of.build().diagram
    return lambda: Simulator(diagram).AdvanceTo(duration)


def trial(rings: bool) -> Any:
    """The scenario of a trial."""
    from forcectl.plant.contact.pairs.peg_contact import InsertionConfig
    from forcectl.scenario.scenario import load_scenario

    seat = {"station.environment.parts.seat": InsertionConfig(peg="plunger", bore="tube")}
    return load_scenario("peg_in_hole", "3 mm, 5 degrees", seat if rings else None)


def scenario(contact: str, step: float = 0.001, estimator: bool = True, controller: bool = True) -> Any:
    """The scenario of a case."""
    from forcectl.diagrams.drives.joint_interface import JointInterfaceConfig
    from forcectl.diagrams.sensors import ContactTruthConfig, JointReadingsConfig
    from forcectl.diagrams.station import StationConfig
    from forcectl.estimation.force_estimator_config import KalmanForceEstimatorConfig
    from forcectl.motion.joint_path import JointMovesConfig
    from forcectl.plant.contact.pairs.peg_contact import InsertionConfig
    from forcectl.plant.contact.part import PartConfig
    from forcectl.plant.contact.parts import EnvironmentPartsConfig
    from forcectl.scenario.scenario import Scenario
    from forcectl.tasks.controllers.reaching import MotionLimitsConfig, ReachConfig, ReactiveReachingConfig
    from forcectl.tasks.null_space_parts import SelfMotionConfig

    aside = 0.05 if contact == "free" else 0.0
    parts: dict[str, Any] = {
        "plunger": PartConfig(
            model="pipette_plunger_0p5",
            frame="tip",
            arm="left",
            position=[0.002, 0.0, 0.105 + DEEP],
            rotation_deg=[183.0, 0.0, 0.0],
        ),
        "tube": PartConfig(model="pipette_body", frame="mouth", arm="right", position=[aside, 0.0, 0.06]),
    }
    if contact == "rings":
        parts["seat"] = InsertionConfig(peg="plunger", bore="tube")
    station = StationConfig(
        fidelity="Multibody",
        robot="yumi",
        tool="yumi_gripper",
        drive=JointInterfaceConfig(),
        sensors={
            "joints": JointReadingsConfig(quantum=1e-5, torque_noise=0.1),
            "insertion": ContactTruthConfig(on=["plunger"], by=["tube"], frame="tube::mouth"),
        },
        environment=EnvironmentPartsConfig(parts=parts),
        self_collision=True,
        posture_deg=LEFT + RIGHT,
        time_step=step,
    )
    goal = [HAND[0], HAND[1] - SPEED * DURATION, HAND[2]]
    reaching = ReactiveReachingConfig(
        targets=[ReachConfig(arm="left", position=goal)],
        motion_limits=MotionLimitsConfig(speed=SPEED),
        null_space=SelfMotionConfig(),
    )
    return Scenario(
        station=station,
        controller=reaching if controller else JointMovesConfig(),
        estimators={"force": KalmanForceEstimatorConfig(expressed_in="tcp")} if estimator else {},
    )


if __name__ == "__main__":
    main("Two arms that put a plunger into a tube", benchmark)
