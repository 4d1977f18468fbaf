"""Containers of all frames: OME-Zarr as specified, NDTiff as Micro-Manager writes it, HDF5 of other programs."""

from __future__ import annotations

import json
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from numpy.typing import NDArray

from lfcal.base.errors import FileFormatError, InputError, StorageError, UnsafeFileError
from lfcal.camera import ScanPlan
from lfcal.frames import open_frames, open_image, read_image
from tests.acquire.rigs import small_plan

FRAMES: NDArray[np.uint16] = np.random.default_rng(0).integers(0, 4000, (2, 3, 4, 16, 18), np.uint16)
"""A scan (z, y, x) of frames."""

Entries = list[tuple[dict[str, Any], NDArray[Any], dict[str, Any]]]


def write_zarr(folder: Path, array: NDArray[Any], axes: str, version: str, **settings: Any) -> None:
    """Write one image with the axes ``axes``, as https://ngff.openmicroscopy.org/ describes it."""
    zarr = pytest.importorskip("zarr", reason="zarr is not installed")
    group = zarr.open_group(folder, mode="a", zarr_format=2 if version == "0.4" else 3)
    chunks = (1,) * (array.ndim - 2) + array.shape[-2:]
    group.create_array("0", shape=array.shape, chunks=chunks, dtype=array.dtype, **settings)[...] = array
    kinds = {"t": "time", "c": "channel"}
    scale = {"type": "scale", "scale": [1.0] * (array.ndim - 1) + [0.5]}
    image = {
        "axes": [{"name": axis, "type": kinds.get(axis, "space"), "unit": "micrometer"} for axis in axes],
        "datasets": [{"path": "0", "coordinateTransformations": [scale]}],
    }
    if version == "0.4":
        group.attrs["multiscales"] = [{**image, "version": "0.4"}]
    else:
        group.attrs["ome"] = {"version": "0.5", "multiscales": [image]}


@pytest.mark.parametrize("version", ["0.4", "0.5"])
def test_an_ome_zarr_is_read_by_its_axes(tmp_path: Path, version: str) -> None:
    """Z is the plane, and T and C are rows and columns of positions, as in an OME-TIFF; a series needs its order."""
    path = tmp_path / "scan.ome.zarr"
    write_zarr(path, FRAMES.transpose(1, 2, 0, 3, 4), "tczyx", version)
    with open_frames(path) as frames:
        assert len(frames) == 24 and frames.shape == (16, 18) and frames.dtype == np.uint16
        for k in range(24):
            np.testing.assert_array_equal(frames.read(k), FRAMES[tuple(frames.info(k).position)])
        np.testing.assert_array_equal(frames.read(3, (slice(2, 9), slice(5, 7))), frames.read(3)[2:9, 5:7])
    for place in (path, path / (".zattrs" if version == "0.4" else "zarr.json")):
        image = open_image(place)
        assert image.metadata["pixel_um"] == 0.5 and image.pages == 24
    write_zarr(tmp_path / "one.zarr", FRAMES[0, 0, 0], "yx", version)
    np.testing.assert_array_equal(read_image(tmp_path / "one.zarr"), FRAMES[0, 0, 0])
    series = tmp_path / "series.zarr"
    write_zarr(series, FRAMES.reshape(24, 16, 18), "tyx", version)
    with pytest.raises(InputError, match="a scan order"):
        open_frames(series)
    with open_frames(series, order="serpentine", plan_shape=(2, 3, 4)) as frames:
        assert [tuple(frames.info(k).position) for k in (3, 4)] == [(0, 0, 3), (0, 1, 3)]
        np.testing.assert_array_equal(frames.read(4), FRAMES[0, 1, 0])


