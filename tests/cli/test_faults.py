"""The command `forcectl faults`."""

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


@pytest.mark.slow
def test_what_was_interrupted_goes_on_by_the_same_command_and_by_no_other(forcectl, tmp_path, warm, monkeypatch):
    arguments = (*ARGUMENTS, "--only", "nan", "--out", "kept")
    with monkeypatch.context() as patch:
        patch.setattr("forcectl.sweeps.faults.run_faults._responses", _interrupt)
        assert forcectl(*arguments)[::2] == (130, "stopped; the same command goes on in kept\n")
    logs = {path: path.stat().st_mtime_ns for path in (tmp_path / "kept").rglob("*.nc")}
    assert len(logs) == 2
    assert forcectl(*arguments)[0] == 0
    assert {path: path.stat().st_mtime_ns for path in (tmp_path / "kept").rglob("*.nc")} == logs
    code, _, err = forcectl(*ARGUMENTS, "--only", "frozen", "--out", "kept")
    assert (code, err.count("\n")) == (2, 1)


def _interrupt(*_):
    raise KeyboardInterrupt


def test_an_unknown_fault_is_one_line(forcectl):
    code, _, err = forcectl(*ARGUMENTS, "--only", "gremlin")
    assert code == 2
    assert "unknown fault 'gremlin'" in err
    assert err.count("\n") == 1
