"""Reproduction: parallel runs, published numbers beside ours, failures as rows."""

import json
import signal
from collections.abc import Sequence
from typing import Any

import pytest

import forcectl as fc
from forcectl.analysis.findings.finding import Severity
from forcectl.runs import run as run_module
from forcectl.runs.logs import read_netcdf
from forcectl.runs.reproduce import InterruptedReproductionError
from forcectl.scenario.catalog import find_scenario
from forcectl.scenario.layers import select_variants
from tests.examples.command_line import call_here
from tests.examples.experiment_runs import run_experiment, run_variant
from tests.examples.html_page import Page

QUICK = """
title: Quick
duration: 0.4
variants: {soft: {}, stiff: {station.environment.stiffness: 5.0e4}}
fidelities: [OneDimensional, Kinematic]
expect:
  - {target: peak, metric: peak_force_N, variant: soft, minimum: 0.0, maximum: 50.0}
  - {target: published, metric: peak_force_N, variant: stiff, published: 100.0, tolerance: {relative: 0.01}}
  - {target: one only, metric: peak_force_N, maximum: 50.0, fidelities: [Kinematic]}
"""
DRIFTED = """
title: Drifted
duration: 0.4
fidelities: [OneDimensional, Kinematic]
expect:
  - {target: still, metric: peak_force_N, maximum: 50.0, expected: 10.0, drift: {relative: 0.9}}
  - {target: moved, metric: peak_force_N, maximum: 50.0, expected: 40.0}
"""
ONE_FAILS = """
title: One fails
duration: 0.4
variants: {good: {}, bad: {station.drive.servo.position_gain: 1.0e5}}
expect:
  - {target: fine, metric: peak_force_N, variant: good, maximum: 50.0}
  - {target: hopeless, metric: peak_force_N, variant: bad, maximum: 50.0}
"""


@pytest.fixture
def files(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "200")
    (tmp_path / "quick.yaml").write_text(QUICK)
    (tmp_path / "one_fails.yaml").write_text(ONE_FAILS)
    return tmp_path


@pytest.mark.slow
def test_variants_and_fidelities_run_in_processes_and_are_judged(files, monkeypatch, capfd):
    code, output = call_here(
        monkeypatch, capfd, "reproduce", "quick.yaml", "one_fails.yaml", "--out", "here", "--workers", "2"
    )
    assert code == 0
    summary = json.loads((files / "here" / "summary.json").read_text())
    assert set(summary) == {"quick", "one_fails"}
    rows = summary["quick"]
    for fidelity in ("OneDimensional", "Kinematic"):
        assert rows[f"peak [{fidelity}]"]["pass"] is True
        missed = rows[f"published [{fidelity}]"]
        assert missed["pass"] is False
        assert missed["deviation"] == pytest.approx(missed["ours"] - 100.0)
        assert missed["tolerance"] == "± 1"
        assert (files / "here" / "quick" / fidelity / "log.nc").exists()
    assert rows["one only [OneDimensional]"]["pass"] is None
    assert rows["one only [Kinematic]"]["pass"] is True
    for row in rows.values():
        assert {"published", "ours", "deviation", "tolerance", "pass"} <= set(row)
    # The variant that cannot be simulated is a row, and the others are there.
    failed = summary["one_fails"]
    assert failed["fine"]["pass"] is True
    assert failed["hopeless"] == failed["hopeless"] | {"ours": None, "pass": False}
    assert "t = 0." in failed["run of 'bad'"]["note"]
    assert (files / "here" / "one_fails" / "Multibody.failed" / "manifest.json").exists()
    for part in (
        "2 of 3  quick: Quick [Kinematic]",
        "published: 100",
        "missed",
        "4 of 8 targets met",
        "results in here: report.html, summary.json and one run per folder",
    ):
        assert " ".join(part.split()) in " ".join(output.out.split())
    report = Page((files / "here" / "report.html").read_text())
    assert [row["missed"] for row in report.table("experiment")] == ["1", "1", "2"]
    assert "pass" not in output.out  # that is told with -v


