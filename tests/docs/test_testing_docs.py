"""The examples of docs/testing.md are a test file that passes in a folder of its own."""

import re
from pathlib import Path

import pytest
import scipy.signal

import forcectl.doctor
import forcectl.testing

pytest_plugins = ["pytester"]

# See test_testing_plugin.py: extension modules must be loaded before pytester takes its snapshot.
LOADED = [scipy.signal, forcectl.doctor, *(getattr(forcectl.testing, name) for name in forcectl.testing.__all__)]

PAGE = (Path(__file__).parents[2] / "docs" / "testing.md").read_text(encoding="utf-8")


def examples():
    return "\n\n".join(re.findall(r"^```python\n(.*?)^```$", PAGE, re.DOTALL | re.MULTILINE))


def test_the_page_passes(pytester, monkeypatch):
    monkeypatch.setenv("PYTEST_DISABLE_PLUGIN_AUTOLOAD", "1")
    pytester.makepyfile(test_page=examples())
    pytester.runpytest_inprocess("-p", "forcectl.testing.plugin").assert_outcomes(passed=4)


@pytest.mark.parametrize("name", [name for name in forcectl.testing.__all__ if name.startswith("assert_")])
def test_every_assertion_is_shown(name):
    assert f"{name}(" in examples()
