"""Progress bars are for terminals."""

from forcectl.cli.sweep import _Display
from forcectl.runs.terminal.progress import ProgressBars
from forcectl.sweeps.at_work import SweepProgress


def test_a_pipe_gets_no_bars_even_if_colours_are_forced(monkeypatch, capsys):
    monkeypatch.setenv("FORCE_COLOR", "1")
    with ProgressBars() as bars:
        bars.stage("building")
        bars.show("default", 0.5)
    with _Display(quiet=False) as display:
        display.show(SweepProgress(done=1, total=2, failed=0, lost=0))
    assert "\x1b" not in capsys.readouterr().err
