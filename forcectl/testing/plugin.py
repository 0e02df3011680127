"""The pytest plugin: fixtures for tests of Drake diagrams. Drake is imported by the first test that uses one."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from pydrake.systems.framework import DiagramBuilder, System

    from forcectl.doctor import Report
    from forcectl.inspect.ports import PortName
    from forcectl.testing.runs import Log


@pytest.fixture
def run_diagram() -> Callable[..., Log]:
    """`forcectl.testing.run_diagram`: simulate any system, get its outputs by name.

    ::

        log = run_diagram(diagram, 1.0, period=0.002, inputs={"desired_force": 15.0})
        log.time, log["measured_force"]
    """
    from forcectl.testing.runs import run_diagram

    return run_diagram


@pytest.fixture
def check_diagram() -> Callable[..., Report]:
    """Let the doctor look at a diagram (or at a builder before Build) and fail with its report.

    check_diagram(diagram)                                  no errors and no warnings
    check_diagram(diagram, warnings=False)                  no errors
    check_diagram(diagram, allow={"offsets-differ"})        these codes are fine
    check_diagram(diagram, expected_delay=0.002)            from sensor to command [s]
    """
    return _check


def _check(
    system: System | DiagramBuilder,
    *,
    warnings: bool = True,
    allow: Iterable[str] = (),
    sensor: PortName | None = None,
    command: PortName | None = None,
    expected_delay: float | None = None,
) -> Report:
    __tracebackhide__ = True
    from pydrake.systems.framework import DiagramBuilder

    from forcectl.doctor import examine, examine_builder

    if isinstance(system, DiagramBuilder):
        report = examine_builder(system)
    else:
        report = examine(system, sensor=sensor, command=command, expected_delay=expected_delay)
    allowed = set(allow)
    bad = [f for f in report.errors + (report.warnings if warnings else ()) if f.code not in allowed]
    if bad:
        lines = [f"the doctor finds in {report.name or 'the diagram'}:", *(f"  {finding}" for finding in bad)]
        pytest.fail("\n".join(lines), pytrace=False)
    return report
