"""`forcectl list` and `schema`, and what a shell completes."""

import json
import os
import re
import subprocess
import sys

import pytest

from forcectl.cli.net import VARIABLE
from forcectl.runs.terminal.listing import KINDS, entries
from forcectl.scenario import catalog


def test_list_shows_everything_there_is_to_choose(forcectl):
    code, out, err = forcectl("list")
    assert (code, err) == (0, "")
    for name in (
        *catalog.list_experiments(),
        *catalog.list_presets(),
        *catalog.SLOTS["fidelity"],
        "!AdaptiveIntegral",
        "!Sequence",
    ):
        assert name in out
    assert "forcectl list KIND, which is experiments, presets, robots, tools, controllers" in out


def test_a_reader_that_has_seen_enough_is_no_error(monkeypatch):
    monkeypatch.delenv(VARIABLE, raising=False)
    read, write = os.pipe()
    os.close(read)
    command = [sys.executable, "-m", "forcectl", "list"]
    done = subprocess.run(command, stdout=write, stderr=subprocess.PIPE, text=True, check=False)
    os.close(write)
    assert done.stderr == ""


@pytest.mark.slow
def test_list_of_a_kind_shows_what_each_is(forcectl, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    for kind in KINDS:
        code, out, err = forcectl("list", kind)
        assert (code, err, "…" in out) == (0, "", False)
        assert max(map(len, out.splitlines())) <= 80
        for name, what, *_ in entries(kind):
            assert name in out
            assert what
            assert kind == "blocks" or not what.startswith("Scenario part"), name
    assert forcectl("list", "controller") == forcectl("list", "controllers")
    code, out, err = forcectl("list", "controlers")
    assert (code, out) == (2, "")
    assert err.startswith("error: unknown kind 'controlers': did you mean 'controllers'? known: experiments, ")


def test_json_of_list_holds_all_kinds_one_kind_or_the_keys_of_a_tag(forcectl):
    everything = json.loads(forcectl("list", "--json")[1])
    assert set(everything) == set(KINDS)
    for block in ("plant/drives/servo", "force/integral", "estimation/environment", "motion/references"):
        assert block in everything["blocks"]
    assert json.loads(forcectl("list", "tools", "--json")[1]) == {"tools": everything["tools"]}
    keys = json.loads(forcectl("list", "!Integral", "--json")[1])["controller"]
    assert keys[0]["key"] == "integral_gain"


def complete(forcectl, monkeypatch, line):
    """What bash is told at the end of a line."""
    from forcectl.cli.app import app

    monkeypatch.setenv("_FORCECTL_COMPLETE", "complete_bash")
    monkeypatch.setenv("COMP_WORDS", line)
    monkeypatch.setenv("COMP_CWORD", str(len(line.split(" ")) - 1))
    assert app.info.name == "forcectl"
    return forcectl()[1].split("\n")


@pytest.mark.parametrize(
    ("line", "found", "not_found"),
    [
        ("forcectl run fig_2", "fig_2_8", "fig_3_4"),
        ("forcectl check own", "own.yaml", "fig_2_8"),
        ("forcectl reproduce fig_2_7 table", "table_4_1", "fig_2_7"),
        ("forcectl list contr", "controllers", "blocks"),
        ("forcectl run fig_2_8 --fidelity K", "Kinematic", "Multibody"),
        ("forcectl run fig_2_8 --set station.env", "station.environment=", "duration="),
        ("forcectl run own.yaml --variant s", "stiff", "other"),
    ],
)
def test_a_shell_completes_names_and_keys(forcectl, monkeypatch, tmp_path, line, found, not_found):
    (tmp_path / "own.yaml").write_text("variants: {stiff: {}, other: {}}\n")
    choices = complete(forcectl, monkeypatch, line)
    assert found in choices
    assert not_found not in choices


def test_list_of_a_tag_shows_its_keys_with_unit_bounds_default_and_meaning(forcectl, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    code, out, err = forcectl("list", "!AdaptiveIntegral")
    assert (code, err) == (0, "")
    assert max(map(len, out.splitlines())) <= 80
    words = " ".join(out.split())
    assert "fills the slot controller" in words
    assert "integral_gain 1.5 a number [1/s], from integral gain K_I of the 0.000001 to 10000 force error" in words
    assert "forgetting 0.995 a number, from 0.1 to 1" in words


def test_list_of_import_shows_how_a_class_of_ones_own_is_named(forcectl):
    code, out, err = forcectl("list", "!Import")
    assert (code, err) == (0, "")
    assert "!Import, fills any slot" in out
    assert [row["key"] for row in json.loads(forcectl("list", "!Import", "--json")[1])["any slot"]] == [
        "path",
        "parameters",
    ]


def test_list_of_scenario_shows_the_keys_that_have_no_tag(forcectl, monkeypatch, tmp_path):
    monkeypatch.setenv("COLUMNS", "160")
    monkeypatch.chdir(tmp_path)
    (tmp_path / "scenario").mkdir()  # a folder of that name stands back
    code, out, err = forcectl("list", "scenario")
    assert (code, err) == (0, "")
    for title in (
        "Keys of a scenario",
        "scenario: station",
        "scenario: guard",
        "scenario: model",
        "scenario: findings",
    ):
        assert f"\n{title} " in f"\n{out}", title
    assert "outward normal, in W" in out
    rows = json.loads(forcectl("list", "scenario", "--json")[1])["scenario"]
    assert {row["key"]: row["unit"] for row in rows}["station.posture_deg"] == "deg"
    assert "scenario, or a tag such as !Integral" in forcectl("list", "station")[2]


def test_every_example_of_list_runs(forcectl):
    _, help_text, _ = forcectl("list", "--help")
    example = help_text.split("Example: forcectl ")[1].split("\n")[0]
    assert example == "list '!Integral'"
    code, out, _ = forcectl("list", "!Integral")
    assert (code, "integral_gain" in out) == (0, True)


@pytest.mark.parametrize("tag", [tag for slot in catalog.SLOTS for tag in catalog.SLOTS[slot]])
def test_every_tag_can_be_listed_without_a_part_being_cut(forcectl, monkeypatch, tag):
    monkeypatch.setenv("COLUMNS", "80")
    code, out, err = forcectl("list", f"!{tag}")
    assert (code, err, "…" in out) == (0, "", False)
    assert max(map(len, out.splitlines()), default=0) <= 80


def test_a_tag_that_does_not_exist_is_refused(forcectl):
    code, out, err = forcectl("list", "!Integrall")
    assert (code, out) == (2, "")
    assert err.startswith("error: unknown tag '!Integrall': did you mean '!Integral'? known: ")


def test_schema_is_printed_or_written(forcectl, tmp_path):
    code, out, _ = forcectl("schema")
    assert code == 0
    assert forcectl("schema", "--out", "own.json")[1] == "wrote own.json\n"
    assert json.loads((tmp_path / "own.json").read_text()) == json.loads(out)
    code, out, err = forcectl("schema", "--out", "no/such/folder/own.json")
    assert (code, out, err) == (
        2,
        "",
        "error: --out 'no/such/folder/own.json' cannot be written: No such file or directory\n",
    )


@pytest.mark.parametrize(("slot", "tag"), [(slot, tag) for slot, tags in catalog.SLOTS.items() for tag in tags])
def test_the_list_says_what_a_part_is_before_what_it_needs(slot, tag):
    text = catalog.first_line(catalog.SLOTS[slot][tag])
    assert not re.match(r"[,;:.]|(of|needs|the default|the same|starts with|One entry|Scenario part)\b", text), text


def test_what_the_terminal_cannot_show_is_a_question_mark(tmp_path):
    (tmp_path / "läuft").mkdir()
    (tmp_path / "läuft/manifest.json").write_text('{"status": "done"}')
    command = [sys.executable, "-m", "forcectl", "list", str(tmp_path)]
    environment = os.environ | {"PYTHONIOENCODING": "ascii", "COLUMNS": "200"}
    done = subprocess.run(command, capture_output=True, text=True, check=False, env=environment)
    assert (done.returncode, done.stderr) == (0, "")
    assert "l?uft" in done.stdout