@pytest.mark.slow
def test_results_are_there_once_an_experiment_has_run_and_one_that_cannot_be_drawn_costs_no_other(files, monkeypatch):
    (files / "plain.yaml").write_text("title: Plain\nduration: 0.2\n")
    draw, known = run_module._write_pictures, []

    def without_quick(folder, log, scenario, *rest):
        if scenario.title == "Quick":
            raise RuntimeError("no ink")
        draw(folder, log, scenario, *rest)

    def look(_, share):
        if share == 1.0:
            known.append(set(json.loads((files / "here" / "summary.json").read_text())))

    monkeypatch.setattr(run_module, "_write_pictures", without_quick)
    report = fc.reproduce(["quick.yaml", "plain.yaml"], fidelity="OneDimensional", workers=1, out="here", progress=look)
    assert [len(names) for names in known] == [0, 1]
    assert [part.experiment for part in report.parts] == ["quick", "plain"]
    rows = json.loads((files / "here" / "summary.json").read_text())["quick"]
    assert (rows["results"]["pass"], rows["results"]["note"]) == (False, "RuntimeError: no ink")
    assert rows["peak"]["pass"] is True
    assert [path.name for path in (files / "here" / "quick").iterdir()] == ["OneDimensional.failed"]
    manifest = json.loads((files / "here/quick/OneDimensional.failed/manifest.json").read_text())
    assert manifest["status"] == "failed"
    assert manifest["failure"] == "pictures cannot be drawn: RuntimeError: no ink"
    for folder in ("quick/OneDimensional.failed", "plain/OneDimensional"):
        assert (files / "here" / folder / "log.nc").exists()


@pytest.mark.slow
def test_check_turns_a_missed_target_into_exit_code_1(files, warm, monkeypatch, capfd):
    arguments = ["quick.yaml", "--check", "--fidelity", "OneDimensional", "--workers", "1"]
    assert call_here(monkeypatch, capfd, "reproduce", *arguments)[0] == 1
    rows = json.loads((files / "runs" / "reproduce-1" / "summary.json").read_text())["quick"]
    assert set(rows) == {"peak", "published", "one only"}
    code, output = call_here(monkeypatch, capfd, "reproduce", *arguments, "--json", "--seed", "2")
    printed = json.loads(output.out)
    assert (code, printed["passed"], set(printed["experiments"]["quick"])) == (1, False, set(rows))
    assert printed["directory"] == "runs/reproduce-2"


@pytest.mark.slow
def test_a_value_away_from_the_expected_one_is_drift_and_turns_check_into_exit_code_1(files, warm, monkeypatch, capfd):
    (files / "drifted.yaml").write_text(DRIFTED)
    code, output = call_here(monkeypatch, capfd, "reproduce", "drifted.yaml", "--out", "here", "--workers", "1")
    assert code == 0
    rows = json.loads((files / "here" / "summary.json").read_text())["drifted"]
    assert {target: (row["pass"], row["expected"], row["drift"]) for target, row in rows.items()} == {
        "still [OneDimensional]": (True, 10.0, False),
        "moved [OneDimensional]": (True, 40.0, True),
        # The number is that of the first fidelity.
        "still [Kinematic]": (True, None, None),
        "moved [Kinematic]": (True, None, None),
    }
    assert "from 40" in output.out
    assert "drifted: 1" in output.out
    assert call_here(monkeypatch, capfd, "reproduce", "drifted.yaml", "--check", "--workers", "1")[0] == 1
    assert (
        call_here(
            monkeypatch, capfd, "reproduce", "drifted.yaml", "--check", "--fidelity", "Kinematic", "--workers", "1"
        )[0]
        == 0
    )


