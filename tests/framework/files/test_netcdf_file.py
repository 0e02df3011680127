"""A NetCDF file of somebody else: its size and where its data lie are looked at before anything is loaded."""

import h5py
import numpy as np
import pytest
import xarray as xr

from forcectl.errors import BadInputError
from forcectl.framework.files.netcdf_file import check_netcdf


@pytest.fixture
def log(tmp_path):
    """A sound file, beside another one."""
    data = {"force": ("time", np.zeros(100)), "word": ("name", ["a", "b"])}
    dataset = xr.Dataset(data, {"time": np.arange(100) * 0.01})
    for name in ("log.nc", "other.nc"):
        dataset.to_netcdf(tmp_path / name, engine="h5netcdf")
    return tmp_path / "log.nc"


def external_link(file):
    file["u"] = h5py.ExternalLink("other.nc", "force")


def external_link_in_a_group(file):
    file.create_group("a/b")["u"] = h5py.ExternalLink("other.nc", "/")


def external_storage(file):
    file.create_dataset("u", (10,), "f8", external=[("other.nc", 0, 80)])


def virtual_dataset(file):
    layout = h5py.VirtualLayout((100,), "f8")
    layout[:] = h5py.VirtualSource("other.nc", "force", (100,))
    file.create_virtual_dataset("u", layout)


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (external_link, "variable 'u' is a link to another file"),
        (external_link_in_a_group, "variable 'a/b/u' is a link to another file"),
        (external_storage, "variable 'u' is data of another file"),
        (virtual_dataset, "variable 'u' is data of another file"),
    ],
)
def test_data_of_other_files_are_refused(log, spoil, words):
    with h5py.File(log, "a") as file:
        spoil(file)
    with pytest.raises(BadInputError) as caught:
        check_netcdf(log)
    assert str(caught.value) == f"log.nc: {words}: must be within the file; copy the data into it"


def test_a_small_file_that_declares_too_much_is_refused_before_it_is_loaded(log):
    """Compressed values that were never written take no room in the file."""
    with h5py.File(log, "a") as file:
        file.create_dataset("u", (100_000_000,), "f8", chunks=(1_000_000,), compression="gzip")
        for k in range(2):
            file[f"u{k}"] = file["u"]  # one more name of the same values, which are loaded once more
    assert log.stat().st_size < 100_000
    with pytest.raises(BadInputError, match=r"log\.nc declares 2400 MB of data: must be at most 2000 MB"):
        check_netcdf(log)


def test_a_sound_file_with_groups_in_circles_and_links_within_passes(log):
    with h5py.File(log, "a") as file:
        group = file.create_group("a")
        group["around"], group["force"], group["nothing"] = file["/"], h5py.SoftLink("/force"), h5py.SoftLink("/none")
        file.create_dataset("empty", dtype="f8")
    check_netcdf(log)
