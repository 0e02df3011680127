"""How a peg was inserted into a bore: times from first contact, depth, tilt and true forces."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from forcectl.analysis.slot import CONTACT_TRUTH, check_modes, check_parts, variants_of
from forcectl.analysis.transitions import Stay, stays
from forcectl.arrays import Array
from forcectl.diagrams.model import Setting
from forcectl.errors import invalid
from forcectl.framework.fields import Config, key

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from forcectl.diagrams.log import LoggedSignal

_ROUNDING = 1e-9  # [s]
DEPTHS = "above 0 and at most 1"  # [m] of a bore
BESIDE = 0.01  # [m] offset from the axis from which on a part is beside the other one, not in it
_TOUCH = 0.05  # [N] a smaller true force is no contact
_IN_THE_AIR = 0.1  # [s] time without contact before a mode begins, after which it began in the air


class InsertionTruth(NamedTuple):
    """The truth of an insertion over time, of T ticks.

    Attributes:
        time: (T,) [s].
        depth: of the peg's tip below the mouth along the axis of the bore, (T,) [m].
        offset: of the tip from that axis, (T,) [m].
        tilt: between the axes, (T,) [rad].
        force: on the peg by the bore, in the frame of its mouth, (T, 3) [N].
    """

    time: Array
    depth: Array
    offset: Array
    tilt: Array
    force: Array


def part_rows(log: Any, setting: Setting, part: str, signal: str) -> Array:
    """The rows (T, k) of a part in `part_position` or `part_orientation`."""
    parts = list(setting.workcell.parts)
    values: Array = log[signal].values
    return values.reshape(len(values), len(parts), -1)[:, parts.index(part)]


def part_orientation(log: Any, setting: Setting, part: str) -> Rotation:
    """Orientations (T) in the world of the frame of a part, by the truth."""
    turns = part_rows(log, setting, part, "part_orientation")
    return Rotation.from_quat(np.roll(turns, -1, axis=1))  # scipy's [x, y, z, w]


def decided_in_the_air(time: Array, force: Array, visited: Sequence[Stay], on_contact: Collection[str]) -> float:
    """Number of modes that may begin in contact only and began without it.

    Args:
        time: (T,) [s].
        force: true force, (T,) [N].
        visited: the stays in modes.
        on_contact: names of the modes that may begin in contact only.
    """
    begins = [stay.begin for stay in visited if stay.mode in on_contact]
    return float(sum(not (force[(time > at - _IN_THE_AIR) & (time <= at)] > _TOUCH).any() for at in begins))


def check_seat(part: Any) -> None:
    """Raise BadInputError if peg and bore are one part, or if the tolerance of the seat includes the mouth."""
    if part.peg == part.bore:
        raise invalid("bore", part.bore, "another part than peg")
    if part.within >= part.seat:
        raise invalid("within", part.within, f"below seat = {part.seat:g} m")


@dataclass(kw_only=True)
class InsertionAnalysis(Config):
    """Scenario part `!Insertion`.

    For a station with a peg and a bore.

    The scenario has one `!ContactTruth` on the peg by the bore in the frame of the mouth. The z axes of the frames of
    both parts point out of the bore when the peg is in it.
    """

    needs: ClassVar[dict[str, str]] = CONTACT_TRUTH

    peg: str = key("plunger", "part whose frame is in the peg's front face")
    bore: str = key("tube", "part whose frame is in the opening of the bore")
    seat: float = key(0.096, "depth of the peg when it is seated", unit="m", bounds=DEPTHS)
    within: float = key(0.002, "tolerance on the depth of the seated peg", unit="m", bounds="positive")
    beside: float = key(
        BESIDE,
        "distance of the peg's tip from the bore's axis from which on it is not in the bore",
        unit="m",
        bounds=DEPTHS,
    )
    on_contact: list[str] = key([], "modes that may begin in contact only")
    task: int = key(1, "number of the inserting task, whose estimated forces are drawn", bounds="positive")
    coordinate: int = key(
        1, "number of the task coordinate that is the first of three whose speeds are drawn", bounds="positive"
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        check_seat(self)

    def check(self, signals: Mapping[str, LoggedSignal], setting: Setting) -> None:
        """Check that parts, modes and task exist.

        Raises:
            BadInputError: one of them does not.
        """
        check_parts({"peg": self.peg, "bore": self.bore}, setting)
        check_modes({f"on_contact.{i}": name for i, name in enumerate(self.on_contact)}, signals)
        for name, signal, size in (("task", "task_wrench", 6), ("coordinate", "task_velocity", 1)):
            if signal in signals:
                rows = signals[signal].rows
                most = (rows.stop - rows.start) // size
                if getattr(self, name) > most:
                    raise invalid(name, getattr(self, name), f"at most {most}, the number of {name}s")

    def metrics(self, log: Any, setting: Setting) -> dict[str, float | None]:
        """Those of `INSERTION_METRICS`."""
        truth = self.truth(log, setting)
        size = np.linalg.norm(truth.force, axis=1)
        touching = np.flatnonzero(size > _TOUCH)
        first = float(truth.time[touching[0]]) if touching.size else None
        visited = stays(log)
        done = next((stay.begin for stay in visited if stay.kind == 1), None)
        # What comes after a success, such as the release, is not part of the insertion.
        last = len(truth.time) - 1 if done is None else int(np.searchsorted(truth.time, done - _ROUNDING))
        in_place = (np.abs(truth.depth - self.seat) <= self.within) & (truth.offset < self.beside)
        outside = np.flatnonzero(~in_place[: last + 1])
        seated = float(truth.time[outside[-1] + 1]) if outside.size and outside[-1] < last else None

        def after(time: float | None) -> float | None:
            return None if time is None or first is None else time - first

        return {
            "first_contact_s": first,
            "seated_after_s": after(seated),
            "finished_after_s": after(done),
            "depth_mm": 1e3 * float(truth.depth[last]),
            "tilt_deg": float(np.degrees(truth.tilt[last])),
            "offset_at_contact_mm": None if first is None else 1e3 * float(truth.offset[touching[0]]),
            "tilt_at_contact_deg": None if first is None else float(np.degrees(truth.tilt[touching[0]])),
            "lateral_force_N": float(np.hypot(truth.force[:, 0], truth.force[:, 1]).max()),
            "axial_force_N": float(np.abs(truth.force[:, 2]).max()),
            "inserted": float(done is not None and seated is not None),
            "decided_in_the_air": decided_in_the_air(truth.time, size, visited, self.on_contact),
        }

    def figures(self, log: Any, setting: Setting, title: str) -> dict[str, Figure]:
        """Forces, speeds and depth of every variant, with the modes."""
        from forcectl.figures.insertion import insertion_figure

        runs = variants_of(log)
        return {
            f"insertion_{i}" if len(runs) > 1 else "insertion": insertion_figure(
                *(self.truth(run, setting), run, stays(run), f"{title}: {name}" if name else title),
                *(self.task, self.coordinate),
            )
            for i, (name, run) in enumerate(runs.items(), start=1)
        }

    def truth(self, log: Any, setting: Setting) -> InsertionTruth:
        """The truth of one variant."""
        pair = (self.peg, self.bore)
        along, out = (part_orientation(log, setting, part).apply([0.0, 0.0, 1.0]) for part in pair)
        tip, mouth = (part_rows(log, setting, part, "part_position") for part in pair)
        offset = tip - mouth
        depth = -np.einsum("ij,ij->i", offset, out)
        turned = np.einsum("ij,ij->i", along, out)
        return InsertionTruth(
            log["time"].values,
            depth,
            np.linalg.norm(offset + depth[:, None] * out, axis=1),
            np.arccos(np.clip(turned, -1.0, 1.0)),
            log["body_contact_wrench"].values[:, 3:],
        )
