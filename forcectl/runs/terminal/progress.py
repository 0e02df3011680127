"""The progress display of runs."""

from __future__ import annotations

import sys
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn


class ProgressBars:
    """A bar per running job on standard error, removed at the end; none where that is not a terminal.

    FORCE_COLOR, which notebooks set for the commands that they run, makes no terminal of a pipe.

    Args:
        quiet: show nothing.
    """

    def __init__(self, quiet: bool = False):
        columns = (TextColumn("{task.description}", markup=False), BarColumn(), TimeElapsedColumn())
        disable = quiet or not sys.stderr.isatty()
        self._bars = Progress(*columns, console=Console(stderr=True), transient=True, disable=disable)
        self._tasks: dict[str, Any] = {}
        self._stage: Any = None

    def __enter__(self) -> ProgressBars:
        self._bars.start()
        return self

    def show(self, name: str, share: float) -> None:
        """Move the bar called `name` to `share` of its length."""
        if name not in self._tasks:
            self._tasks[name] = self._bars.add_task(name, total=1.0)
        self._bars.update(self._tasks[name], completed=share)

    def stage(self, text: str) -> None:
        """Show a step without measurable progress, such as building or drawing."""
        if self._stage is None:
            self._stage = self._bars.add_task(text, total=None)
        self._bars.update(self._stage, description=text)

    def __exit__(self, *_: object) -> None:
        self._bars.stop()
