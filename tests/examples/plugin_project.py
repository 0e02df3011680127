"""A user's project in a folder of its own, in which pytest runs with our plugin and no other one.

Pytester forgets every module that its inner run imports. Extension modules cannot be loaded twice, and XArray looks for
its engines once: all of them must have been loaded before.
"""

from pathlib import Path

import h5netcdf
import pydrake.examples
import pydrake.multibody.parsing
import pydrake.systems.controllers
import scipy.signal
import xarray

import forcectl.doctor
import forcectl.testing
import forcectl.testing.golden.check
import forcectl.testing.golden.picture

FOLDER = Path(__file__).parent
LOADED = [
    h5netcdf,
    pydrake.examples,
    pydrake.multibody.parsing,
    pydrake.systems.controllers,
    scipy.signal,
    forcectl.doctor.examine,
    forcectl.testing.golden.check,
    forcectl.testing.golden.picture.FigureCanvasAgg,
    bytes(xarray.Dataset({"x": ("t", [0.0])}).to_netcdf(engine="h5netcdf")),
    *(getattr(forcectl.testing, name) for name in forcectl.testing.__all__),
]


def prepared(pytester, monkeypatch):
    """The folder, for a run at somebody's desk."""
    monkeypatch.setenv("PYTEST_DISABLE_PLUGIN_AUTOLOAD", "1")
    monkeypatch.delenv("CI", raising=False)
    pytester.syspathinsert()
    return pytester


def run(project, *options):
    """Run its tests in this process."""
    return project.runpytest_inprocess("-p", "forcectl.testing.plugin", *options)
