"""What the README shows works: its Python code is executed as printed, its links lead somewhere.

Its commands are run in `tests/docs/commands`.
"""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from tests.examples.commands import run_command

ROOT = Path(__file__).resolve().parents[2]
README = (ROOT / "README.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"^```(\w+)\n(.*?)^```$", README, flags=re.MULTILINE | re.DOTALL)
FILE_NAME = re.compile(r"# ([\w.-]+\.\w+)$")


def named_files() -> dict[str, str]:
    """Blocks that begin with a file name in a comment, as files."""
    found = {}
    for _, text in BLOCKS:
        name = FILE_NAME.match(text.split("\n", 1)[0])
        if name:
            found[name[1]] = text
    return found


def scripts() -> list[str]:
    return [text for kind, text in BLOCKS if kind == "python" and text not in named_files().values()]


@pytest.fixture
def folder(tmp_path) -> Path:
    """An empty directory with the files that the README tells its reader to write."""
    for name, text in named_files().items():
        (tmp_path / name).write_text(text, encoding="utf-8")
    return tmp_path


def python(*arguments: str, cwd: Path, **environment: str) -> subprocess.CompletedProcess[str]:
    # The reader has forcectl installed; a bare checkout stands in for that here.
    path = os.pathsep.join(filter(None, [os.environ.get("PYTHONPATH"), str(ROOT)]))
    return subprocess.run(
        [sys.executable, *arguments],
        cwd=cwd, env=os.environ | {"PYTHONPATH": path} | environment, capture_output=True, text=True, check=False,
    )  # fmt: skip


def test_the_blocks_are_found():
    assert {"my_law.py", "my_scenario.yaml"} <= set(named_files())
    assert len(scripts()) >= 1
    assert README.count("```") == 2 * len(BLOCKS)


def test_first_two_commands_are_make_demo_and_make_test():
    shown = re.findall(r"^    (make \w+)", README, flags=re.MULTILINE)
    assert shown[:2] == ["make demo", "make test"]


@pytest.mark.slow
@pytest.mark.parametrize("number", range(len(scripts())))
def test_python_code_runs(number, folder):
    script = folder / "script.py"
    script.write_text(scripts()[number], encoding="utf-8")
    done = run_command([], folder, os.environ, script=script)
    assert done.returncode == 0, done.stderr[-2000:]


@pytest.mark.slow
def test_plugin_example_passes(folder):
    tests = [name for name in named_files() if name.startswith("test_")]
    assert tests != []
    # Named instead of found, because a bare checkout announces no plugin.
    options = ["-p", "no:cacheprovider", "-p", "forcectl.testing.plugin"]
    done = python("-m", "pytest", "-q", *options, *tests, cwd=folder, PYTEST_DISABLE_PLUGIN_AUTOLOAD="1")
    assert done.returncode == 0, done.stdout[-2000:]


PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").glob("*.md"))]


def links(page: Path) -> set[str]:
    """What a page links to or shows, other sites left out."""
    text = page.read_text(encoding="utf-8")
    targets = re.findall(r"\]\(([^)#\s]+)", text) + re.findall(r'src="([^"]+)"', text)
    return {target for target in targets if "://" not in target}


def test_links_lead_somewhere():
    assert len(links(ROOT / "README.md")) >= 3
    assert [f"{page.name}: {link}" for page in PAGES for link in links(page) if not (page.parent / link).exists()] == []


def test_every_page_is_reachable_from_the_index():
    others = {page.name for page in (ROOT / "docs").glob("*.md")} - {"index.md"}
    assert others - links(ROOT / "docs/index.md") == set()
