"""Whether a command can have the memory that it takes to load Drake and HDF5."""

from __future__ import annotations

import resource

from forcectl.errors import RunFailedError

LEAST = 900e6  # [B] of addresses: with 600 MB libraries fail to load, each in its own way, with 1000 MB runs are sound


def check_memory() -> None:
    """Refuse a process that may have too few addresses (`ulimit -v`).

    Raises:
        RunFailedError: says how many it must have.
    """
    allowed, _ = resource.getrlimit(resource.RLIMIT_AS)
    if allowed != resource.RLIM_INFINITY and allowed < LEAST:
        raise RunFailedError(
            f"not enough memory: this process is limited to {allowed / 1e6:.0f} MB (ulimit -v), and must be allowed at "
            f"least {LEAST / 1e6:.0f} MB; nothing was written"
        )
