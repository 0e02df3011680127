"""The wheel and the source archive hold everything, and what they install works from any directory."""

import shutil
import subprocess
import sys
import tarfile
import zipfile
from dataclasses import dataclass
from pathlib import Path

import pytest

pytestmark = pytest.mark.slow

ROOT = Path(__file__).resolve().parents[2]
LINKED = ("diagrams", "models", "experiments")
NOT_SHIPPED = {".md"}  # notes beside the data may or may not be shipped


@dataclass(frozen=True)
class Archives:
    """A copy of the repository's files, the source archive built from it, and the wheel built from that archive."""

    copy: Path
    sdist: Path
    wheel: Path


@pytest.fixture(scope="module")
def archives(tmp_path_factory) -> Archives:
    work = tmp_path_factory.mktemp("packaging")
    copy, dist = work / "copy", work / "dist"
    listing = ["git", "ls-files", "--cached", "--others", "--exclude-standard"]
    for name in subprocess.check_output(listing, cwd=ROOT, text=True).splitlines():
        if (ROOT / name).exists():
            (copy / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(ROOT / name, copy / name, follow_symlinks=False)
    dist.mkdir()
    backend = "from setuptools import build_meta; print(build_meta.build_{kind}({folder!r}))"
    sdist = dist / run_python(backend.format(kind="sdist", folder=str(dist)), cwd=copy).split()[-1]
    with tarfile.open(sdist) as archive:
        archive.extractall(work / "unpacked", filter="data")
    [unpacked] = (work / "unpacked").iterdir()
    wheel = dist / run_python(backend.format(kind="wheel", folder=str(dist)), cwd=unpacked).split()[-1]
    return Archives(copy, sdist, wheel)


def run_python(code: str, cwd: Path, *options: str) -> str:
    result = subprocess.run(
        [sys.executable, *options, "-c", code], cwd=cwd, capture_output=True, text=True, check=False
    )
    assert result.returncode == 0, result.stderr[-2000:]
    return result.stdout


def expected_files(root: Path) -> set[str]:
    """Each file of the four packages in a copy of the repository, as it is called in the wheel."""
    files = set()
    for folder in ("forcectl", *LINKED):
        for path in (root / folder).rglob("*"):
            inside = path.relative_to(root)
            linked = folder == "forcectl" and len(inside.parts) > 1 and inside.parts[1] in LINKED
            if not path.is_file() or linked or path.suffix in NOT_SHIPPED:
                continue
            files.add(inside.as_posix() if folder == "forcectl" else f"forcectl/{inside.as_posix()}")
    return files


def test_the_wheel_holds_code_and_data_of_all_four_folders(archives):
    names = set(zipfile.ZipFile(archives.wheel).namelist())
    expected = expected_files(archives.copy)
    assert {"forcectl/py.typed", "forcectl/diagrams/__init__.py", "forcectl/experiments/__init__.py"} <= expected
    assert expected - names == set()


def test_the_wheel_holds_nothing_else(archives):
    names = {n for n in zipfile.ZipFile(archives.wheel).namelist() if ".dist-info/" not in n}
    assert {n for n in names - expected_files(archives.copy) if Path(n).suffix not in NOT_SHIPPED} == set()


def test_the_source_archive_holds_no_part_of_the_tests(archives):
    """All of them or none: setuptools adds `tests/test_*.py` alone, which need the rest."""
    with tarfile.open(archives.sdist) as archive:
        assert [name for name in archive.getnames() if Path(name).parts[1:2] == ("tests",)] == []


def test_metadata_names_the_command_the_plugin_and_the_licence(archives):
    wheel = zipfile.ZipFile(archives.wheel)
    text = {Path(n).name: wheel.read(n).decode() for n in wheel.namelist() if ".dist-info/" in n}
    assert "forcectl = forcectl.cli:main" in text["entry_points.txt"]
    assert "forcectl = forcectl.testing.plugin" in text["entry_points.txt"]
    assert "License-Expression: BSD-3-Clause" in text["METADATA"]
    assert "Requires-Python: <3.14,>=3.11" in text["METADATA"]
    assert "LICENSE" in text


def test_the_wheel_works_from_another_directory(archives, tmp_path):
    """Unpacked beside nothing of ours, with the checkout out of reach."""
    site = tmp_path / "site"
    zipfile.ZipFile(archives.wheel).extractall(site)
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    code = f"""
import sys
sys.path[:0] = [{str(site)!r}]
import forcectl.diagrams, forcectl.models, forcectl.experiments
from pathlib import Path
for module in (forcectl, forcectl.diagrams, forcectl.models, forcectl.experiments):
    assert Path(module.__file__).is_relative_to({str(site)!r}), module.__file__
import forcectl as fc
print(*fc.list_experiments())
"""
    assert "fig_2_7" in run_python(code, elsewhere, "-I").split()
