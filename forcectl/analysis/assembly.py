"""Success of assembling a plunger in its body and a cap on its mount, by the truth: engaged, full depth, stays."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from forcectl.analysis.insertion import BESIDE, DEPTHS, check_seat, part_orientation, part_rows
from forcectl.analysis.slot import WithoutFigures, check_parts
from forcectl.arrays import Array
from forcectl.diagrams.model import Setting
from forcectl.errors import BadInputError, invalid
from forcectl.framework.fields import Config, key


@dataclass(kw_only=True)
class AssemblyAnalysis(Config, WithoutFigures):
    """Scenario part `!Assembly`: three levels of success of a plunger in a body and a cap that locks on a mount.

    Engaged: the plunger was past the lead-in of the bore, the cap turned beyond the lock with its face at the mount.
    Full depth: the plunger was at its seat; the locked cap was also straight. Stays: at full depth at the end, released
    by the hands; both together also need every true contact force on an arm to stay below the limit. Frames are those
    of `!PegInBore` and `!CapOnMount`.
    """

    needs: ClassVar[dict[str, str]] = {"part_released": "parts that an arm can hold"}

    peg: str = key("plunger", "part whose frame is in the peg's front face")
    bore: str = key("tube", "part whose frame is in the opening of the bore")
    cap: str = key("cap", "part whose frame is in its face")
    mount: str = key("mount", "part whose frame is between its feet")
    lead_in: float = key(0.012, "depth from which on the peg is past the lead-in of the bore", unit="m", bounds=DEPTHS)
    seat: float = key(0.096, "depth of the peg when it is seated", unit="m", bounds=DEPTHS)
    within: float = key(
        0.002,
        "tolerance on the depth of the seated peg, and on the distance between the faces of cap and mount",
        unit="m",
        bounds="positive",
    )
    lock_deg: float = key(
        16.0,
        "angle of the mount in the cap from which on the cap is locked; its sign is the direction",
        unit="deg",
        bounds="from -180 to 180",
    )
    straight_deg: float = key(
        5.0,
        "largest tilt of the mount in the cap that counts as straight",
        unit="deg",
        bounds="above 0 and at most 180",
    )
    force: float = key(18.0, "largest true contact force on an arm that is allowed", unit="N", bounds="positive")

    def __post_init__(self) -> None:
        super().__post_init__()
        check_seat(self)
        if self.lead_in >= self.seat:
            raise invalid("lead_in", self.lead_in, f"below seat = {self.seat:g} m")
        if self.cap == self.mount:
            raise invalid("mount", self.mount, "another part than cap")

    def check(self, signals: Mapping[str, Any], setting: Setting) -> None:
        """Check that the parts exist.

        Raises:
            BadInputError: a part does not exist, or no arm can hold the peg or the cap.
        """
        check_parts({field: getattr(self, field) for field in ("peg", "bore", "cap", "mount")}, setting)
        held = _held(setting)
        for field in ("peg", "cap"):
            if getattr(self, field) not in held:
                raise BadInputError(" must be a part that an arm can hold", key=field)

    def metrics(self, log: Any, setting: Setting) -> dict[str, float | None]:
        """Those of `ASSEMBLY_METRICS`."""
        held = _held(setting)
        free = log["part_released"].values[-1] > 0.5
        let_go = {name: bool(free[held.index(name)]) for name in (self.peg, self.cap)}
        place, _ = _relative(log, setting, self.bore, self.peg)
        depth, within = -place[:, 2], np.linalg.norm(place[:, :2], axis=1) < BESIDE
        engaged, seated = within & (depth > self.lead_in), within & (np.abs(depth - self.seat) <= self.within)
        place, turn = _relative(log, setting, self.cap, self.mount)
        angle, sign = np.degrees(np.arctan2(turn[:, 1, 0], turn[:, 0, 0])), np.copysign(1.0, self.lock_deg)
        tilt = np.degrees(np.arccos(np.clip(turn[:, 2, 2], -1.0, 1.0)))
        locked = (sign * angle >= abs(self.lock_deg)) & (np.linalg.norm(place[:, :2], axis=1) < BESIDE)
        locked &= np.abs(place[:, 2]) <= self.within
        straight = locked & (tilt <= self.straight_deg)
        force = float(log["arm_contact_force"].values.max())
        levels = {
            "engaged": (engaged.any(), locked.any()),
            "full_depth": (seated.any(), straight.any()),
            "stays": (seated[-1] and let_go[self.peg], straight[-1] and let_go[self.cap]),
        }
        found: dict[str, float | None] = {}
        for level, (peg, cap) in levels.items():
            found |= {f"peg_{level}": float(peg), f"cap_{level}": float(cap)}
            found[f"both_{level}"] = float(peg and cap and (level != "stays" or force <= self.force))
        return found | {
            "depth_at_end_mm": 1e3 * float(depth[-1]),
            "cap_angle_at_end_deg": float(angle[-1]),
            "cap_tilt_at_end_deg": float(tilt[-1]),
        }


def _held(setting: Setting) -> list[str]:
    """Names of the parts that an arm can hold."""
    return [name for name, part in setting.workcell.parts.items() if part.arm]


def _relative(log: Any, setting: Setting, base: str, part: str) -> tuple[Array, Array]:
    """Position, (T, 3) [m], and orientation, (T, 3, 3), of one part in the frame of another."""
    at, place = (part_rows(log, setting, name, "part_position") for name in (base, part))
    frame, turn = (part_orientation(log, setting, name) for name in (base, part))
    back = frame.inv()
    return back.apply(place - at), (back * turn).as_matrix()
