"""What analyses of the user's put out: names of their own, of the kind asked for, of a log that stays as it is."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr
from matplotlib.figure import Figure

from forcectl.analysis.slot import check_figures, check_files, check_metrics, read_only
from forcectl.errors import RunFailedError

TAKEN = "which the run or another analysis returns already: must have a name of its own"
PLAIN = "its name must be 1 to 100 printable characters without '/', not beginning with a dot"


def log() -> xr.Dataset:
    time = np.arange(3.0)
    return xr.Dataset({"contact_force": ("time", np.zeros(3), {"units": "N"})}, {"time": time, "variant": "soft"})


@pytest.mark.parametrize(
    ("write", "refused"),
    [
        (lambda seen: seen["contact_force"].__setitem__(slice(None), 100.0), True),
        (lambda seen: seen["contact_force"].values.__setitem__(0, 100.0), True),
        (lambda seen: seen["time"].values.__setitem__(0, 100.0), True),
        (lambda seen: seen.__setitem__("contact_force", seen["contact_force"] + 1.0), False),
        (lambda seen: setattr(seen["contact_force"], "values", np.ones(3)), False),
        (lambda seen: seen["contact_force"].attrs.update(units="kN"), False),
        (lambda seen: seen.__delitem__("contact_force"), False),
    ],
)
def test_what_an_analysis_writes_into_the_log_is_seen_by_nobody(write: Callable[[Any], None], refused: bool) -> None:
    whole = log()
    seen = read_only(whole)
    assert np.shares_memory(seen["contact_force"].values, whole["contact_force"].values)
    if refused:
        with pytest.raises(ValueError, match=r"view|read-only"):
            write(seen)
    else:
        write(seen)
    assert whole.identical(log())
    whole["contact_force"][:] = 1.0  # whoever has the log itself may


@pytest.mark.parametrize(
    ("found", "told"),
    [
        ({"peak_N": 1.0}, f"analyses.mine returns metric 'peak_N', {TAKEN}"),
        ({"findings": 1.0}, f"analyses.mine returns metric 'findings', {TAKEN}"),
        ({3: 1.0}, "analyses.mine: metric 3: its name must be text, not int"),
        ({"a\nb": 1.0}, r"analyses.mine: metric 'a\nb': its name must be printable characters"),
        ({"a": "b"}, "analyses.mine: metric a = 'b': must be a number or None"),
    ],
)
def test_metrics_have_names_of_their_own_and_are_numbers(found: Mapping[Any, Any], told: str) -> None:
    with pytest.raises(RunFailedError) as error:
        check_metrics(found, ["peak_N"], "mine")
    assert str(error.value) == told


def test_a_metric_that_is_not_finite_is_none() -> None:
    found = check_metrics({"a": np.nan, "b": None, "c": np.int64(2), "d": True}, ["peak_N"], "mine")
    assert found == {"a": None, "b": None, "c": 2.0, "d": 1.0}


@pytest.mark.parametrize(
    ("found", "told"),
    [
        ({"../../evil": Figure()}, f"analyses.mine: figure '../../evil': {PLAIN}"),
        ({"/x": Figure()}, f"analyses.mine: figure '/x': {PLAIN}"),
        ({"..": Figure()}, f"analyses.mine: figure '..': {PLAIN}"),
        ({"": Figure()}, f"analyses.mine: figure '': {PLAIN}"),
        ({"Force": Figure()}, f"analyses.mine returns figure 'Force', {TAKEN}"),
        ({"one": Figure(), "ONE": Figure()}, f"analyses.mine returns figure 'ONE', {TAKEN}"),
        ({"one": 3}, "analyses.mine: figure 'one': must be a Figure of Matplotlib, not int"),
    ],
)
def test_figures_have_names_of_their_own_in_the_folder(found: Mapping[Any, Any], told: str) -> None:
    with pytest.raises(RunFailedError) as error:
        check_figures(found, ["force"], "mine")
    assert str(error.value) == told


@pytest.mark.parametrize(
    ("found", "told"),
    [
        ({"../x.csv": ""}, f"analyses.mine: file '../x.csv': {PLAIN}"),
        ({".hidden": ""}, f"analyses.mine: file '.hidden': {PLAIN}"),
        ({"log.nc": ""}, f"analyses.mine returns file 'log.nc', {TAKEN}"),
        ({"x.csv": b""}, "analyses.mine: file 'x.csv': must be text, not bytes"),
    ],
)
def test_files_have_names_of_their_own_in_the_folder(found: Mapping[Any, Any], told: str) -> None:
    with pytest.raises(RunFailedError) as error:
        check_files(found, ["log.nc"], "mine")
    assert str(error.value) == told


class Mine:
    """An analysis of the user's."""

    def __init__(self, metrics: Any = (), figures: Any = (), files: Any = ()):
        self.answers = {"metrics": dict(metrics), "figures": dict(figures), "files": dict(files)}

    def metrics(self, log: Any, setting: Any) -> Any:
        return self.answers["metrics"]

    def figures(self, log: Any, setting: Any, title: str) -> Any:
        return self.answers["figures"]

    def files(self, log: Any, setting: Any) -> Any:
        return self.answers["files"]


@pytest.mark.parametrize(
    ("answers", "told"),
    [
        ({"metrics": {"peak_force_N": 1e9}}, f"analyses.mine returns metric 'peak_force_N', {TAKEN}"),
        ({"figures": {"force": Figure()}}, f"analyses.mine returns figure 'force', {TAKEN}"),
        ({"figures": {"../../evil": Figure()}}, f"analyses.mine: figure '../../evil': {PLAIN}"),
        ({"files": {"metrics.json": "{}"}}, f"analyses.mine returns file 'metrics.json', {TAKEN}"),
        ({"files": {"../../evil.txt": ""}}, f"analyses.mine: file '../../evil.txt': {PLAIN}"),
    ],
)
def test_an_analysis_adds_to_a_run_and_writes_nothing_beside_it(
    tmp_path: Path, answers: dict[str, Any], told: str, request: pytest.FixtureRequest
) -> None:
    from forcectl.runs.run import run

    if "figures" not in answers:
        request.getfixturevalue("without_pictures")
    short = {"station": {"fidelity": "OneDimensional"}, "duration": 0.05, "analyses": {"mine": Mine(**answers)}}
    with pytest.raises(RunFailedError) as error:
        run(short, out=tmp_path / "folder" / "run")
    assert told in str(error.value)
    assert [path.name for path in tmp_path.rglob("*") if path.name.startswith("evil")] == []
    assert [path.name for path in (tmp_path / "folder").iterdir()] == ["run.failed"]
