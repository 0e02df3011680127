"""Runs of shipped experiments, each variant simulated at most once in a test session, whichever process asks first."""

import fcntl
import os
import pickle
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from hashlib import sha256
from pathlib import Path
from typing import Any

import xarray as xr

from forcectl.analysis.findings.finding import RunFinding
from forcectl.diagrams.loop import Loop
from forcectl.diagrams.station import SHIPPED_FIDELITIES
from forcectl.runs.chosen import choose
from forcectl.runs.logs import stack
from forcectl.runs.run import verdicts_on
from forcectl.runs.simulate import FOUND, VariantOutcome, simulate
from forcectl.scenario.catalog import find_scenario
from forcectl.scenario.expectations import Verdict
from forcectl.scenario.gains import identifications, text_of
from forcectl.scenario.scenario import Scenario, build, resolve, with_shortcuts


@dataclass(frozen=True)
class ExperimentRun:
    """All variants of an experiment, see `forcectl.runs.run.RunResult`. Do not change what is in it."""

    log: xr.Dataset
    metrics: dict[str, dict[str, Any]]
    verdicts: list[Verdict]
    findings: dict[str, list[RunFinding]]


def fidelities_of(name: str) -> list[str]:
    """The fidelities that an experiment of a force loop can be built in.

    A two-sided contact is for one dimension; one with a torque, with a normal that turns, or with boxes beside it in a
    variant, for bodies.
    """
    tree = find_scenario(name).tree
    environment = tree.get("station", {}).get("environment", {})
    every = [environment, *(variant.get("station.environment") for variant in tree.get("variants", {}).values())]
    turning = environment.get("surface", {}).get("turning")
    if turning or any(getattr(each, "tag", None) in ("Patch", "Parts") for each in every):
        return ["Multibody"]
    return ["OneDimensional"] if environment.get("one_sided") is False else [*SHIPPED_FIDELITIES]


@lru_cache(maxsize=32)
def run_experiment(name: str, fidelity: str | None = None, seed: int | None = None) -> ExperimentRun:
    """All variants of a shipped experiment.

    Args:
        name: of the experiment.
        fidelity: of the station; None: that of the scenario.
        seed: of the noise; None: that of the scenario.
    """
    chosen = choose(name, seed=seed, fidelity=fidelity)
    done: dict[str, VariantOutcome] = {}
    for wait in (False, True):  # variants that another process simulates come last: two at it share them out
        for variant in [each for each in chosen.scenarios if each not in done]:
            if (one := _outcome(name, variant, chosen.changes, wait)) is not None:
                done[variant] = one
    outcomes = [done[variant] for variant in chosen.scenarios]
    metrics = {outcome.variant: outcome.metrics for outcome in outcomes}
    findings = {outcome.variant: outcome.findings for outcome in outcomes}
    return ExperimentRun(stack([o.log for o in outcomes]), metrics, verdicts_on(chosen, outcomes), findings)


def run_variant(name: str, variant: str, fidelity: str | None = None, seed: int | None = None) -> VariantOutcome:
    """One variant of a shipped experiment; arguments as above."""
    found = _outcome(name, variant, with_shortcuts(None, seed, fidelity))
    assert found is not None
    return found


def _outcome(name: str, variant: str, changes: Mapping[str, Any], wait: bool = True) -> VariantOutcome | None:
    done = _simulated(resolve(find_scenario(name), variant, changes), f"{name}, {variant!r}", None, wait)
    return done and replace(done, variant=variant, log=done.log.assign_coords(variant=variant))


def simulated(scenario: Scenario, name: str, loop: Loop | None = None) -> VariantOutcome:
    """A scenario, simulated once whatever it is called: experiments that find gains are the same in several.

    Args:
        scenario: complete.
        name: for the message of a failure.
        loop: of the scenario, where it is built already.
    """
    found = _simulated(scenario, name, loop, wait=True)
    assert found is not None
    return found


def _simulated(scenario: Scenario, name: str, loop: Loop | None, wait: bool) -> VariantOutcome | None:
    """See `simulated`; None where another process is at it and nobody is to wait for that."""
    path = Path(os.environ["FORCECTL_TEST_RUNS"]) / sha256(text_of(scenario).encode()).hexdigest()
    with path.with_suffix(".lock").open("w") as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX if wait else fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            return None
        if not path.exists():
            for one in identifications(scenario, scenario.experiment):
                FOUND[text_of(one.scenario)] = simulated(one.scenario, one.experiment).metrics
            done = simulate(scenario, loop or build(scenario), "default")
            assert done.failure is None, f"{name}: {done.failure}"
            path.write_bytes(pickle.dumps(replace(done, realtime_factor=None, diagram=None)))
    return pickle.loads(path.read_bytes())
