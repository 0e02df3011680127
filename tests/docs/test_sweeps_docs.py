"""docs/sweeps.md: the file it shows is a sweep. Its commands are run in `tests/docs/commands`."""

import re

from forcectl.sweeps.sweep_config import read_sweep
from tests.examples.pages import page_text

PAGE = page_text("sweeps.md")
BLOCKS = re.findall(r"^```(\w+)\n(.*?)^```$", PAGE, flags=re.MULTILINE | re.DOTALL)


def test_the_file_is_a_sweep(tmp_path):
    (text,) = [text for kind, text in BLOCKS if kind == "yaml"]
    (tmp_path / "mine.yaml").write_text(text, encoding="utf-8")
    config = read_sweep(tmp_path / "mine.yaml").config
    assert (config.title, config.design, config.trials) == ("Gains on soft and hard surfaces", "sobol", 64)
