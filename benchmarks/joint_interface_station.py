"""Two arms behind their joint interface in a loop: real-time factor, and the share of each part.

Both arms move in free air, friction sticks, everything is logged. They swing; or they reach for poses that change, with
force estimator and reactive controller. Of each case the time of a run without the estimator and one with it are
measured in turns; the shares come from taking parts away.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

# Found also when this file is run as a script, from a checkout.
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks._measure import Row, interleaved_medians, main

DURATION = 3.0  # [s]
APART = [-99, -86, 11, 16, -103, 26, -19, 74, -93, -45, -17, -82, 26, -18]  # no link meets another on its way
REAL = {"elastic_joints": True, "self_collision": None}


def benchmark(repeats: int) -> Iterator[Row]:
    from forcectl.estimation.force_estimator_config import ForceEstimatorConfig
    from forcectl.motion.joint_path import JointExcitationConfig
    from forcectl.tasks.controllers.reaching import ReachConfig, ReactiveReachingConfig

    swing, estimator = JointExcitationConfig(speed_shares=[0.3]), ForceEstimatorConfig()
    targets = [
        ReachConfig(time=0.5 * k, arm=arm, position=[0.4 + 0.05 * (k % 2), side * 0.25, 0.2 + 0.05 * (k % 3)])
        for k in range(5)
        for arm, side in (("left", 1.0), ("right", -1.0))
    ]
    reach = ReactiveReachingConfig(targets=targets, link_distance=0.0)
    apart = ReactiveReachingConfig(targets=targets)
    cases: list[tuple[str, str, dict[str, Any], Any, Any]] = [
        ("two arms, servos of 2 kHz", ">= 3", {}, swing, None),
        ("  and force estimator", ">= 3", {}, swing, estimator),
        ("  and elastic joints", "", {"elastic_joints": True}, swing, estimator),
        ("  and links that may touch", "", {"self_collision": True, "posture_deg": APART}, swing, estimator),
        ("  with a plant of 2 kHz, too", "", {"time_step": 0.0005}, swing, estimator),
        ("both arms as they are by default, reactive controller", ">= 2", REAL, reach, estimator),
        ("  that keeps links apart", "", REAL, apart, estimator),
        ("one arm and force estimator", "", {"robot": "yumi/left"}, swing, estimator),
    ]
    times = interleaved_medians([_runner(*parts) for _, _, *parts in cases], repeats)
    for (name, required, *_), spent in zip(cases, times, strict=True):
        yield Row(name, DURATION / spent, "x real time", required, "5" if required else "")
    bare, observed = times[:2]
    plant = interleaved_medians([_plant_runner()], repeats)[0]
    yield Row("share of the plant", 100 * plant / observed, "%", note="robot with friction and constant torques")
    yield Row("share of servo, sensors, path, log", 100 * (bare - plant) / observed, "%")
    yield Row("share of the estimator", 100 * (observed - bare) / observed, "%")


def _runner(options: dict[str, Any], controller: Any, estimator: Any) -> Callable[[], None]:
    from pydrake.systems.analysis import Simulator

    from forcectl.scenario.scenario import Scenario

    estimators = {} if estimator is None else {"force": estimator}
    loop = Scenario(station=_station(**options), controller=controller, estimators=estimators).build()
    return lambda: Simulator(loop.diagram).AdvanceTo(DURATION)


def _station(**options: Any) -> Any:
    """Both arms in free air, with rigid joints and links that do not touch unless said otherwise."""
    from forcectl.diagrams.drives.joint_interface import JointInterfaceConfig
    from forcectl.diagrams.sensors import JointReadingsConfig
    from forcectl.diagrams.station import StationConfig
    from forcectl.plant.contact.parts import EnvironmentPartsConfig

    usual: dict[str, Any] = {
        "fidelity": "Multibody",
        "robot": "yumi",
        "tool": "yumi_gripper",
        "elastic_joints": False,
        "self_collision": False,
        "drive": JointInterfaceConfig(),
        "environment": EnvironmentPartsConfig(parts={}),
        "sensors": {"joints": JointReadingsConfig()},
    }
    return StationConfig(**{**usual, **options})


def _plant_runner() -> Callable[[], None]:
    from pydrake.systems.analysis import Simulator
    from pydrake.systems.framework import DiagramBuilder
    from pydrake.systems.primitives import ConstantVectorSource

    from forcectl.diagrams.mechanics.world import add_world
    from forcectl.diagrams.workcell import describe

    builder = DiagramBuilder()
    site = add_world(builder, describe(_station()), 0)
    plant, instance = site.plant, site.parts.instance
    for port in (plant.get_actuation_input_port(instance), plant.get_desired_state_input_port(instance)):
        source = builder.AddSystem(ConstantVectorSource([0.0] * port.size()))
        builder.Connect(source.get_output_port(), port)
    diagram = builder.Build()
    return lambda: Simulator(diagram).AdvanceTo(DURATION)


if __name__ == "__main__":
    main("Two arms behind their joint interface", benchmark)
