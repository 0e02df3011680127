"""The doctor: examines any Drake diagram, also a user's own, and reports errors in it."""

from __future__ import annotations

from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder, System

from forcectl.doctor.cenic import refused_scheme, scheme_name
from forcectl.doctor.connections import unconnected_inputs, unused_outputs
from forcectl.doctor.delays import chain_findings, declared_findings
from forcectl.doctor.feedthrough import missing_prerequisites, undeclared_prerequisites
from forcectl.doctor.loops import algebraic_loops
from forcectl.doctor.overlaps import overlapping_bodies
from forcectl.doctor.repeat import not_repeatable
from forcectl.doctor.report import Finding, Report, error, info, sort_findings
from forcectl.doctor.timing import failed_updates, timing_findings
from forcectl.doctor.units import mismatches
from forcectl.doctor.values import non_finite_outputs
from forcectl.errors import BadInputError
from forcectl.inspect.delay import COMMANDS, SENSOR, DelayChain, trace, way_and_back, ways_around
from forcectl.inspect.events import read_timing
from forcectl.inspect.feedthrough import feedthrough_table
from forcectl.inspect.names import type_in_words
from forcectl.inspect.ports import PortName, find_inputs, find_outputs
from forcectl.inspect.schedule import clean
from forcectl.inspect.start import StartValues
from forcectl.inspect.ways import Hops
from forcectl.inspect.wiring import Wiring


def examine(
    system: System,
    *,
    sensor: PortName | None = None,
    command: PortName | None = None,
    expected_delay: float | None = None,
    scheme: str | Simulator | None = None,
) -> Report:
    """Examine a diagram, or a single block, and everything inside it.

    The system is not changed, as the doctor uses its own contexts. To find their events, blocks are simulated alone for
    some samples from their start values, except Drake's own blocks with abstract inputs (visualizers, drivers).

    The delay tables follow the signal once around the loop, from the command to the contact force, to the sensor and
    back to the command; `Report.dead_time` is their sum. With `sensor` and `command` they lead from the one to the
    other and back.

    Args:
        system: any Diagram or LeafSystem.
        sensor: start of the delay table: an output ("station.measured_force", or ("station", "measured_force")) or an
            input of a block (then the delay of that block counts). Default: the output called `measured_force`.
        command: end of the delay table. Default: one of `inspect.delay.COMMANDS`.
        expected_delay: expected delay from `sensor` to `command` [s]; a different delay is an error.
        scheme: integration scheme for the simulation, by Drake's name, or a simulator that has one.

    Raises:
        BadInputError: `sensor` or `command` name no port, or several; `scheme` is not a scheme of Drake.
    """
    if not isinstance(system, System):
        raise BadInputError(f"examine() takes a Drake system, not {type_in_words(system)}")
    chosen = scheme_name(scheme)
    wiring = Wiring(system)
    values = StartValues(wiring)
    timing = read_timing(values)
    hops = Hops(wiring, timing.events)
    findings = [
        *_structure(values),
        *refused_scheme(values, chosen),
        *non_finite_outputs(values),
        *overlapping_bodies(values),
        *failed_updates(values, timing),
        *not_repeatable(values, timing),
        *timing_findings(timing.events),
        *declared_findings(values, hops),
    ]
    delays, dead_time = _delays(values, hops, sensor, command, expected_delay, findings)
    table = feedthrough_table(wiring)
    return Report(system.get_name(), sort_findings(findings), table, timing.events, delays, dead_time)


def examine_builder(builder: DiagramBuilder) -> Report:
    """Examine what has been added to a builder so far, before `Build()`, which refuses algebraic loops.

    Reports wiring, loops and feedthrough. Unused outputs, timing and delays need the built diagram: a builder does not
    say which outputs it exports.

    Raises:
        BadInputError: the builder has already built its diagram.
    """
    if not isinstance(builder, DiagramBuilder):
        raise BadInputError(f"examine_builder() takes a DiagramBuilder, not {type(builder).__name__}")
    if builder.already_built():
        raise BadInputError("this builder has already built its diagram: use examine(diagram)")
    wiring = Wiring(builder)
    return Report("", sort_findings(_structure(StartValues(wiring))), feedthrough_table(wiring))


def _structure(values: StartValues) -> list[Finding]:
    wiring = values.wiring
    return [
        *unconnected_inputs(wiring),
        *algebraic_loops(wiring),
        *undeclared_prerequisites(wiring),
        *missing_prerequisites(values),
        *mismatches(wiring),
        *unused_outputs(wiring),
    ]


def _delays(
    values: StartValues,
    hops: Hops,
    sensor: PortName | None,
    command: PortName | None,
    expected: float | None,
    findings: list[Finding],
) -> tuple[tuple[DelayChain, ...], float | None]:
    """The delay tables, and their sum where they form a loop; findings about them are added to `findings`."""
    defaults = ways_around(values.wiring)
    asked = not (sensor is None and command is None and expected is None)
    ways = defaults
    if asked:
        first, last = defaults[-1] if defaults and defaults[-1][0] == SENSOR else (SENSOR, COMMANDS[0])
        named = (first if sensor is None else sensor, last if command is None else command)
        for key, given, default in (("sensor (--from)", sensor, first), ("command (--to)", command, last)):
            if given is None and not any(find(values.wiring, default) for find in (find_inputs, find_outputs)):
                raise BadInputError(f"{key} must be given: no port here is called {default}, the default")
        ways = defaults if named in defaults else way_and_back(hops, *named)
    source, target = ways[-1] if ways else ("", "")
    closed = len(ways) > 1 and ways[0][0] == target
    onward = [way[1] if closed else None for way in ways[1:] + ways[:1]]
    traced = {way: trace(values, hops, *way, after) for way, after in zip(ways, onward, strict=True)}
    chains = {way: chain for way, chain in traced.items() if chain is not None}
    text = "no signal reaches the second port from the first"
    if (chain := chains.get((source, target))) is None and ways:
        where = f"{source} -> {target}"
        findings.append(error("no-way", where, text) if asked else info("open-loop", where, text))
    elif chain is not None and (asked or source == SENSOR):  # holds in plant and sensor are not reported
        findings += chain_findings(values, chain, expected)
    total = clean(sum(chain.total for chain in chains.values())) if closed and len(chains) == len(ways) else None
    return tuple(chains.values()), total
