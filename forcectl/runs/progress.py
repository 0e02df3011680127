"""What is shown while runs take their time."""

from __future__ import annotations

from typing import Any

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn


class ProgressBars:
    """A bar per running job on standard error, gone when all is done; nothing when that is not a terminal."""

    def __enter__(self) -> ProgressBars:
        console = Console(stderr=True)
        columns = (TextColumn("{task.description}", markup=False), BarColumn(), TimeElapsedColumn())
        self._bars = Progress(*columns, console=console, transient=True, disable=not console.is_terminal)
        self._tasks: dict[str, Any] = {}
        self._bars.start()
        return self

    def show(self, name: str, share: float) -> None:
        """Move the bar called `name` to `share` of its length."""
        if name not in self._tasks:
            self._tasks[name] = self._bars.add_task(name, total=1.0)
        self._bars.update(self._tasks[name], completed=share)

    def __exit__(self, *_: object) -> None:
        self._bars.stop()
