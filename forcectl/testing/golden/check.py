"""What the fixtures `golden_log` and `golden_graph` do: compare with a golden file, or write it."""

from __future__ import annotations

import difflib
import os
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import pytest
from pydrake.systems.framework import System

from forcectl.errors import invalid
from forcectl.testing.artefacts import Artefacts, KeptLog
from forcectl.testing.golden.compare import Tolerances, as_log, differences, tolerances
from forcectl.testing.golden.files import golden_path, read_log, same, write, write_log
from forcectl.testing.golden.wiring_text import wiring_text

_MOST_LINES = 30  # of a message


@dataclass
class GoldenFiles:
    """The golden files of one test.

    Attributes:
        test_file: of the test.
        parameters: of a parametrised test, as pytest shows them; "" for none.
        first: whether these parameters are the first ones of the test.
        update: write the files instead of comparing with them.
        artefacts: what is kept of the test in case it fails.
        written: called with the name of each file that was made or changed.
        updated: files that tests of this session have brought up to date; a later test compares with them.
        used: files that the test has asked for so far; it may ask for each only once.
    """

    test_file: Path
    parameters: str
    first: bool
    update: bool
    artefacts: Artefacts
    written: Callable[[str], object]
    updated: set[Path]
    used: set[Path] = field(default_factory=set)

    def log(self, log: object, name: str, *, time: float = 0.0, value: Tolerances = None, shared: bool = False) -> None:
        """Compare a log with the golden one; see the fixture `golden_log`."""
        __tracebackhide__ = True
        if not time >= 0:
            raise invalid("time", time, "a tolerance, not negative [s]")
        today, path = as_log(log), self._path(name, shared, ".nc")
        if self.update and path not in self.updated:
            tolerances(today, value)
            if self._writes(path, shared) and not (path.exists() and same(read_log(path), today)):
                write_log(today, path)
                self.written(_shown(path))
            return
        self._must_exist(path, "log", name)
        golden = read_log(path)
        allowed = tolerances(golden, value, today.values)
        found = differences(today, golden, time, allowed)
        self.artefacts.logs.append(KeptLog(name, today, golden, time, allowed, tuple(found)))
        if found:
            first, shown = found[0], found[:_MOST_LINES]
            lines = [f"golden log {name!r}: {_count(len(found), 'difference')}, first {first.signal} {first.text}"]
            lines += [f"  {each.signal}: {each.text}{each.summary and f'; {each.summary}'}" for each in shown]
            lines += [f"  and {len(found) - len(shown)} more"] if len(found) > len(shown) else []
            lines += [f"  {_shown(path)}, tolerance in time {time:g} s"]
            pytest.fail("\n".join(lines), pytrace=False)

    def graph(self, diagram: System, name: str, *, depth: int | None = None, shared: bool = False) -> None:
        """Compare the wiring of a diagram with the golden one; see the fixture `golden_graph`."""
        __tracebackhide__ = True
        self.artefacts.keep_diagram(diagram)
        today, path = wiring_text(diagram, depth), self._path(name, shared, ".txt")
        if self.update and path not in self.updated:
            if self._writes(path, shared) and not (path.exists() and path.read_text(encoding="utf-8") == today):
                write(path, today.encode())
                self.written(_shown(path))
            return
        self._must_exist(path, "graph", name)
        golden = path.read_text(encoding="utf-8")
        if golden != today:
            changed = [
                line
                for line in difflib.unified_diff(golden.splitlines(), today.splitlines(), n=0, lineterm="")
                if not line.startswith(("---", "+++", "@@"))
            ]
            lines = [f"golden graph {name!r}: {_count(len(changed), 'line')} of the wiring changed (- golden, + today)"]
            lines += [f"  {line}" for line in changed[:_MOST_LINES]]
            lines += [f"  and {len(changed) - _MOST_LINES} more"] if len(changed) > _MOST_LINES else []
            pytest.fail("\n".join([*lines, f"  {_shown(path)}"]), pytrace=False)

    def _path(self, name: str, shared: bool, suffix: str) -> Path:
        path = golden_path(self.test_file, name, "" if shared else self.parameters, suffix)
        if path in self.used:
            raise invalid("name", name, "another one for each golden file of a test")
        self.used.add(path)
        return path

    def _writes(self, path: Path, shared: bool) -> bool:
        """Whether this test writes the file; of tests that share it, only the one with the first parameters does."""
        if shared and not self.first:
            return False
        self.updated.add(path)
        return True

    @staticmethod
    def _must_exist(path: Path, kind: str, name: str) -> None:
        __tracebackhide__ = True
        if not path.exists():
            pytest.fail(
                f"golden {kind} {name!r} does not exist: run `pytest --update-golden`, then commit {_shown(path)}",
                pytrace=False,
            )


def _count(number: int, thing: str) -> str:
    return f"{number} {thing}" if number == 1 else f"{number} {thing}s"


def _shown(path: Path) -> str:
    """A path relative to the working directory if it is below that, else as it is."""
    relative = os.path.relpath(path)
    return str(path) if relative.startswith("..") else relative
