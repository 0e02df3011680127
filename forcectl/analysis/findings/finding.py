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
        """What it says of the run."""
        return _MEANINGS[self]


SEVERITIES = {severity.word: severity for severity in Severity}


def parse_severity(text: str, name: str) -> Severity:
    """The severity of that word; BadInputError that says `name` for another one."""
    if text not in SEVERITIES:
        raise unknown(name, text, SEVERITIES)
    return SEVERITIES[text]


_MEANINGS = {
    Severity.INFO: "worth knowing; nothing is wrong",
    Severity.WARNING: "the run did what it was to do, but not well: look before its numbers are used",
    Severity.ERROR: "the run did not do what it was to do, or a real robot would have stopped or been damaged",
}


class Kind(NamedTuple):
    """A kind of findings: how bad it is, and what it says."""

    severity: Severity
    meaning: str


KINDS: dict[str, Kind] = {
    "sensor_saturated": Kind(Severity.ERROR, "the true force was at the end of the force sensor's range, or beyond"),
    "sensor_off": Kind(Severity.ERROR, "the force sensor showed a force at rest wrong by more than a fifth"),
    "readings_repeated": Kind(Severity.WARNING, "readings of the force sensor were lost or late, again and again"),
    "command_saturated": Kind(
        Severity.WARNING, "a command stood still at its extreme while more was needed, or a motor torque at its limit"
    ),
    "torque_beyond_limits": Kind(
        Severity.WARNING, "the motion may have needed more torque than a motor has, from drives without a limit"
    ),
    "estimate_at_bound": Kind(
        Severity.WARNING, "an estimated compliance stood at its bound, and explained the force no longer"
    ),
    "compliance_off": Kind(
        Severity.INFO, "a surface was at least twice as stiff or as soft as the model of it that the law is given"
    ),
    "contact_lost": Kind(
        Severity.ERROR, "the tool left the surface while a force was wanted, and for longer than a bounce"
    ),
    "contact_bounced": Kind(Severity.WARNING, "the tool left the surface for a moment while a force was wanted"),
    "no_contact": Kind(
        Severity.ERROR, "a force was wanted, and the tool never touched the surface, or no law regulated it"
    ),
    "touched_again": Kind(Severity.INFO, "a first touch bounced or went back a step, before the force law took over"),
    "force_too_high": Kind(Severity.ERROR, "the true force was above the stated maximum"),
    "unstable": Kind(
        Severity.ERROR,
        "the true force swings more and more under a constant reference, or nothing but losses of contact bounds it",
    ),
    "limit_cycle": Kind(
        Severity.WARNING,
        "the true force keeps swinging under a constant reference, at rest or in motion along an even surface; an "
        "error where it swings by more than half of that",
    ),
    "swings_beside_reference": Kind(
        Severity.WARNING, "the true force swings more often, or much further, than its varying reference"
    ),
    "reference_not_followed": Kind(
        Severity.WARNING, "the true force changes by less than a tenth of what its varying reference does"
    ),
    "force_disturbed": Kind(
        Severity.WARNING,
        "the true force had settled, and was taken off its constant reference by more than a fifth; or, in motion "
        "along a surface, it stays off by more than the reference for half a second",
    ),
    "stick_slip": Kind(Severity.WARNING, "a joint sticks and lets go, again and again, while its command moves on"),
    "not_settled": Kind(
        Severity.WARNING,
        "the true force is off its constant reference at the end of a hold; an info while it is on its way",
    ),
    "chatter": Kind(Severity.WARNING, "a command at rest turns round many times a second"),
    "command_beyond_limits": Kind(Severity.ERROR, "the commanded motion is beyond limits of the joints"),
    "links_beyond_limits": Kind(Severity.WARNING, "the motion of the robot is beyond limits of its joints"),
    "target_not_reached": Kind(Severity.WARNING, "the run ended on the way to the last targets"),
    "target_stalled": Kind(Severity.ERROR, "the last targets were not reached, and came no nearer for a second"),
    "machine_failed": Kind(Severity.ERROR, "the state machine ended in a failure"),
    "machine_not_ended": Kind(Severity.WARNING, "the run ended before its state machine"),
    "solver_fallback": Kind(
        Severity.ERROR, "a controller had no solution of its program, or no good readings, and braked or held"
    ),
    "guarded": Kind(Severity.WARNING, "the guard held, slowed down or took back the command, and passed it on again"),
    "guard_stopped": Kind(Severity.ERROR, "the guard took the command over and stopped"),
    "friction_unknown": Kind(Severity.WARNING, "friction was to be identified, and the run does not excite a joint"),
    "key_unread": Kind(Severity.INFO, "a key has another value than usual, and no effect"),
    "held": Kind(Severity.WARNING, "a controller braked or held its joints, with a solution"),
}


@dataclass(frozen=True)
class RunFinding:
    """One thing to know of a run.

    Attributes:
        kind: one of `KINDS`, or a name of one's own.
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
        """What was recorded."""
        return cls(row["kind"], parse_severity(row["severity"], "severity"), row["text"], row["time_s"])


def findings_lines(findings: Mapping[str, Sequence[RunFinding]]) -> list[str]:
    """The findings of every variant, a line each; one that says so where there is none."""
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
