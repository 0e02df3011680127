"""Tables of numbers from files: any order, any of three separators, and which cell is wrong."""

import h5py
import numpy as np
import pytest
import xarray as xr

from forcectl.errors import BadInputError
from forcectl.runs.records.columns import read_columns


def write(folder, text, name="data.csv"):
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return path


@pytest.mark.parametrize(
    "text",
    [
        "time [s],force [N]\n0.0,1.5\n0.5,2.5\n",
        "\ufefftime [s],force [N]\r\n0.0,1.5\r\n0.5,2.5\r\n",
        "# exported\ntime [s]; force [N]\n0,0; 1,5\n0,5; 2,5\n",
        "time (s)\tforce (N)\n0.0\t1.5\n\n0.5\t2.5\n\n",
        'time [s],"force [N]"\n"0.0","1.5"\n"0.5","2.5"\n',
    ],
)
def test_headers_separators_and_blank_lines(tmp_path, text):
    table = read_columns(write(tmp_path, text))
    assert {name: column.unit for name, column in table.columns.items()} == {"time": "s", "force": "N"}
    np.testing.assert_array_equal(table.columns["time"].values, [0.0, 0.5])
    np.testing.assert_array_equal(table.columns["force"].values, [1.5, 2.5])


def test_rows_are_called_by_their_line_in_the_file(tmp_path):
    table = read_columns(write(tmp_path, "# a remark\ntime [s],a\n\n0,1\n1,\n"))
    assert (table.row(0), table.row(1)) == ("row 4", "row 5")
    assert np.isnan(table.columns["a"].values[1])


def test_columns_are_found_by_any_writing_of_their_name(tmp_path):
    table = read_columns(write(tmp_path, "Time [s],Measured Force [N],x\n0,1,2\n1,2,3\n"))
    assert table.find(None, ("force", "measured_force"), "force").label == "Measured Force [N]"
    assert table.find("measured-force", (), "force").name == "Measured Force"
    with pytest.raises(BadInputError, match="no column of displacement: has Time"):
        table.find(None, ("displacement",), "displacement")
    with pytest.raises(BadInputError, match="did you mean 'Measured Force'"):
        table.find("measured forse", (), "force")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "empty"),
        ("time [s],force [N]\n", "no rows"),
        ("0.0,1.0\n0.1,2.0\n", "no header"),
        ("a,b\n1,2\n3\n", "row 3 has 1 cells: must have 2, as the header, with commas between$"),
        ("a,b\n0,0,1,5\n", "row 2 has 4 cells: must have 2, .*; numbers with decimal commas need semicolons or tabs"),
        ("a,b\n1,2\n" + "3" * 200_000 + "\n", "row 3 has 1 cells"),
        ("a,b\n1,2,3\n4,5,6\n", "row 2 has 3 cells: must have 2"),
        ("a [N],A [N]\n1,2\n", "two columns called 'A'"),
    ],
)
def test_what_is_wrong_with_a_table(tmp_path, text, words):
    with pytest.raises(BadInputError, match=words) as caught:
        read_columns(write(tmp_path, text))
    assert str(caught.value).startswith("data.csv")


@pytest.mark.parametrize("separator", [";", "\t"])
def test_decimal_commas_where_no_comma_separates(tmp_path, separator):
    def table(*rows):
        return read_columns(write(tmp_path, "".join(f"{separator.join(row)}\n" for row in rows)))

    # Commas in the header outnumber the separators; a date is no number with a decimal point.
    for header in ("a", "a, of two, with three commas"):
        found = table((header, "b", "day"), ("0,25", "-1", "01.02.2026"), ("1e-3", "2,5", "02.02.2026"))
        np.testing.assert_array_equal(found.find(header, (), "force").values, [0.25, 1e-3])
        np.testing.assert_array_equal(found.find("b", (), "force").values, [-1.0, 2.5])
    with pytest.raises(BadInputError, match=r"row 3, column a: '1\.234,5' must be a number"):
        table(("a", "b"), ("0,25", "1"), ("1.234,5", "2")).find("a", (), "force")
    with pytest.raises(BadInputError, match=r"row 3, column a: '1,234' must be a number"):
        table(("a", "b"), ("0.25", "1"), ("1,234", "2")).find("a", (), "force")


def test_a_missing_column_is_told_with_what_can_be_done(tmp_path):
    table = read_columns(write(tmp_path, "Zeit [s],Weg [mm]\n0,1\n"))
    with pytest.raises(BadInputError, match=r"name one time or t$"):  # no option names it
        table.find(None, ("time", "t"), "time")
    with pytest.raises(BadInputError, match=r"name one x, or say with --input which it is$"):
        table.find(None, ("x",), "displacement")
    with pytest.raises(BadInputError, match=r"name one y, or say with --output .*must be semicolons, tabs, commas$"):
        read_columns(write(tmp_path, "x [m]|y [N]\n0|1\n")).find(None, ("y",), "force")


