"""The output ports that the key `log` of a scenario names."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from pydrake.systems.framework import Diagram

from forcectl.diagrams.components import components_of
from forcectl.diagrams.log import Probe
from forcectl.diagrams.workcell import Workcell
from forcectl.errors import BadInputError, invalid
from forcectl.inspect.ports import one_output, unit, value_type
from forcectl.inspect.wiring import Wiring


def probes_of(diagram: Diagram, names: Sequence[str], workcell: Workcell) -> tuple[Probe, ...]:
    """The ports that are logged in addition to the signals of a loop.

    Args:
        diagram: diagram of the loop.
        names: names of ports as in `forcectl graph`, such as `station/force_sensor.measured_wrench`.
        workcell: workcell of the loop.

    Raises:
        BadInputError: there is no output of that name, or it holds no numbers.
    """
    wiring, probes = Wiring(diagram), []
    for i, name in enumerate(names):
        try:
            address = one_output(wiring, name)
        except BadInputError as error:
            raise BadInputError(str(error), key=f"log.{i}") from None
        if value_type(port := wiring.port(address)):
            raise invalid(f"log.{i}", name, "an output with numbers")
        probes.append(Probe(name.replace("/", "."), port, unit(wiring, address)))
    named = components_of({probe.name: probe.port for probe in probes}, workcell)
    return tuple(replace(probe, components=named.get(probe.name)) for probe in probes)
