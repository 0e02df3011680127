"""One reading of any Drake diagram or block: names, wires, ports, periodic events, feedthrough and delays.

The doctor, the block diagrams and the pytest plugin all read through this room, so they call a block by the same name:
paths such as `station/plant`, ports such as `station/plant.net_actuation`. The parts are loaded when they are used.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from forcectl.inspect.delay import DelayChain, DelayRow
    from forcectl.inspect.events import PeriodicEvent, Timing, read_timing
    from forcectl.inspect.feedthrough import FeedthroughRow, feedthrough_table
    from forcectl.inspect.start import StartValues
    from forcectl.inspect.wiring import Port, Wiring

__all__ = [
    "Wiring", "Port", "StartValues", "Timing", "PeriodicEvent", "read_timing",
    "FeedthroughRow", "feedthrough_table", "DelayChain", "DelayRow",
]  # fmt: skip

_HOME = {
    "Wiring": "wiring",
    "Port": "wiring",
    "StartValues": "start",
    "Timing": "events",
    "PeriodicEvent": "events",
    "read_timing": "events",
    "FeedthroughRow": "feedthrough",
    "feedthrough_table": "feedthrough",
    "DelayChain": "delay",
    "DelayRow": "delay",
}


def __getattr__(name: str) -> object:
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_HOME[name]}"), name)


def __dir__() -> list[str]:
    return __all__
