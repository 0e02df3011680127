"""The command line, called in this process."""

from typing import Any

import pytest

from forcectl import cli


def call_here(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str], *arguments: object
) -> tuple[Any, Any]:
    """Exit code, and what it printed."""
    monkeypatch.setattr("sys.argv", ["forcectl", *map(str, arguments)])
    with pytest.raises(SystemExit) as stopped:
        cli.main()
    return stopped.value.code, capfd.readouterr()
