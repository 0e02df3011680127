"""What random faults come to: 1000 faulted and 500 sound runs, as the table of `docs/safety.md`.

`python benchmarks/faulted_runs.py rows.jsonl` takes about an hour of one processor. A row is kept as its run ends:
stopped and started again on the same file, it goes on where it was. The runs come in a random order, the same every
time, so that `--count 150` is a sample of all of them. The parameters of a run follow from its number and from nothing
else: stiffness, force, maximum_force, begin of the fault, fault and seed. `--first 10000` makes others.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
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

Row = dict[str, Any]


@dataclass(frozen=True)
class Group:
    """Runs that are alike.

    Attributes:
        name: of the row.
        faulted, sound: how many.
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

    def law(self, number: int) -> str:
        """Tag of the controller of a run; the scenario's name for its own."""
        return self.laws[number % len(self.laws)] if self.laws else self.base


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
    from forcectl.scenario.scenario import load_scenario

    for tag in tags_of("controller"):
        try:
            scenario = load_scenario(base, overrides=changes | {"controller": Tagged({}, tag)})
        except BadInputError:
            continue
        if _can_be_built(scenario):
            yield tag


def _can_be_built(scenario: Scenario) -> bool:
    """Whether its parts fit, and its guard can hold the force of a touch or of a surface that comes closer."""
    from forcectl.errors import BadInputError
    from forcectl.scenario.scenario import build

    try:
        build(scenario)
    except BadInputError:
        return False
    return True


def drawn(group: Group, number: int, with_fault: bool) -> tuple[Scenario, Scenario, DeclaredFault | None, float]:
    """Scenario with and without its fault, the fault, and its begin [s]."""
    from forcectl.framework.yaml_tree import Tagged
    from forcectl.scenario.scenario import load_scenario
    from forcectl.sweeps.faults.declared import FAULTS, changes_of

    rng = np.random.default_rng([number, int(with_fault), *group.name.encode()])
    changes = {**group.changes, "duration": group.duration, "seed": int(rng.integers(1000))}
    while True:
        force = rng.uniform(5.0, 20.0)
        changes["guard.maximum_force"] = 2.0 * force if group.laws else 30.0
        if group.laws:
            changes |= {"controller": Tagged({}, group.law(number)), "reference.force": force}
            changes["station.environment.stiffness"] = float(10.0 ** rng.uniform(np.log10(6e3), np.log10(2e5)))
        sound = load_scenario(group.base, overrides=changes)
        if group.law(number) != "Approach" or _can_be_built(sound):
            break
    if not with_fault:
        return sound, sound, None, 0.0
    period = sound.setting().workcell.period
    begin = period * round(rng.uniform(0.4, 0.6) * group.duration / period)
    for index in rng.permutation(len(FAULTS)):
        found = changes_of(FAULTS[index], sound, begin)
        if not isinstance(found, str):
            faulted = load_scenario(group.base, overrides=changes | found)
            if _can_be_built(faulted):
                return faulted, sound, FAULTS[index], begin
    raise ValueError(f"{group.name} can have no fault")


def one(group: Group, number: int, with_fault: bool) -> Row:
    """What one run comes to; where findings alone name its fault, against the sound run."""
    from forcectl.analysis.findings.guard import guard_codes
    from forcectl.runs.simulate import simulate
    from forcectl.scenario.scenario import build
    from forcectl.sweeps.faults.response import response_of

    begun = time.process_time()
    scenario, sound, fault, begin = drawn(group, number, with_fault)
    outcome = simulate(scenario, build(scenario), "run")
    if outcome.interrupted:
        raise KeyboardInterrupt
    kinds = [finding.kind for finding in outcome.findings]
    codes = guard_codes(outcome.log)
    response = response_of(group.law(number), fault, scenario, outcome.log, begin, kinds, [])
    if response.named_by and not any(name.startswith("status") for name in response.named_by):
        before = [finding.kind for finding in simulate(sound, build(sound), "sound").findings]
        response = response_of(group.law(number), fault, scenario, outcome.log, begin, kinds, before)
    maximum = scenario.guard.maximum_force if scenario.guard is not None else None
    share = 0.0 if response.peak_force is None or maximum is None else response.peak_force / maximum
    stiffness = getattr(scenario.station.environment, "stiffness", None)
    row = {"group": group.name, "number": number, "faulted": with_fault, **asdict(response), "findings": kinds}
    row |= {"guard": sorted({int(code) for code in codes if code}), "maximum": maximum, "share": share}
    if fault is None and codes.any() and maximum is not None:
        bare = replace(scenario, guard=None)
        peak = response_of("", None, scenario, simulate(bare, build(bare), "bare").log, 0.0, [], []).peak_force
        row["without_guard"] = None if peak is None else peak / maximum
    row |= {"failure": outcome.failure, "stiffness": stiffness, "seconds": time.process_time() - begun}
    return row