def test_words_matter_only_in_a_column_that_is_used(tmp_path):
    table = read_columns(write(tmp_path, "a,note,b\n1,start,2\n3,,four\n5,end,five\n"))
    np.testing.assert_array_equal(table.find("a", (), "force").values, [1.0, 3.0, 5.0])
    with pytest.raises(BadInputError, match=r"data\.csv row 3, column b: 'four' must be a number"):
        table.find("b", (), "force")
    table = read_columns(write(tmp_path, "a,b\n1,2\n1_0,3\n"))
    with pytest.raises(BadInputError, match=r"data\.csv row 3, column a: '1_0' must be a number"):
        table.find("a", (), "force")
    table = read_columns(write(tmp_path, "a,b\n1,2\n\u0661,3\n"))  # a digit, but of no keyboard of a laboratory's
    with pytest.raises(BadInputError, match=r"data\.csv row 3, column a: '\u0661' must be a number"):
        table.find("a", (), "force")


def test_a_force_that_is_text_in_a_log_is_not_passed_over_for_another_one(tmp_path):
    words = xr.Dataset({"measured_force": ("time", ["a", "b"]), "force": ("time", [1.0, 2.0])}, {"time": [0.0, 1.0]})
    words.to_netcdf(tmp_path / "log.nc", engine="h5netcdf")
    table = read_columns(tmp_path / "log.nc")
    with pytest.raises(BadInputError, match=r"log\.nc variable measured_force has values of type .*: must be numbers"):
        table.find(None, ("measured_force", "force"), "force")


def test_files_that_are_no_tables(tmp_path):
    with pytest.raises(BadInputError, match="does not exist"):
        read_columns(tmp_path / "none.csv")
    with pytest.raises(BadInputError, match="is a folder"):
        read_columns(tmp_path)
    (tmp_path / "bytes.csv").write_bytes(b"\xff\xfe\x00\x01")
    with pytest.raises(BadInputError, match="not UTF-8"):
        read_columns(tmp_path / "bytes.csv")
    with pytest.raises(BadInputError, match=r"cannot read words\.nc as NetCDF"):
        read_columns(write(tmp_path, "no data", "words.nc"))
    with pytest.raises(BadInputError, match="--variant 'a'"):
        read_columns(write(tmp_path, "a\n1\n"), "a")


def test_hdf5_without_dimensions_is_one_line_without_warnings_of_libraries(tmp_path, recwarn):
    with h5py.File(tmp_path / "log.nc", "w") as file:
        file["time"], file["force"] = np.arange(100) * 0.01, np.zeros((100, 2))
        file["force"].attrs["_FillValue"], file["force"].attrs["missing_value"] = 1.0, 2.0
    with pytest.raises(BadInputError, match=r"^log\.nc has no dimension 'time': must be the log of a run$"):
        read_columns(tmp_path / "log.nc")
    assert not recwarn.list


def test_a_netcdf_file_whose_data_lie_elsewhere_is_refused(tmp_path):
    with h5py.File(tmp_path / "log.nc", "w") as file:
        file.create_dataset("force", (10,), "f8", external=[(str(tmp_path / "secret"), 0, 80)])
    with pytest.raises(BadInputError, match=r"^log\.nc: variable 'force' is data of another file"):
        read_columns(tmp_path / "log.nc")


def test_a_damaged_netcdf_file_is_one_line_and_nothing_else(tmp_path, capfd):
    """Wrong bytes anywhere: HDF5, h5netcdf and xarray each raise errors of their own, and print some."""
    time = np.arange(200) * 0.01
    data = {"force": ("time", np.sin(time), {"units": "N"}), "u": ("time", np.cos(time), {"units": "m"})}
    content = bytes(xr.Dataset(data, {"time": ("time", time, {"units": "s"})}).to_netcdf(engine="h5netcdf"))
    random = np.random.default_rng(3)
    said = []
    for _ in range(12):
        wrong = bytearray(content)
        for place in random.integers(0, len(wrong), 40):
            wrong[place] = random.integers(256)
        (tmp_path / "log.nc").write_bytes(wrong)
        try:
            read_columns(tmp_path / "log.nc")
        except BadInputError as error:
            said.append(str(error))
    assert len(said) > 2
    assert not any("\n" in line for line in said)
    assert capfd.readouterr().err == ""
