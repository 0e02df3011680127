"""The signals that the findings of a force loop are made from."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from forcectl.arrays import Mask, Signal
from forcectl.force.approach import ApproachMode

TOUCH = 0.02  # share of the reference above which a force makes a contact that can be lost


class SurfaceSignals(NamedTuple):
    """The signals of one surface, shapes (k,).

    Attributes:
        time: [s].
        desired, measured, true: forces [N].
        contact: state of the contact, see `ContactMode`; None of a station without this output.
        command: displacement [m]; None where it is not logged.
        displacement: of the tool along the normal by the motors [m]; None where it is not logged.
        motors: positions of the motors by the names of the joints [rad].
        regulated: whether the force law is active: tuned, and past the first touch.
        closed: whether the force law is active, and the tool is not in motion along the surface.
        moves: whether the tool is in motion along the surface.
        sliding: whether the force law is active in motion along an even surface.
        compliance: C_T [m/N].
        estimate: C_E_hat [m/N]; None of a law that does not estimate it.
    """

    time: Signal
    desired: Signal
    measured: Signal
    true: Signal
    contact: Signal | None
    command: Signal | None
    displacement: Signal | None
    motors: dict[str, Signal]
    regulated: Mask
    closed: Mask
    moves: Mask
    sliding: Mask
    compliance: float
    estimate: Signal | None = None

    @classmethod
    def of(cls, log: Any, compliance: float, motion: tuple[float, float] | None, even: bool) -> SurfaceSignals:
        """From the log of one surface.

        Args:
            log: over time.
            compliance: C_T [m/N].
            motion: begin and end of the motion along the surface [s].
            even: whether the surface is a plane at rest, perhaps with a slope.
        """
        time = log["time"].values
        regulated = np.ones(len(time), dtype=bool)
        if "mode" in log and "controller_output" in log:  # a law that is tuned by an excitation before it takes over
            regulated &= log["mode"].values > 0
        if "approach_mode" in log:  # a guarded move that hands over to the law
            regulated &= log["approach_mode"].values == ApproachMode.CONTACT
        begin, end = motion or (np.inf, np.inf)
        moves = (begin <= time) & (time <= end)
        desired, measured, true = (log[f"{name}_force"].values for name in ("desired", "measured", "contact"))
        command, displacement, estimate, contact = (
            log[name].values if name in log else None
            for name in ("displacement_command", "contact_displacement", "environment_compliance", "contact_state")
        )
        motors = {}
        if "motor_position" in log:
            names = [str(name) for name in log["joint"].values]
            motors = dict(zip(names, log["motor_position"].values.T, strict=True))
        closed, sliding = regulated & ~moves, regulated & moves & even
        forces = (time, desired, measured, true)
        masks = (regulated, closed, moves, sliding)
        return cls(*forces, contact, command, displacement, motors, *masks, compliance, estimate)


def lasts(time: Signal, part: slice) -> float:
    """Time from the first to the last sample of an interval [s]."""
    return float(time[part.stop - 1] - time[part.start])


def spent(time: Signal, here: Mask) -> float:
    """Total time in which `here` is true [s]; a sample counts until the next one."""
    return float(np.sum(np.diff(time, append=2 * time[-1] - time[-2] if len(time) > 1 else time[-1])[here]))


def first_time(time: Signal, here: Mask) -> float:
    """Time of the first sample at which `here` is true [s]."""
    return float(time[int(np.argmax(here))])


def percent(share: float) -> str:
    """A share in per cent, in words."""
    return f"{100 * share:.0f} %" if share > 0.1 else f"{100 * share:.2g} %"


def times(count: int) -> str:
    """How often, in words."""
    return "once" if count == 1 else f"{count} times"