def unsafe(row: Row) -> bool:
    """Whether a second after the fault the force was still too large."""
    return row["peak_force"] is not None and (row["safe_time"] is None or row["safe_time"] > _SAFE)


def wrong(row: Row) -> bool:
    """Whether a run misses what is asked of it; an alarm is false where the force stays below its maximum by itself."""
    if not row["faulted"]:
        return bool(row["guard"]) and (row["without_guard"] or 0.0) <= 1.0
    bad = not row["finite"] or row["failure"] is not None or not row["named_by"]
    return bad or row["share"] > _LATE or unsafe(row)


def lines(rows: list[Row]) -> Iterator[str]:
    """The table of docs/safety.md."""
    head = ("", "runs", "commands not finite", "stopped by an error", "named by status or finding")
    yield f"| {' | '.join((*head, 'peak above 1.2 `maximum_force`', 'not safe after 1 s', 'false alarms'))} |"
    yield f"|{'---|' * (len(head) + 3)}"
    for name in dict.fromkeys(row["group"] for row in rows):
        own = [row for row in rows if row["group"] == name]
        faulted, sound = ([row for row in own if row["faulted"] is so] for so in (True, False))
        peaks = [row["share"] for row in faulted if row["share"] > _LATE]
        cells = (
            len(faulted),
            sum(not row["finite"] for row in faulted),
            sum(row["failure"] is not None for row in faulted),
            sum(bool(row["named_by"]) for row in faulted),
            f"{len(peaks)}, up to {max(peaks):.2f}" if peaks else "0",
            sum(map(unsafe, faulted)),
            f"{sum(map(wrong, sound))} of {len(sound)}",
        )
        yield f"| {name} | {' | '.join(map(str, cells))} |"


def run_all() -> None:
    parser = argparse.ArgumentParser(description="Random faults, as the table of docs/safety.md.")
    parser.add_argument("rows", type=Path, help="file of rows: those in it are not run again")
    parser.add_argument("--count", type=int, default=1500, help="of the 1000 faulted and 500 sound runs (default all)")
    parser.add_argument("--first", type=int, default=0, help="number of the first run of each group (default 0)")
    parser.add_argument("--only", default="", help="groups whose name contains this")
    arguments = parser.parse_args()
    plan = [
        (group, number, with_fault)
        for group in groups()
        for with_fault, total in ((True, group.faulted), (False, group.sound))
        for number in range(arguments.first, arguments.first + total)
        if arguments.only in group.name
    ]
    order = np.random.default_rng(0).permutation(len(plan))[: arguments.count]
    text = arguments.rows.read_text(encoding="utf-8") if arguments.rows.exists() else ""
    rows = [json.loads(line) for line in text.splitlines() if line.endswith("}")]
    done = {(row["group"], row["number"], row["faulted"]) for row in rows}
    with arguments.rows.open("a", encoding="utf-8") as file:
        file.write("\n" * (text != "" and not text.endswith("\n")))
        for group, number, with_fault in (plan[i] for i in order):
            if (group.name, number, with_fault) not in done:
                rows.append(one(group, number, with_fault))
                file.write(json.dumps(rows[-1], default=str) + "\n")
                file.flush()
    names = [group.name for group in groups()]
    rows.sort(key=lambda row: (names.index(row["group"]), not row["faulted"], row["number"]))
    print("\n".join(lines(rows)))
    for row in filter(wrong, rows):
        print(json.dumps(row, default=str), file=sys.stderr)


if __name__ == "__main__":
    run_all()
