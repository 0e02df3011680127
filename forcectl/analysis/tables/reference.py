"""Explanations of every metric and every kind of findings: as one page, and one at a time."""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterator

from forcectl.analysis.findings.finding import KINDS, Severity
from forcectl.analysis.tables import metric_tables as of_force
from forcectl.analysis.tables import motion_tables as of_motion
from forcectl.analysis.tables import task_tables as of_task
from forcectl.analysis.tables.metric import Metric
from forcectl.analysis.tracking_metrics import TRACKING_METRICS
from forcectl.errors import BadInputError, unknown

_NAMED = 5  # names in an error

_TABLES: dict[str, dict[str, Metric]] = {
    "Steps of a force": of_force.STEP_METRICS,
    "References that move": TRACKING_METRICS,
    "Motion along the surface": of_force.MOTION_METRICS,
    "Tuning": of_force.TUNING_METRICS,
    "The whole run of a force loop": of_force.RUN_METRICS,
    "Two variants": of_force.PAIR_METRICS,
    "Robots behind a joint interface": of_motion.LOOP_METRICS,
    "`!ForceEstimation`": of_motion.FORCE_METRICS,
    "`!WrenchErrors`": of_motion.WRENCH_ERROR_METRICS,
    "`!FrictionIdentification`": of_motion.FRICTION_METRICS,
    "`!Reaching`": of_motion.REACH_METRICS,
    "`!Alignment`": of_motion.ALIGNMENT_METRICS,
    "`!Transitions`": of_task.TRANSITION_METRICS,
    "`!Insertion`": of_task.INSERTION_METRICS,
    "`!KeptForce`": of_task.KEPT_FORCE_METRICS,
    "`!Assembly`": of_task.ASSEMBLY_METRICS,
    "`!TouchDown`": of_task.TOUCH_DOWN_METRICS,
    "`!SurfaceAlignment`": of_task.SURFACE_ALIGNMENT_METRICS,
    "`!SideForce`": of_task.SIDE_FORCE_METRICS,
    "`!SurfaceFollowing`": of_task.SURFACE_FOLLOWING_METRICS,
}
_HEAD = """# Metrics and findings

Made from the code by `forcectl explain > docs/metrics.md`; `forcectl explain overshoot_pct` shows one of them. A metric
that the signals of a run do not determine is null in `metrics.json`: a settling time of a force that did not settle, an
overshoot of a sine.

F is the measured force, after the filter of its sensor, and F_c the true contact force: a metric that begins with
`true_` is the same one of F_c. F_r is the reference, s the sign of a step of it, F_M the response of the reference
model, dx the displacement command; q joint positions, q' and so on their derivatives, _ref a command; f and m true
forces and torques, tau joint torques, tau_c Coulomb friction, _hat an estimate. Times of a step count from the step,
and shares of F_r are of the height of the step where F_r is zero after it. With several steps, `step_2.overshoot_N` is
that of the second, and `overshoot_N` that of the last; a step is a change of F_r within two samples. `left.reached` is
that of one arm, joint or mode, `NAME.overshoot_N` that of one of several surfaces. `expect` of a scenario checks the
metrics that it names. Published numbers were measured with a sensor, so they are to be compared with F.
"""
_FINDINGS = """## Findings

After every run `forcectl run` prints its findings, one line each. They are computed from the log, true signals
included. The same findings are in `metrics.json` as `findings`, in Python as `result.findings`, and in the figures,
each at its time. The key `findings` of a scenario holds the thresholds, as in `findings: {largest_force: 30.0}`, and in
`ignore` the kinds to leave out; the resolved `scenario.yaml` of a run shows all of them. `forcectl run --strict error`
exits with 1 on an error, `--strict` alone also on a warning. An analysis of one's own adds findings by a method
`findings(log, setting)`, see [Fill a slot](slots.md).
"""


def explanation(name: str) -> str:
    """The explanation of a metric or a kind of findings, in a few lines.

    Args:
        name: also of one step, arm, joint or mode: `step_2.overshoot_N`.

    Raises:
        BadInputError: there is none of that name.
    """
    metrics = {known: metric for table in _TABLES.values() for known, metric in table.items()}
    last = name.rpartition(".")[2]
    if last in metrics:
        metric = metrics[last]
        return f"{name} [{metric.unit}]: {metric.meaning}\n  formula: {metric.formula}\n  sign:    {metric.sign}"
    if name in KINDS:
        kind = KINDS[name]
        return f"{name}: {kind.meaning}\n  severity: {kind.severity.word}, {kind.severity.meaning}"
    every = [*metrics, *KINDS]
    near = difflib.get_close_matches(last, every, n=_NAMED, cutoff=0.0)
    raise BadInputError(f"{unknown('metric or finding', name, near)} and {len(every) - len(near)} more")


def analyses_of(name: str) -> list[str]:
    """Tags of the analyses that compute a metric; empty for a metric that runs have without an analysis."""
    last = name.rpartition(".")[2]
    titles = [title for title, table in _TABLES.items() if last in table]
    return [title.strip("`!") for title in titles] if all(title.startswith("`") for title in titles) else []


def page() -> str:
    """All of them, as Markdown."""
    return "\n".join(_lines())


def _lines() -> Iterator[str]:
    yield _HEAD
    for title, table in _TABLES.items():
        yield f"## {title}\n"
        yield from _table("metric", "unit", "meaning", "formula", "sign")
        for name, (unit, meaning, formula, sign) in table.items():
            yield _row(f"`{name}`", unit, meaning, f"`{formula}`", sign)
        yield ""
    yield _FINDINGS
    yield from _table("severity", "meaning")
    for severity in Severity:
        yield _row(f"`{severity.word}`", severity.meaning)
    yield ""
    yield from _table("finding", "severity", "meaning")
    for name, kind in KINDS.items():
        yield _row(f"`{name}`", kind.severity.word, kind.meaning)
    yield ""


def _table(*heads: str) -> Iterator[str]:
    yield _row(*heads)
    yield f"|{'---|' * len(heads)}"


def _row(*cells: str) -> str:
    return f"| {' | '.join(re.sub(r'[|]', chr(92) + '|', cell) for cell in cells)} |"
