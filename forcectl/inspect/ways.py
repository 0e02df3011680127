"""Signal paths through the blocks, from one port to another."""

from __future__ import annotations

import heapq
import itertools
from collections.abc import Iterable
from dataclasses import dataclass

from pydrake.systems.primitives import Demultiplexer, Multiplexer

from forcectl.inspect.events import PeriodicEvent
from forcectl.inspect.wiring import PortAddress, Wiring

Elements = range | None  # of a vector; None: all


@dataclass(frozen=True)
class Hop:
    """One block on a signal path, from one of its inputs to one of its outputs."""

    input: PortAddress
    output: PortAddress
    # "feedthrough", "fixed" (declared delay without a sample), "continuous", "discrete", "unrestricted", or "aperiodic"
    # (its state changes at every step of the simulator, or at witnessed events).
    kind: str
    event: PeriodicEvent | None = None  # of a sampled block

    @property
    def block(self) -> str:
        """Path of the block."""
        return self.output.system


class Hops:
    """The connections through each block: which outputs an input affects, and by which kind of event.

    Attributes:
        readers: leaf inputs that read each leaf output, and each input of the whole diagram.
        updates: fastest periodic update of each block that has one.
    """

    def __init__(self, wiring: Wiring, events: tuple[PeriodicEvent, ...]):
        self.wiring = wiring
        self.readers = wiring.readers()
        self.updates: dict[str, PeriodicEvent] = {}
        for event in events:
            known = self.updates.get(event.block)
            if event.kind != "publish" and (known is None or event.period < known.period):
                self.updates[event.block] = event

    def through(self, reader: PortAddress, target: PortAddress | None = None) -> list[Hop]:
        """The hops from an input of a block to each of its outputs that is read, or is the target.

        In a block with state an input is assumed to affect all outputs.
        """
        update, system = self.updates.get(reader.system), self.wiring.systems[reader.system]
        hops = []
        for output in self.wiring.outputs(reader.system):
            if output not in self.readers and output != target:
                continue
            if reader in self.wiring.passed(output):
                hops.append(Hop(reader, output, "feedthrough"))
            elif update is not None:
                hops.append(Hop(reader, output, update.kind, update))
            elif self.declared(reader, output) is not None:
                hops.append(Hop(reader, output, "fixed"))
            elif system.num_continuous_states():
                hops.append(Hop(reader, output, "continuous"))
            elif system.num_discrete_state_groups() or system.num_abstract_states():
                hops.append(Hop(reader, output, "aperiodic"))
        return hops

    def declared(self, reader: PortAddress, output: PortAddress) -> float | None:
        """The delay that the block declares in `sample_delay` for these ports [s]; None when it declares none."""
        return declared_delays(self.wiring, output.system).get((reader, output))

    def shortest(self, starts: Iterable[PortAddress], target: PortAddress, inside: str = "") -> list[Hop] | None:
        """The path of least delay from any of the inputs `starts` to the leaf output `target`, or None.

        A path that the blocks' `passed_elements` exclude is taken only where there is no other. With `inside`, only
        blocks in that nested diagram are passed.
        """
        heap: list[tuple[int, float, int, int, Elements, list[Hop]]] = []
        order = itertools.count()  # entries of equal cost are never compared further
        done: set[tuple[PortAddress, Elements]] = set()

        def push(
            readers: Iterable[PortAddress], excluded: int, delay: float, elements: Elements, trail: list[Hop]
        ) -> None:
            for reader in readers:
                if inside and inside not in self.wiring.parents(reader.system):
                    continue
                for hop in self.through(reader, target):
                    beyond = self._elements(hop, elements)
                    if beyond == range(0) and not any(self._excludes(each) for each in (*trail, hop)):
                        continue  # the signal is in other elements of a vector, by Drake's own blocks alone
                    cost = (excluded + (beyond == range(0)), delay + self._cost(hop), len(trail) + 1, next(order))
                    heapq.heappush(heap, (*cost, beyond or None, [*trail, hop]))

        push(starts, 0, 0.0, None, [])
        while heap:
            excluded, delay, _, _, elements, trail = heapq.heappop(heap)
            output = trail[-1].output
            if output == target:
                return trail
            if (output, elements) not in done:
                done.add((output, elements))
                push(self.readers.get(output, ()), excluded, delay, elements, trail)
        return None

    def _elements(self, hop: Hop, elements: Elements) -> Elements:
        """The elements of the hop's output that carry the signal; an empty range for none.

        Args:
            hop: hop through a block.
            elements: elements of the hop's input that carry the signal.
        """
        system = self.wiring.systems[hop.block]
        if isinstance(system, Demultiplexer) and elements is not None:
            sizes = system.get_output_ports_sizes()
            first, size = sum(sizes[: hop.output.index]), sizes[hop.output.index]
            return range(max(elements.start - first, 0), min(elements.stop - first, size))
        if isinstance(system, Multiplexer):
            first = sum(self.wiring.port(port).size() for port in self.wiring.inputs(hop.block)[: hop.input.index])
            own = range(self.wiring.port(hop.input).size()) if elements is None else elements
            return range(first + own.start, first + own.stop)
        names = tuple(self.wiring.port(port).get_name() for port in (hop.input, hop.output))
        passed: dict[tuple[str, ...], range] = getattr(system, "passed_elements", {})
        return passed.get(names)

    def _excludes(self, hop: Hop) -> bool:
        """Whether the block declares `passed_elements`: its other elements follow the input only in a fault."""
        return bool(getattr(self.wiring.systems[hop.block], "passed_elements", {}))

    def _cost(self, hop: Hop) -> float:
        declared = self.declared(hop.input, hop.output)
        if declared is not None:
            return declared
        return hop.event.period if hop.event is not None else 0.0


def declared_delays(wiring: Wiring, path: str) -> dict[tuple[PortAddress, PortAddress], float]:
    """The entries of a system's `sample_delay` by input and output port [s], without those of unknown ports."""
    table: dict[tuple[str, str], float] = getattr(wiring.systems[path], "sample_delay", {})
    if not table:
        return {}
    inputs = {wiring.port(port).get_name(): port for port in wiring.inputs(path)}
    outputs = {wiring.port(port).get_name(): port for port in wiring.outputs(path)}
    return {(inputs[i], outputs[o]): float(s) for (i, o), s in table.items() if i in inputs and o in outputs}
