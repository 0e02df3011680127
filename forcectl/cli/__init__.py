"""The command line. Commands import what they need when they run, so that `--help` does not wait for Drake.

Exit codes: 0 done; 1 a run failed, an expectation was missed, the doctor found errors, a run with `--strict` has a
finding, or an unexpected error (one line; `--debug` shows the traceback); 2 bad input; 130 interrupted.
"""

from __future__ import annotations

import os
import sys

from forcectl import interrupts


def main() -> None:
    """Entry point: every error is one line on standard error."""
    interrupts.register_exit_steps()
    with interrupts.leaving():  # before anything that takes time
        from forcectl.cli import net

        debug = net.take_debug()
        try:
            from forcectl.cli.app import call

            code = call(net.whole if debug else lambda error: None)
        except BaseException as error:  # user code may raise anything
            if "_FORCECTL_COMPLETE" in os.environ:  # shell completion ends with an exception
                raise
            if debug:
                net.whole(error)
            code = net.caught(error)
        if code == interrupts.EXIT_CODE:
            interrupts.finish()
    sys.exit(code)
