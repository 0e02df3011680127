"""No file is read without an end."""

import pytest

from forcectl.errors import BadInputError
from forcectl.framework.files.series_file import read_series
from forcectl.framework.files.text_file import yaml_text
from forcectl.runs.records.columns import read_columns


@pytest.fixture
def endless(tmp_path):
    """A file of 200 GB that takes no room."""
    path = tmp_path / "own.csv"
    with path.open("wb") as file:
        file.truncate(200_000_000_000)
    return path


def test_of_a_long_yaml_file_no_more_is_read_than_refuses_it(endless):
    assert len(yaml_text(endless)) == 500_001


def test_a_table_that_is_too_large_is_refused_by_its_size(endless):
    with pytest.raises(BadInputError, match=r"own\.csv.*of up to 1 GB$"):
        read_series(str(endless), "time", "force")
    with pytest.raises(BadInputError, match=r"^cannot read own\.csv: it has more than 1 GB$"):
        read_columns(endless)
