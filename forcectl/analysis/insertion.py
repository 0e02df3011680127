"""How a peg was inserted into a bore: times from first contact, depth, tilt and true forces."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from forcectl.analysis.slot import variants_of
from forcectl.analysis.transitions import stays
from forcectl.diagrams.model import Setting
from forcectl.errors import BadInputError, unknown
from forcectl.framework.fields import Config, key

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Array = NDArray[np.float64]
_ROUNDING = 1e-9  # [s]
_TOUCH = 0.05  # [N] a smaller true force is no contact
_IN_THE_AIR = 0.1  # [s] without contact, after which a decision was one in the air


class Course(NamedTuple):
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


@dataclass(kw_only=True)
class InsertionAnalysis(Config):
    """Scenario part `!Insertion`: of a station with a peg and a bore.

    The scenario has one `!ContactTruth` on the peg by the bore in the frame of the mouth. The z axes of the frames of
    both parts point out of the bore when the peg is in it.
    """

    peg: str = key("plunger", "part whose frame is in the peg's front face")
    bore: str = key("tube", "part whose frame is in the opening of the bore")
    seat: float = key(0.096, "depth of a peg that is seated", unit="m", bounds="positive")
    within: float = key(0.002, "of that depth a peg is seated", unit="m", bounds="positive")
    on_contact: list[str] = key([], "modes that only a contact may begin")

    def metrics(self, log: Any, setting: Setting) -> dict[str, float | None]:
        """Those of `INSERTION_METRICS`."""
        course = self.course(log, setting)
        size = np.linalg.norm(course.force, axis=1)
        touching = np.flatnonzero(size > _TOUCH)
        first = float(course.time[touching[0]]) if touching.size else None
        way = stays(log)
        done = next((stay.begin for stay in way if stay.kind == 1), None)
        # What comes after a success, such as the release, is not part of the insertion.
        last = len(course.time) - 1 if done is None else int(np.searchsorted(course.time, done - _ROUNDING))
        outside = np.flatnonzero(np.abs(course.depth[: last + 1] - self.seat) > self.within)
        seated = float(course.time[outside[-1] + 1]) if outside.size and outside[-1] < last else None

        def after(time: float | None) -> float | None:
            return None if time is None or first is None else time - first

        return {
            "first_contact_s": first,
            "seated_after_s": after(seated),
            "finished_after_s": after(done),
            "depth_mm": 1e3 * float(course.depth[last]),
            "tilt_deg": float(np.degrees(course.tilt[last])),
            "offset_at_contact_mm": None if first is None else 1e3 * float(course.offset[touching[0]]),
            "tilt_at_contact_deg": None if first is None else float(np.degrees(course.tilt[touching[0]])),
            "lateral_force_N": float(np.hypot(course.force[:, 0], course.force[:, 1]).max()),
            "axial_force_N": float(np.abs(course.force[:, 2]).max()),
            "inserted": float(done is not None and seated is not None),
            "decided_in_the_air": float(
                sum(
                    not (size[(course.time > stay.begin - _IN_THE_AIR) & (course.time <= stay.begin)] > _TOUCH).any()
                    for stay in way
                    if stay.mode in self.on_contact
                )
            ),
        }

    def figures(self, log: Any, setting: Setting, title: str) -> dict[str, Figure]:
        """Forces, speeds and depth of every variant, with the modes."""
        from forcectl.figures.insertion import insertion_figure

        runs = variants_of(log)
        return {
            f"insertion_{i}" if len(runs) > 1 else "insertion": insertion_figure(
                self.course(run, setting), run, stays(run), f"{title}: {name}" if name else title
            )
            for i, (name, run) in enumerate(runs.items(), start=1)
        }

    def course(self, log: Any, setting: Setting) -> Course:
        """The truth of one variant.

        Raises:
            BadInputError: there is no such part, or no true force between the two.
        """
        parts = list(setting.workcell.parts)
        for field, name in (("peg", self.peg), ("bore", self.bore)):
            if name not in parts:
                raise unknown("part", name, parts).at(field)
        if "body_contact_wrench" not in log:
            raise BadInputError("needs one !ContactTruth among the sensors, on the peg by the bore")
        tip, mouth = parts.index(self.peg), parts.index(self.bore)
        places = log["part_position"].values.reshape(-1, len(parts), 3)
        turns = np.roll(log["part_orientation"].values.reshape(-1, len(parts), 4), -1, axis=2)  # scipy's [x, y, z, w]
        along, out = (Rotation.from_quat(turns[:, i]).apply([0.0, 0.0, 1.0]) for i in (tip, mouth))
        apart = places[:, tip] - places[:, mouth]
        depth = -np.einsum("ij,ij->i", apart, out)
        turned = np.einsum("ij,ij->i", along, out)
        return Course(
            log["time"].values,
            depth,
            np.linalg.norm(apart + depth[:, None] * out, axis=1),
            np.arccos(np.clip(turned, -1.0, 1.0)),
            log["body_contact_wrench"].values[:, 3:],
        )
