"""What the README shows works: its commands and its Python code are executed as printed, its links lead somewhere."""

from __future__ import annotations

import os
import re
import shlex
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


def commands() -> list[str]:
    return [
        line[2:] for kind, text in BLOCKS if kind == "console" for line in text.splitlines() if line.startswith("$ ")
    ]


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
    assert len(commands()) >= 5
    assert len(scripts()) >= 1
    assert README.count("```") == 2 * len(BLOCKS)


def test_first_two_commands_are_make_demo_and_make_test():
    shown = re.findall(r"^    (make \w+)", README, flags=re.MULTILINE)
    assert shown[:2] == ["make demo", "make test"]


# What each command prints: words that it is for.
SHOWN = {
    "forcectl list": ["Experiments", "fig_2_7", "Controllers", "!Integral"],
    "forcectl list controllers": ["!Integral", "!Vrft", "!Admittance"],
    "forcectl list '!Integral'": ["integral_gain", "1/s"],
    'forcectl run fig_2_7 --variant "K_I = 3 1/s" --set station.environment.stiffness=2e4 --seed 3': [
        "overshoot", "results in runs/fig_2_7-1: log.nc, metrics.json, figures/",
    ],
    "forcectl run fig_2_8 --fidelity Kinematic --out runs/kinematic": ["pass", "results in runs/kinematic: log.nc"],
    "forcectl graph fig_2_7 --format pdf --depth 2 --out loop.pdf": ["loop.pdf"],
    "forcectl graph fig_2_7 --format html --out loop.html": ["loop.html"],
    "forcectl check fig_2_7": ["station/drive", "Dead time once around the loop:", "0 error, 0 warning"],
    "forcectl explain true_overshoot_pct": ["true_overshoot_pct", "%", "true force"],
    "forcectl robot yumi": ["right_link_6", "kg in all", "yumi: complete"],
    "forcectl reproduce fig_2_8 --fidelity OneDimensional": ["fig_2_8: Integral force controller", "targets met,"],
    "forcectl run my_scenario.yaml": ["overshoot", "results in runs/my_scenario-1: log.nc"],
    "forcectl run my_workcell.yaml": ["results in runs/my_workcell-1: log.nc"],
}  # fmt: skip


def test_every_command_has_words_that_it_shall_print():
    assert set(commands()) == set(SHOWN)


@pytest.mark.slow
@pytest.mark.parametrize("command", commands())
def test_command_prints_what_it_is_for(command, folder):
    program, *arguments = shlex.split(command)
    assert program == "forcectl"
    done = run_command(arguments, folder, os.environ | {"COLUMNS": "200"})
    assert done.returncode == 0, done.stderr[-2000:]
    assert "Traceback" not in done.stderr
    printed = " ".join(done.stdout.split())
    assert [words for words in SHOWN[command] if words not in printed] == []


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
