"""Sliding over several materials: the best fixed gains on the path of the experiment, and random paths.

    python benchmarks/multi_material.py --best Multibody    K_P and K_I by direct search (Nelder-Mead), a few minutes
    python benchmarks/multi_material.py --paths 20          orders, speeds, forces, grooves and noise by chance
    python benchmarks/multi_material.py --paths 20 --late 4    the same, but the joints come 4 s later: under full force

Random paths are judged against the VRFT gains of each material and against the fixed gains that are best on the path of
the experiment.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import minimize

# Found also when this file is run as a script, from a checkout.
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import forcectl

EXPERIMENT = "multi_material"
FIXED = ("fixed, of plastic", "fixed, of wood", "fixed, of aluminium", "fixed, best on OneDimensional")
ORDERS = ("plastic", "wood", "aluminium")
STAY = 8.0  # on each material [s]


def errors(variant: str, overrides: dict[str, Any]) -> tuple[float, float]:
    """Standard deviation and largest distance from the reference model [N]."""
    metrics = forcectl.run(EXPERIMENT, variant=variant, overrides=overrides).metrics[variant]
    sd, furthest = metrics["run_model_error_sd_N"], metrics["run_max_abs_model_error_N"]
    if sd is None or furthest is None:
        raise RuntimeError(f"{variant}: no reference model")
    return sd, furthest


def best_fixed(fidelity: str) -> tuple[float, float]:
    """K_P and K_I of the smallest standard deviation on the path of the experiment, with K_D of wood."""

    def cost(logarithms: np.ndarray[Any, Any]) -> float:
        kp, ki = (-np.exp(logarithms)).tolist()
        gains = {"controller.proportional_gain": kp, "controller.integral_gain": ki, "station.fidelity": fidelity}
        sd, furthest = errors("fixed, of wood", gains)
        print(f"K_P {kp:.4g}  K_I {ki:.4g}  SD {sd:.4f} N  max {furthest:.3f} N", flush=True)
        return sd

    start = np.log([2e-5, 1.2e-5])
    corners = start + np.array([[0.0, 0.0], [0.3, 0.0], [0.0, 0.3]])
    found = minimize(
        cost, start, method="Nelder-Mead", options={"initial_simplex": corners, "fatol": 2e-3, "xatol": 0.02}
    )
    return tuple((-np.exp(found.x)).tolist())


def random_path(seed: int, late: float, fidelity: str) -> dict[str, Any]:
    """Overrides of the experiment: three materials in random order, other speed, surface, forces and noise."""
    chance = np.random.default_rng(seed)
    order, speed = chance.permutation(ORDERS).tolist(), float(chance.uniform(0.003, 0.008))
    length = STAY * speed
    segments = [{"material": name, "start": i * length, "end": (i + 1) * length} for i, name in enumerate(order)]
    times, forces = [0.0], [5.0]
    for begin in (0.0, STAY, 2 * STAY):
        times += [begin + 1.0, begin + 2.5, begin + 4.5, begin + 6.0]
        forces += [10.0, float(chance.uniform(17.0, 22.0)), float(chance.uniform(10.0, 14.0)), 5.0]
    surface = "station.environment.surface"
    return {
        f"{surface}.materials.segments": segments,
        f"{surface}.heights.grooves.spacing": float(chance.uniform(0.008, 0.025)),
        f"{surface}.heights.roughness.seed": seed,
        "reference.times": times,
        "reference.forces": forces,
        "motion.distance": 3 * length,
        "motion.speed": speed,
        "motion.start_time": late,
        "seed": seed,
        "station.fidelity": fidelity,
    }


def random_paths(count: int, late: float, fidelity: str) -> None:
    """Print the errors of every controller on random paths, and the share where the adaptive one is the best."""
    beside, wins = [], np.zeros(2, dtype=int)
    for seed in range(count):
        path = random_path(seed, late, fidelity)
        start = path["station.environment.surface.materials.segments"][0]["material"]
        adaptive = errors("adaptive", path)
        fixed = {name: errors(name, path) for name in FIXED}
        print(seed, start, f"{path['motion.speed']:.4f}", adaptive, fixed, flush=True)
        least = np.min(list(fixed.values()), axis=0)
        wins += np.array(adaptive) < least
        beside.append(np.array(adaptive) / least)
    sd, furthest = np.median(beside, axis=0)
    print(f"SD: below every fixed one on {wins[0]} of {count}, {sd:.2f} of the best (median)")
    print(f"largest error: below every fixed one on {wins[1]} of {count}, {furthest:.2f} of the best (median)")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--best", metavar="FIDELITY")
    parser.add_argument("--paths", type=int, metavar="COUNT")
    parser.add_argument("--late", type=float, default=0.0, metavar="SECONDS")
    parser.add_argument("--fidelity", default="OneDimensional", help="of the random paths")
    arguments = parser.parse_args()
    if arguments.best:
        print(best_fixed(arguments.best))
    if arguments.paths:
        random_paths(arguments.paths, arguments.late, arguments.fidelity)
