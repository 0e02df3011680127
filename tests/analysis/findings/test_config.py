"""Findings of a run as a whole: where they stand, in which order, what is left out, and those of one's own."""

import json
from dataclasses import dataclass
from typing import Any

import pytest

import forcectl as fc
from forcectl.analysis.findings import RunFinding, Severity
from forcectl.analysis.findings.finding import findings_lines
from forcectl.analysis.tables.metric_tables import metric_unit
from forcectl.errors import BadInputError, RunFailedError

WILD: dict[str, Any] = {
    "station": {"fidelity": "OneDimensional", "environment": {"stiffness": 5.9e3}},
    "controller": {"integral_gain": 300.0},
    "guard": None,
    "duration": 0.5,
}
KINDS = ["contact_lost", "links_beyond_limits", "not_settled"]


@dataclass
class Own:
    found: Any

    def metrics(self, log: Any, setting: Any) -> dict[str, float]:
        return {}

    def figures(self, log: Any, setting: Any, title: str) -> dict[str, Any]:
        return {}

    def findings(self, log: Any, setting: Any) -> Any:
        return self.found


def test_findings_stand_in_the_result_and_in_metrics_json_the_worst_first(tmp_path, without_pictures):
    result = fc.run(WILD, out=tmp_path / "run")
    (found,) = result.findings.values()
    assert [one.kind for one in found] == KINDS
    assert [one.severity for one in found] == sorted((one.severity for one in found), reverse=True)
    assert result.has_finding("error")
    assert result.has_finding("info")
    assert not result.has_finding(None)
    written = json.loads((tmp_path / "run" / "metrics.json").read_text())["default"]
    assert written.pop("findings") == [one.as_row() for one in found]
    assert written == result.metrics["default"]
    assert findings_lines(result.findings)[0].startswith("error: contact lost once")


def test_the_same_run_writes_the_same_metrics_and_speed_stands_in_the_manifest(tmp_path, without_pictures):
    for name in ("one", "two"):
        fc.run(WILD, out=tmp_path / name)
    one, two = (tmp_path / name / "metrics.json" for name in ("one", "two"))
    assert one.read_bytes() == two.read_bytes()
    manifest = json.loads((tmp_path / "one" / "manifest.json").read_text())
    assert manifest["realtime_factor"]["default"] > 0
    assert manifest["model_error_window_s"] == {"default": 4.1}
    assert metric_unit("realtime_factor") == metric_unit("model_error_window_s") == ""


def test_kinds_that_are_not_wanted_are_left_out_and_an_unknown_one_is_refused():
    result = fc.run(WILD, overrides={"findings.ignore": ["contact_lost", "not_settled"]})
    assert [one.kind for one in result.findings["default"]] == ["links_beyond_limits"]
    with pytest.raises(BadInputError, match=r"findings.ignore.*'contact_lots'.*did you mean 'contact_lost'"):
        fc.run(WILD, overrides={"findings.ignore": ["contact_lots"]})
    with pytest.raises(BadInputError, match=r"findings.largest_force = -1.0: must be"):
        fc.run(WILD, overrides={"findings.largest_force": -1.0})


def test_an_analysis_of_ones_own_adds_findings():
    calm = WILD | {"controller": {"integral_gain": 8.0}, "duration": 0.3, "findings": {"ignore": ["not_settled"]}}
    mine = RunFinding("too_warm", Severity.WARNING, "the motor is too warm", 0.2)
    result = fc.run(calm | {"analyses": {"own": Own([mine])}})
    assert result.findings["default"] == [mine]
    assert findings_lines(result.findings) == ["warning: the motor is too warm"]
    assert result.has_finding("warning")
    assert not result.has_finding("error")
    assert findings_lines(fc.run(calm).findings) == ["findings: none"]
    told_by_own = RunFinding("friction_unknown", Severity.WARNING, "no friction")
    ignored = {"findings.ignore": ["not_settled", "friction_unknown"]}
    both = calm | {"analyses": {"own": Own([told_by_own, mine])}}
    assert fc.run(both, overrides=ignored).findings["default"] == [mine]
    with pytest.raises(RunFailedError, match=r"analyses.own: findings must return a list, not dict"):
        fc.run(calm | {"analyses": {"own": Own({})}})
    with pytest.raises(RunFailedError, match=r"analyses.own: findings must be a list of RunFinding, not of str"):
        fc.run(calm | {"analyses": {"own": Own(["warm"])}})


def test_a_finding_of_ones_own_is_checked_when_it_is_made():
    severity: Any = "warning"
    with pytest.raises(BadInputError, match=r"severity = 'warning': must be a Severity"):
        RunFinding("own", severity, "text")
    with pytest.raises(BadInputError, match="time = nan"):
        RunFinding("own", Severity.INFO, "text", float("nan"))
