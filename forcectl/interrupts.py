"""Ctrl-C: where it ends the program at once, where it raises `KeyboardInterrupt`, and where it is deferred.

The other signals that ask a program to end are treated alike, see `SIGNALS`. The command line begins with `leaving()`:
while there is nothing to save, an interrupt prints so and ends the process. Work that must be stopped in an orderly way
runs within an `Interrupts`.
"""

from __future__ import annotations

import atexit
import contextlib
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator, Mapping
from typing import Any

SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)  # Ctrl-C, a batch system or `kill`, a terminal that is closed
EXIT_CODE = 130
NOTHING_KEPT = "interrupted: nothing was kept"
_CLEAR = b"\r\x1b[2K\x1b[?25h"  # the line of a progress bar, and show the cursor again
_message = NOTHING_KEPT
_last_acts: list[Callable[[], object]] = []
ending = False  # an interrupted process skips the interpreter's shutdown, which takes half a second with Drake


def set_interrupt_message(line: str) -> None:
    """Set the line that the command line prints when it is interrupted from now on."""
    global _message
    _message = line


@contextlib.contextmanager
def leaving() -> Iterator[None]:
    """A context in which an interrupt prints its line and ends the process at once.

    An exception could be lost or changed while a compiled module is being imported.
    """
    set_interrupt_message(NOTHING_KEPT)
    before = _set(dict.fromkeys(SIGNALS, _leave))
    try:
        yield
    finally:
        _set(before)


@contextlib.contextmanager
def before_leaving(act: Callable[[], object]) -> Iterator[None]:
    """A context in which `act` is called before an interrupt ends the process, such as to remove a folder."""
    _last_acts.append(act)
    try:
        yield
    finally:
        _last_acts.remove(act)


def _leave(number: int, frame: object) -> None:
    _set(dict.fromkeys(SIGNALS, signal.SIG_IGN))  # once is enough
    for act in reversed(tuple(_last_acts)):
        act()
    clear = _CLEAR if os.isatty(2) else b""
    os.write(2, clear + f"{_message}\n".encode())
    os._exit(EXIT_CODE)


class Interrupts:
    """A context in which an interrupt raises `KeyboardInterrupt`, and is recorded.

    Python drops an exception that is raised while it frees an object: `check` raises it again. An interrupt that has
    neither been raised nor handled by the end of the context is passed to the handler that was set before.

    Args:
        held: defer interrupts, and raise them only within `let_through`.

    Attributes:
        asked: whether there was an interrupt.
        handled: whether the caller has handled it.
    """

    def __init__(self, held: bool = False):
        self._held = held
        self._raising = not held
        self.asked = self.handled = False

    def __enter__(self) -> Interrupts:
        self._before = _set(dict.fromkeys(SIGNALS, self._note))
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        self._raising = False
        _set(self._before)
        raised = kind is not None and issubclass(kind, KeyboardInterrupt)
        if self.asked and not self.handled and not raised:
            signal.raise_signal(signal.SIGINT)

    def _note(self, number: int, frame: object) -> None:
        self.asked = True
        if self._raising:
            self._raising = not self._held
            raise KeyboardInterrupt

    def check(self) -> None:
        """Raise `KeyboardInterrupt` if there was an interrupt."""
        if self.asked:
            raise KeyboardInterrupt

    @contextlib.contextmanager
    def let_through(self) -> Iterator[None]:
        """A context in which interrupts raise; a deferred one raises at once."""
        try:
            self._raising = True
            self.check()
            yield
        finally:
            self._raising = False


@contextlib.contextmanager
def interrupts_ignored() -> Iterator[None]:
    """A context in which interrupts are ignored, also by processes that are started in it."""
    before = _set(dict.fromkeys(SIGNALS, signal.SIG_IGN))
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


@contextlib.contextmanager
def interrupts_deferred() -> Iterator[None]:
    """A context in which interrupts are deferred, and processes that are started in it do not receive Ctrl-C."""
    with Interrupts(held=True):
        before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})  # inherited, by new programs too
        try:
            yield
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)


def register_exit_steps() -> None:
    """Register the last steps of a process that uses `leaving`; to be called before other exit handlers are registered.

    No message is printed for an interrupt that was raised where Python drops exceptions, see `Interrupts`. An interrupt
    during the interpreter's shutdown ends the process at once.
    """

    def hook(lost: sys.UnraisableHookArgs) -> None:
        if not issubclass(lost.exc_type, KeyboardInterrupt):
            sys.__unraisablehook__(lost)

    def end() -> None:
        if ending:
            sys.stdout.flush()
            os._exit(EXIT_CODE)

    sys.unraisablehook = hook
    atexit.register(end)  # the first one registered is called last
    atexit.register(_set, dict.fromkeys(SIGNALS, _leave))


def finish() -> None:
    """Print the line of an interrupted process, and skip the interpreter's shutdown at its end."""
    global ending
    ending = True
    print(_message, file=sys.stderr, flush=True)


def _set(handlers: Mapping[int, Any]) -> dict[int, Any]:
    """Set handlers of signals; returns the earlier ones. Only in the main thread; ignored signals stay ignored."""
    if threading.current_thread() is not threading.main_thread():
        return {}
    settable = [number for number in handlers if signal.getsignal(number) is not signal.SIG_IGN]
    return {number: signal.signal(number, handlers[number]) for number in settable}
