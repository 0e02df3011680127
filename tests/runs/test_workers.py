"""Processes that work for this one."""

import math
import sys
from contextlib import closing
from multiprocessing import Pipe
from types import ModuleType

import pytest

import forcectl as fc
from forcectl.errors import BadInputError
from forcectl.runs.workers import Workers, _work, check_can_be_sent


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


CELL = """
from forcectl.force import IntegralForceLaw

class MyConfig:
    def add_to(self, builder, model):
        return builder.AddNamedSystem("my_law", IntegralForceLaw(model.size, integral_gain=1.5, compliance=1e-4))

def mine():
    pass
"""


@pytest.fixture
def typed(monkeypatch):
    """An instance of a class and a function as a cell of a notebook defines them."""
    main = ModuleType("__main__")
    exec(CELL, vars(main))
    monkeypatch.setitem(sys.modules, "__main__", main)
    return main


def test_what_a_notebook_defines_is_refused_in_one_line(typed):
    for found, name in ((typed.MyConfig(), "MyConfig"), (typed.mine, "mine")):
        with pytest.raises(BadInputError, match=f"^{name} is defined in a notebook or at a prompt, .*; or else$"):
            check_can_be_sent({"controller": [found]}, "or else")
    check_can_be_sent({"controller": [math.sqrt, 1.0]}, "or else")
    with pytest.raises(BadInputError, match=r"^cannot be sent to worker processes: .*lambda.*; or else$"):
        check_can_be_sent(lambda: None, "or else")
    typed.__file__ = "program.py"  # a program that processes import again
    check_can_be_sent(typed.MyConfig(), "or else")


def test_sweep_and_reproduction_refuse_it_before_anything_is_written(typed, tmp_path):
    change = {"station.fidelity": "OneDimensional", "controller": typed.MyConfig()}
    plan = {
        "scenario": "fig_2_8",
        "overrides": change,
        "seeds": [1, 2],
        "keys": {"station.environment.stiffness": [1e4]},
    }
    with pytest.raises(BadInputError, match=r"^MyConfig is defined in a notebook .*engine='sequential'$"):
        fc.sweep(plan, out=tmp_path / "sweep")
    with pytest.raises(BadInputError, match=r"^MyConfig is defined in a notebook"):
        fc.reproduce("fig_2_8", overrides={"controller": typed.MyConfig()}, out=tmp_path / "all")
    assert list(tmp_path.iterdir()) == []
