"""Sweeps whose tables are made by hand: nothing is simulated."""

from pathlib import Path

import numpy as np

from forcectl.framework.expression import Expression
from forcectl.framework.yaml_tree import Tagged
from forcectl.sweeps.results import Results
from forcectl.sweeps.study import study_of
from forcectl.sweeps.sweep_config import read_sweep
from forcectl.sweeps.table import costs_table, trials_table

STIFFNESS, GAIN = "station.environment.stiffness", "controller.integral_gain"
NOISE, DELAY = "station.sensors.force.noise_std", "station.sensors.force.delay"
PRESET, TARE = "preset", "station.sensors.force.tare"
BASE = {
    "scenario": "fig_2_7",
    "variant": "K_I = 1.5 1/s",
    "overrides": {"station.fidelity": "OneDimensional", "duration": 0.2},
    "success": "overshoot_pct <= 5",
}
ARMS = {"low": {"controller.dead_zone": 0.0}, "high": {"controller.dead_zone": 0.1}}


def log_uniform(low, high):
    return Tagged({"min": low, "max": high}, "LogUniform")


def uniform(low, high):
    return Tagged({"min": low, "max": high}, "Uniform")


def made(sweep, row, only=None):
    """A study, its table and its costs, as trials with such rows give them.

    Args:
        sweep: fields of the sweep file beside those of `BASE`.
        row: (study, trial, labels) -> metrics; a text: the trial failed for this reason; None: it is not finished.
        only: numbers of the trials in the table; None: all.
    """
    study = study_of(read_sweep(BASE | sweep))
    numbers = range(study.size) if only is None else only
    rows = {}
    for number in numbers:
        trial = study.trial(number)
        found = row(trial, study.labels(trial))
        if found is not None:
            rows[number] = row_of(study, number, found)
    return study, trials_table(study, numbers, rows, {}), costs_table(rows)


def row_of(study, number, found):
    failed = isinstance(found, str)
    metrics = {} if failed else found
    config = study.config
    return {
        "trial": number,
        "state": "failed" if failed else "done",
        "success": bool(not failed and Expression(config.success)(metrics)) if config.success else None,
        "findings": [name for name, text in config.findings.items() if Expression(text)(metrics)],
        "reason": found if failed else "",
        "time_s": 0.3 if failed else 5.0,
        "metrics": metrics,
        "cost": {"wall_s": 0.2, "cpu_s": 0.1 + 0.01 * number, "batch": 1, "host": "h", "finished": 1.0},
    }


def results_in(folder, study):
    folder.mkdir(parents=True, exist_ok=True)
    return Results(Path(folder), study.digest())


def write_signals(results, table, signal, name="measured_force"):
    """Recorded signals: `signal(trial number, times)` of each trial in the table.

    Args:
        results: the directory.
        table: of trials.
        signal: gives the values, shape (components, times).
        name: of the signal.
    """
    time = np.linspace(0.0, 1.0, 401)
    for number in table["trial"]:
        path = results.signals_path(int(number))
        path.parent.mkdir(parents=True, exist_ok=True)
        np.savez(path, time=time, **{name: np.atleast_2d(signal(int(number), time))})
