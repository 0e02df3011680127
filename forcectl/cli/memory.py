"""Check that a command may use enough memory to load Drake and HDF5."""

from __future__ import annotations

import resource

from forcectl.errors import RunFailedError

LEAST = 900e6  # [B] of address space: with 600 MB libraries fail to load with various errors, with 1000 MB runs work


def check_memory() -> None:
    """Refuse a process whose address space is limited too much (`ulimit -v`).

    Raises:
        RunFailedError: the limit is below `LEAST`; the message names both.
    """
    allowed, _ = resource.getrlimit(resource.RLIMIT_AS)
    if allowed != resource.RLIM_INFINITY and allowed < LEAST:
        raise RunFailedError(
            f"not enough memory: this process is limited to {allowed / 1e6:.0f} MB (ulimit -v), and must be allowed at "
            f"least {LEAST / 1e6:.0f} MB; nothing was written"
        )
