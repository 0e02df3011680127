"""Processes that work for this one."""

from __future__ import annotations

import math
from contextlib import closing

from forcectl.runs.workers import Workers


def test_they_take_no_module_from_the_working_directory(tmp_path, monkeypatch):
    for name in ("multiprocessing", "threading", "pickle"):
        (tmp_path / f"{name}.py").write_text("open('it_ran', 'w').close()\nraise ImportError\n")
    monkeypatch.chdir(tmp_path)
    with closing(Workers(math.sqrt, (), 1)) as workers:
        workers.submit(4.0)
        while not (ended := workers.wait()):
            pass
    assert ended[0].result == 2.0
    assert not (tmp_path / "it_ran").exists()
