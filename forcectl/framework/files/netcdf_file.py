"""Check of a NetCDF-4 file before its data are loaded: its declared size, and that it contains all its data.

NetCDF-4 is HDF5. There a file of a few kilobytes may declare terabytes that were never written. It may also take data
from other files: by an external link, by external storage, or by a virtual dataset.
"""

from __future__ import annotations

import math
from pathlib import Path

from forcectl.errors import BadInputError, show

_MOST_BYTES = 2e9  # [B] largest size of all variables together, uncompressed


def check_netcdf(path: Path) -> None:
    """Refuse a file that refers to other files, or whose variables are too large to load. No data are read.

    Args:
        path: path of the file.

    Raises:
        BadInputError: with the file, and the variable where it is about one.
        OSError: the file is no HDF5 file, or is damaged; h5py may raise other errors for a damaged file.
    """
    import h5py

    with h5py.File(path, "r") as file:
        links: list[tuple[bytes, int]] = []
        file.id.links.visit(lambda name, link: links.append((bytes(name), link.type)), info=True)
        for name, kind in links:
            if kind not in (h5py.h5l.TYPE_HARD, h5py.h5l.TYPE_SOFT):
                raise _outside(path, name, "a link to another file")
        size = 0
        for name, _ in links:
            found = file.get(name)  # None: a soft link to nothing
            if not isinstance(found, h5py.Dataset):
                continue
            if found.external or found.is_virtual:
                raise _outside(path, name, "data of another file")
            size += math.prod(found.shape or ()) * found.dtype.itemsize
    if size > _MOST_BYTES:
        raise BadInputError(
            f"{path.name} declares {size / 1e6:.0f} MB of data: must be at most {_MOST_BYTES / 1e6:g} MB"
        )


def _outside(path: Path, name: bytes, what: str) -> BadInputError:
    variable = show(name.decode(errors="replace"))
    return BadInputError(f"{path.name}: variable {variable} is {what}: must be within the file; copy the data into it")
