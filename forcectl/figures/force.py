"""Figures of a run: force over time against reference and reference model, and the model error."""

from __future__ import annotations

import io
import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import IO, Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.legend import Legend

from forcectl.figures.shown import ShownFigure
from forcectl.figures.targets import GREY, ForceTarget, draw_bands, draw_targets

# Okabe and Ito: distinguishable with any colour vision, and in print.
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
# Line styles of each further round through the colours; reference models have plain dashes.
_DASHES: tuple[Any, ...] = ("-", (0, (1, 1.2)), (0, (7, 1.5, 1, 1.5)))
_OVER, _CLOSE = (0, (4, 4)), 0.02  # dashes of a curve that covers another, nearer than this share of its range
Found = Mapping[str, Sequence[Any]]  # findings of every variant, see `forcectl.analysis.findings`
NOTHING: Found = {}
_ONLY_VARIANT = "default"  # name of the variant of a scenario without variants
_MOST_LABELLED = 12
# Sizes of a legend above axes: width left for labels of the axis [in], of a letter on average and of what belongs to
# each name beside it [letter sizes], most letters of a name.
_MARGIN, _OF_LETTER, _BESIDE, _LONGEST = 1.0, 0.6, 4.0, 60
_MOST_INSIDE = 6  # more entries of a legend than that would hide curves
_MOST_MARKED = 8  # findings whose kinds are written
_LETTER = 0.0075  # width of a letter of a kind, as a share of the time axis
_FIRST_SAMPLES = 0.2  # first share of the time, which the limits of a tuning's axes ignore
_GAIN = "proportional_gain"
_TUNING = {
    "controller_output": "u_hat [m]",
    _GAIN: "K_P [m/N]",
    "integral_gain": "K_I [m/(N s)]",
    "derivative_gain": "K_D [m s/N]",
}


def force_figure(log: Any, title: str = "", findings: Found = NOTHING, targets: Sequence[ForceTarget] = ()) -> Figure:
    """Measured force of every variant over time, with the desired force, its bands, and, dashed, the reference model.

    Args:
        log: dataset over time, or over (variant, time): `desired_force`, `measured_force` and perhaps `model_force`.
        title: heading.
        findings: of every variant, marked at their times.
        targets: allowed ranges of the forces.
    """
    figure, axes = _new(title, "force [N]")
    variants, drawn = list(_drawn(log)), list[Any]()
    desired = {one["desired_force"].values.tobytes(): one["desired_force"] for *_, one in variants}
    for i, values in enumerate(desired.values()):
        axes.plot(values["time"], values, color=GREY, lw=1.0, label="reference" if i == 0 else None, zorder=1)
    draw_bands(axes, ((one["time"].values, one.values) for one in desired.values()))
    for colour, dashes, name, one in variants:
        label, look = _label(name) or "measured force", _dashes_over(dashes, one["measured_force"], drawn)
        axes.plot(one["time"], one["measured_force"], color=colour, ls=look, lw=1.8, label=label, zorder=3)
        if _has_model(log):
            axes.plot(one["time"], one["model_force"], color=colour, lw=1.2, ls=(0, (5, 3)), alpha=0.9, zorder=2)
    if _has_model(log):
        axes.plot([], [], color=GREY, lw=1.2, ls=(0, (5, 3)), label="reference model")
    colours = {name: colour for colour, _, name, _ in variants}
    axes.set_xlim(float(log["time"][0]), float(log["time"][-1]))
    draw_targets(axes, colours, targets)
    _finish(figure, axes, log)
    axes.set_ylim(bottom=min(0.0, axes.get_ylim()[0]))
    mark_findings(axes, colours, findings)
    return figure


def mark_findings(axes: Axes, colours: Mapping[str, str], findings: Found) -> None:
    """Mark findings that have a time: a triangle below in the colour of the variant, with the kind if they are few.

    Args:
        axes: over time.
        colours: of the variants by name.
        findings: of every variant.
    """
    shown = [(colours[name], one) for name, found in findings.items() if name in colours for one in found]
    timed = sorted(((one.time, colour, one) for colour, one in shown if one.time is not None), key=lambda row: row[0])
    bottom, (begin, end) = axes.get_xaxis_transform(), axes.get_xlim()
    rows: list[float] = []  # where the last name in each row ends
    for time, colour, one in timed:
        axes.plot(time, 0.0, marker="^", color=colour, ms=6, transform=bottom, clip_on=False, zorder=5)
        if len(timed) > _MOST_MARKED:
            continue
        share, width = (time - begin) / (end - begin), _LETTER * (2 + len(one.kind))
        back = share > 1 - width
        left = share - width * back
        row = next((i for i, taken in enumerate(rows) if taken <= left), len(rows))
        rows[row : row + 1] = [left + width]
        axes.annotate(
            one.kind.replace("_", " "),
            (time, 0.0),
            xytext=(-5 if back else 5, 4 + 9 * row),
            xycoords=bottom,
            textcoords="offset points",
            ha="right" if back else "left",
            fontsize=7,
            color=colour,
        )
    if rows:  # room for the names, below the curves and the legend
        room = (9 * len(rows) + 6) / (72 * axes.bbox.height / axes.figure.dpi)
        low, high = axes.get_ylim()
        axes.set_ylim(low - room / (1 - room) * (high - low), high)
        if legend := axes.get_legend():
            legend.set_bbox_to_anchor((0.0, room, 1.0, 1.0 - room), transform=axes.transAxes)


