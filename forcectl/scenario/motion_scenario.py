"""Scenarios of the motion loop (Part II): `loop: motion` in the scenario file.

loop: motion
station: {robot: yumi, tool: yumi_gripper}      # see ResearchStationConfig
controller: !JointMoves {...}                   # what moves the robot: MOTION_CONTROLLERS, or !Import
estimator: !ForceEstimator {...}                # optional: ESTIMATORS, or !Import
loads: [...]                                    # wrenches at the TCPs over time
analysis: !ForceEstimation {...}                # optional: metrics and figures from the log
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import xarray as xr
from matplotlib.figure import Figure

from forcectl.analysis.motion_metrics import motion_loop_metrics
from forcectl.diagrams.motion_loop import MotionLoop, build_motion_loop
from forcectl.diagrams.research_cell import ResearchStationConfig
from forcectl.errors import BadInputError
from forcectl.motion.loads import LoadConfig
from forcectl.scenario.catalog import ANALYSES, ESTIMATORS, MOTION_CONTROLLERS, MOTION_STATION
from forcectl.scenario.checks import check_run
from forcectl.scenario.expectations import Expectation
from forcectl.scenario.schema import first_of

LARGEST_CONTACT_FORCE = 2000.0  # [N] above it a run diverges


@dataclass(kw_only=True)
class MotionScenario:
    """One simulation of a motion loop, complete: a scenario file after one variant and overrides."""

    loop: str = "motion"
    title: str = ""
    source: str = ""  # figure or table of the thesis
    description: str = ""
    station: ResearchStationConfig = field(default_factory=ResearchStationConfig)
    controller: Any = field(default_factory=first_of(MOTION_CONTROLLERS), metadata={"tags": MOTION_CONTROLLERS})
    estimator: Any = field(default_factory=first_of(ESTIMATORS), metadata={"tags": ESTIMATORS})
    loads: list[LoadConfig] = field(default_factory=list)
    analysis: Any = field(default_factory=first_of(ANALYSES), metadata={"tags": ANALYSES})
    duration: float = 5.0  # [s], > 0
    seed: int = 0  # of every random number in the run, >= 0
    variants: dict[str, Any] = field(default_factory=dict)  # name -> values that replace the scenario's
    expect: list[Expectation] = field(default_factory=list)

    def __post_init__(self) -> None:
        check_run(self.duration, self.seed)
        for i, expectation in enumerate(self.expect):
            if expectation.fidelities:
                raise BadInputError(f"expect.{i}.fidelities: must be left out, a motion loop has one station")

    @property
    def fidelity(self) -> str:
        """Of its station."""
        return MOTION_STATION

    def build(self) -> MotionLoop:
        """The loop as a diagram."""
        return build_motion_loop(self.station, self.controller, self.estimator, loads=self.loads, seed=self.seed)

    def limits(self) -> dict[str, float]:
        """Largest absolute values of a healthy run, by signal."""
        return {"contact_force": LARGEST_CONTACT_FORCE}

    def model_bandwidth(self, loop: Any) -> float | None:
        """There is no reference model."""
        del loop
        return None

    def metrics(self, log: xr.Dataset, loop: Any, realtime_factor: float | None) -> dict[str, float | None]:
        """All metrics of a run."""
        return motion_loop_metrics(log, loop.facts, realtime_factor) | self.analysis.metrics(log, loop.facts)

    def figures(self, log: xr.Dataset, title: str) -> dict[str, Figure]:
        """Figures of a run, by file name; `log` may be that of several variants."""
        from forcectl.figures.motion import motion_figures

        return motion_figures(log, title) | self.analysis.figures(log, self.build().facts, title)
