"""Processes that work for this one."""

import math
from contextlib import closing
from multiprocessing import Pipe

import pytest

from forcectl.runs.workers import Workers, _work


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


def stopped(task):
    raise KeyboardInterrupt


def test_one_that_a_signal_stops_ends_without_a_traceback():
    here, there = Pipe()
    here.send((stopped, ()))
    here.send("task")
    with pytest.raises(SystemExit) as ended:
        _work(there)
    assert ended.value.code == 1
