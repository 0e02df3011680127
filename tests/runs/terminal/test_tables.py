"""What the commands print: tables that fit the terminal and never cut a number."""

import io
import re
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from rich.console import Console

import forcectl as fc
from forcectl.analysis.tables.metric_tables import METRICS
from forcectl.models import list_robots
from forcectl.runs.claims.found import FoundResults
from forcectl.runs.robots.report import examine_robot
from forcectl.runs.robots.tables import print_robot
from forcectl.runs.terminal.listing import catalog_tables, found_table
from forcectl.runs.terminal.tables import (
    in_words,
    metrics_table,
    reproduction_lines,
    short_list,
    undefined,
    verdict_table,
)
from forcectl.runs.tuning_report import gains_table
from forcectl.scenario.catalog import find_scenario
from forcectl.scenario.expectations import Verdict, judge
from forcectl.scenario.layers import select_variants
from forcectl.scenario.scenario import resolve
from forcectl.tuning.controller_basis import continuous_pid, discrete_pid, fir


def text_of(table, width, show=Console.print):
    console = Console(file=io.StringIO(), width=width)
    show(console, table)
    lines = console.file.getvalue().splitlines()
    assert max(map(len, lines)) <= width
    assert not any(re.search(r"\S…|…\S", line) for line in lines)  # which stands between two limits elsewhere
    return "\n".join(lines)


def test_a_variant_that_does_not_reach_its_target_has_a_line() -> None:
    there = {"left.reached": 1.0, "left.stalled": 0.0, "reached": 1.0, "stalled": 0.0}
    blocked = {"left.reached": 0.0, "left.stalled": 1.0, "right.reached": 0.0, "right.stalled": 0.0, "reached": 0.0}
    assert metrics_table({"free": there}).caption is None
    assert metrics_table({"free": there, "blocked": blocked}).caption == (
        "blocked: last target not reached: left (stalled), right (still moving)"
    )
    own = metrics_table({"own": {"goal.reached": 0.0}})  # of an analysis of the user's
    assert own.caption == "own: last target not reached: goal"


def made_metrics(expected, variants):
    """Long numbers, each another one, for metrics of every kind of run."""
    names = dict.fromkeys(
        [*expected, *METRICS, "step_2.time_of_max_positive_model_error_s", "yumi_joint_7_l.jerk_rms_rad_s3"]
    )
    return {
        variant: {name: -(1.0 + 0.001 * (i * len(names) + k)) * 1e-5 for k, name in enumerate(names)}
        for i, variant in enumerate(variants)
    }


@pytest.mark.parametrize("name", fc.list_experiments())
def test_no_table_of_a_shipped_experiment_cuts_a_number(name):
    file = find_scenario(name)
    variants = select_variants(file)
    scenario = resolve(file, variants[0])
    metrics = made_metrics([m for line in scenario.expect for m in line.metrics], variants)
    verdicts = [judge(line, metrics, variants, scenario.fidelity, lambda *_: -1.234e-05) for line in scenario.expect]
    for width in (80, 120):
        short = short_list(metrics, verdicts)
        assert {metric for v in verdicts for metric in v.metrics} - {"force_distance_N"} <= set(short)
        for names in (None, short):
            text = text_of(metrics_table(metrics, name, names, width), width)
            wanted = sorted(f"{values[n]:.4g}" for values in metrics.values() for n in (names or values))
            assert sorted(re.findall(r"-\d\.\d+e-05|-1e-05", text)) == wanted
        words = text_of(verdict_table(verdicts, name, width), width).split()
        for v in verdicts:
            for number in (v.ours, v.deviation if width > 100 else None):
                assert number is None or f"{number:.4g}" in words or f"({number:.4g}" in words
        text_of(reproduction_lines([(name, verdicts)]), width)


WIDTHS = pytest.mark.parametrize("width", [80, 120])


