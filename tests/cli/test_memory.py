"""Too little memory is told in one line, before libraries fail to load."""

import resource


def test_a_process_with_too_few_addresses_is_refused(forcectl, monkeypatch, tmp_path):
    monkeypatch.setattr(resource, "getrlimit", lambda what: (600_000 * 1024, resource.RLIM_INFINITY))
    code, out, err = forcectl("run", "fig_2_7", "--out", "here")
    assert (code, out) == (1, "")
    assert err == (
        "error: not enough memory: this process is limited to 614 MB (ulimit -v), and must be allowed at least 900 MB; "
        "nothing was written\n"
    )
    assert list(tmp_path.iterdir()) == []


def test_memory_that_runs_out_is_one_line(forcectl, monkeypatch):
    def full(name):
        raise MemoryError

    monkeypatch.setattr("forcectl.scenario.catalog.find_scenario", full)
    code, _, err = forcectl("run", "fig_2_7")
    assert (code, err.count("\n"), err.startswith("error: not enough memory")) == (1, 1, True)