def test_images_of_several_positions_and_a_plain_array(tmp_path: Path) -> None:
    """Layout bioformats2raw: images 0, 1, … 11, each a stack of planes. A plain array has the axes of a scan."""
    zarr = pytest.importorskip("zarr", reason="zarr is not installed")
    root = zarr.open_group(tmp_path / "s.zarr", mode="w", zarr_format=3)
    root.attrs["ome"] = {"version": "0.5", "bioformats2raw.layout": 3}
    for k in range(12):
        write_zarr(tmp_path / "s.zarr" / str(k), FRAMES[:, k // 4, k % 4], "zyx", "0.5")
    with open_frames(tmp_path / "s.zarr", order="raster", plan_shape=(2, 3, 4)) as frames:
        for k in range(24):
            np.testing.assert_array_equal(frames.read(k), FRAMES.reshape(24, 16, 18)[k])
    with open_frames(f"{tmp_path / 's.zarr'}::11", order="raster", plan_shape=(1, 1, 2)) as frames:
        np.testing.assert_array_equal(frames.read(1), FRAMES[1, 2, 3])
    zarr.save_array(tmp_path / "a.zarr", FRAMES, zarr_format=3)
    with open_frames(tmp_path / "a.zarr") as frames:
        np.testing.assert_array_equal(frames.read(23), FRAMES[1, 2, 3])
        assert tuple(frames.info(23).position) == (1, 2, 3)


def test_zarr_codecs_that_are_unknown_run_code_or_lose_information_are_refused(tmp_path: Path) -> None:
    for version, place in (("0.4", "0/.zarray"), ("0.5", "0/zarr.json")):
        path = tmp_path / f"{version}.zarr"
        write_zarr(path, FRAMES, "tczyx", version)
        said = json.loads((path / place).read_text())
        foreign = [*said.get("codecs", [])[:-1], {"name": "foreign", "configuration": {}}]
        wrong = {"compressor": {"id": "foreign"}} if version == "0.4" else {"codecs": foreign}
        (path / place).write_text(json.dumps(said | wrong))
        words = r"codecs .* lossless, got .*foreign.*; write the image with zlib, zstd or"
        with pytest.raises(FileFormatError, match=words):
            open_frames(path)
        lossy = {"id": "quantize", "digits": 1, "dtype": "<f4"}
        known = {"pickle": {"compressor": {"id": "pickle", "protocol": 5}}, "quantize": {"filters": [lossy]}}
        for name, wrong in known.items() if version == "0.4" else ():
            (path / place).write_text(json.dumps(said | wrong))
            with pytest.raises((FileFormatError, UnsafeFileError), match=name):  # zarr itself refuses some
                open_frames(path)


def test_damaged_stores_are_reported(tmp_path: Path) -> None:
    path = tmp_path / "s.zarr"
    write_zarr(path, FRAMES.reshape(24, 16, 18), "tyx", "0.5")
    piece = path / "0" / "c" / "5" / "0" / "0"
    piece.write_bytes(piece.read_bytes()[:20])
    with open_frames(path, order="raster", plan_shape=(2, 3, 4)) as frames:
        frames.read(4)
        with pytest.raises(FileFormatError, match="damaged data"):
            frames.read(5)
    (path / "zarr.json").write_text("{")
    with pytest.raises(FileFormatError, match="an OME-Zarr image"):
        open_frames(path, order="raster", plan_shape=(2, 3, 4))


def index_entry(axes: dict[str, Any], file: str, numbers: tuple[int, ...]) -> bytes:
    words, name = json.dumps(axes).encode(), file.encode()
    return struct.pack("<I", len(words)) + words + struct.pack("<I", len(name)) + name + struct.pack("<8I", *numbers)


def write_ndtiff(folder: Path, entries: Entries, kind: int = 4, end: bytes = b"\0\0\0\0") -> None:
    """Write images as pages of TIFF files of ten images each, with the index; the pages' headers are not needed."""
    folder.mkdir()
    index, files = b"", {}
    for k, (axes, image, said) in enumerate(entries):
        file = f"scan_NDTiffStack{'' if k < 10 else f'_{k // 10}'}.tif"
        body = files.setdefault(file, bytearray(b"II*\0" + bytes(60)))
        words = json.dumps(said).encode() + b"\0"
        start = len(body)
        body += image.astype("<u2").tobytes() + words
        rows, columns = image.shape
        index += index_entry(axes, file, (start, columns, rows, kind, 0, start + image.size * 2, len(words), 0))
    for file, body in files.items():
        (folder / file).write_bytes(body)
    (folder / "NDTiff.index").write_bytes(index + end)


def test_ndtiff_with_rows_and_columns(tmp_path: Path) -> None:
    places = [(z, y, x) for y in range(3) for x in range(4) for z in range(2)]
    said = {"Exposure": 12.5}
    entries: Entries = [({"row": y, "column": x, "z": z}, FRAMES[z, y, x], said) for z, y, x in places]
    write_ndtiff(tmp_path / "scan", entries)
    with open_frames(tmp_path / "scan") as frames:
        assert len(frames) == 24 and frames.metadata.bit_depth == 12
        for k in range(24):
            np.testing.assert_array_equal(frames.read(k), FRAMES[tuple(frames.info(k).position)])
            assert frames.info(k).exposure_s == 0.0125
        np.testing.assert_array_equal(frames.read(20, (slice(2, 9), slice(5, 7))), frames.read(20)[2:9, 5:7])


def test_ndtiff_in_the_order_of_acquisition(tmp_path: Path) -> None:
    """An acquisition that was stopped has no end; an image that was recorded again replaces the earlier one."""
    entries: Entries = [({"time": k}, FRAMES.reshape(24, 16, 18)[k], {}) for k in range(24)]
    write_ndtiff(tmp_path / "scan", [entries[0], *entries], kind=1, end=b"")
    with open_frames(tmp_path / "scan", order="serpentine", plan_shape=(2, 3, 4)) as frames:
        np.testing.assert_array_equal(frames.read(4), FRAMES[0, 1, 0])
        assert tuple(frames.info(4).position) == (0, 1, 3)


def test_ndtiff_with_stage_coordinates(tmp_path: Path) -> None:
    plan: ScanPlan = small_plan()
    order, shape = plan.order_indices(), plan.camera.sensor.shape
    names = [f"{axis}Position_um_Intended" for axis in "XYZ"]
    images = [np.random.default_rng(k).integers(0, 4000, shape, np.uint16) for k in range(len(order))]
    said = [dict(zip(names, map(float, place), strict=True)) for place in plan.stage_um(order)]
    write_ndtiff(tmp_path / "scan", [({"position": k}, image, said[k]) for k, image in enumerate(images)])
    with open_frames(tmp_path / "scan", plan=plan) as source:
        assert len(source) == len(order)
        for k in range(len(source)):
            at = order.tolist().index(list(source.info(k).position))
            np.testing.assert_array_equal(source.read(k), images[at])
        assert any("stage coordinates" in note for note in source.metadata.notes)


def test_a_channel_of_ndtiff_is_named(tmp_path: Path) -> None:
    both = [(k, z) for k in range(4) for z in range(2)]
    entries: Entries = [({"row": 0, "column": k, "channel": "AB"[z]}, FRAMES[z, 0, k], {}) for k, z in both]
    write_ndtiff(tmp_path / "scan", entries)
    with pytest.raises(InputError, match="one of A, B, got none; name it as scan::A"):
        open_frames(tmp_path / "scan")
    with open_frames(f"{tmp_path / 'scan'}::B") as frames:
        np.testing.assert_array_equal(frames.read(2), FRAMES[1, 0, 2])


def test_damaged_indices_of_ndtiff_are_refused(tmp_path: Path) -> None:
    write_ndtiff(tmp_path / "s", [({"row": 0, "column": 0}, FRAMES[0, 0, 0], {})])
    name, good = "scan_NDTiffStack.tif", (64, 18, 16, 4, 0, 0, 0, 0)
    bad: list[tuple[str, tuple[int, ...], type[Exception], str]] = [
        ("../other.tif", good, UnsafeFileError, "names of files in the same folder"),
        ("none.tif", good, StorageError, "No such file"),
        (name, (10_000, *good[1:]), FileFormatError, "all images of the index"),
        (name, (64, 18, 16, 2, 0, 0, 0, 0), FileFormatError, "grey data"),
        (name, (64, 18, 16, 9, 0, 0, 0, 0), FileFormatError, "uncompressed images, got type 9"),
        (name, (64, 1 << 31, 16, 4, 0, 0, 0, 0), UnsafeFileError, "px per side"),
        (name, good, FileFormatError, "an intact NDTiff index"),
    ]
    for k, (file, numbers, kind, words) in enumerate(bad):
        data = index_entry({"row": 0, "column": 0}, file, numbers)
        (tmp_path / "s" / "NDTiff.index").write_bytes(data if k < len(bad) - 1 else data[:-12])
        with pytest.raises(kind, match=words) as raised:
            open_frames(tmp_path / "s")
        assert "\n" not in str(raised.value)


# -- HDF5 of other programs --------------------------------------------------------------------------------------------


SERIES = np.arange(6 * 5 * 4, dtype=np.uint16).reshape(6, 5, 4)
OTHER = SERIES + 500
DARK = np.full((2, 5, 4), 7, np.uint16)


def area_detector(file: h5py.File) -> None:
    """Write what an EPICS area detector writes (areaDetector/ADCore#28): the stack lies deep, and the default leads."""
    file.attrs["default"] = "entry"
    file.create_group("entry").attrs["default"] = "data"
    data = file["entry"].create_group("data")
    data.attrs["signal"] = "data"
    data["data"] = SERIES
    file["entry/instrument/detector/other"] = OTHER


def nexus_by_link(file: h5py.File) -> None:
    """Write plot data that are a soft link to the detector's (apstools#781)."""
    file["entry/instrument/detector/data"] = SERIES
    file["entry/plot/image"] = h5py.SoftLink("/entry/instrument/detector/data")
    file["entry/extra"] = OTHER
    file.attrs["default"] = np.bytes_(b"entry")
    file["entry"].attrs["default"] = "plot"
    file["entry/plot"].attrs["signal"] = "image"


def data_exchange(file: h5py.File) -> None:
    """Write the layout of tomography beamlines (Dioptas#119): dark and white frames lie in the same group."""
    file["exchange/data"] = SERIES
    file["exchange/data_dark"] = DARK
    file["exchange/data_white"] = DARK + 900


def old_nexus(file: h5py.File) -> None:
    """Write a signal marked by a number (GSAS-II#71)."""
    file["entry/data/counts"] = SERIES
    file["entry/data"].attrs["signal"] = 1


def marked_dataset(file: h5py.File) -> None:
    """Write two stacks, of which a number marks the signal (the older NeXus convention)."""
    file["entry/data/counts"], file["entry/data/monitor"] = SERIES, OTHER
    file["entry/data/counts"].attrs["signal"] = 1
    file["entry/data/monitor"].attrs["signal"] = "2"


def one_below(file: h5py.File) -> None:
    """Write one stack in a group, twice by hard links, with a table that is no stack."""
    file["measurement/frames"] = SERIES
    file["copy"] = file["measurement/frames"]
    file["measurement/time"] = np.arange(6.0)


def filled(path: Path, write: Callable[[h5py.File], None]) -> Path:
    with h5py.File(path, "w") as file:
        write(file)
    return path


def test_the_stack_of_another_program_is_found(tmp_path: Path) -> None:
    path = tmp_path / "scan.h5"
    for write in (area_detector, nexus_by_link, data_exchange, old_nexus, marked_dataset, one_below):
        with open_frames(filled(path, write), order="raster", plan_shape=(1, 2, 3)) as frames:
            np.testing.assert_array_equal([frames.read(k) for k in range(6)], SERIES, err_msg=write.__name__)
    with open_frames(filled(path, data_exchange), order="raster", plan_shape=(1, 2, 3)) as frames:
        dark, white = sorted(frames.metadata.notes)
    assert dark.endswith(f"--dark {path}::/exchange/data_dark")
    assert white.endswith(f"--white {path}::/exchange/data_white")


def test_of_several_stacks_one_is_named_after_the_file(tmp_path: Path) -> None:
    path = tmp_path / "scan.h5"
    with h5py.File(path, "w") as file:
        file["lamp/on"], file["lamp/off"] = SERIES, OTHER
    with pytest.raises(FileFormatError, match=r"got .*/lamp/off \(6, 5, 4\).*; name it as scan\.h5::/lamp/o"):
        open_image(path)
    np.testing.assert_array_equal(read_image(f"{path}::/lamp/off", 2), OTHER[2])
    with open_frames(f"{path}::lamp/on", order="raster", plan_shape=(1, 2, 3)) as frames:
        np.testing.assert_array_equal(frames.read(4), SERIES[4])
    with pytest.raises(FileFormatError, match="lamp/no"):
        open_image(f"{path}::/lamp/no")
    np.save(tmp_path / "a::b.npy", SERIES)
    assert open_image(tmp_path / "a::b.npy").pages == 6, "the name of a file may contain the mark"


def test_links_that_lead_out_or_in_a_circle_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.h5"
    with h5py.File(path, "w") as file:
        file["round"], file["there"] = h5py.SoftLink("/there"), h5py.SoftLink("round")
        file["out"] = h5py.ExternalLink("b.h5", "/x")
        file["over"], file["lost"] = h5py.SoftLink("/out"), h5py.SoftLink("/nowhere/x")
    with pytest.raises(
        FileFormatError, match="/lost: expected a dataset, got a link to /nowhere/x, which does not exi"
    ):
        open_image(path, dataset="lost")
    for name, words in (("round", "a chain of soft links"), ("over", "ExternalLink")):
        with pytest.raises(UnsafeFileError, match=words):
            open_image(path, dataset=name)