@WIDTHS
@pytest.mark.parametrize("basis", [continuous_pid(0.002), discrete_pid(0.002), fir(12, 0.002)], ids=lambda b: b.form)
@pytest.mark.parametrize("known", [True, False])
def test_no_table_of_gains_cuts_a_number(basis, known, width):
    gains = -1.23456e-15 * (1.0 + np.arange(len(basis.names)) / 7)
    shares = np.linspace(0.0123, 1.0, len(gains)) if known else None
    fit = SimpleNamespace(basis=basis, gains=gains, noise_share=shares, vrft_gains=None, standard_errors=gains / 3.3)
    words = text_of(gains_table(fit), width).split()
    assert {f"{gain:.6g}" for gain in gains} | {f"{error:.2g}" for error in gains / 3.3} <= set(words)
    assert not known or {f"{100 * share:.1f}" for share in shares} <= set(words)


@pytest.mark.slow
@pytest.mark.parametrize("robot", list_robots())
def test_no_table_of_a_robot_cuts_a_number(robot):
    report = examine_robot(robot)
    found = zip(report.robot.found.gravity, report.robot.found.inertia, strict=True)
    computed = dict(zip(report.robot.parameters.arm_joints, found, strict=True))
    for width in (80, 120):
        text = text_of(report, width, lambda console, report: print_robot(report, console))
        for unit in ("[1/s]", "[1/s2]", "[kg m2]", "[kg]", "[Nm]"):
            assert unit in text
        rows = {cells[0]: cells[-2:] for line in text.splitlines() if len(cells := line.split()) == 9}
        for name, numbers in computed.items():
            assert [float(cell) for cell in rows[name]] == pytest.approx(numbers, rel=5e-3, abs=1e-6)


@WIDTHS
def test_lists_fit_and_say_where_and_what_results_are(width):
    for table in catalog_tables():
        text_of(table, width)
    folder = Path("/where/many/people/keep/their/results/of/long/studies")
    found = FoundResults(folder / f"{'a_long_name_' * 6}-12", "reproduction", "at work: process 12345 on a-machine")
    text = text_of(found_table([found]), width)
    joined = "".join(line[: text.splitlines()[0].index("kind")].strip() for line in text.splitlines()[1:])
    assert joined == str(found.directory)
    assert {"reproduction", "12345", "a-machine"} <= set(text.split())


def test_a_number_that_is_not_there_is_said_in_words():
    text = text_of(
        metrics_table({"a": {"settling_time_2pct_s": None, "overshoot_N": 1.0}, "b": {"settling_time_2pct_s": 2.0}}), 80
    )
    assert "not settled" in text
    assert "–" not in text
    assert (undefined("step_1.rise_time_s"), undefined("overshoot_pct")) == ("not reached", "not defined")


def test_a_step_that_has_not_settled_is_told_by_default():
    step = {"a": {"overshoot_pct": 1.0, "settling_time_2pct_s": None, "rise_time_s": None}}
    assert short_list(step, []) == ["overshoot_pct", "settling_time_2pct_s"]
    assert short_list({"a": {"tracking_error_rad": 1.0, "settling_time_2pct_s": None}}, []) == ["tracking_error_rad"]


def test_a_verdict_says_unit_what_is_published_and_drift():
    missed = Verdict("peak", "none visible", 12.3456, None, "≤ 10", False, "", 9.0, True, ("peak_force_N",), "N")
    assert in_words(missed) == "peak: 12.35 N (≤ 10; published: none visible; drifted from 9)"
    assert Verdict.from_row("peak", missed.as_row()) == missed
    met = Verdict("soft", 3.0, 3.1, 0.1, "± 0.25", True)
    lines = text_of(reproduction_lines([("fig: title [Kinematic]", [missed, met])]), 80).splitlines()
    assert [line.split() for line in lines[1:]] == [
        ["1", "of", "2", "fig:", "title", "[Kinematic]"],
        ["missed", *in_words(missed).split()],
    ]
