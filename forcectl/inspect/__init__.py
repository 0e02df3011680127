"""One reading of any Drake diagram or block: names, wires, ports, periodic events, feedthrough and delays.

The doctor, the block diagrams and the pytest plugin all read through this room, so they call a block by the same name:
paths such as `station/plant`, ports such as `station/plant.net_actuation`.
"""

from forcectl.inspect.delay import DelayChain, DelayRow
from forcectl.inspect.events import PeriodicEvent, Timing, read_timing
from forcectl.inspect.feedthrough import FeedthroughRow, feedthrough_table
from forcectl.inspect.start import StartValues
from forcectl.inspect.wiring import Port, Wiring

__all__ = [
    "Wiring", "Port", "StartValues", "Timing", "PeriodicEvent", "read_timing",
    "FeedthroughRow", "feedthrough_table", "DelayChain", "DelayRow",
]  # fmt: skip
