"""Recorded experiments: units and signs on the way in, and every fault of a record named by row or column."""

import h5py
import numpy as np
import pytest
from scipy.signal import lfilter

from forcectl.errors import BadInputError
from forcectl.runs.records.recorded import read_record
from tests.examples.vrft_records import TS, contact, trapezoidal_moves

U = trapezoidal_moves()
Y = lfilter(*contact(5.9e3, (75.4, 12.6, 12.6), 3), U)
TIME = TS * np.arange(U.size)


def write(folder, columns, name="data.csv", separator=","):
    """A CSV file of columns {header: values}."""
    path = folder / name
    rows = np.column_stack(list(columns.values()))
    lines = [separator.join(columns), *(separator.join(f"{v:.12g}" for v in row) for row in rows)]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def good(**changes):
    columns = {"time [s]": TIME.copy(), "displacement [m]": U.copy(), "force [N]": Y.copy()}
    return columns | changes


def test_si_columns_are_taken_as_they_are(tmp_path):
    record = read_record(write(tmp_path, good()))
    assert record.period == pytest.approx(TS, rel=1e-9)
    assert record.resting >= 100
    np.testing.assert_allclose(record.u, U, atol=1e-15)
    np.testing.assert_allclose(record.y, Y, atol=1e-10)
    np.testing.assert_allclose(record.time, TIME, atol=1e-9)


@pytest.mark.parametrize(
    ("time", "length", "force"),
    [
        (("ms", 1e3), ("mm", 1e3), ("kN", 1e-3)),
        (("us", 1e6), ("um", 1e6), ("mN", 1e3)),
        (("min", 1 / 60), ("in", 1 / 0.0254), ("lbf", 1 / 4.4482216152605)),
    ],
)
def test_other_units_and_orders_are_converted(tmp_path, time, length, force):
    columns = {
        f"Force [{force[0]}]": force[1] * Y,
        "temperature": np.full(U.size, 20.0),
        f"Displacement [{length[0]}]": length[1] * U,
        f"Time [{time[0]}]": time[1] * TIME,
    }
    record = read_record(write(tmp_path, columns, separator=";"))
    assert record.period == pytest.approx(TS, rel=1e-6)
    np.testing.assert_allclose(record.u, U, atol=1e-12)
    np.testing.assert_allclose(record.y, Y, atol=1e-8)


def test_values_at_rest_are_taken_off_and_times_may_begin_anywhere(tmp_path):
    noise = 0.05 * np.random.default_rng(0).normal(size=Y.size)
    columns = {"time [s]": TIME + 1e3, "displacement [m]": U - 2e-3, "force [N]": Y + 5.0 + noise}
    record = read_record(write(tmp_path, columns))
    assert record.u_rest == pytest.approx(-2e-3)
    assert record.y_rest == pytest.approx(5.0, abs=0.02)  # the mean of the rest, not the noise of the first sample
    np.testing.assert_allclose(record.u, U, atol=1e-12)


def test_columns_can_be_named_and_displacements_turned_round(tmp_path):
    columns = good(**{"pressing depth [mm]": -1e3 * U, "gauge [N]": 2 * Y})
    record = read_record(
        write(tmp_path, columns), input_column="pressing depth", output_column="gauge", flip_input=True
    )
    assert (record.input_name, record.output_name) == ("pressing depth [mm]", "gauge [N]")
    np.testing.assert_allclose(record.u, U, atol=1e-12)
    np.testing.assert_allclose(record.y, 2 * Y, atol=1e-8)


def test_small_jitter_of_the_clock_is_no_fault(tmp_path):
    jitter = 0.01 * TS * np.random.default_rng(1).uniform(-1, 1, size=TIME.size)
    assert read_record(write(tmp_path, good(**{"time [s]": TIME + jitter}))).period == pytest.approx(TS, rel=1e-5)


def without(rows):
    return {name: np.delete(values, rows) for name, values in good().items()}


def changed(name, row, value):
    columns = good()
    columns[name][row] = value
    return columns


def renamed(old, new):
    return {new if name == old else name: values for name, values in good().items()}


@pytest.mark.parametrize(
    ("columns", "words"),
    [
        # row k of the data is row k + 2 of the file: one header, counted from one
        (without([50]), r"row 52: 1 row is missing before it.*after row 51.*period of 0\.002"),
        (without([700, 701, 702, 900]), r"row 702: 3 rows are missing before it.*\(2 such gaps\)"),
        (changed("force [N]", 100, np.nan), r"row 102, column force \[N\]: empty or not a number"),
        (changed("displacement [m]", 100, np.inf), r"row 102, column displacement \[m\]"),
        (changed("time [s]", 100, np.nan), r"row 102, column time \[s\]"),
        (changed("time [s]", 100, TIME[99]), "row 102: the same time as row 101"),
        (changed("time [s]", 100, TIME[97]), "row 102: an earlier time than row 101"),
        (changed("time [s]", 100, TIME[100] + 0.2 * TS), "row 102: .* the others 0.002 s: sampling must be regular"),
        (
            changed("time [s]", 100, 1e300),
            r"row 102: a time of 1e\+300 s is implausible: must be at most 1e\+10",
        ),
        (good(**{"time [s]": 1e300 * TIME}), r"row 3: a time of 2e\+297 s is implausible"),
        (good(**{"time [s]": 1e-9 * TIME}), "a period of 2e-12 s is implausible: must be at least 1e-06 s"),
        (good(**{"displacement [m]": np.full(U.size, 0.5)}), r"displacement \[m\] is constant at 0.5.*must move it"),
        (good(**{"force [N]": np.zeros(U.size)}), r"force \[N\] is constant at 0.*is there contact"),
        (good(**{"force [N]": np.minimum(Y, 15.0)}), r"force \[N\]: is constant at 15 .*saturated"),
        # no contact before the tool has moved 1.4 mm, nor at the end
        (good(**{"force [N]": np.maximum(Y - 8.0, 0.0)}), r"force \[N\]: is constant at 0 .*contact is lost"),
        (good(**{"force [N]": -np.minimum(Y, 15.0)}), "saturated"),
        ({name: values[:80] for name, values in good().items()}, "has 80 rows: must have at least 100"),
        (renamed("force [N]", "force"), r"'force' has no unit: write it in the header, as in 'force \[N\]'"),
        (renamed("time [s]", "time"), r"'time' has no unit.*'time \[s\]'"),
        (renamed("force [N]", "force [V]"), "unit 'V': must be one of force, N, kN"),
        (renamed("displacement [m]", "displacement [N]"), "must be one of displacement, m, cm"),
        (renamed("displacement [m]", "way [m]"), r"no column of displacement: has time \[s\], way \[m\], force \[N\]"),
        (renamed("time [s]", "clock [s]"), "no column of time"),
    ],
)
def test_faults_are_named_by_row_or_column_with_what_to_do(tmp_path, columns, words):
    path = write(tmp_path, columns)
    with pytest.raises(BadInputError, match=words) as caught:
        read_record(path)
    assert "\n" not in str(caught.value)
    assert str(caught.value).startswith("data.csv")


