"""Write constraints.txt and hashes.txt: the exact version of every dependency, and of what file, for each Python.

    python .ci/lock.py python3.11 python3.12 python3.13
    python .ci/lock.py --keep python3.11 python3.12 python3.13     with the versions that constraints.txt has

Each interpreter named on the command line asks its own pip to resolve the project's dependencies with all extras
(nothing is installed). Versions that are the same everywhere are written once, the others with a `python_version`
marker. The files name packages only, so they work with whatever package index pip is configured for. The hashes are
those of the files that the interpreters' pip chooses: for this machine's system and processor.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import tempfile
import tomllib
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
HEADER = """\
# Exact versions this project is tested with; written by `make lock`, not by hand.
# Use with any package index: python -m pip install -c constraints.txt -e .
"""
HASHES_HEADER = """\
# The versions of constraints.txt with the SHA-256 of each package's file, for Linux on x86-64; written by `make lock`.
# python -m pip install --require-hashes -r hashes.txt
# python -m pip install --no-deps --no-build-isolation -e .
"""


def requirements() -> list[str]:
    """Every dependency in pyproject.toml, extras and what builds it included, without the project itself."""
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text())
    project = settings["project"]
    wanted = settings["build-system"]["requires"] + project["dependencies"]
    for extra in project["optional-dependencies"].values():
        wanted += [r for r in extra if not r.startswith(project["name"] + "[")]
    return sorted(set(wanted))


def resolve(python: str, *options: str) -> dict[str, tuple[str, str]]:
    """Version and SHA-256 of every package that an interpreter's pip chooses, by name.

    Args:
        python: the interpreter.
        options: of pip.
    """
    with tempfile.TemporaryDirectory() as folder:
        report = Path(folder) / "report.json"
        command = [python, "-m", "pip", "install", "--quiet", "--dry-run", "--ignore-installed", *options]
        subprocess.run([*command, "--report", str(report), *requirements()], check=True, stdout=subprocess.DEVNULL)
        chosen = json.loads(report.read_text())["install"]
    found = {}
    for item in chosen:
        name = item["metadata"]["name"].lower().replace("_", "-")
        found[name] = (item["metadata"]["version"], item["download_info"]["archive_info"]["hashes"]["sha256"])
    return found


def merge(resolved: dict[str, dict[str, tuple[str, str]]]) -> list[tuple[str, list[str]]]:
    """The lines of constraints.txt, one per package and version, each with its hashes.

    Args:
        resolved: by the version of Python (`3.12`): what `resolve` found.
    """
    lines = []
    for name in sorted({name for packages in resolved.values() for name in packages}):
        groups: dict[str, dict[str, str]] = {}
        for python, packages in resolved.items():
            if name in packages:
                version, digest = packages[name]
                groups.setdefault(version, {})[python] = digest
        for version, digests in groups.items():
            marker = " or ".join(f'python_version == "{python}"' for python in digests)
            line = f"{name}=={version}" + ("" if len(digests) == len(resolved) else f" ; {marker}")
            lines.append((line, sorted(set(digests.values()))))
    return lines


def version_of(python: str) -> str:
    """The version of an interpreter, such as `3.12`."""
    shown = subprocess.check_output([python, "-c", "import sys; print('%d.%d' % sys.version_info[:2])"], text=True)
    return shown.strip()


def main() -> None:
    """Resolve with each interpreter and write both files."""
    parser = argparse.ArgumentParser(description="Write constraints.txt and hashes.txt.")
    parser.add_argument("pythons", nargs="+", help="interpreters, of all supported versions")
    parser.add_argument("--keep", action="store_true", help="the versions that constraints.txt has")
    arguments = parser.parse_args()
    options = ["--constraint", str(ROOT / "constraints.txt")] if arguments.keep else []
    lines = merge({version_of(python): resolve(python, *options) for python in arguments.pythons})
    (ROOT / "constraints.txt").write_text(HEADER + "\n".join(line for line, _ in lines) + "\n")
    hashed = [" \\\n    ".join([line, *(f"--hash=sha256:{digest}" for digest in digests)]) for line, digests in lines]
    (ROOT / "hashes.txt").write_text(HASHES_HEADER + "\n".join(hashed) + "\n")
    print(f"constraints.txt, hashes.txt: {len(lines)} packages from {', '.join(arguments.pythons)}")


if __name__ == "__main__":
    main()
