"""The pytest plugin: fixtures for tests of Drake diagrams. Drake is imported by the first test that uses one."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from collections.abc import Callable, Generator, Iterable

    from pydrake.systems.framework import DiagramBuilder, System

    from forcectl.doctor import Report
    from forcectl.inspect.ports import PortName
    from forcectl.testing.artefacts import Artefacts
    from forcectl.testing.golden.check import GoldenFiles
    from forcectl.testing.runs import Log

_ARTEFACTS = pytest.StashKey["Artefacts"]()
_WRITTEN = "golden file"
_UPDATED = pytest.StashKey["set[Path]"]()


def pytest_addoption(parser: pytest.Parser) -> None:
    """The options of the plugin."""
    group = parser.getgroup("forcectl", "golden logs and diagrams of Drake (forcectl)")
    group.addoption(
        "--update-golden",
        action="store_true",
        help="write the golden files that tests compare with; not where the variable CI is set",
    )
    group.addoption(
        "--artefacts",
        metavar="DIR",
        help="where failed tests write logs, figures and diagrams; default: in pytest's temporary folder",
    )


def pytest_configure(config: pytest.Config) -> None:
    """Refuse to write golden files where nobody would look at them."""
    if config.getoption("--update-golden") and os.environ.get("CI", "").lower() not in ("", "0", "false"):
        raise pytest.UsageError(
            "--update-golden is refused where CI is set: write golden files at your desk, look at them and commit them"
        )


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(
    item: pytest.Item, call: pytest.CallInfo[Any]
) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    """Write the artefacts of a test that has failed, and say where they are."""
    report = yield
    artefacts = item.stash.get(_ARTEFACTS, None)  # false while there are none
    if artefacts and report.when == "call" and report.failed:
        try:
            names = ", ".join(path.name for path in artefacts.write())
        except Exception as error:  # a test must not fail for another reason than its own
            names = f"not written, {type(error).__name__}: {' '.join(str(error).split())[:200]}"
        report.sections.append(("artefacts", f"{artefacts.folder}: {names}"))
    return report


def pytest_terminal_summary(terminalreporter: Any) -> None:
    """Say which golden files were written."""
    reports = [report for kind in ("passed", "failed") for report in terminalreporter.stats.get(kind, ())]
    written = [value for each in reports for name, value in getattr(each, "user_properties", ()) if name == _WRITTEN]
    if written:
        terminalreporter.section("golden files written: look at them, then commit them")
        for path in sorted(set(written)):
            terminalreporter.line(path)


@pytest.fixture
def _artefacts(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Artefacts:
    """What is kept of the test in case it fails."""
    from forcectl.figures.file_names import file_name
    from forcectl.testing.artefacts import Artefacts

    given = request.config.getoption("--artefacts")
    base = Path(given).absolute() if given else tmp_path_factory.getbasetemp() / "artefacts"
    test = request.node.nodeid.replace("/", ".").replace("::", ".")
    request.node.stash[_ARTEFACTS] = artefacts = Artefacts(base / file_name(test))
    return artefacts


@pytest.fixture
def _golden_files(request: pytest.FixtureRequest, _artefacts: Artefacts) -> GoldenFiles:
    """The golden files of the test."""
    from forcectl.testing.golden.check import GoldenFiles

    parameters = getattr(request.node, "callspec", None)
    return GoldenFiles(
        request.path,
        parameters.id if parameters else "",
        first=parameters is None or not any(parameters.indices.values()),
        update=request.config.getoption("--update-golden"),
        artefacts=_artefacts,
        updated=request.config.stash.setdefault(_UPDATED, set()),
        written=lambda path: request.node.user_properties.append((_WRITTEN, path)),
    )


@pytest.fixture
def golden_log(_golden_files: GoldenFiles) -> Callable[..., None]:
    """Compare a log with the golden one of the test, signal by signal, within a tube in time and value.

    golden_log(log, "swing", time=2e-3, value={"theta": 1e-3})   tolerances [s], and in the unit of each signal
    golden_log(log, "swing", shared=True)                       the same one for all parameters of the test

    The file is `golden/<test file>/swing.nc` beside the test file; `pytest --update-golden` writes it. `log` is what
    `run_diagram` gives, an xarray dataset over `time`, Drake's VectorLog, or a mapping of arrays with `time`.
    """
    return _golden_files.log


@pytest.fixture
def golden_graph(_golden_files: GoldenFiles) -> Callable[..., None]:
    """Compare the wiring of a diagram with the golden one of the test, as text.

    golden_graph(diagram, "loop")             all levels
    golden_graph(diagram, "loop", depth=1)    the outermost one

    The file is `golden/<test file>/loop.txt` beside the test file; `pytest --update-golden` writes it.
    """
    return _golden_files.graph


@pytest.fixture
def simulate_diagram(_artefacts: Artefacts) -> Callable[..., Log]:
    """`forcectl.testing.run_diagram`, and what ran is kept: log, figure and diagram of a test that fails.

    ::

        log = simulate_diagram(diagram, 1.0, period=0.002, inputs={"desired_force": 15.0})
        log.time, log["measured_force"], log.to_xarray()
    """
    from forcectl.testing.artefacts import KeptLog
    from forcectl.testing.runs import run_diagram

    def simulate(system: System, *arguments: Any, **keywords: Any) -> Log:
        __tracebackhide__ = True
        _artefacts.keep_diagram(system)
        log = run_diagram(system, *arguments, **keywords)
        _artefacts.logs.append(KeptLog("run", log))
        return log

    return simulate


@pytest.fixture
def check_diagram(_artefacts: Artefacts) -> Callable[..., Report]:
    """Let the doctor look at a diagram (or at a builder before Build) and fail with its report.

    check_diagram(diagram)                                  no errors and no warnings
    check_diagram(diagram, warnings=False)                  no errors
    check_diagram(diagram, allow={"offsets-differ"})        these codes are fine
    check_diagram(diagram, expected_delay=0.002)            from sensor to command [s]
    """

    def check(system: System | DiagramBuilder, **keywords: Any) -> Report:
        __tracebackhide__ = True
        from pydrake.systems.framework import System

        if isinstance(system, System):
            _artefacts.keep_diagram(system)
        return _check(system, **keywords)

    return check


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
