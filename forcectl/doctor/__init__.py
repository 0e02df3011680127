"""The diagram doctor: finds errors in a Drake diagram, says where they are, and how to correct them."""

from forcectl.doctor.examine import examine, examine_builder
from forcectl.doctor.loops import build
from forcectl.doctor.measure import measure_delay
from forcectl.doctor.render import render
from forcectl.doctor.report import Finding, Report
from forcectl.inspect.delay import DelayChain, DelayRow
from forcectl.inspect.events import PeriodicEvent
from forcectl.inspect.feedthrough import FeedthroughRow

__all__ = [
    "examine", "examine_builder", "build", "measure_delay", "render",
    "Report", "Finding", "FeedthroughRow", "PeriodicEvent", "DelayChain", "DelayRow",
]  # fmt: skip


def __dir__() -> list[str]:
    return sorted(__all__)