def error_figure(log: Any, title: str = "") -> Figure:
    """Measured force minus reference model of every variant over time."""
    figure, axes = _new(title, "force minus reference model [N]")
    axes.axhline(0.0, color=GREY, lw=1.0, zorder=1)
    drawn: list[Any] = []
    for colour, dashes, name, one in _drawn(log):
        error = one["measured_force"] - one["model_force"]
        if error.isnull().all():  # a law without a reference model
            continue
        look = _dashes_over(dashes, error, drawn)
        axes.plot(one["time"], error, color=colour, ls=look, lw=1.6, label=_label(name))
    _finish(figure, axes, log)
    return figure


def tuning_figure(log: Any, title: str = "") -> Figure:
    """Output of a controller, at first its excitation, and the gains tuned meanwhile, of every variant over time."""
    signals = {name: label for name, label in _TUNING.items() if name in log}
    figure, rows = stacked(len(signals), 8.0, 0.8 + 1.7 * len(signals))
    for axes, (name, label) in zip(rows, signals.items(), strict=True):
        for colour, dashes, variant, one in _drawn(log):
            axes.plot(one["time"], one[name], color=colour, ls=dashes, lw=1.6, label=_label(variant))
        axes.set_ylabel(label)
        # The first samples make the gains jump so far that nothing else would be seen.
        later = log[name].where(log["time"] > _FIRST_SAMPLES * log["time"][-1])
        low, high = min(0.0, float(later.min())), max(0.0, float(later.max()))
        if high > low:
            axes.set_ylim(low - 0.1 * (high - low), high + 0.1 * (high - low))
    rows[0].set_title(title, loc="left", fontsize=11, parse_math=False)
    _finish(figure, rows[0], log)
    return figure


def run_figures(
    log: Any, title: str = "", findings: Found = NOTHING, targets: Sequence[ForceTarget] = ()
) -> dict[str, Figure]:
    """The figures that the log of a force loop has signals for, by file name; arguments as those of `force_figure`."""
    figures = {"force": force_figure(log, title, findings, targets)}
    if _has_model(log):
        figures["model_error"] = error_figure(log, title)
    if _GAIN in log:
        figures["tuning"] = tuning_figure(log, title)
    return figures


def write_figures(figures: Mapping[str, Figure], folder: Path) -> list[Path]:
    """Write figures as SVG and PNG under their names; the same figures give the same files."""
    folder.mkdir(parents=True, exist_ok=True)
    return [path for stem, figure in figures.items() for path in save(figure, folder / stem)]


def save(figure: Figure, stem: Path) -> list[Path]:
    """Write one figure as `<stem>.svg` and `<stem>.png`, without dates or random identifiers in the file."""
    written = [stem.with_name(stem.name + suffix) for suffix in (".svg", ".png")]
    write_svg(figure, written[0])
    figure.savefig(written[1], dpi=150)
    return written


def as_svg(figure: Figure) -> str:
    """A figure as an SVG element, for a page."""
    page = io.StringIO()
    write_svg(figure, page)
    text = page.getvalue()
    return text[text.index("<svg") :]


def write_svg(figure: Figure, where: Path | IO[Any]) -> None:
    """Write a figure as SVG, without dates or random identifiers."""
    FigureCanvasAgg(figure)
    with mpl.rc_context({"svg.hashsalt": "forcectl", "svg.fonttype": "path"}):
        figure.savefig(where, format="svg", metadata={"Date": None})


def _new(title: str, ylabel: str) -> tuple[Figure, Axes]:
    figure, (axes,) = stacked(1, 8.0, 4.5)
    axes.set_title(title, loc="left", fontsize=11, parse_math=False)
    axes.set_ylabel(ylabel)
    return figure, axes


