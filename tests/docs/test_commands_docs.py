"""Every command that README and pages name, words left to the reader included, exists with its options and names.

Those that can be given as they stand are run in `tests/docs/commands`.
"""

import re
import shlex
from pathlib import Path

import pytest
from typer.main import get_command

from forcectl.cli.app import app
from forcectl.scenario.catalog import list_experiments
from tests.docs.commands.printed import ROOT, lines_of
from tests.examples.pages import PAGES

SWEEPS = {file.stem for file in (ROOT / "experiments" / "sweeps").glob("*.yaml")}
NAMED = {name: set(list_experiments()) for name in ("run", "graph", "check", "reproduce")} | {"sweep": SWEEPS}


def commands(page: Path) -> list[list[str]]:
    """The words behind `forcectl` of each command."""
    return [shlex.split(line)[1:] for line in lines_of(page)]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_commands_options_and_names_exist(page):
    root, wrong = get_command(app), []
    for words in commands(page):
        command, rest = root, words
        while rest and rest[0] in getattr(command, "commands", ()):
            command, rest = command.commands[rest[0]], rest[1:]
        known = {option for each in command.params for option in (*each.opts, *each.secondary_opts)} | {"--help"}
        given = {word.partition("=")[0] for word in rest if re.match(r"--?[a-z]", word)}
        names = {word for word in rest[:1] if words[0] in NAMED and re.fullmatch(r"[a-z]\w*", word)}
        if (command is root and not given) or given - known or names - NAMED.get(words[0], set()):
            wrong.append(words)
    assert wrong == []


def test_there_are_commands_to_look_at():
    assert sum(len(commands(page)) for page in PAGES) > 80
