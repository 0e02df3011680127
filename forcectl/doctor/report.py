"""The result of an examination as plain data, without references to Drake objects."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from functools import partial
from typing import Any

from forcectl.inspect.delay import DelayChain
from forcectl.inspect.events import PeriodicEvent
from forcectl.inspect.feedthrough import FeedthroughRow

SEVERITIES = ("error", "warning", "info")


@dataclass(frozen=True)
class Finding:
    """One finding: what was found, where, and how to correct it."""

    severity: str  # one of SEVERITIES
    code: str  # short and stable, such as "unconnected-input"
    path: str  # block or port: "station/sensor.measured_force"
    message: str  # one line

    def __str__(self) -> str:
        return f"{self.severity} [{self.code}] {self.path}: {self.message}"


# Each takes code, path and message.
error = partial(Finding, "error")  # makes the diagram wrong
warning = partial(Finding, "warning")  # deserves a second look
info = partial(Finding, "info")  # worth knowing


@dataclass(frozen=True, repr=False)
class Report:
    """All findings and tables of one examination.

    Attributes:
        name: name of the diagram.
        findings: errors first, then warnings, then infos.
        feedthrough: every output with the inputs that have direct feedthrough to it.
        events: all periodic events.
        delays: delays of the examined signal paths, in the order of the signal.
        dead_time: sum of these delays where the paths form one loop [s], else None.
    """

    name: str
    findings: tuple[Finding, ...] = ()
    feedthrough: tuple[FeedthroughRow, ...] = ()
    events: tuple[PeriodicEvent, ...] = ()
    delays: tuple[DelayChain, ...] = ()
    dead_time: float | None = None

    @property
    def ok(self) -> bool:
        """Whether there is no error; warnings do not count."""
        return not self.errors

    @property
    def errors(self) -> tuple[Finding, ...]:
        """The findings that make the diagram wrong."""
        return self.of_severity("error")

    @property
    def warnings(self) -> tuple[Finding, ...]:
        """The findings that deserve a second look."""
        return self.of_severity("warning")

    def of_severity(self, severity: str) -> tuple[Finding, ...]:
        """All findings of one severity, in the order they were made."""
        return tuple(f for f in self.findings if f.severity == severity)

    def with_code(self, code: str) -> tuple[Finding, ...]:
        """All findings of one code."""
        return tuple(f for f in self.findings if f.code == code)

    def to_dict(self) -> dict[str, Any]:
        """The report as dicts, lists, strings and numbers, ready for JSON."""
        return {"ok": self.ok, **asdict(self)}

    @property
    def counts(self) -> str:
        """Number of findings of each severity, as text."""
        return ", ".join(f"{len(self.of_severity(s))} {s}" for s in SEVERITIES)

    def __repr__(self) -> str:
        return f"<report on {self.name or 'diagram'!r}: {self.counts}>"

    def _repr_html_(self) -> str:
        from forcectl.doctor.render import as_html

        return as_html(self)

    def __str__(self) -> str:
        return "\n".join([f"{self.name or 'diagram'}: {self.counts}", *(f"  {finding}" for finding in self.findings)])


def sort_findings(findings: list[Finding]) -> tuple[Finding, ...]:
    """Errors first, then warnings, then infos; the order within each is kept."""
    return tuple(sorted(findings, key=lambda f: SEVERITIES.index(f.severity)))
