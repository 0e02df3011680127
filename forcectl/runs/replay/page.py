"""The page of a replay: Meshcat's picture with the time, the mode, the forces of the arrows, and a time line."""

from __future__ import annotations

import json
from collections.abc import Sequence

import numpy as np

from forcectl.analysis.transitions import Stay
from forcectl.arrays import Array
from forcectl.runs.pages.layout import rendered
from forcectl.runs.replay.forces import ARROW, ShownForce


def with_panel(
    html: str, title: str, times: Array, pictures: Array, stays: Sequence[Stay], forces: Sequence[ShownForce]
) -> str:
    """Add the panel and the time line to a page of Meshcat's. They follow its animation.

    Args:
        html: of Meshcat.
        title: heading.
        times: of the samples of the log, (k,) [s].
        pictures: which of them are shown.
        stays: intervals in the modes of a state machine; empty without one.
        forces: those with an arrow in the picture.
    """
    data = {
        "begin": float(times[0]),
        "end": float(times[-1]),
        "times": [round(float(time), 4) for time in times[pictures]],
        "stays": [
            stay._asdict() | {"mode": stay.mode.replace("_", " "), "value": _number(stay.value)} for stay in stays
        ],
        "arrows": [force.path for force in forces],
        "forces": [[_number(size) for size in np.linalg.norm(force.values[pictures], axis=1)] for force in forces],
    }
    panel = rendered(
        "forcectl.runs.replay",
        "replay.html.j2",
        title=title,
        forces=[(force.label, _css(force)) for force in forces],
        millimetres=f"{1e3 * ARROW:g}",
        newtons=f"{1e-3 / ARROW:g}",
        # A closing tag inside of a name must not end the script element.
        data=json.dumps(data, ensure_ascii=False, allow_nan=False, separators=(",", ":")).replace("<", "\\u003c"),
    )
    before, end, after = html.rpartition("</body>")
    return f"{before}{panel}{end}{after}"


def _number(value: float | None) -> float | None:
    """A number rounded to four digits, with at most nine decimals; None (null in JSON) if it is not finite."""
    return round(float(f"{value:.4g}"), 9) if value is not None and np.isfinite(value) else None


def _css(force: ShownForce) -> str:
    colour = force.look.colour
    return f"rgb({255 * colour.r():.0f} {255 * colour.g():.0f} {255 * colour.b():.0f} / {colour.a():g})"
