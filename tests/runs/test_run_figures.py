"""Figures: what they show, and that the same log gives the same files."""

import numpy as np
import pytest
import xarray as xr
from matplotlib.colors import to_hex
from matplotlib.image import imread

from forcectl.analysis.findings.finding import finding
from forcectl.figures.force import COLOURS, error_figure, force_figure, run_figures, write_figures
from forcectl.figures.targets import ForceTarget


def log(variants=("slow", "fast"), model=True):
    t = np.linspace(0, 5, 501)
    parts = []
    for i, name in enumerate(variants, start=1):
        force = 15 * (1 - np.exp(-i * t))
        data = {"desired_force": ("time", np.full_like(t, 15.0)), "measured_force": ("time", force)}
        if model:
            data["model_force"] = ("time", 0.95 * force)
        parts.append(xr.Dataset(data, coords={"time": t, "variant": name}))
    return parts[0] if len(parts) == 1 else xr.concat(parts, dim="variant")


def lines(figure):
    return figure.axes[0].get_lines()


@pytest.mark.parametrize("make", [force_figure, error_figure])
def test_no_two_of_many_variants_look_alike(make):
    figure = make(log([f"v{i}" for i in range(16)]))
    shown = [line for line in lines(figure) if len(line.get_xdata()) > 2 and line.get_linewidth() > 1.5]
    looks = {(line.get_color(), str(line._unscaled_dash_pattern)) for line in shown}
    assert len(shown) == len(looks) == 16


@pytest.mark.parametrize("make", [force_figure, error_figure])
def test_a_variant_with_a_longer_period_is_a_curve_without_gaps(make):
    fine, coarse = (log().sel(variant=name) for name in ("slow", "fast"))
    both = xr.concat([fine, coarse.isel(time=slice(None, None, 2))], dim="variant", join="outer")
    of_coarse = [line for line in lines(make(both)) if line.get_color() == COLOURS[1]]
    assert of_coarse
    for line in of_coarse:
        assert len(line.get_xdata()) == 251
        assert np.isfinite(line.get_ydata()).all()


def test_force_shows_every_variant_its_model_dashed_and_the_reference_once():
    figure = force_figure(log(), "A title")
    axes = figure.axes[0]
    assert axes.get_title(loc="left") == "A title"
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("time [s]", "force [N]")
    labels = [text.get_text() for text in axes.get_legend().get_texts()]
    assert labels == ["reference", "within 5 % and 2 %", "slow", "fast", "reference model"]
    solid = [line for line in lines(figure) if line.get_color() == COLOURS[0]]
    assert [line.is_dashed() for line in solid] == [False, True]
    np.testing.assert_allclose(solid[0].get_ydata(), log()["measured_force"].sel(variant="slow"))


def test_findings_are_marked_at_their_times_in_the_colour_of_their_variant():
    found = {
        "fast": [finding("limit_cycle", "swings", 2.0), finding("not_settled", "off", 5.0)],
        "gone": [finding("held", "", 1)],
    }
    axes = force_figure(log(), findings=found).axes[0]
    marks = [line for line in axes.get_lines() if line.get_marker() == "^"]
    assert [(mark.get_xdata()[0], mark.get_color()) for mark in marks] == [(2.0, COLOURS[1]), (5.0, COLOURS[1])]
    assert [text.get_text() for text in axes.texts] == ["limit cycle", "not settled"]
    many = {"slow": [finding("held", "", 0.1 * k) for k in range(20)]}
    axes = force_figure(log(), findings=many).axes[0]
    assert len([line for line in axes.get_lines() if line.get_marker() == "^"]) == 20
    assert not axes.texts


def bands(figure):
    """Corners of the bands: begin, lowest, end, highest."""
    boxes = [collection.get_paths()[0].get_extents() for collection in figure.axes[0].collections]
    return [(box.x0, box.y0, box.x1, box.y1) for box in boxes]


def test_a_force_that_is_held_has_its_bands_and_one_that_moves_has_none():
    steps = log()
    steps["desired_force"] = steps["desired_force"].where(steps["time"] < 3.0, 20.0).where(steps["time"] < 4.9, 0.0)
    found = bands(force_figure(steps))
    assert found == [
        pytest.approx(each)
        for each in [(0, 14.25, 2.99, 15.75), (0, 14.7, 2.99, 15.3), (3, 19, 4.89, 21), (3, 19.6, 4.89, 20.4)]
    ]
    sine = log()
    sine["desired_force"] = sine["desired_force"] + 5 * np.sin(sine["time"])
    assert bands(force_figure(sine)) == []
    assert "within" not in str(legend(force_figure(sine)))


