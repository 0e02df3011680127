"""What the page of a replay draws, read from its recording: shapes, and their place, scale and visibility over time."""

import base64
import re
import struct
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from pydrake.common.eigen_geometry import Quaternion
from pydrake.math import RigidTransform

RATE = 64.0  # frames per second that Meshcat counts in
_SIZED = {0xD9: (">B", "s"), 0xDA: (">H", "s"), 0xDB: (">I", "s"), 0xC4: (">B", "b"), 0xC5: (">H", "b")}
_SIZED |= {0xC6: (">I", "b"), 0xDC: (">H", "a"), 0xDD: (">I", "a"), 0xDE: (">H", "m"), 0xDF: (">I", "m")}
_NUMBERS = {0xCA: ">f", 0xCB: ">d", 0xCC: ">B", 0xCD: ">H", 0xCE: ">I", 0xCF: ">Q"}
_NUMBERS |= {0xD0: ">b", 0xD1: ">h", 0xD2: ">i", 0xD3: ">q"}
_CONSTANTS = {0xC0: None, 0xC2: False, 0xC3: True}


class _Unpacker:
    """MessagePack, as far as Meshcat uses it for shapes and recordings."""

    def __init__(self, data: bytes):
        self._data, self._at = data, 0

    def _take(self, count: int) -> bytes:
        self._at += count
        return self._data[self._at - count : self._at]

    def _number(self, format_: str) -> Any:
        return struct.unpack(format_, self._take(struct.calcsize(format_)))[0]

    def value(self) -> Any:
        first = self._number(">B")
        if first < 0x80:
            return first
        if first >= 0xE0:
            return first - 0x100
        if first < 0xC0:
            kind, size = ("m", first & 15) if first < 0x90 else ("a", first & 15) if first < 0xA0 else ("s", first & 31)
        elif first in _CONSTANTS:
            return _CONSTANTS[first]
        elif first in _NUMBERS:
            return self._number(_NUMBERS[first])
        else:
            format_, kind = _SIZED[first]
            size = self._number(format_)
        if kind == "m":
            return {self.value(): self.value() for _ in range(size)}
        if kind == "a":
            return [self.value() for _ in range(size)]
        return self._take(size).decode() if kind == "s" else self._take(size)


@dataclass(frozen=True)
class Drawn:
    """A shape at one time: its two ends in W [m] along its longest side."""

    start: np.ndarray
    end: np.ndarray


def tracks(page: Path, path: str, time: float) -> dict[str, Any]:
    """What the recording says at a time [s] of the things whose path begins so: `.position`, `.scale`, and others."""
    (recording,) = [message["animations"] for message in _messages(page, b"set_animation")]
    values: dict[str, Any] = {}
    for part in recording:
        if part["path"].startswith(f"/drake/{path}"):
            for track in part["clip"]["tracks"]:
                at = {key["time"]: key["value"] for key in track["keys"]}
                if round(time * RATE) in at:
                    values[track["name"]] = at[round(time * RATE)]
    return values


def pose(page: Path, path: str, time: float) -> RigidTransform:
    """Where the only thing at a path is at a recorded time [s]."""
    values = tracks(page, path, time)
    x, y, z, w = values[".quaternion"]
    return RigidTransform(Quaternion(w, x, y, z), values[".position"])


def drawn(page: Path, path: str, time: float) -> Drawn | None:
    """What a page shows of the box or cylinder at a path at a recorded time [s]; None when it is hidden."""
    found = [each for each in _messages(page, b"set_object") if each["path"].startswith(f"/drake/{path}")]
    ((shape,),) = [message["object"]["geometries"] for message in found]
    values = tracks(page, path, time)
    if not values.get(".visible", True):
        return None
    # Meshcat's own axes: a box has its height along y and its depth along z, a cylinder its height along y.
    box = shape["type"] == "BoxGeometry"
    across = 2.0 * shape.get("radiusTop", 0.0)
    sides = (shape["width"], shape["height"], shape["depth"]) if box else (across, shape["height"], across)
    long = np.diag(np.multiply(sides, values[".scale"]))[np.argmax(np.multiply(sides, values[".scale"]))]
    X_WG = pose(page, path, time)
    half = X_WG.rotation() @ long / 2
    return Drawn(X_WG.translation() - half, X_WG.translation() + half)


def _messages(page: Path, kind: bytes) -> list[dict[str, Any]]:
    found = re.findall(r'base64,([^"]+)"\)', page.read_text(encoding="utf-8"))
    return [_Unpacker(data).value() for data in map(base64.b64decode, found) if data.find(kind, 0, 40) > 0]
