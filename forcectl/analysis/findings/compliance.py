"""Whether a surface is as compliant as its model, from the log, its truth included."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from forcectl.analysis.findings.finding import RunFinding, finding
from forcectl.analysis.findings.pressing import Pressing

_RANGE = 0.1  # smallest range of the force in contact, as a share of the largest reference
_STRAIGHT = 0.05  # largest standard deviation from the fitted line, as a share of the range of displacement
_FACTOR = 2.0  # smallest ratio of the two compliances that is reported
_SHARE = 0.1  # smallest difference that is reported, as a share of the model's whole compliance
_MOST = 100.0  # largest ratio that is stated as a number


def compliance_findings(log: Pressing, robot: float, believed: float) -> Iterator[RunFinding]:
    """Compare the surface with its model: compliance is a line fit of displacement over force, at rest along it.

    Args:
        log: of a surface of one material that does not move.
        robot: C_R of the robot [m/N].
        believed: C_E of the model [m/N].
    """
    if log.displacement is None:
        return
    here = (log.true > 0) & ~log.moves
    force, way = log.true[here], -log.displacement[here]  # into the surface
    if len(force) < 2 or np.ptp(force) < _RANGE * log.desired.max() or not np.ptp(force) > 0:
        return
    line = np.polyfit(force, way, 1)
    if np.std(way - np.polyval(line, force)) > _STRAIGHT * np.ptp(way):  # disturbed by loads or loss of contact
        return
    seen = float(line[0]) - robot
    factor = max(believed / seen if seen > 0 else np.inf, seen / believed)
    if factor < _FACTOR or abs(seen - believed) < _SHARE * (robot + believed):
        return
    side = "stiff" if seen < believed else "soft"
    often = f"{factor:.2g}" if factor < _MOST else f"more than {_MOST:g}"
    text = f"the surface gives {1e6 * max(seen, 0.0):.3g} um/N, that of the model {1e6 * believed:.3g} um/N"
    yield finding("compliance_off", f"{text}: it is {often} times as {side}")
