"""One reading of any Drake diagram or block: names, wires, ports, periodic events, feedthrough and delays.

The doctor, the block diagrams and the pytest plugin all read through this room, so they call a block by the same name:
paths such as `station/plant`, ports such as `station/plant.net_actuation`.
"""
