"""Running a scenario with each fault of a list, for one controller or several, as a sweep of cases."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from forcectl.errors import BadInputError, unknown
from forcectl.framework.yaml_tree import Tagged
from forcectl.runs.logs import read_netcdf
from forcectl.scenario.catalog import ScenarioFile, tags_of
from forcectl.scenario.layers import select_variants
from forcectl.scenario.scenario import Scenario, as_file, build, resolve, with_shortcuts
from forcectl.scenario.trees import to_tree
from forcectl.sweeps.at_work import SweepProgress
from forcectl.sweeps.faults.declared import SOUND, Changes, DeclaredFault, changes_of, chosen
from forcectl.sweeps.faults.response import Response, response_of
from forcectl.sweeps.results import IDENTITY, Results, identity_of
from forcectl.sweeps.run_sweep import sweep
from forcectl.sweeps.sweep_config import SweepConfig

_PARTED = " | "  # separates controller and fault in the name of a case


@dataclass(frozen=True)
class FaultReport:
    """The table of faults of a scenario.

    Attributes:
        scenario: name.
        variant: of it.
        fidelity: of its station.
        begin: of the faults [s].
        rows: for every controller, the run without a fault and those with faults.
        left_out: reasons of runs that were left out, by "controller: fault" or controller.
        directory: of the sweep; None where none was given.
    """

    scenario: str
    variant: str
    fidelity: str
    begin: float
    rows: list[Response]
    left_out: dict[str, str] = field(default_factory=dict)
    directory: Path | None = None


def try_faults(
    scenario: str | Path | Mapping[str, Any] | Scenario | ScenarioFile,
    *,
    controllers: str = "",
    faults: str = "all",
    variant: str | None = None,
    overrides: Mapping[str, Any] | None = None,
    seed: int | None = None,
    fidelity: str | None = None,
    begin: float | None = None,
    out: str | Path | None = None,
    engine: str = "processes",
    workers: int | None = None,
    allow_imports: Sequence[str] = (),
    progress: Callable[[SweepProgress], None] | None = None,
) -> FaultReport:
    """Run a scenario without a fault and with each of the declared ones.

    Args:
        scenario: see `run`.
        controllers: tags with commas between them, "all", or "" for the scenario's own.
        faults: names with commas between them, or "all", see `forcectl.sweeps.faults.declared`.
        variant: the first one when None.
        overrides: dotted key -> value on top of everything.
        seed, fidelity: short for the overrides of `seed` and `station.fidelity`.
        begin: of the faults, to the next tick [s]; None: half of the duration.
        out: directory of the sweep; an interrupted one there is resumed. None keeps the table only.
        engine, workers: see `sweep`.
        allow_imports: names of modules that the scenario may name.
        progress: called now and then.

    Raises:
        BadInputError: the scenario, a controller, a fault or the directory cannot be used, or nothing is left to run.
    """
    file = as_file(scenario, allow_imports)
    names = select_variants(file, variant)
    changes = with_shortcuts(overrides, seed, fidelity)
    base = resolve(file, names[0], changes)
    when = base.duration / 2 if begin is None else begin
    if not 0 <= when < base.duration:
        raise BadInputError(f"begin = {when!r}: must be from 0 to below the duration, {base.duration:g} s")
    period = base.setting().workcell.period
    when = period * round(when / period)  # so that a fault of one tick meets a tick
    wanted = chosen(faults)
    left_out: dict[str, str] = {}
    cases: dict[str, Changes] = {}
    kinds: list[tuple[str, DeclaredFault | None]] = []
    for tag, own in _controllers(file, names[0], changes, base, controllers, left_out):
        one = resolve(file, names[0], changes | own)
        cases[_case(tag, SOUND)] = own
        kinds.append((tag, None))
        for fault in wanted:
            found = changes_of(fault, one, when)
            if not isinstance(found, str) and (reason := _refusal(file, names[0], changes | own | found)):
                found = reason
            if isinstance(found, str):
                left_out[f"{tag}: {fault.name}"] = found
            else:
                cases[_case(tag, fault.name)] = own | found
                kinds.append((tag, fault))
    if not cases:
        reasons = "; ".join(f"{tag}: {why}" for tag, why in left_out.items())
        raise BadInputError(f"controllers = {controllers!r}: must be at least one that fits the scenario: {reasons}")
    config = SweepConfig(
        title=f"Faults of {file.name}",
        scenario=file,
        variant=names[0],
        overrides=changes,
        cases=cases,
        keep="all",
        batches=False,
    )
    scenarios = [resolve(file, names[0], changes | case) for case in cases.values()]
    with _folder(out) as folder:
        sweep(
            config,
            out=folder,
            resume=os.path.isfile(folder / IDENTITY),  # refused if it is of another scenario or other faults
            engine=engine,
            workers=workers,
            allow_imports=allow_imports,
            progress=progress,
            report=False,
        )
        rows = _responses(folder, kinds, scenarios, when)
    return FaultReport(file.name, names[0], base.fidelity, when, rows, left_out, None if out is None else folder)


def _case(tag: str, fault: str) -> str:
    return f"{tag}{_PARTED}{fault}"


@contextmanager
def _folder(out: str | Path | None) -> Iterator[Path]:
    if out is not None:
        yield Path(out).expanduser()
        return
    with tempfile.TemporaryDirectory(prefix="forcectl-faults-") as folder:
        yield Path(folder) / "faults"


def _controllers(
    file: ScenarioFile, variant: str, changes: Changes, base: Scenario, wanted: str, left_out: dict[str, str]
) -> Iterator[tuple[str, Changes]]:
    """Tags of controllers, each with the changes that select it; those that do not fit are added to `left_out`."""
    own = to_tree(base.controller, "controller").tag or "controller"
    tags = [own] if not wanted else [name.strip().removeprefix("!") for name in wanted.split(",")]
    known = tags_of("controller")
    for tag in known if wanted == "all" else dict.fromkeys(tags):
        if tag == own:
            yield tag, {}
            continue
        if tag not in known:
            raise unknown("controller", tag, known)
        change: Changes = {"controller": Tagged({}, tag)}
        if reason := _refusal(file, variant, changes | change):
            left_out[tag] = reason
        else:
            yield tag, change


def _refusal(file: ScenarioFile, variant: str, changes: Changes) -> str:
    """Why a scenario with these changes cannot be built; "" where it can."""
    try:
        build(resolve(file, variant, changes))
    except BadInputError as error:
        return str(error)
    return ""


def _responses(
    folder: Path,
    kinds: Sequence[tuple[str, DeclaredFault | None]],
    scenarios: Sequence[Scenario],
    begin: float,
) -> list[Response]:
    results = Results(folder, identity_of(folder)["digest"])
    found, sound = [], []
    for number, ((tag, fault), scenario) in enumerate(zip(kinds, scenarios, strict=True)):
        row, path = results.row(number), results.log_path(number)
        reason = "not run" if row is None else row["reason"]
        kinds_found = [] if row is None else [one["kind"] for one in row["run_findings"]]
        if fault is None:
            sound = kinds_found
        if path.exists():
            response = response_of(tag, fault, scenario, read_netcdf(path), begin, kinds_found, sound)
        else:
            response = Response(tag, SOUND if fault is None else fault.name)
        found.append(replace(response, failure=reason))
    return found
