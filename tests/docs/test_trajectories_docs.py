"""docs/trajectories.md says what is true."""

import re
from pathlib import Path

PAGE = (Path(__file__).parents[2] / "docs" / "trajectories.md").read_text(encoding="utf-8")


def test_the_examples_run_and_print_what_is_shown(capsys):
    namespace = {}
    for example in re.findall(r"^```python\n(.*?)^```", PAGE, re.DOTALL | re.MULTILINE):
        exec(compile(example, "docs/trajectories.md", "exec"), namespace)
    (shown,) = re.findall(r"^```text\n(.*?)^```", PAGE, re.DOTALL | re.MULTILINE)
    assert capsys.readouterr().out == shown
    assert namespace["controller"].tasks[1].leader == "left"