def stacked(
    count: int, width: float, height: float, title: str = "", ratios: Sequence[float] | None = None
) -> tuple[Figure, list[Axes]]:
    """A figure of axes above each other, over the same time.

    Args:
        count: of the axes.
        width, height: of the figure [in].
        title: above them all.
        ratios: of their heights; None: all alike.
    """
    figure = ShownFigure(figsize=(width, height), layout="constrained")
    rows = list(figure.subplots(count, sharex=True, squeeze=False, height_ratios=ratios)[:, 0])
    if title:
        figure.suptitle(title, x=0.01, ha="left", fontsize=11, parse_math=False)
    rows[-1].set_xlabel("time [s]")
    for axes in rows:
        frame(axes)
    return figure, rows


def frame(axes: Axes) -> None:
    """Grid and spines as in all figures."""
    axes.grid(color="#e4e4e4", lw=0.8)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)


def _finish(figure: Figure, axes: Axes, log: Any) -> None:
    axes.set_xlim(float(log["time"][0]), float(log["time"][-1]))
    if log.sizes.get("variant", 1) > _MOST_LABELLED:
        return
    handles, labels = axes.get_legend_handles_labels()
    if not labels:
        return
    if len(labels) <= _MOST_INSIDE:
        legend = axes.legend(frameon=False, fontsize=9, loc="best")
    else:  # beside the curves, in room of its own
        width, height = figure.get_size_inches()
        figure.set_size_inches(width + 2.2, height)
        legend = figure.legend(handles, labels, frameon=False, fontsize=9, loc="outside right upper")
    plain_names(legend)


def legend_above(axes: Axes, columns: int, size: float = 8.0) -> None:
    """A legend above the axes, if any of its curves has a name.

    Args:
        axes: with their curves.
        columns: of names, at most; fewer where the names are too long for the width of the figure.
        size: of the letters [pt].
    """
    handles, names = axes.get_legend_handles_labels()
    if not names:
        return
    figure = axes.get_figure(root=True)
    room = (figure.get_figwidth() - _MARGIN) * 72 / size if figure is not None else math.inf  # [letter sizes]
    longest = max(_BESIDE + _OF_LETTER * min(len(name), _LONGEST) for name in names)
    look: dict[str, Any] = {"frameon": False, "fontsize": size, "loc": "lower left", "columnspacing": 1.0}
    columns = max(1, min(columns, int(room / longest)))
    shown = [_short(name) for name in names]
    plain_names(axes.legend(handles, shown, bbox_to_anchor=(0.0, 1.0), ncol=columns, **look))


def _short(name: str) -> str:
    """A name without its middle, where it is too long for a legend."""
    half = (_LONGEST - 1) // 2
    return name if len(name) <= _LONGEST else f"{name[:half]}…{name[-half:]}"


def plain_names(legend: Legend) -> None:
    """Show names as plain text: two dollar signs do not mark a formula."""
    for text in legend.get_texts():
        text.set_parse_math(False)


def _dashes_over(dashes: Any, values: Any, drawn: list[Any]) -> Any:
    """The dashes of a curve: with gaps where it would cover one that is drawn already.

    Args:
        dashes: of its variant.
        values: of the curve, over its times.
        drawn: the curves so far; this one is added.
    """
    finite = values.values[np.isfinite(values)]
    near = _CLOSE * float(np.ptp(finite)) if finite.size else 0.0
    gaps = [abs(values - other).values for other in drawn]  # at the times that both have
    covers = any(np.isfinite(gap).any() and np.nanmax(gap) < near for gap in gaps)
    drawn.append(values)
    return _OVER if covers and dashes == "-" else dashes


def _has_model(log: Any) -> bool:
    """Whether the reference model responds: it stays at zero while a controller is excited in an open loop."""
    return "model_force" in log and bool((abs(log["model_force"]) > 0.0).any())


def colour_of(index: int) -> str:
    """The colour of a curve of several, counted from 0."""
    return COLOURS[index % len(COLOURS)]


def look_of(index: int) -> tuple[str, Any]:
    """Colour and dashes of one of several curves, all different as far as possible; colours repeat when used up."""
    return colour_of(index), _DASHES[index // len(COLOURS) % len(_DASHES)]


def _label(variant: str) -> str | None:
    """Name of a variant in a legend; none for the only one of a scenario without variants."""
    return None if variant == _ONLY_VARIANT else variant


def _drawn(log: Any) -> Iterator[tuple[str, Any, str, Any]]:
    """Colour, dashes, name and log of every variant, see `look_of`.

    Without the times that only others have: a curve has a gap at each of them.
    """
    if "variant" in log.dims:
        variants = [(str(name), log.sel(variant=name).dropna("time", how="all")) for name in log["variant"].values]
    else:
        variants = [(str(log["variant"].item()) if "variant" in log.coords else _ONLY_VARIANT, log)]
    for i, (name, one) in enumerate(variants):
        yield *look_of(i), name, one
