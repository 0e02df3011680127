"""Runs of shipped experiments, each variant simulated at most once in a test session, whichever process asks first."""

from __future__ import annotations

import fcntl
import os
import pickle
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from hashlib import sha256
from pathlib import Path
from typing import Any

import xarray as xr

from forcectl.diagrams.station import SHIPPED_FIDELITIES
from forcectl.runs.logs import stack
from forcectl.runs.run import verdicts_on, with_shortcuts
from forcectl.runs.simulate import VariantOutcome, simulate
from forcectl.scenario.catalog import find_scenario
from forcectl.scenario.expectations import Verdict
from forcectl.scenario.scenario import build, resolve, select_variants


@dataclass(frozen=True)
class ExperimentRun:
    """All variants of an experiment, see `forcectl.runs.run.RunResult`. Do not change what is in it."""

    log: xr.Dataset
    metrics: dict[str, dict[str, Any]]
    verdicts: list[Verdict]


def fidelities_of(name: str) -> list[str]:
    """The fidelities that an experiment of a force loop can be built in: a two-sided contact is for one dimension."""
    two_sided = find_scenario(name).tree.get("station", {}).get("environment", {}).get("one_sided") is False
    return ["OneDimensional"] if two_sided else [*SHIPPED_FIDELITIES]


@lru_cache(maxsize=32)
def run_experiment(name: str, fidelity: str | None = None, seed: int | None = None) -> ExperimentRun:
    """All variants of a shipped experiment.

    Args:
        name: of the experiment.
        fidelity: of the station; None: that of the scenario.
        seed: of the noise; None: that of the scenario.
    """
    file, changes = find_scenario(name), with_shortcuts(None, seed, fidelity)
    scenarios = {variant: resolve(file, variant, changes) for variant in select_variants(file)}
    outcomes = [_outcome(name, variant, changes) for variant in scenarios]
    metrics = {outcome.variant: outcome.metrics for outcome in outcomes}
    return ExperimentRun(stack([o.log for o in outcomes]), metrics, verdicts_on(file, scenarios, outcomes))


def run_variant(name: str, variant: str, fidelity: str | None = None, seed: int | None = None) -> VariantOutcome:
    """One variant of a shipped experiment; arguments as above."""
    return _outcome(name, variant, with_shortcuts(None, seed, fidelity))


def _outcome(name: str, variant: str, changes: Mapping[str, Any]) -> VariantOutcome:
    scenario = resolve(find_scenario(name), variant, changes)
    key = sha256(repr((name, variant, scenario.fidelity, scenario.seed)).encode()).hexdigest()
    path = Path(os.environ["FORCECTL_TEST_RUNS"]) / key
    with path.with_suffix(".lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)  # another process that wants the same run waits for it
        if not path.exists():
            done = simulate(scenario, build(scenario), variant)
            assert done.failure is None, f"{name}, {variant!r}: {done.failure}"
            path.write_bytes(pickle.dumps(VariantOutcome(variant, done.log, done.metrics)))
    outcome: VariantOutcome = pickle.loads(path.read_bytes())
    return outcome
