"""Artefacts of a test, written to files when it fails: logs, figures, pages of diagrams."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from pydrake.systems.framework import System

from forcectl.arrays import Array
from forcectl.figures.file_names import file_name
from forcectl.testing.golden.compare import Difference
from forcectl.testing.golden.files import write_log
from forcectl.testing.runs import Log

_MOST = 5  # artefacts of each kind that are kept, the last ones


@dataclass(frozen=True)
class KeptLog:
    """A log, and what it was compared with, if it was; see `forcectl.testing.golden.compare`."""

    name: str
    log: Log
    golden: Log | None = None
    time: float = 0.0
    value: Mapping[str, Array] | None = None
    found: tuple[Difference, ...] = ()


@dataclass
class Artefacts:
    """The artefacts of one test.

    Attributes:
        folder: where they are written.
        logs: the last ones.
        diagrams: the last ones.
    """

    folder: Path
    logs: deque[KeptLog] = field(default_factory=lambda: deque(maxlen=_MOST))
    diagrams: deque[System] = field(default_factory=lambda: deque(maxlen=_MOST))

    def __bool__(self) -> bool:
        return bool(self.logs or self.diagrams)

    def keep_diagram(self, diagram: System) -> None:
        """Keep a diagram, once."""
        if not any(each is diagram for each in self.diagrams):
            self.diagrams.append(diagram)

    def write(self) -> list[Path]:
        """Write what there is; returns the files."""
        from forcectl.graph.export import graph
        from forcectl.testing.golden.picture import draw

        self.folder.mkdir(parents=True, exist_ok=True)
        compared = {id(each.log) for each in self.logs if each.golden is not None}
        logs = [each for each in self.logs if each.golden is not None or id(each.log) not in compared]
        written = []
        for number, each in enumerate(logs, start=1):
            stem = f"{number}-{file_name(each.name)}"
            write_log(each.log, self.folder / f"{stem}.nc")
            picture = draw(each.log, each.golden, each.time, each.value, each.found)
            picture.savefig(self.folder / f"{stem}.png", dpi=110)
            written += [self.folder / f"{stem}.nc", self.folder / f"{stem}.png"]
        for number, diagram in enumerate(self.diagrams, start=1):
            page = self.folder / f"diagram-{number}.html"
            graph(diagram, depth=2).save(page)
            written.append(page)
        return written