@pytest.mark.slow
def test_a_known_gap_is_shown_as_missed_with_its_reason_and_fails_no_check(files, warm, monkeypatch, capfd):
    gap = QUICK.replace(
        "tolerance: {relative: 0.01}}", "tolerance: {relative: 0.01}, gaps: {OneDimensional: it sticks}}"
    )
    (files / "quick.yaml").write_text(gap)
    arguments = ["quick.yaml", "--check", "--fidelity", "OneDimensional", "--workers", "1", "--out", "here"]
    code, output = call_here(monkeypatch, capfd, "reproduce", *arguments)
    assert code == 0
    said = " ".join(output.out.split())
    assert "1 of 2 targets met, known gaps: 1, drifted: 0" in said
    assert "known gap: it sticks" in said
    assert "missed" in said
    row = json.loads((files / "here" / "summary.json").read_text())["quick"]["published"]
    assert (row["pass"], row["gap"]) == (False, "it sticks")


@pytest.mark.slow
def test_a_known_gap_that_is_met_is_out_of_date_and_fails_a_check(files, warm, monkeypatch, capfd):
    gap = "maximum: 50.0, fidelities: [Kinematic], gaps: {Kinematic: it sticks}}"
    kept = QUICK.replace("maximum: 50.0, fidelities: [Kinematic]}", gap).replace("relative: 0.01", "relative: 2.0")
    (files / "quick.yaml").write_text(kept)
    arguments = ["quick.yaml", "--check", "--workers", "1", "--out", "here"]
    code, output = call_here(monkeypatch, capfd, "reproduce", *arguments, "--fidelity", "Kinematic")
    assert code == 1
    said = " ".join(output.out.split())
    assert "3 of 3 targets met, known gaps out of date: 1, drifted: 0" in said
    assert "met, so that its known gap is out of date: it sticks" in said
    row = json.loads((files / "here" / "summary.json").read_text())["quick"]["one only"]
    assert (row["pass"], row["gap"]) == (True, "it sticks")
    # On another fidelity the gap is none.
    code, output = call_here(monkeypatch, capfd, "reproduce", *arguments, "--force", "--fidelity", "OneDimensional")
    assert (code, "out of date" in output.out) == (0, False)


@pytest.mark.slow
def test_results_equal_those_of_a_run_in_this_process(files, warm):
    report = fc.reproduce(["quick.yaml"], fidelity="OneDimensional", workers=2)
    here = fc.run("quick.yaml", fidelity="OneDimensional").metrics
    (part,) = report.parts
    for variant in ("soft", "stiff"):
        assert part.metrics[variant] == here[variant]
    assert report.passed is False
    assert set(part.metrics) == {"soft", "stiff"}
    judged = [v.passed for v in part.verdicts if v.passed is not None]
    assert repr(report) == f"<reproduction of 1 runs: {sum(judged)} of {len(judged)} targets met>"


def test_nothing_is_run_when_one_experiment_is_wrong_or_the_output_exists(files, monkeypatch, capfd):
    (files / "wrong.yaml").write_text("duration: -1\n")
    code, output = call_here(monkeypatch, capfd, "reproduce", "quick.yaml", "wrong.yaml", "--out", "here")
    assert code == 2
    assert output.err == "error: wrong.yaml:1: duration = -1.0: must be positive, at most 86400\n"
    (files / "here").mkdir()
    assert call_here(monkeypatch, capfd, "reproduce", "quick.yaml", "--out", "here")[0] == 2


def test_two_experiments_of_one_name_are_refused(files):
    (files / "other").mkdir()
    (files / "other" / "quick.yaml").write_text(QUICK)
    with pytest.raises(fc.BadInputError, match="two are called 'quick'"):
        fc.reproduce(["quick.yaml", "other/quick.yaml"])


def shipped() -> list[tuple[str, str]]:
    """Every experiment with every fidelity it names."""
    experiments = fc.list_experiments()
    return [(name, on) for name in experiments for on in find_scenario(name).tree.get("fidelities", ["OneDimensional"])]


