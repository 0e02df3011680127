"""A sweep of quick trials, for the tests of what runs sweeps."""

import os
import subprocess
import sys
import time
from pathlib import Path

STIFFNESS, GAIN = "station.environment.stiffness", "controller.integral_gain"


def small(**keys):
    """Eight trials of 0.3 s: four stiffnesses, two gains."""
    return {
        "scenario": "fig_2_7",
        "variant": "K_I = 1.5 1/s",
        "overrides": {"station.fidelity": "OneDimensional", "duration": 0.3},
        "keys": {STIFFNESS: [1e3, 5e3, 2e4, 1e5]},
        "arms": {"low": {GAIN: 1.0}, "high": {GAIN: 4.0}},
        "success": "overshoot_pct <= 5",
    } | keys


# Diverges on stiff surfaces only: the gain is far too high there.
FAILING = {GAIN: 500.0, "controller.compliance_error": 10.0, "guard": None}


def write(folder: Path, name: str = "small", **keys) -> Path:
    """The same as a file."""
    from forcectl.framework.yaml_tree import dump, plain

    path = folder / f"{name}.yaml"
    path.write_text(dump(plain(small(**keys))), encoding="utf-8")
    return path


def start(*arguments, **options) -> subprocess.Popen:
    """The command line in a process of its own."""
    environment = os.environ | {"OMP_NUM_THREADS": "1", "COLUMNS": "200"}
    command = [sys.executable, "-m", "forcectl", *map(str, arguments)]
    return subprocess.Popen(
        command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, **options
    )


def wait_until(condition, seconds: float = 120.0) -> None:
    """Wait until a condition holds."""
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "it took too long"
        time.sleep(0.02)


def rows(folder: Path) -> int:
    """How many trials have a row."""
    return len(list(folder.glob("rows/*/*.json")))
