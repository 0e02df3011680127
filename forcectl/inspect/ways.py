"""The way of a signal through the blocks, from one port to another."""

from __future__ import annotations

import heapq
import itertools
from dataclasses import dataclass

from pydrake.systems.framework import System

from forcectl.framework.wiring import input_names, output_names
from forcectl.inspect.events import PeriodicEvent
from forcectl.inspect.wiring import PortAddress, Wiring


@dataclass(frozen=True)
class Hop:
    """One block on the way."""

    block: str
    input: int
    output: int
    kind: str  # "feedthrough", "fixed" (declared delay without a sample), "continuous", "discrete", "unrestricted"
    event: PeriodicEvent | None = None  # of a sampled block


class Hops:
    """Which outputs of a block an input reaches, and how."""

    def __init__(self, wiring: Wiring, events: tuple[PeriodicEvent, ...]):
        self.wiring = wiring
        self.readers = wiring.readers()
        self._updates: dict[str, PeriodicEvent] = {}
        for event in events:
            known = self._updates.get(event.block)
            if event.kind != "publish" and (known is None or event.period < known.period):
                self._updates[event.block] = event

    def update_of(self, block: str) -> PeriodicEvent | None:
        """The fastest periodic update of a block."""
        return self._updates.get(block)

    def through(self, reader: PortAddress) -> list[Hop]:
        """Every way from an input of a block to its outputs. An input of a block with state may reach all of them."""
        wiring, system = self.wiring, self.wiring.systems[reader.system]
        pairs = wiring.feedthrough(reader.system)
        update = self.update_of(reader.system)
        hops = []
        for o in range(system.num_output_ports()):
            if (reader.index, o) in pairs:
                hops.append(Hop(reader.system, reader.index, o, "feedthrough"))
            elif update is not None:
                hops.append(Hop(reader.system, reader.index, o, update.kind, update))
            elif self.declared(reader.system, reader.index, o) is not None:
                hops.append(Hop(reader.system, reader.index, o, "fixed"))
            elif system.num_continuous_states():
                hops.append(Hop(reader.system, reader.index, o, "continuous"))
        return hops

    def declared(self, block: str, input_index: int, output_index: int) -> float | None:
        """What the block's `sample_delay` says about this way [s], None when it says nothing."""
        return declared_delays(self.wiring.systems[block]).get((input_index, output_index))

    def shortest(self, starts: list[PortAddress], target: PortAddress, inside: str = "") -> list[Hop] | None:
        """The way with the least delay from any of the inputs `starts` to the leaf output `target`, or None.

        With `inside`, only blocks within that nested diagram are passed.
        """
        heap: list[tuple[float, int, int, tuple[Hop, ...]]] = []
        order = itertools.count()  # entries of equal cost are never compared further
        done: set[PortAddress] = set()

        def push(readers: list[PortAddress], delay: float, trail: tuple[Hop, ...]) -> None:
            for reader in readers:
                if inside and inside not in self.wiring.parents(reader.system):
                    continue
                for hop in self.through(reader):
                    heapq.heappush(heap, (delay + self._cost(hop), len(trail) + 1, next(order), (*trail, hop)))

        push(starts, 0.0, ())
        while heap:
            delay, _, _, trail = heapq.heappop(heap)
            output = PortAddress(trail[-1].block, trail[-1].output)
            if output == target:
                return list(trail)
            if output not in done:
                done.add(output)
                push(self.readers.get(output, []), delay, trail)
        return None

    def _cost(self, hop: Hop) -> float:
        declared = self.declared(hop.block, hop.input, hop.output)
        if declared is not None:
            return declared
        return hop.event.period if hop.event is not None else 0.0


def declared_delays(system: System) -> dict[tuple[int, int], float]:
    """The entries of a `sample_delay` by input and output index [s]; entries with unknown ports are left out."""
    table: dict[tuple[str, str], float] = getattr(system, "sample_delay", {})
    if not table:
        return {}
    inputs, outputs = input_names(system), output_names(system)
    known = {names: delay for names, delay in table.items() if names[0] in inputs and names[1] in outputs}
    return {(inputs.index(source), outputs.index(target)): float(delay) for (source, target), delay in known.items()}
