"""HDF5 files as other programs write them, after public reports: the stack is found, or can be named."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pytest

from lfcal.base import FileFormatError, UnsafeFileError
from lfcal.frames import open_frames, open_image, read_image

STACK = np.arange(6 * 5 * 4, dtype=np.uint16).reshape(6, 5, 4)
OTHER = STACK + 500
DARK = np.full((2, 5, 4), 7, np.uint16)


def area_detector(file: h5py.File) -> None:
    """Write what an EPICS area detector writes (areaDetector/ADCore#28): the stack lies deep, and the default leads."""
    file.attrs["default"] = "entry"
    file.create_group("entry").attrs["default"] = "data"
    data = file["entry"].create_group("data")
    data.attrs["signal"] = "data"
    data["data"] = STACK
    file["entry/instrument/detector/other"] = OTHER


def nexus_by_link(file: h5py.File) -> None:
    """Write plot data that are a soft link to the detector's (apstools#781)."""
    file["entry/instrument/detector/data"] = STACK
    file["entry/plot/image"] = h5py.SoftLink("/entry/instrument/detector/data")
    file["entry/extra"] = OTHER
    file.attrs["default"] = np.bytes_(b"entry")
    file["entry"].attrs["default"] = "plot"
    file["entry/plot"].attrs["signal"] = "image"


def data_exchange(file: h5py.File) -> None:
    """Write the layout of tomography beamlines (Dioptas#119): dark and white frames lie in the same group."""
    file["exchange/data"] = STACK
    file["exchange/data_dark"] = DARK
    file["exchange/data_white"] = DARK + 900


def old_nexus(file: h5py.File) -> None:
    """Write a signal marked by a number (GSAS-II#71)."""
    file["entry/data/counts"] = STACK
    file["entry/data"].attrs["signal"] = 1


def marked_dataset(file: h5py.File) -> None:
    """Write two stacks, of which a number marks the signal (the older NeXus convention)."""
    file["entry/data/counts"], file["entry/data/monitor"] = STACK, OTHER
    file["entry/data/counts"].attrs["signal"] = 1
    file["entry/data/monitor"].attrs["signal"] = "2"


def one_below(file: h5py.File) -> None:
    """Write one stack in a group, twice by hard links, with a table that is no stack."""
    file["measurement/frames"] = STACK
    file["copy"] = file["measurement/frames"]
    file["measurement/time"] = np.arange(6.0)


@pytest.mark.parametrize("write", [area_detector, nexus_by_link, data_exchange, old_nexus, marked_dataset, one_below])
def test_the_stack_of_another_program_is_found(tmp_path: Path, write: Callable[[h5py.File], None]) -> None:
    with h5py.File(tmp_path / "scan.h5", "w") as file:
        write(file)
    with open_frames(tmp_path / "scan.h5", order="raster", plan_shape=(1, 2, 3)) as frames:
        np.testing.assert_array_equal([frames.read(k) for k in range(6)], STACK)


def test_dark_and_white_frames_in_the_same_file_are_named(tmp_path: Path) -> None:
    path = tmp_path / "scan.h5"
    with h5py.File(path, "w") as file:
        data_exchange(file)
    with open_frames(path, order="raster", plan_shape=(1, 2, 3)) as frames:
        dark, white = sorted(frames.metadata.notes)
    assert dark.endswith(f"--dark {path}::/exchange/data_dark") and white.endswith(
        f"--white {path}::/exchange/data_white"
    )


def test_of_several_stacks_one_is_named_after_the_file(tmp_path: Path) -> None:
    path = tmp_path / "scan.h5"
    with h5py.File(path, "w") as file:
        file["lamp/on"], file["lamp/off"] = STACK, OTHER
    with pytest.raises(FileFormatError, match=r"got .*/lamp/off \(6, 5, 4\).*; name it as scan\.h5::/lamp/o"):
        open_image(path)
    np.testing.assert_array_equal(read_image(f"{path}::/lamp/off", 2), OTHER[2])
    with open_frames(f"{path}::lamp/on", order="raster", plan_shape=(1, 2, 3)) as frames:
        np.testing.assert_array_equal(frames.read(4), STACK[4])
    with pytest.raises(FileFormatError, match="lamp/no"):
        open_image(f"{path}::/lamp/no")


def test_a_file_whose_name_has_the_mark_is_that_file(tmp_path: Path) -> None:
    np.save(tmp_path / "a::b.npy", STACK)
    assert open_image(tmp_path / "a::b.npy").pages == 6


def test_links_that_lead_out_or_in_a_circle_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.h5"
    with h5py.File(path, "w") as file:
        file["round"], file["there"] = h5py.SoftLink("/there"), h5py.SoftLink("round")
        file["out"] = h5py.ExternalLink("b.h5", "/x")
        file["over"], file["lost"] = h5py.SoftLink("/out"), h5py.SoftLink("/nowhere/x")
    with pytest.raises(
        FileFormatError, match=r"/lost: expected a dataset, got a link to /nowhere/x, which does not exist"
    ):
        open_image(path, dataset="lost")
    for name, words in (("round", "a chain of soft links"), ("over", "ExternalLink")):
        with pytest.raises(UnsafeFileError, match=words):
            open_image(path, dataset=name)