def variants_of_shipped() -> list[tuple[str, str, str]]:
    """Each alone, so that they spread over the processes of a test run."""
    return [(name, on, variant) for name, on in shipped() for variant in select_variants(find_scenario(name))]


# Variants that misbehave, by fidelity, and are there to show it; all others are well behaved.
_HUNTS = {"limit_cycle", "stick_slip"}
_BOUNCES = {"contact_lost", "unstable"}
_EVERY = ("Multibody", "Kinematic", "OneDimensional")


def on(fidelities: Sequence[str], *kinds: str) -> dict[str, set[str]]:
    return {fidelity: set(kinds) for fidelity in fidelities}


MISBEHAVE: dict[tuple[str, str], dict[str, set[str]]] = {
    ("cap_rotation", "exact, 10 degrees askew"): on(["Multibody"], "machine_not_ended"),  # the lock comes later
    ("fig_2_7", "K_I = 3 1/s"): on(_EVERY, *_HUNTS),
    ("fig_2_7", "K_I = 4.5 1/s"): on(_EVERY, *_HUNTS),
    ("fig_3_4", "K_I = 3 1/s"): on(["Multibody", "Kinematic"], "stick_slip"),
    ("fig_3_5", "K_I = 3 1/s"): on(_EVERY, *_HUNTS),
    ("fig_3_6_directions", "ahead, compliance alone"): on(["Multibody"], "estimate_at_bound"),  # and the force grows
    ("fig_3_7", "alpha = 0"): on(_EVERY, *_BOUNCES),
    ("fig_3_7", "alpha = 0.3"): on(["Kinematic", "OneDimensional"], "contact_lost", "limit_cycle"),
    ("fig_3_8", "alpha = 0.5"): on(["Multibody"], "limit_cycle"),
    # Where there is a largest force, the guard holds that of the first touch.
    ("first_touch", "governed VRFT, 50 mm/s on 1e4 N/m"): on(["Multibody"], "limit_cycle"),
    ("first_touch", "at most 30 N, 90 mm/s on 1e4 N/m"): on(_EVERY, "guarded"),
    ("first_touch", "at most 30 N, 29 mm/s on 1e5 N/m"): on(_EVERY, "guarded"),
    ("first_touch", "at most 30 N, 35 mm/s on 1e5 N/m, taken for 1e4"): on(["OneDimensional"], "guarded", "not_settled")
    | on(["Multibody"], "guard_stopped", "no_contact"),
    ("fig_4_7", "4.5 rad/s"): on(["Multibody"], *_HUNTS) | on(["Kinematic", "OneDimensional"], "stick_slip"),
    ("fig_4_14", "aluminium, VRFT for 7.5 rad/s"): on(["Multibody"], "limit_cycle"),
    ("fig_4_14", "plastic, VRFT for 7.5 rad/s"): on(["Multibody"], "not_settled"),
    ("fig_6_5", "position-based"): on(["OneDimensional"], "not_settled"),  # which pulls back to the start
    ("fig_6_5", "position-based, real"): on(["OneDimensional"], "not_settled"),
    ("governor_limits", "horizon of 20"): on(["Multibody"], "contact_bounced", "limit_cycle"),
    # It may not go to 20 N, and at the limit the reference has the noise of the force 295 times.
    ("governor_limits", "predicted force at most 15 N"): on(["Multibody"], "not_settled", "chatter", "stick_slip")
    | on(["OneDimensional"], "not_settled", "chatter"),
    ("mismatch_2_14", "compliance -20 %"): on(["Multibody"], "limit_cycle"),
    ("mismatch_2_14", "compliance exact"): on(_EVERY, *_HUNTS),
    ("mismatch_2_14", "compliance +20 %"): on(_EVERY, *_HUNTS),
    # It rests at another force.
    ("mismatch_3_55", "compliance -20 %"): on(["Multibody", "OneDimensional"], "command_saturated", "not_settled"),
    ("mismatch_3_55", "compliance +20 %"): on(["Multibody", "OneDimensional"], "not_settled"),
    ("mismatch_3_84", "alpha = 0.5"): on(["OneDimensional"], *_BOUNCES),
    ("table_4_2", "plastic"): on(["Multibody"], "not_settled"),  # a known gap
}


