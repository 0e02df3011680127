"""Golden files beside the tests: where they are, how a log is read and written.

`tests/test_pendulum.py` has them in `tests/golden/test_pendulum/`. A log is a NetCDF file with the units of its signals
and exact numbers; its bytes depend on nothing else.
"""

from __future__ import annotations

import os
import re
from pathlib import Path

import numpy as np

from forcectl.errors import BadInputError, invalid
from forcectl.figures.file_names import file_name
from forcectl.framework.files.netcdf_file import check_netcdf
from forcectl.testing.golden.compare import as_log
from forcectl.testing.runs import Log


def golden_path(test_file: Path, name: str, parameters: str, suffix: str) -> Path:
    """The path of a golden file.

    Args:
        test_file: of the test.
        name: of the file, as the test gives it.
        parameters: of a parametrised test, as pytest shows them; "" for none.
        suffix: with its dot.

    Raises:
        BadInputError: a name that is no file name.
    """
    if not re.fullmatch(r"[A-Za-z0-9_][A-Za-z0-9_.-]*", name):
        raise invalid("name", name, "letters, digits, and _ . - between them")
    return test_file.parent / "golden" / test_file.stem / f"{name}{file_name(parameters, '--')}{suffix}"


def read_log(path: Path) -> Log:
    """A golden log.

    Raises:
        BadInputError: the file is no golden log.
    """
    import xarray as xr

    try:
        check_netcdf(path)
        with xr.open_dataset(path, engine="h5netcdf") as dataset:
            loaded = dataset.load()
        return as_log(loaded.rename({name: each.attrs["long_name"] for name, each in loaded.data_vars.items()}))
    except (OSError, ValueError, KeyError) as error:
        raise BadInputError(f"{path}: is no golden log: {' '.join(str(error).split())[:200]}") from None


def write_log(log: Log, path: Path) -> None:
    """Write a log; the same log gives the same file. HDF5 has no slashes in names, `long_name` has them."""
    dataset = log.to_xarray()
    dataset = dataset.rename({name: name.replace("/", ".") for name in (*dataset.data_vars, *dataset.dims)})
    encoding = {name: {"zlib": True, "complevel": 4, "shuffle": True} for name in dataset.data_vars}
    write(path, bytes(dataset.to_netcdf(engine="h5netcdf", encoding=encoding)))


def write(path: Path, content: bytes) -> None:
    """Write a file at once, so that another process reads the old one or the new one."""
    path.parent.mkdir(parents=True, exist_ok=True)
    unfinished = path.with_name(f".{path.name}.{os.getpid()}")
    unfinished.write_bytes(content)
    unfinished.replace(path)


def same(a: Log, b: Log) -> bool:
    """Whether two logs have the same signals and numbers, bit by bit."""
    return a.values.keys() == b.values.keys() and all(
        np.array_equal(x, y, equal_nan=True)
        for x, y in [(a.time, b.time), *((a.values[name], b.values[name]) for name in a.values)]
    )
