"""Whether a surface is as compliant as its model, from the log, its truth included."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from forcectl.analysis.findings.finding import RunFinding, finding
from forcectl.analysis.findings.pressing import SurfaceSignals

_RANGE = 0.1  # smallest range of the force in contact, as a share of the largest reference
_STRAIGHT = 0.05  # largest standard deviation from the fitted line, as a share of the range of displacement
_FACTOR = 2.0  # smallest ratio of the two compliances that is reported
_SHARE = 0.1  # smallest difference that is reported, as a share of the model's whole compliance
_MOST = 100.0  # largest ratio that is stated as a number


def compliance_findings(log: SurfaceSignals, robot: float, modelled: float) -> Iterator[RunFinding]:
    """Compare the surface with its model: compliance is a line fit of displacement over force, at rest along it.

    Args:
        log: of a surface of one material that does not move.
        robot: C_R of the robot [m/N].
        modelled: C_E of the model [m/N].
    """
    if log.displacement is None:
        return
    here = (log.true > 0) & ~log.moves
    force, displacement = log.true[here], -log.displacement[here]  # into the surface
    if len(force) < 2 or np.ptp(force) < _RANGE * log.desired.max() or not np.ptp(force) > 0:
        return
    line = np.polyfit(force, displacement, 1)
    residual = displacement - np.polyval(line, force)
    if np.std(residual) > _STRAIGHT * np.ptp(displacement):  # disturbed by loads or loss of contact
        return
    identified = float(line[0]) - robot
    factor = max(modelled / identified if identified > 0 else np.inf, identified / modelled)
    if factor < _FACTOR or abs(identified - modelled) < _SHARE * (robot + modelled):
        return
    side = "stiff" if identified < modelled else "soft"
    often = f"{factor:.2g}" if factor < _MOST else f"more than {_MOST:g}"
    values = f"is {1e6 * max(identified, 0.0):.3g} um/N, in the model {1e6 * modelled:.3g} um/N"
    yield finding("compliance_off", f"the compliance of the surface {values}: it is {often} times as {side}")
