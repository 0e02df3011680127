"""What the commands of a story need beforehand, and what must hold of the files that they write."""

import contextlib
import io
import json
import re
from collections.abc import Callable
from pathlib import Path

import pandas as pd
import pytest

from tests.docs.commands.printed import ROOT
from tests.examples.pages import run_python

Check = Callable[[Path, str], None]  # folder, standard output


def write_record(folder: Path) -> None:
    """The record of an experiment on a contact of 5.9e3 N/m."""
    from tests.runs.test_tune import record_file

    record_file(folder, "record.csv")


def write_small_sweep(folder: Path) -> None:
    """A sweep of eight quick trials where the reader has one of their own."""
    from tests.sweeps.small_sweeps import write

    write(folder, "robustness")


def write_public_arm(folder: Path) -> None:
    """The arm of the page on public URDFs, with the parameters that the page tells to paste."""
    from tests.docs.test_public_urdf_docs import PARAMETERS
    from tests.examples.public_robots import write_public_robot

    (write_public_robot(folder) / "arm.control.yaml").write_text(PARAMETERS, encoding="utf-8")


def write_parts(folder: Path) -> None:
    """The module that the page on slots makes, block by block."""
    from tests.docs.test_slots_docs import code_of_the_page

    (folder / "my_parts.py").write_text(code_of_the_page(), encoding="utf-8")


def gains_fit_the_record(folder: Path, out: str) -> None:
    """The integral gain is the bandwidth over the stiffness of the record."""
    found = json.loads((folder / "tuned" / "summary.json").read_text(encoding="utf-8"))["controller"]["continuous"]
    assert found["K_I"] == pytest.approx(-1.5 / 5.9e3, rel=0.02)


def merged_is_whole(folder: Path, out: str) -> None:
    """The table has each of the eight trials once."""
    table = pd.read_parquet(folder / "runs/whole/trials.parquet")
    assert list(table["state"]) == 8 * ["done"]
    assert table["trial"].is_unique


def draws(name: str, *words: str) -> Check:
    """The picture `name` is there, with these words in it where it is text."""

    def check(folder: Path, out: str) -> None:
        content = (folder / name).read_bytes()
        assert len(content) > 2000
        assert [word for word in words if word.encode() not in content] == []

    return check


def is_the_page(name: str) -> Check:
    """What was written is the page that is in the tree."""

    def check(folder: Path, out: str) -> None:
        assert (folder / name).read_text(encoding="utf-8") == (ROOT / name).read_text(encoding="utf-8")

    return check


def has_trials(name: str, count: int) -> Check:
    """A sweep has so many rows, each with what it cost."""

    def check(folder: Path, out: str) -> None:
        table = pd.read_parquet(folder / name / "trials.parquet")
        assert list(table["state"]) == count * ["done"]

    return check


def has_variants(name: str, *variants: str) -> Check:
    """A run has metrics of these variants."""

    def check(folder: Path, out: str) -> None:
        found = json.loads((folder / name / "metrics.json").read_text(encoding="utf-8"))
        assert [variant for variant in variants if variant not in found] == []

    return check


def the_page_reads_the_table(folder: Path, out: str) -> None:
    """The Python of the page on sweeps prints the share of successes by gain, which falls with the gain."""
    with contextlib.redirect_stdout(io.StringIO()) as said:
        run_python("sweeps.md")
    rates = {float(gain): float(rate) for gain, rate in re.findall(r"^(\d\S*) +(\S+)$", said.getvalue(), re.MULTILINE)}
    assert set(rates) == {1, 2, 3, 4}
    assert rates[1] >= rates[4]


def schema_has_slots(folder: Path, out: str) -> None:
    """The schema is of scenarios."""
    content = json.loads((folder / "scenario.schema.json").read_text(encoding="utf-8"))
    assert {"station", "controller", "reference"} <= set(content["properties"])


def first_is(line: str) -> Check:
    """The output begins with this line."""

    def check(folder: Path, out: str) -> None:
        assert out.splitlines()[0] == line

    return check
