"""Analyses of the log of a run: metrics and figures.

Every run has the metrics and figures that its signals allow; an analysis of the scenario's part `analyses` adds its
own. It is a dataclass with two methods::

    metrics(log, setting) -> {name: value or None}        log of one variant
    figures(log, setting, title) -> {file name: Figure}   log of one variant, or of several along `variant`

and may have two more: `findings(log, setting) -> [RunFinding]`, added to those of every run, see
`forcectl.analysis.findings`, and `files(log, setting) -> {file name: text}`, for further files in the run directory.

The log is read-only. Names are plain file names; one that exists already is refused, because an analysis only adds.

A third, `check(signals, setting)`, raises BadInputError about a key that does not fit the loop, such as the name of a
part that does not exist; `signals` are those of the log, by name. Signals that the analysis requires stand in its class
as `needs = {signal: what makes it}`. A scenario whose loop has no such signal, or that `check` refuses, is refused when
it is built, before it is simulated.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from numbers import Real
from typing import TYPE_CHECKING, Any

from forcectl.analysis.findings.finding import RunFinding
from forcectl.analysis.force_metrics import metrics_of
from forcectl.analysis.motion_metrics import joint_metrics
from forcectl.diagrams.model import Setting
from forcectl.errors import BadInputError, RunFailedError, about, invalid, show, unknown
from forcectl.framework.reader import PART_NAME, is_part_name

if TYPE_CHECKING:
    from collections.abc import Container, Iterable, Sequence

    from matplotlib.figure import Figure

    from forcectl.analysis.force_targets import Allowed
    from forcectl.diagrams.log import LoggedSignal

SURFACE = "surface"  # dimension of signals with one element for each surface that is pressed on
# Entries of `needs` that several analyses share.
CONTACT_TRUTH = {"body_contact_wrench": "a sensor !ContactTruth, in Multibody"}
REFERENCE = {"desired_force": "a reference of the force"}


class WithoutFigures:
    """Base of analyses that have metrics but no figures."""

    def figures(self, log: Any, setting: Setting, title: str) -> dict[str, Figure]:
        """No figures."""
        return {}


def check_needs(analysis: Any, signals: Container[str], key: str = "analyses") -> None:
    """Refuse an analysis without a signal that it needs.

    Args:
        analysis: with or without `needs`.
        signals: names of the existing signals.
        key: of the analysis, for the message.

    Raises:
        BadInputError: names the signal, and what makes it.
    """
    needs = getattr(analysis, "needs", {})
    if not isinstance(needs, Mapping):
        raise invalid("needs", needs, "a mapping: what makes it, by the name of each signal").at(f"{key}.needs")
    for signal, maker in needs.items():
        if signal not in signals:
            raise BadInputError(f" finds no {signal}: must go together with {maker}", key=key)


def check_fits(analysis: Any, signals: Mapping[str, LoggedSignal], setting: Setting, key: str = "analyses") -> None:
    """Refuse an analysis that cannot be done in a loop, see `check_needs` and its own `check`.

    Args:
        analysis: with or without `needs` and `check`.
        signals: of the log, by name.
        setting: of the loop.
        key: of the analysis, for the message.

    Raises:
        BadInputError: about a key of the analysis.
    """
    check_needs(analysis, signals, key)
    if hasattr(analysis, "check"):
        with about(analysis):
            analysis.check(signals, setting)


def check_parts(names: Mapping[str, str], setting: Setting) -> None:
    """Refuse names of parts that the station does not have.

    Args:
        names: by the key that each stands at.
        setting: of the loop.
    """
    for key, name in names.items():
        if name not in setting.workcell.parts:
            raise unknown("part", name, setting.workcell.parts).at(key)


def check_modes(names: Mapping[str, str], signals: Mapping[str, LoggedSignal]) -> None:
    """Refuse names of modes that no state machine has.

    Args:
        names: by the key that each stands at.
        signals: of the log, by name.
    """
    modes = signals["mode"].meanings if "mode" in signals else ()
    for key, name in names.items():
        if not modes:
            raise invalid(key, name, "left out: no state machine has modes")
        if name not in modes:
            raise unknown("mode", name, modes).at(key)


def read_only(log: Any) -> Any:
    """A read-only log of the same samples, for an analysis: writing into it raises, or changes this copy only."""
    copy = log.copy(deep=False)
    for name, variable in copy.variables.items():
        if name in copy.indexes:
            variable.values.flags.writeable = False  # of an index that pandas keeps as it is
        else:
            variable.data = variable.data.view()
            variable.data.flags.writeable = False
    return copy


def check_metrics(found: Mapping[Any, Any], there: Iterable[str], analysis: str) -> dict[str, float | None]:
    """Check the metrics that an analysis returns; numbers that are not finite become None.

    Args:
        found: by name.
        there: names of the existing metrics.
        analysis: its name.

    Raises:
        RunFailedError: a name that is invalid or taken, or a value that is not a number.
    """
    _check_names(found, (*there, "findings"), "metric", analysis)  # metrics.json has both
    for name, value in found.items():
        if not isinstance(value, Real | None):
            raise RunFailedError(f"analyses.{analysis}: metric {name} = {show(value)}: must be a number or None")
    finite = {name: value is not None and math.isfinite(value) for name, value in found.items()}
    return {name: float(value) if finite[name] else None for name, value in found.items()}


def check_findings(found: list[Any], analysis: str) -> list[RunFinding]:
    """Check the findings that an analysis returns, see `check_metrics`."""
    for one in found:
        if not isinstance(one, RunFinding):
            kind = type(one).__name__
            raise RunFailedError(f"analyses.{analysis}: findings must be a list of RunFinding, not of {kind}")
    return found


def check_figures(found: Mapping[Any, Any], there: Iterable[str], analysis: str) -> Mapping[str, Figure]:
    """Check the figures that an analysis returns, see `check_metrics`."""
    from matplotlib.figure import Figure

    _check_names(found, there, "figure", analysis)
    for name, figure in found.items():
        if not isinstance(figure, Figure):
            kind = type(figure).__name__
            raise RunFailedError(
                f"analyses.{analysis}: figure {show(name)}: must be a Figure of Matplotlib, not {kind}"
            )
    return found


def check_files(found: Mapping[Any, Any], there: Iterable[str], analysis: str) -> Mapping[str, str]:
    """Check the files that an analysis returns, see `check_metrics`."""
    _check_names(found, there, "file", analysis)
    for name, text in found.items():
        if not isinstance(text, str):
            raise RunFailedError(f"analyses.{analysis}: file {show(name)}: must be text, not {type(text).__name__}")
    return found


def _check_names(names: Iterable[Any], there: Iterable[str], what: str, analysis: str) -> None:
    """Refuse names that are invalid for a file or a column, or taken in any case: some systems ignore case."""
    taken = {name.lower() for name in there}
    for name in names:
        if not isinstance(name, str):
            kind = type(name).__name__
            raise RunFailedError(f"analyses.{analysis}: {what} {show(name)}: its name must be text, not {kind}")
        if what == "metric":  # with names of parts, each as long as one may be
            allowed = "" if name.strip() and name.isprintable() else "printable characters"
        else:
            allowed = "" if is_part_name(name) and name[0] != "." else f"{PART_NAME}, not beginning with a dot"
        if allowed:
            raise RunFailedError(f"analyses.{analysis}: {what} {show(name)}: its name must be {allowed}")
        if name.lower() in taken:
            raise RunFailedError(
                f"analyses.{analysis} returns {what} {show(name)}, which the run or another analysis returns already: "
                "must have a name of its own"
            )
        taken.add(name.lower())


def run_metrics(
    log: Any,
    setting: Setting,
    *,
    window: float,
    motion: tuple[float, float] | None,
) -> dict[str, float | None]:
    """The metrics of any run, as far as it has the signals.

    With several surfaces, each has its own force metrics, with its name as a prefix.

    Args:
        log: over time.
        setting: of the run.
        window: of the standard deviation from the reference model [s].
        motion: begin and end of the motion along the surface [s]; None without one.
    """
    found: dict[str, float | None] = {}
    if "desired_force" in log:
        for label, one in surfaces(log):
            signals = {str(name): one[name].values for name in one.variables}
            own = metrics_of(signals, window=window, motion=motion)
            found |= {f"{label}{name}": value for name, value in own.items()}
    if "motor_torque" in log:
        found |= joint_metrics(log, setting.truth)
    elif "torque_share" in log:
        found["torque_share"] = float(log["torque_share"].max())
    return found


def surfaces(log: Any) -> list[tuple[str, Any]]:
    """The log of each surface that is pressed on, with the prefix of its metrics, empty for a single surface."""
    if SURFACE not in log.dims:
        return [("", log)]
    return [(f"{name}.", log.sel(surface=name)) for name in log[SURFACE].values]


def variants_of(log: Any) -> dict[str, Any]:
    """The log of each variant by name, without the times that only others have; of a single one under ""."""
    if "variant" not in log.dims:
        return {"": log}
    return {str(name): log.sel(variant=name).dropna("time", how="all") for name in log["variant"].values}


def run_figures(
    log: Any,
    title: str,
    findings: Mapping[str, Sequence[RunFinding]],
    allowed: Sequence[Allowed] = (),
    motion: tuple[float, float] | None = None,
) -> dict[str, Figure]:
    """The figures of any run by file name, as far as it has the signals.

    Args:
        log: over time, or over (variant, time).
        title: heading.
        findings: of every variant, marked where a time belongs to them.
        allowed: expected ranges of metrics, drawn where they can be converted to forces.
        motion: begin and end of the motion along the surface [s]; None without one.
    """
    from forcectl.analysis.force_targets import force_targets
    from forcectl.figures.force import run_figures as force_figures
    from forcectl.figures.motion import motion_figures

    found: dict[str, Figure] = {}
    if "desired_force" in log:
        for label, one in surfaces(log):
            shown = f"{title}: {label[:-1]}" if label else title
            begin = f"{label[:-1]}:" if label else ""
            of_this = {name: [f for f in every if f.text.startswith(begin)] for name, every in findings.items()}
            targets = force_targets(variants_of(one), allowed, label, motion)
            figures = force_figures(one, shown, of_this, targets)
            found |= {f"{label}{name}".replace(".", "_"): figure for name, figure in figures.items()}
    if "motor_torque" in log:
        found |= motion_figures(log, title, findings)
    return found