def test_targets_are_marked_in_the_colour_of_their_variant_with_what_is_allowed():
    targets = [
        ForceTarget("slow", 2.0, 14.0, 15.0, 14.6),
        ForceTarget("fast", 3.0, None, 17.0),
        ForceTarget("no", 1, 1, 2),
    ]
    figure = force_figure(log(), targets=targets)
    bars = [c for c in figure.axes[0].containers if len(c.get_children())]
    assert len(bars) == 2
    (segment,) = bars[0].lines[2][0].get_segments()
    np.testing.assert_allclose(segment, [(2.0, 14.0), (2.0, 15.0)])
    assert to_hex(bars[0].lines[2][0].get_color()[0]) == COLOURS[0].lower()
    assert max(point[1] for point in bars[1].lines[2][0].get_segments()[0]) == 17.0
    labels = [text.get_text() for text in figure.legends[0].get_texts()]
    assert labels[-2:] == ["target: allowed force", "published force"]
    assert not force_figure(log(), targets=targets[2:]).axes[0].containers


def test_error_is_force_less_model():
    (zero, slow, fast) = lines(error_figure(log()))
    assert zero.get_ydata() == [0.0, 0.0]
    np.testing.assert_allclose(fast.get_ydata(), 0.05 * log()["measured_force"].sel(variant="fast"))
    assert slow.get_color() != fast.get_color()


def test_a_single_variant_and_a_log_without_model(tmp_path):
    written = write_figures(run_figures(log(("only",), model=False)), tmp_path)
    assert {path.name for path in written} == {"force.svg", "force.png"}


def legend(figure):
    found = figure.axes[0].get_legend()
    return found and [text.get_text() for text in found.get_texts()]


def test_the_run_of_a_scenario_without_variants_is_called_by_what_is_shown():
    figures = run_figures(log(("default",)))
    assert legend(figures["force"]) == ["reference", "within 5 % and 2 %", "measured force", "reference model"]
    assert legend(figures["model_error"]) is None


@pytest.mark.parametrize("make", [force_figure, error_figure])
def test_a_curve_over_another_one_lets_it_be_seen(make):
    close = log(("slow", "same", "fast"))
    for name in ("measured_force", "model_force"):
        close[name].loc[{"variant": "same"}] = 1.001 * close[name].sel(variant="slow").values
    shown = {line.get_label(): line.is_dashed() for line in lines(make(close)) if line.get_linewidth() > 1.5}
    assert shown == {"slow": False, "same": True, "fast": False}


def test_a_variant_without_a_reference_model_has_no_error():
    some = log()
    some["model_force"] = some["model_force"].where(some["variant"] != "fast")
    assert legend(error_figure(some)) == ["slow"]


def test_a_reference_model_that_rests_while_the_loop_is_open_is_not_drawn():
    excited = log(("default",))
    excited["desired_force"] *= 0.0
    excited["model_force"] *= 0.0
    figures = run_figures(excited)
    assert set(figures) == {"force"}
    assert legend(figures["force"]) == ["reference", "measured force"]
    shorter = excited.isel(time=slice(200)).assign_coords(variant="shorter")  # filled up with NaN beside the other one
    assert set(run_figures(xr.concat([excited, shorter], dim="variant", join="outer"))) == {"force"}


@pytest.mark.slow
def test_the_same_log_gives_the_same_files_and_a_readable_picture(tmp_path):
    first, second = (write_figures(run_figures(log(), "T"), tmp_path / name) for name in ("a", "b"))
    assert [path.name for path in first] == ["force.svg", "force.png", "model_error.svg", "model_error.png"]
    for one, other in zip(first, second, strict=True):
        assert one.read_bytes() == other.read_bytes()
    picture = imread(tmp_path / "a" / "force.png")
    assert picture.shape[0] >= 600
    assert picture.shape[1] >= 1000
    # The curves are there: pixels in the colour of the first variant.
    colour = np.array([int(COLOURS[0][i : i + 2], 16) / 255 for i in (1, 3, 5)])
    assert (np.abs(picture[..., :3] - colour).max(axis=-1) < 0.02).sum() > 500


@pytest.mark.slow
def test_names_are_drawn_as_they_are_written(tmp_path):
    assert write_figures(run_figures(log(("costs $5", r"$\frac{1}{$", "_x", "")), r"$\nonsense{$"), tmp_path)


@pytest.mark.parametrize(("count", "legend"), [(3, "inside"), (7, "beside"), (15, None)])
def test_many_variants_still_draw(tmp_path, count, legend):
    """A legend stands beside the curves when it would hide them, and is left out when nobody could follow it."""
    figure = force_figure(log(tuple(f"v{i}" for i in range(count))))
    assert len(lines(figure)) >= 2 * count
    assert (figure.axes[0].get_legend() is not None) == (legend == "inside")
    assert [len(one.get_texts()) >= count for one in figure.legends] == ([True] if legend == "beside" else [])
