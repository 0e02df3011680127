"""The command `forcectl faults`."""

from __future__ import annotations

import json

import pytest

ARGUMENTS = ("faults", "fig_2_7", "--fidelity", "OneDimensional", "--set", "duration=0.4", "--workers", "1")


@pytest.mark.slow
def test_it_prints_a_table_and_keeps_it(forcectl, tmp_path, warm):
    code, out, err = forcectl(*ARGUMENTS, "--only", "nan,robot pushed", "--out", "kept")
    assert (code, err) == (0, "")
    assert "named by" in out
    assert "left out: Integral: robot pushed: no dynamics" in out
    kept = json.loads((tmp_path / "kept" / "faults.json").read_text(encoding="utf-8"))
    assert [row["fault"] for row in kept["rows"]] == ["none", "nan"]
    assert (tmp_path / "kept" / "faults.md").is_file()
    assert len(list((tmp_path / "kept").rglob("*.nc"))) == 2


def test_an_unknown_fault_is_one_line(forcectl):
    code, _, err = forcectl(*ARGUMENTS, "--only", "gremlin")
    assert code == 2
    assert "unknown fault 'gremlin'" in err
    assert err.count("\n") == 1
