"""The doctor: look at any Drake diagram, a user's own included, and say what is wrong with it."""

from __future__ import annotations

from pydrake.systems.framework import DiagramBuilder, System

from forcectl.doctor.connections import unconnected_inputs, unused_outputs
from forcectl.doctor.delay import COMMANDS, SENSOR, chain_findings, default_traces, trace
from forcectl.doctor.events import periodic_events, timing_findings
from forcectl.doctor.feedthrough import feedthrough_table, undeclared_prerequisites
from forcectl.doctor.loops import algebraic_loops
from forcectl.doctor.paths import Hops, PortName
from forcectl.doctor.report import DelayChain, Finding, Report, error, sort_findings
from forcectl.doctor.stages import declared_findings
from forcectl.doctor.units import mismatches
from forcectl.doctor.values import StartValues, non_finite_outputs
from forcectl.doctor.wiring import Wiring
from forcectl.errors import BadInputError


def examine(
    system: System,
    *,
    sensor: PortName | None = None,
    command: PortName | None = None,
    expected_delay: float | None = None,
) -> Report:
    """Examine a diagram, or a single block, and everything inside it.

    Nothing of the given system is changed; contexts are the doctor's own. To see their timing, blocks are run alone
    for some samples from their start values, except Drake's own blocks with abstract inputs (visualizers, drivers).

    Args:
        system: any Diagram or LeafSystem.
        sensor: where the delay table begins: an output ("station.measured_force", or ("station", "measured_force"))
            or an input of a block (then the block's own delay counts). Default: the output called `measured_force`.
        command: where the delay table ends. Default: `joint_position_command` or `displacement_command`.
        expected_delay: the delay that the way from `sensor` to `command` should have [s]; another one is an error.

    Raises:
        BadInputError: `sensor` or `command` name no port, or several.
    """
    if not isinstance(system, System):
        raise BadInputError(f"examine() takes a Drake system, not {type(system).__name__}")
    wiring = Wiring(system)
    values = StartValues(wiring)
    findings = _structure(wiring, values)
    findings += non_finite_outputs(values)
    events = periodic_events(values, findings)
    findings += timing_findings(events)
    hops = Hops(wiring, events)
    findings += declared_findings(values, hops)
    delays = _delays(values, hops, sensor, command, expected_delay, findings)
    return Report(system.get_name(), sort_findings(findings), feedthrough_table(wiring), events, delays)


def examine_builder(builder: DiagramBuilder) -> Report:
    """Examine what has been added to a builder so far, before `Build()`, which refuses algebraic loops.

    Reports wiring, loops and feedthrough. Unused outputs, timing and delays need the built diagram: a builder does
    not tell which outputs it exports.

    Raises:
        BadInputError: the builder has already built its diagram.
    """
    if not isinstance(builder, DiagramBuilder):
        raise BadInputError(f"examine_builder() takes a DiagramBuilder, not {type(builder).__name__}")
    if builder.already_built():
        raise BadInputError("this builder has already built its diagram: use examine(diagram)")
    wiring = Wiring(builder)
    findings = _structure(wiring, StartValues(wiring))
    return Report("", sort_findings(findings), feedthrough_table(wiring))


def _structure(wiring: Wiring, values: StartValues) -> list[Finding]:
    return [
        *unconnected_inputs(wiring),
        *algebraic_loops(wiring),
        *undeclared_prerequisites(wiring, values.block_context),
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
) -> tuple[DelayChain, ...]:
    defaults = default_traces(values.wiring)
    wanted = defaults
    if sensor is not None or command is not None or (expected is not None and not defaults):
        first = sensor if sensor is not None else (defaults[-1][0] if defaults else SENSOR)
        last = command if command is not None else (defaults[-1][1] if defaults else COMMANDS[0])
        wanted = [(first, last)]
    chains = []
    for source, target in wanted:
        chain = trace(values, hops, source, target)
        main = (source, target) == wanted[-1]
        if chain is not None:
            chains.append(chain)
            if main:  # what happens inside the sensor is the sensor's own matter
                findings += chain_findings(values, chain, expected)
        elif main and (wanted is not defaults or expected is not None):
            where = f"{source} -> {target}"
            findings.append(error("no-way", where, "no signal reaches the second port from the first"))
    return tuple(chains)
