"""What random faults come to: 1000 faulted and 500 sound runs, as the table of `docs/safety.md`.

`python benchmarks/faulted_runs.py` makes all of them, which takes hours; `--share 0.1` makes a tenth, of each group at
least one of each kind. The parameters of a run follow from its number and from nothing else: a smaller share is the
beginning of a larger one. Stiffness, force, maximum_force, begin of the fault, fault and seed are random.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

# Found also when this file is run as a script, from a checkout.
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

if TYPE_CHECKING:
    from forcectl.scenario.scenario import Scenario
    from forcectl.sweeps.faults.declared import DeclaredFault

_LATE = 1.2  # of maximum_force, that a peak may come to
_SAFE = 1.0  # [s] from the fault to a safe state


@dataclass(frozen=True)
class Group:
    """Runs that are alike.

    Attributes:
        name: of the row.
        faulted, sound: runs of a full benchmark.
        base: scenario.
        changes: of it.
        duration: [s].
        laws: tags of the controllers; none for the scenario's own.
    """

    name: str
    faulted: int
    sound: int
    base: str
    changes: dict[str, Any]
    duration: float
    laws: tuple[str, ...] = ()


@dataclass
class Tally:
    """What the runs of a group came to."""

    runs: int = 0
    sound: int = 0
    alarms: int = 0
    not_finite: int = 0
    failed: int = 0
    named: int = 0
    peaks: int = 0
    worst: float = 0.0
    unsafe: int = 0


def groups() -> list[Group]:
    """The groups: every controller that fits, three fidelities, and two arms."""
    from forcectl.framework.yaml_tree import Tagged

    laws = tuple(fitting("fig_2_7", {"station.fidelity": "OneDimensional", "guard.maximum_force": 30.0}))
    observer = {"estimators": {"force": Tagged({}, "ForceEstimator")}}
    return [
        Group("OneDimensional", 860, 440, "fig_2_7", {"station.fidelity": "OneDimensional"}, 2.5, laws),
        Group("Kinematic", 100, 40, "fig_2_7", {"station.fidelity": "Kinematic"}, 2.5, laws),
        Group("Multibody", 32, 16, "fig_2_7", {"station.fidelity": "Multibody"}, 2.5, ("Integral", "InvarianceRobot")),
        Group("two arms (`fig_5_3`)", 8, 4, "fig_5_3", observer, 1.0),
    ]


def fitting(base: str, changes: dict[str, Any]) -> Iterator[str]:
    """Tags of the controllers that a scenario can have."""
    from forcectl.errors import BadInputError
    from forcectl.framework.yaml_tree import Tagged
    from forcectl.scenario.catalog import tags_of
    from forcectl.scenario.scenario import build, load_scenario

    for tag in tags_of("controller"):
        try:
            build(load_scenario(base, overrides=changes | {"controller": Tagged({}, tag)}))
        except BadInputError:
            continue
        yield tag


def drawn(group: Group, number: int, with_fault: bool) -> tuple[Scenario, Scenario, DeclaredFault | None, float] | None:
    """Scenario with and without its fault, the fault, and its begin [s]; None where the scenario cannot have it."""
    from forcectl.framework.yaml_tree import Tagged
    from forcectl.scenario.scenario import load_scenario
    from forcectl.sweeps.faults.declared import FAULTS, changes_of

    rng = np.random.default_rng([number, int(with_fault), *group.name.encode()])
    changes = {**group.changes, "duration": group.duration, "seed": int(rng.integers(1000))}
    force = rng.uniform(5.0, 20.0)
    changes["guard.maximum_force"] = 2.0 * force if group.laws else 30.0
    if group.laws:
        law = group.laws[number % len(group.laws)]
        changes |= {"controller": Tagged({}, law), "reference.force": force}
        changes["station.environment.stiffness"] = float(10.0 ** rng.uniform(np.log10(6e3), np.log10(2e5)))
    sound = load_scenario(group.base, overrides=changes)
    if not with_fault:
        return sound, sound, None, 0.0
    period = sound.setting().workcell.period
    begin = period * round(rng.uniform(0.4, 0.6) * group.duration / period)
    for index in rng.permutation(len(FAULTS)):
        found = changes_of(FAULTS[index], sound, begin)
        if not isinstance(found, str):
            return load_scenario(group.base, overrides=changes | found), sound, FAULTS[index], begin
    return None


def one(group: Group, number: int, with_fault: bool, tally: Tally, missed: list[dict[str, Any]]) -> None:
    """One run, and where it has a fault the sound run that its findings are compared with."""
    from forcectl.analysis.findings.guard import guard_codes
    from forcectl.runs.simulate import simulate
    from forcectl.scenario.scenario import build
    from forcectl.sweeps.faults.response import response_of

    made = drawn(group, number, with_fault)
    if made is None:
        return
    scenario, sound, fault, begin = made
    outcome = simulate(scenario, build(scenario), "run")
    kinds = [finding.kind for finding in outcome.findings]
    maximum = scenario.guard.maximum_force if scenario.guard is not None else None
    tag = group.laws[number % len(group.laws)] if group.laws else group.base
    if fault is None:
        tally.sound += 1
        if guard_codes(outcome.log).any():
            tally.alarms += 1
            missed.append({"group": group.name, "number": number, "controller": tag, "false alarm": kinds})
        return
    response = response_of(tag, fault, scenario, outcome.log, begin, kinds, [])
    if response.named_by and not any(name.startswith("status") for name in response.named_by):
        # Named by findings alone: by those that the same run has not without the fault.
        before = [finding.kind for finding in simulate(sound, build(sound), "sound").findings]
        response = response_of(tag, fault, scenario, outcome.log, begin, kinds, before)
    share = 0.0 if response.peak_force is None or maximum is None else response.peak_force / maximum
    safe = response.peak_force is None or (response.safe_time is not None and response.safe_time <= _SAFE)
    tally.runs += 1
    tally.not_finite += not response.finite
    tally.failed += outcome.failure is not None
    tally.named += bool(response.named_by)
    tally.peaks += share > _LATE
    tally.worst = max(tally.worst, share)
    tally.unsafe += not safe
    if share > _LATE or not safe or not response.named_by or not response.finite or outcome.failure:
        row = asdict(response) | {"group": group.name, "number": number, "of maximum": round(share, 3)}
        missed.append(row | {"failure": outcome.failure, "maximum": maximum})


def lines(found: dict[str, Tally]) -> Iterator[str]:
    """The table of docs/safety.md."""
    head = ("", "runs", "commands not finite", "stopped by an error", "named by status or finding")
    yield f"| {' | '.join((*head, 'peak above 1.2 `maximum_force`', 'not safe after 1 s', 'false alarms'))} |"
    yield f"|{'---|' * (len(head) + 3)}"
    for name, tally in found.items():
        peaks = f"{tally.peaks}, up to {tally.worst:.2f}" if tally.peaks else "0"
        cells = (tally.runs, tally.not_finite, tally.failed, tally.named, peaks, tally.unsafe)
        yield f"| {name} | {' | '.join(map(str, cells))} | {tally.alarms} of {tally.sound} |"


def run_all() -> None:
    parser = argparse.ArgumentParser(description="Random faults, as the table of docs/safety.md.")
    parser.add_argument("--share", type=float, default=1.0, help="of the 1000 faulted and 500 sound runs (default 1)")
    parser.add_argument("--only", default="", help="groups whose name contains this")
    parser.add_argument("--json", default="", help="file for what was missed")
    arguments = parser.parse_args()
    found: dict[str, Tally] = {}
    missed: list[dict[str, Any]] = []
    begin = time.perf_counter()
    for group in groups():
        if arguments.only not in group.name:
            continue
        tally = found[group.name] = Tally()
        for with_fault, total in ((True, group.faulted), (False, group.sound)):
            for number in range(max(round(arguments.share * total), 1)):
                one(group, number, with_fault, tally, missed)
        print(f"{group.name}: {time.perf_counter() - begin:.0f} s", file=sys.stderr, flush=True)
    print("\n".join(lines(found)))
    if arguments.json:
        Path(arguments.json).write_text(json.dumps(missed, indent=1, default=str), encoding="utf-8")


if __name__ == "__main__":
    run_all()