def test_a_reading_that_stands_alone_is_told_with_its_row(tmp_path):
    spiked = Y.copy()
    spiked[1500] = 300.0
    with pytest.raises(BadInputError, match=r"data.csv row 1502, column force \[N\]: 300 is an outlier between"):
        read_record(write(tmp_path, good(**{"force [N]": spiked})))


def test_metres_that_are_called_millimetres_move_nothing(tmp_path):
    columns = {"time [s]": TIME, "displacement [mm]": U, "force [N]": Y}
    with pytest.raises(BadInputError, match=r"displacement \[mm\] moves by 4e-06 m in all: must be at least 1e-05 m"):
        read_record(write(tmp_path, columns))


def test_quantised_steps_after_long_rests_are_not_taken_for_saturation(tmp_path):
    u = -1e-3 * np.repeat([0.0, 1.0, 2.0, 1.0, 2.0, 0.0], 1500)
    y = np.round(lfilter(*contact(5.9e3, (12.6, 12.6), 30), u) / 0.05) * 0.05
    columns = {"time [s]": TS * np.arange(u.size), "displacement [m]": u, "force [N]": y}
    assert read_record(write(tmp_path, columns)).u.size == u.size


def test_damaged_files_are_refused_in_one_line_or_read(tmp_path):
    text = write(tmp_path, {name: values[:400] for name, values in good().items()}).read_text()
    rng = np.random.default_rng(0)
    pieces = [
        "nan",
        "inf",
        "",
        '"',
        ",",
        ";",
        "\t",
        "1e400",
        "-",
        "\n",
        "[",
        "mm",
        "\x00",
        "é",
        "#",
        "1_000",
        "time [s]",
        "\r",
    ]
    messages = []
    for _ in range(150):
        damaged = text
        for _ in range(rng.integers(1, 4)):
            place = rng.integers(0, len(damaged) if rng.random() < 0.6 else 60)
            piece = pieces[rng.integers(len(pieces))]
            damaged = damaged[:place] + piece + damaged[place + rng.integers(0, 20) :]
        (tmp_path / "damaged.csv").write_text(damaged, encoding="utf-8")
        try:
            record = read_record(tmp_path / "damaged.csv")
        except BadInputError as error:
            messages.append(str(error))
        else:
            assert np.isfinite(record.u).all()
            assert np.isfinite(record.y).all()
    assert len(messages) > 75
    assert not any("\n" in message for message in messages)


def test_a_number_out_of_all_proportion_is_named_by_its_row(tmp_path):
    force = Y.copy()
    force[5000] = 1e300
    with pytest.raises(BadInputError, match=r"row 5002, column force \[N\]: 1e\+300 is implausible as a force"):
        read_record(write(tmp_path, good(**{"force [N]": force})))
    kilo = {"force [N]": 1e3 * Y}
    with pytest.raises(BadInputError, match=r"is implausible as a force: must be at most 10000 N"):
        read_record(write(tmp_path, good(**kilo)))


def test_the_rests_show_the_stiffness_whatever_the_lags(tmp_path):
    assert read_record(write(tmp_path, good())).gain_at_rest == pytest.approx(-5.9e3, rel=1e-3)
    wave = 1e-3 * (np.cos(3 * TIME) - 1)
    waves = write(tmp_path, good(**{"displacement [m]": wave, "force [N]": -5.9e3 * wave}))
    assert read_record(waves).gain_at_rest is None


def test_one_column_cannot_be_both(tmp_path):
    with pytest.raises(BadInputError, match="both"):
        read_record(write(tmp_path, good()), input_column="force")


def test_a_record_without_end_is_refused(tmp_path):
    """Compressed values that were never written: a few kilobytes."""
    with h5py.File(tmp_path / "log.nc", "w") as file:
        for name, unit in (("time", "s"), ("displacement", "m"), ("force", "N")):
            values = file.create_dataset(name, (5_000_001,), "f8", chunks=(1_000_000,), compression="gzip")
            values.attrs["units"] = unit
            values.make_scale() if name == "time" else values.dims[0].attach_scale(file["time"])
    with pytest.raises(BadInputError, match=r"^log\.nc has 5000001 rows: must have at most 5000000; cut the record"):
        read_record(tmp_path / "log.nc")
