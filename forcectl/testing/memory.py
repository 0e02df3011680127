"""An assertion that building, running and dropping a system releases its memory."""

from __future__ import annotations

import ctypes
import gc
import resource
import sys
import weakref
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Context, Diagram, DiagramBuilder, LeafSystem, System
from pydrake.systems.primitives import PassThrough

from forcectl.errors import invalid
from forcectl.framework.block import PythonBlock, PythonDiagram
from forcectl.inspect.wiring import is_python_block


@dataclass(frozen=True)
class MemoryRecord:
    """Results of the measurement.

    Attributes:
        systems: how many systems one build makes.
        checked_references: whether it was checked that each of them was freed.
        growth_kb: growth of the process per build, without the leak of Drake itself for as many systems [kB].
        drake_kb: leak of Drake itself for as many systems, per build [kB]; 0 where it frees them.
    """

    systems: int
    checked_references: bool
    growth_kb: float
    drake_kb: float


def assert_memory_released(
    build: Callable[[], System],
    *,
    duration: float = 0.0,
    builds: int = 10,
    allowed_kb: float = 1024.0,
    run: Callable[[System], None] | None = None,
) -> MemoryRecord:
    """Build, run and drop a system several times: no Python system survives, and the process does not grow.

    Older releases of Drake (1.51, for example) keep a diagram for good when one of its Python blocks is not derived
    from `PythonBlock`; there systems that survive with such a block are no error (`checked_references` is False). The
    leak of such a release for as many empty systems is measured, and subtracted from the growth.

    Args:
        build: makes the system.
        duration: how long each system is simulated [s].
        builds: how many are made for the measurement, after three that warm up.
        allowed_kb: allowed growth of the process per build, beyond the leak of Drake itself [kB].
        run: what to do with each system instead of simulating it for `duration`.

    Raises:
        AssertionError: with the systems that are still alive and what refers to them, or with the growth.
        BadInputError: fewer than one build.
    """
    __tracebackhide__ = True
    if builds < 1:
        raise invalid("builds", builds, "at least 1")
    references = _use(build, duration, run)
    alive = [system for reference in references if (system := reference()) is not None]
    collected = _drake_releases_blocks() or not any(map(_is_plain_python, alive))
    if alive and collected:
        names = ", ".join(f"{type(s).__name__} (held by {_holders(s, alive)})" for s in alive[:5])
        raise AssertionError(f"{len(alive)} of {len(references)} systems are still alive after use: {names}")
    del alive
    for _ in range(2):
        _use(build, duration, run)
    kept = 0 if collected else sum(reference() is not None for reference in references)
    lost = _drake_loses_kb() * kept if kept else 0.0
    growth = _growth_kb(build, duration, run, builds) - lost
    if growth > allowed_kb:
        beyond = f", beyond the {lost:.0f} kB that Drake does not release for {kept} systems" if lost else ""
        raise AssertionError(f"the process grows by {growth:.0f} kB per build, allowed are {allowed_kb:g} kB{beyond}")
    return MemoryRecord(len(references), not kept, growth, lost)


def _is_plain_python(system: System) -> bool:
    """Whether it is a Python block that older releases of Drake cannot free."""
    return is_python_block(system) and not isinstance(system, PythonBlock | PythonDiagram)


def _growth_kb(
    build: Callable[[], System], duration: float, run: Callable[[System], None] | None, builds: int
) -> float:
    """Growth of the process per build [kB]."""
    before = _memory_kb()
    for _ in range(builds):
        _use(build, duration, run)
    return (_memory_kb() - before) / builds


def _use(
    build: Callable[[], System], duration: float, run: Callable[[System], None] | None
) -> list[weakref.ref[System]]:
    system = build()
    references = [weakref.ref(each) for each in _systems(system)]
    if run is not None:
        run(system)
    elif duration > 0:
        Simulator(system).AdvanceTo(duration)
    del system
    gc.collect()
    return references


class _Smallest(LeafSystem):
    """The smallest Python block: one port and one callback."""

    def __init__(self) -> None:
        super().__init__()
        self._input = self.DeclareVectorInputPort("u", 1)
        self.DeclarePeriodicPublishEvent(1.0, 0.0, self._publish)

    def _publish(self, context: Context) -> None:
        pass


def _smallest(others: int) -> System:
    """A diagram of the simplest Python block, and as many blocks without Python beside it."""
    builder = DiagramBuilder()
    builder.AddSystem(_Smallest())
    for _ in range(others):
        builder.AddSystem(PassThrough(1))
    return builder.Build()


@cache
def _drake_releases_blocks() -> bool:
    """Whether this Drake frees the smallest Python block that was part of a diagram."""
    return all(reference() is None for reference in _use(lambda: _smallest(0), 0.0, None))


@cache
def _drake_loses_kb() -> float:
    """Leak of this Drake per system of a diagram with a Python block [kB]."""
    others = 40
    _use(lambda: _smallest(others), 0.0, None)
    return _growth_kb(lambda: _smallest(others), 0.0, None, 10) / (others + 2)


def _systems(system: System) -> Iterator[System]:
    """The system and everything inside it."""
    yield system
    if isinstance(system, Diagram):
        for inner in system.GetSystems():
            yield from _systems(inner)


def _holders(system: System, alive: list[System]) -> str:
    kinds = {type(holder).__name__ for holder in gc.get_referrers(system) if holder is not alive}
    return ", ".join(sorted(kinds - {"frame"})) or "C++"


def _memory_kb() -> float:
    """Memory of this process [kB]: resident now where /proc has it, else the highest so far."""
    # Make the C library release its free memory, where it can: a leak could be hidden in it for a long time.
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
    if trim is not None:
        trim(0)
    status = Path("/proc/self/statm")
    if status.exists():
        return int(status.read_text().split()[1]) * resource.getpagesize() / 1024
    highest = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return highest / 1024 if sys.platform == "darwin" else float(highest)
