"""All benchmarks, one after the other, in one table: `python -m benchmarks [--json] [--repeats N]`."""

from __future__ import annotations

import argparse

from benchmarks import (
    _measure,
    block_graph,
    contact,
    control_tick,
    force_laws,
    governor,
    joint_interface_station,
    many_builds,
    memory,
    plant_share,
    quadratic_program,
    reactive_controller,
    real_time,
    robot_controller,
    start_up,
    trajectory,
    vrft,
    vrft_tick,
)


def run_all() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description="All benchmarks of forcectl.")
    parser.add_argument("--repeats", type=int, default=5, help="runs to take medians of (default 5)")
    parser.add_argument("--json", action="store_true", help="print JSON instead of a table")
    arguments = parser.parse_args()
    rows: list[_measure.Row] = []
    for module in (
        start_up,
        real_time,
        joint_interface_station,
        contact,
        control_tick,
        force_laws,
        governor,
        vrft_tick,
        trajectory,
        robot_controller,
        reactive_controller,
        quadratic_program,
        vrft,
        plant_share,
        block_graph,
        memory,
        many_builds,
    ):
        rows += module.benchmark(max(1, arguments.repeats))
    _measure.report("forcectl benchmarks", rows, arguments.json)


if __name__ == "__main__":
    run_all()
