"""Write constraints.txt: the exact version of every dependency, for each supported Python.

    python .ci/lock.py python3.11 python3.12 python3.13

Each interpreter named on the command line asks its own pip to resolve the project's dependencies with all extras
(nothing is installed). Versions that are the same everywhere are written once, the others with a `python_version`
marker. The file names packages and versions only, so it works with whatever package index pip is configured for.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
import tomllib
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
HEADER = """\
# Exact versions this project is tested with; written by `make lock`, not by hand.
# Use with any package index: python -m pip install -c constraints.txt -e .
"""


def requirements() -> list[str]:
    """Every dependency in pyproject.toml, extras included, without the project itself."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    wanted = list(project["dependencies"])
    for extra in project["optional-dependencies"].values():
        wanted += [r for r in extra if not r.startswith(project["name"] + "[")]
    return sorted(set(wanted))


def resolve(python: str) -> tuple[str, dict[str, str]]:
    """The Python version (`3.12`) of the interpreter and the package versions its pip chooses."""
    version = subprocess.check_output([python, "-c", "import sys; print('%d.%d' % sys.version_info[:2])"], text=True)
    with tempfile.TemporaryDirectory() as folder:
        report = Path(folder) / "report.json"
        command = [python, "-m", "pip", "install", "--quiet", "--dry-run", "--ignore-installed"]
        subprocess.run([*command, "--report", str(report), *requirements()], check=True, stdout=subprocess.DEVNULL)
        chosen = json.loads(report.read_text())["install"]
    versions = {item["metadata"]["name"].lower().replace("_", "-"): item["metadata"]["version"] for item in chosen}
    return version.strip(), versions


def merge(resolved: dict[str, dict[str, str]]) -> list[str]:
    """One line per package and version, with a marker where the Pythons differ."""
    lines = []
    for name in sorted({name for versions in resolved.values() for name in versions}):
        groups: dict[str, list[str]] = {}
        for python, versions in resolved.items():
            if name in versions:
                groups.setdefault(versions[name], []).append(python)
        for version, pythons in groups.items():
            marker = " or ".join(f'python_version == "{p}"' for p in pythons)
            lines.append(f"{name}=={version}" + ("" if len(pythons) == len(resolved) else f" ; {marker}"))
    return lines


def main(pythons: list[str]) -> None:
    """Resolve with each interpreter and write the file."""
    if not pythons:
        raise SystemExit(__doc__)
    lines = merge(dict(resolve(python) for python in pythons))
    (ROOT / "constraints.txt").write_text(HEADER + "\n".join(lines) + "\n")
    print(f"constraints.txt: {len(lines)} lines from {', '.join(pythons)}")


if __name__ == "__main__":
    main(sys.argv[1:])
