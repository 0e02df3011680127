"""Every command that the help texts, README and the pages print, collected; and the files that they print."""

import re
import shlex
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

from typer.main import get_command

from forcectl.cli.app import app
from tests.examples.pages import PAGES, page_text

ROOT = Path(__file__).parents[3]
_BLOCK = re.compile(r"^```(\w*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
_FILE = re.compile(r"# ([\w./-]+\.\w+)\b")
_PLACEHOLDER = re.compile(r"^[A-Z]+$|\.\.\.|<")
_ALONE = ("list", "explain", "schema")  # commands that need no argument


def lines_of(page: Path) -> list[str]:
    """Commands of a page, those that leave words to the reader included: in lines of code, and within the text."""
    text = page.read_text(encoding="utf-8")
    blocks = [block for _, block in _BLOCK.findall(text)]
    rest = _BLOCK.sub("", text)
    found = [line for block in blocks for line in re.findall(r"^(?:\$ )?(forcectl .+)$", block, re.MULTILINE)]
    found += re.findall(r"^    (forcectl .+)$", rest, re.MULTILINE)
    found += [f"forcectl {' '.join(words.split())}" for words in re.findall(r"`forcectl ([^`]+)`", rest)]
    return [re.sub(r"\s+#.*", "", line) for line in found]


def helps() -> dict[str, str]:
    """The help of every command by its name; of forcectl itself by the empty one."""

    def walk(name: str, command: Any) -> Iterator[tuple[str, str]]:
        yield name, command.help or ""
        for each, below in getattr(command, "commands", {}).items():
            yield from walk(f"{name} {each}".strip(), below)

    return dict(walk("", get_command(app)))


def example_of(text: str) -> str:
    """The example of a help text."""
    (found,) = re.findall(r"(?:Example: |: )(forcectl [^\n]+(?:\n[^\n]+)*)", text)
    return " ".join(found.split())


def is_complete(words: list[str]) -> bool:
    """Whether a command names all that it needs: neither its argument is left out nor a word left to the reader."""
    if any(_PLACEHOLDER.search(word) for word in words):
        return False
    argument = words[2:3] if words[0] == "tune" else words[1:2]
    if words[0] in _ALONE or words[0].startswith("-"):
        return True
    return bool(argument) and (not argument[0].startswith("-") or argument[0] == "--all")


@cache
def printed() -> dict[str, list[str]]:
    """Commands that can be given as they stand, and where they are printed."""
    places: dict[str, list[str]] = {}
    for name, text in helps().items():
        places.setdefault(example_of(text), []).append(f"forcectl {name} --help")
    for page in PAGES:
        for line in lines_of(page):
            if is_complete(shlex.split(line)[1:]):
                places.setdefault(line, []).append(page.name)
    return places


def write_files(page: str, folder: Path) -> None:
    """Write the files that a page tells its reader to write: blocks that begin with the name of one."""
    for _, text in _BLOCK.findall(page_text(page)):
        if (name := _FILE.match(text)) is not None:
            (folder / name[1]).write_text(text, encoding="utf-8")
