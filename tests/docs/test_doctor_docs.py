"""docs/doctor.md says what is true."""

import re
from pathlib import Path

from tests.examples.pages import blocks, page_text, run_python

PAGE = page_text("doctor.md")
SOURCES = Path(__file__).parents[2] / "forcectl" / "doctor"


def test_the_examples_run_and_print_what_is_shown(capsys):
    run_python("doctor.md")
    assert [capsys.readouterr().out] == blocks(PAGE, "text")


def test_every_code_is_explained_and_every_explained_code_exists():
    text = "".join(path.read_text(encoding="utf-8") for path in SOURCES.glob("*.py"))
    used = set(re.findall(r"\b(?:error|warning|info|finding)\(\s*\"([a-z-]+)\"", text))
    table = PAGE.split("## What it finds")[1].split("## Loops")[0]
    explained = {
        code for row in re.findall(r"^\| (`.*?) \|", table, re.MULTILINE) for code in re.findall(r"`(.*?)`", row)
    }
    assert explained == used
