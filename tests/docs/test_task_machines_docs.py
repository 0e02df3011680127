"""docs/task_machines.md says what is true."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from forcectl.errors import BadInputError
from forcectl.tasks import StateMachine

DOCS = Path(__file__).parents[2] / "docs"
PAGE = (DOCS / "task_machines.md").read_text(encoding="utf-8")
BUILD, BREAK = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)
(MESSAGE,) = re.findall(r"```text\n(.*?)\n```", PAGE, re.DOTALL)


def test_the_code_runs_the_picture_is_its_own_and_the_message_is_that(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {}
    exec(BUILD, names)
    assert (tmp_path / "peg.svg").read_text() == (DOCS / "images" / "peg_machine.svg").read_text()
    with pytest.raises(BadInputError) as error:
        exec(BREAK, names)
    assert str(error.value) == MESSAGE


def test_the_table_names_every_output():
    table = re.findall(r"^\| `(\w+)` \|", PAGE, re.MULTILINE)
    listed = re.search(r"output_ports: \[(.*?)\]", StateMachine.__doc__ or "", re.DOTALL)[1]
    outputs = re.findall(r"\w+", listed.replace("(optional)", ""))
    assert sorted(table) == sorted(outputs)
