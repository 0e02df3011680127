"""The structure of any Drake diagram or block: names, wires, ports, periodic events, feedthrough and delays.

The doctor, the block diagrams and the pytest plugin all use this package, so they call a block by the same name: paths
such as `station/plant`, ports such as `station/plant.net_actuation`.
"""

from forcectl.framework.lazy import lazy_names

__getattr__, __dir__ = lazy_names(__name__, __file__)
