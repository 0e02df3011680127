"""docs/notebook.md says what is true: its Python runs, and objects show themselves without a notebook being there."""

import pytest

from tests.examples.pages import blocks, page_text, run_python

PNG = b"\x89PNG\r\n\x1a\n"


@pytest.mark.slow
def test_its_python_runs(capsys):
    names = run_python("notebook.md")
    (shown,) = blocks(page_text("notebook.md"), "text")
    assert capsys.readouterr().out == shown
    result, trials = names["result"], names["trials"]
    assert result.metric("peak_force_N") is not None
    assert result.plot()._repr_png_().startswith(PNG)
    assert "peak_force_N" in result._repr_html_()
    assert repr(trials) == "<sweep of 2 trials: 2 done>"
    assert "<td>done</td>" in trials._repr_html_()


def test_the_changed_gain_is_that_of_the_law():
    import forcectl as fc

    loop = fc.build("fig_2_8", fidelity="OneDimensional")
    law = loop.diagram.GetSubsystemByName("controller").GetSubsystemByName("force_law")
    context = law.CreateDefaultContext()
    assert law.parameter(context, "integral_gain") == 1.5
    assert repr(loop).startswith("<loop of ")
    assert "measured_force" in repr(loop)
    assert " object at " not in repr(loop)
