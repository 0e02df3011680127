"""The code of the page on reactive control runs and prints what is printed there."""

import pytest

from tests.examples.pages import blocks, page_text, run_python


@pytest.mark.slow
def test_the_example_prints_what_the_page_says(capsys: pytest.CaptureFixture[str]) -> None:
    run_python("reactive_control.md")
    assert [capsys.readouterr().out] == blocks(page_text("reactive_control.md"), "text")