@pytest.mark.slow
@pytest.mark.parametrize(("experiment", "fidelity", "variant"), variants_of_shipped())
def test_every_variant_of_a_shipped_experiment_behaves(experiment, fidelity, variant):
    allowed = MISBEHAVE.get((experiment, variant), {}).get(fidelity, set())
    found = run_variant(experiment, variant, fidelity).findings
    assert [str(one) for one in found if one.severity > Severity.INFO and one.kind not in allowed] == []


@pytest.mark.slow
@pytest.mark.parametrize(("experiment", "fidelity"), shipped())
def test_every_shipped_experiment_meets_its_targets_and_has_not_drifted(experiment, fidelity):
    """Of the runs of the test above."""
    done = run_experiment(experiment, fidelity)
    assert [(v.target, v.ours) for v in done.verdicts if v.surprising or v.stale] == []
    assert [(v.target, v.ours, v.expected) for v in done.verdicts if v.drifted] == []


def test_a_fidelity_that_variants_set_themselves_is_not_overridden(files):
    (files / "cells.yaml").write_text("variants: {a: {station.fidelity: Kinematic}, b: {}}\n")
    with pytest.raises(fc.BadInputError, match=r"override of station\.fidelity .* set by 'a': run one"):
        fc.reproduce(["cells.yaml"], fidelity="OneDimensional")


@pytest.mark.slow
def test_an_interrupted_reproduction_goes_on_where_it_stopped(files, warm, without_pictures, monkeypatch):
    """What has finished is not run again: one experiment whole, and one variant of the other."""
    (files / "loop.yaml").write_text("duration: 0.2\nvariants: {one: {}, two: {seed: 2}, three: {seed: 3}}\n")
    (files / "plain.yaml").write_text("duration: 0.2\n")
    both: dict[str, Any] = {"fidelity": "OneDimensional", "workers": 1, "out": "here"}

    def press(name, share):
        if name.startswith("loop") and share > 0.5:
            signal.raise_signal(signal.SIGTERM)

    with pytest.raises(InterruptedReproductionError, match=r"1 of 2 finished, kept in here; go on with --resume$"):
        fc.reproduce(["plain.yaml", "loop.yaml"], **both, progress=press)
    assert [path.name for path in (files / "here" / "loop").iterdir()] == ["OneDimensional.interrupted"]
    seen = []
    log = (files / "here" / "plain" / "OneDimensional" / "log.nc").stat().st_mtime_ns
    report = fc.reproduce(["plain.yaml", "loop.yaml"], **both, resume=True, progress=lambda *told: seen.append(told))
    assert report.notes == ["1 of 2 had finished before, and 1 variants of others: not run again"]
    assert [share for _, share in seen] == pytest.approx([2 / 3, 1.0])
    assert (files / "here" / "plain" / "OneDimensional" / "log.nc").stat().st_mtime_ns == log
    assert sorted(path.name for path in (files / "here").iterdir()) == ["loop", "plain", "report.html", "summary.json"]
    assert [path.name for path in (files / "here" / "loop").iterdir()] == ["OneDimensional"]
    whole = fc.run("loop.yaml", fidelity="OneDimensional")
    assert report.parts[1].metrics == whole.metrics
    kept = read_netcdf(files / "here" / "loop" / "OneDimensional" / "log.nc")
    assert kept["measured_force"].equals(whole.log["measured_force"])


def test_only_a_reproduction_is_gone_on_with(files):
    with pytest.raises(fc.BadInputError, match="'here' is not the directory of a reproduction"):
        fc.reproduce(["quick.yaml"], out="here", resume=True)
