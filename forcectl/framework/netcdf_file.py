"""What a NetCDF-4 file declares, looked at before anything of it is loaded: its size.

NetCDF-4 is HDF5, and there a few kilobytes may declare terabytes that were never written.
"""

from __future__ import annotations

import math
from pathlib import Path

from forcectl.errors import BadInputError

_MOST_BYTES = 2e9  # [B] of all variables together, unpacked


def check_netcdf(path: Path) -> None:
    """Refuse a file whose variables are too large to load. No data are read.

    Args:
        path: of the file.

    Raises:
        BadInputError: names the file.
        OSError: the file is no HDF5, or a damaged one; of a damaged one h5py raises others, too.
    """
    import h5py

    with h5py.File(path, "r") as file:
        links: list[bytes] = []
        file.id.links.visit(lambda name: links.append(bytes(name)))
        size = 0
        for name in links:
            found = file.get(name)  # None: a soft link to nothing
            if not isinstance(found, h5py.Dataset):
                continue
            size += math.prod(found.shape or ()) * found.dtype.itemsize
    if size > _MOST_BYTES:
        raise BadInputError(
            f"{path.name} declares {size / 1e6:.0f} MB of data: must be at most {_MOST_BYTES / 1e6:g} MB"
        )
