"""Names of a package that its stub lists: found on first use, and no others."""

import os.path

import pytest

from forcectl.framework.lazy import lazy_names


def test_names_are_those_of_the_stub_long_lines_included(tmp_path):
    (tmp_path / "__init__.pyi").write_text(
        "from json import dumps as dumps\nfrom os.path import (\n    join as join,\n)\n\nanswer: int\n"
    )
    get, names = lazy_names("somewhere", str(tmp_path / "__init__.py"))
    assert names() == ["dumps", "join"]
    assert get("join") is os.path.join
    with pytest.raises(AttributeError, match="no attribute 'answer'"):
        get("answer")
