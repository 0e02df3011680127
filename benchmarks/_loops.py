"""The loops that are measured: the default plant of the targets, pressing with 15 N at K_I = 1.5 1/s."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Diagram

from forcectl.diagrams.log import LoggedLoop
from forcectl.diagrams.loop import Loop
from forcectl.diagrams.one_dimensional_loop import OneDimensionalLoopConfig, build_one_dimensional_loop
from forcectl.diagrams.station import SHIPPED_FIDELITIES, StationConfig
from forcectl.force.integral import IntegralConfig
from forcectl.motion.references import StepConfig
from forcectl.scenario.scenario import Scenario

__all__ = ["SHIPPED_FIDELITIES", "build", "build_scalar", "runner"]


def build(fidelity: str, **station: Any) -> Loop:
    """A closed loop with noise, friction, elastic joints and its log."""
    own = StationConfig(fidelity=fidelity, **station)
    return Scenario(station=own, controller=IntegralConfig(), reference=StepConfig(force=15.0)).build()


def build_scalar(size: int = 1, linear: bool = False) -> LoggedLoop:
    """The scalar loop of Fig. 2.2 for a batch of `size`, with its log."""
    config = OneDimensionalLoopConfig.linear() if linear else OneDimensionalLoopConfig()
    return build_one_dimensional_loop(config, size=size)


def runner(diagram: Diagram, duration: float) -> Callable[[], None]:
    """A function that simulates a diagram from its start for `duration` [s]; building and initialising do not count."""

    def run() -> None:
        simulator.reset_context(diagram.CreateDefaultContext())
        simulator.Initialize()
        simulator.AdvanceTo(duration)

    simulator = Simulator(diagram)
    return run
