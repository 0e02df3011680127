"""Two columns of a CSV file."""

import numpy as np
import pytest

from forcectl.errors import BadInputError
from forcectl.framework.files.series_file import read_series


def write(folder, text):
    path = folder / "series.csv"
    path.write_text(text, encoding="utf-8")
    return str(path)


def test_columns_come_in_any_order_with_others_between(tmp_path):
    along, value = read_series(write(tmp_path, "\ufeffv, remark, s\r\n2,a,-1\r\n\r\n3,b,1e1\r\n"), "s", "v")
    np.testing.assert_array_equal(along, [-1.0, 10.0])
    np.testing.assert_array_equal(value, [2.0, 3.0])


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("", "has columns None: must have s and v"),
        ("s,w\n0,0\n", "must have s and v"),
        ("s [mm],v [N]\n0,0\n1,1\n", "must have s and v, named without a unit: they are in SI units"),
        ("s,v\n", "has 0 rows: must have at least 2"),
        ("s,v\n0,0\n1,1_0\n", "line 3: s = '1', v = '1_0': must be finite numbers"),
        ("s,v\n0,0\n1,x\n", "line 3: s = '1', v = 'x': must be finite numbers"),
        ("s,v\n0,inf\n1,1\n", "line 2"),
        ("s,v\n0,0\n1\n", "line 3: s = '1', v = None"),
        ("s,v,s\n0,0,0\n1,1,1\n", "has the column 's' twice: must have it once"),
        ("s,v\n0,0\n1,1,7\n", "line 3 has more: must have 2 columns, as in its first line"),
        ("s,v\n0,0\n0,1\n", "line 3: s = 0: must be above the last one"),
    ],
)
def test_what_cannot_be_read_is_refused_in_one_line(tmp_path, text, told):
    with pytest.raises(BadInputError, match=r"path = .*series\.csv") as caught:
        read_series(write(tmp_path, text), "s", "v")
    assert told in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_file_that_does_not_exist_or_is_no_text_is_refused(tmp_path):
    with pytest.raises(BadInputError, match="existing CSV file with the columns s and v"):
        read_series("nowhere.csv", "s", "v")
    (tmp_path / "b.csv").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(BadInputError, match="readable CSV file in UTF-8"):
        read_series(str(tmp_path / "b.csv"), "s", "v")
