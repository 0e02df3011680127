"""What a finding is, and the kinds of findings of any run."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import Any, NamedTuple

from forcectl.errors import invalid, unknown


class Severity(IntEnum):
    """How bad a finding is."""

    INFO = 0
    WARNING = 1
    ERROR = 2

    @property
    def word(self) -> str:
        """As users write it."""
        return self.name.lower()

    @property
    def meaning(self) -> str:
        """The meaning of this severity for the run."""
        return _MEANINGS[self]


SEVERITIES = {severity.word: severity for severity in Severity}


def parse_severity(text: str, name: str) -> Severity:
    """The severity of that word; for another word a BadInputError about `name`."""
    if text not in SEVERITIES:
        raise unknown(name, text, SEVERITIES)
    return SEVERITIES[text]


_MEANINGS = {
    Severity.INFO: "for information: nothing is wrong",
    Severity.WARNING: "the run completed its task, but not well: check it before its numbers are used",
    Severity.ERROR: "the run did not complete its task, or a real robot would have stopped or been damaged",
}


class Kind(NamedTuple):
    """A kind of findings: how bad it is, and what it means."""

    severity: Severity
    meaning: str


KINDS: dict[str, Kind] = {
    "sensor_saturated": Kind(Severity.ERROR, "the true force was at the end of the force sensor's range, or beyond"),
    "sensor_off": Kind(
        Severity.ERROR, "the readings of the force sensor differed from a steady true force by more than a fifth"
    ),
    "readings_repeated": Kind(Severity.WARNING, "readings of the force sensor were repeatedly lost or late"),
    "command_saturated": Kind(
        Severity.WARNING,
        "a command stayed at its extreme value while the force error required more, or a motor torque was at its limit",
    ),
    "torque_beyond_limits": Kind(
        Severity.WARNING, "the motion may have needed more than a motor's torque limit, which the drives do not apply"
    ),
    "estimate_at_bound": Kind(
        Severity.WARNING, "an estimated compliance stayed at its bound and could no longer explain the force"
    ),
    "compliance_off": Kind(
        Severity.INFO, "a surface was at least twice as stiff or as soft as in the model that the force law uses"
    ),
    "contact_lost": Kind(
        Severity.ERROR, "the tool left the surface for longer than a bounce while the desired force was above zero"
    ),
    "contact_bounced": Kind(
        Severity.WARNING, "the tool left the surface for a moment while the desired force was above zero"
    ),
    "no_contact": Kind(
        Severity.ERROR,
        "a force was desired, but the tool never touched the surface, or no force law was active at the end",
    ),
    "touched_again": Kind(
        Severity.INFO, "the tool left the surface again after a first touch, before the force law took over"
    ),
    "force_too_high": Kind(Severity.ERROR, "the true force was above the stated maximum"),
    "unstable": Kind(
        Severity.ERROR,
        "the true force oscillates under a constant reference, and its amplitude grows or is only bounded by loss of "
        "contact",
    ),
    "limit_cycle": Kind(
        Severity.WARNING,
        "the true force keeps oscillating under a constant reference, at rest or in motion along an even surface; an "
        "error if the amplitude is more than half of the reference",
    ),
    "swings_beside_reference": Kind(
        Severity.WARNING,
        "the true force reverses more often, or varies over a much larger range, than its varying reference",
    ),
    "reference_not_followed": Kind(
        Severity.WARNING, "the true force changes by less than a tenth of the change of its varying reference"
    ),
    "force_disturbed": Kind(
        Severity.WARNING,
        "the true force had settled, and then deviated from its constant reference by more than a fifth; or, in motion "
        "along a surface, its error exceeds the reference for half a second",
    ),
    "stick_slip": Kind(
        Severity.WARNING, "a joint sticks and slips repeatedly, while its command moves on or the reference is constant"
    ),
    "not_settled": Kind(
        Severity.WARNING,
        "the true force has not settled at the end of a constant reference; an info while it still approaches it",
    ),
    "chatter": Kind(Severity.WARNING, "a command at rest reverses many times a second"),
    "command_beyond_limits": Kind(Severity.ERROR, "the commanded motion exceeds limits of the joints"),
    "links_beyond_limits": Kind(Severity.WARNING, "the motion of the robot exceeds limits of its joints"),
    "target_not_reached": Kind(Severity.WARNING, "the run ended before the last targets were reached"),
    "target_stalled": Kind(
        Severity.ERROR, "the last targets were not reached, and their distance did not decrease for a second"
    ),
    "machine_failed": Kind(Severity.ERROR, "the state machine ended in a failure"),
    "machine_not_ended": Kind(Severity.WARNING, "the run ended before its state machine"),
    "solver_fallback": Kind(
        Severity.ERROR,
        "a controller found no solution of its optimisation problem, or had invalid readings, and braked or held",
    ),
    "guarded": Kind(
        Severity.WARNING, "the guard held, slowed down or withdrew the command for a while, then released it"
    ),
    "guard_stopped": Kind(Severity.ERROR, "the guard took over the command and stopped"),
    "friction_unknown": Kind(
        Severity.WARNING, "friction could not be identified, for example because a joint is not excited"
    ),
    "key_unread": Kind(Severity.INFO, "a key has another value than its default, and no effect"),
    "held": Kind(
        Severity.WARNING, "a controller braked or held its joints although its optimisation problem had a solution"
    ),
}


@dataclass(frozen=True)
class RunFinding:
    """One finding about a run.

    Attributes:
        kind: one of `KINDS`, or a name that an analysis chose.
        severity: how bad it is.
        text: one line.
        time: when it begins [s]; None where no time belongs to it.
    """

    kind: str
    severity: Severity
    text: str
    time: float | None = None

    def __post_init__(self) -> None:
        if not isinstance(self.severity, Severity):
            raise invalid("severity", self.severity, "a Severity, such as Severity.WARNING")
        if self.time is not None and not math.isfinite(self.time):
            raise invalid("time", self.time, "a time [s] or None")

    def __str__(self) -> str:
        return f"{self.severity.word}: {self.text}"

    def as_row(self) -> dict[str, Any]:
        """The record in `metrics.json`."""
        return {
            "kind": self.kind,
            "severity": self.severity.word,
            "text": self.text,
            "time_s": None if self.time is None else float(self.time),
        }

    @classmethod
    def from_row(cls, row: Mapping[str, Any]) -> RunFinding:
        """The finding of a recorded row."""
        return cls(row["kind"], parse_severity(row["severity"], "severity"), row["text"], row["time_s"])


def findings_lines(findings: Mapping[str, Sequence[RunFinding]]) -> list[str]:
    """The findings of every variant, a line each; `findings: none` if there are none."""
    several = len(findings) > 1
    lines = [
        f"{one.severity.word}: {f'{variant}: ' if several else ''}{one.text}"
        for variant, found in findings.items()
        for one in found
    ]
    return lines or ["findings: none"]


def finding(kind: str, text: str, time: float | None = None) -> RunFinding:
    """A finding of one of `KINDS`."""
    return RunFinding(kind, KINDS[kind].severity, text, time)
