"""Ctrl-C: raised, held, let through, and passed on."""

import contextlib
import os
import signal
import subprocess
import sys
import threading

import pytest

from forcectl.interrupts import Interrupts, interrupts_deferred


def press() -> None:
    signal.raise_signal(signal.SIGINT)


def test_an_interrupt_raises_within_and_what_was_there_before_comes_back():
    before = signal.getsignal(signal.SIGINT)
    with pytest.raises(KeyboardInterrupt), Interrupts():
        press()
    assert signal.getsignal(signal.SIGINT) is before


def test_one_that_python_passed_over_is_raised_again():
    with Interrupts() as interrupts:
        interrupts.handled = True
        with contextlib.suppress(KeyboardInterrupt):  # as while an object is freed
            press()
        with pytest.raises(KeyboardInterrupt):
            interrupts.check()


def test_a_held_one_waits_until_it_is_let_through():
    with Interrupts(held=True) as interrupts:
        interrupts.handled = True
        press()
        for _ in range(2):
            with pytest.raises(KeyboardInterrupt), interrupts.let_through():
                raise AssertionError("not stopped")
    with Interrupts(held=True) as interrupts:
        interrupts.handled = True
        with pytest.raises(KeyboardInterrupt), interrupts.let_through():
            press()


@pytest.mark.parametrize("inner", [lambda: Interrupts(held=True), interrupts_deferred])
def test_what_nobody_heeds_goes_on_to_the_one_around(inner):
    done = []

    def work() -> None:
        with Interrupts():
            with inner():
                press()
                done.append("inner")
            done.append("outer")

    with pytest.raises(KeyboardInterrupt):
        work()
    assert done == ["inner"]


def test_what_was_heeded_does_not():
    with Interrupts(), Interrupts(held=True) as inner:
        press()
        inner.handled = True


def test_processes_started_within_leave_it_to_this_one():
    code = "import os, signal; os.kill(os.getpid(), signal.SIGINT); print('alive')"
    with interrupts_deferred():
        done = subprocess.run([sys.executable, "-S", "-c", code], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (0, "alive\n", "")


def test_in_another_thread_nothing_is_set():
    before, found = signal.getsignal(signal.SIGINT), []

    def look() -> None:
        with Interrupts():
            found.append(signal.getsignal(signal.SIGINT))

    thread = threading.Thread(target=look)
    thread.start()
    thread.join()
    assert found == [before]


def test_where_there_is_nothing_to_keep_the_process_ends_at_once_with_one_line():
    code = (
        "import os, signal\n"
        "from forcectl.interrupts import leaving\n"
        "with leaving():\n"
        "    try: os.kill(os.getpid(), signal.SIGINT)\n"
        "    finally: print('not reached')\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False, env=os.environ)
    assert (done.returncode, done.stdout, done.stderr) == (130, "", "interrupted: nothing was kept\n")
