"""docs/trajectories.md says what is true."""

from tests.examples.pages import blocks, page_text, run_python

PAGE = page_text("trajectories.md")


def test_the_examples_run_and_print_what_is_shown(capsys):
    namespace = run_python("trajectories.md")
    assert [capsys.readouterr().out] == blocks(PAGE, "text")
    assert namespace["controller"].tasks[1].leader == "left"
