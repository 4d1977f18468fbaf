"""Folders that contain all frames: OME-Zarr as specified, and NDTiff as Micro-Manager writes it."""

from __future__ import annotations

import json
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from lfcal.base.errors import FileFormatError, InputError, StorageError, UnsafeFileError
from lfcal.camera import ScanPlan
from lfcal.frames import open_frames
from lfcal.frames.formats import open_image
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
    image = {
        "axes": [{"name": axis, "type": kinds.get(axis, "space"), "unit": "micrometer"} for axis in axes],
        "datasets": [
            {"path": "0", "coordinateTransformations": [{"type": "scale", "scale": [1.0] * (array.ndim - 1) + [0.5]}]}
        ],
    }
    if version == "0.4":
        group.attrs["multiscales"] = [{**image, "version": "0.4"}]
    else:
        group.attrs["ome"] = {"version": "0.5", "multiscales": [image]}


@pytest.mark.parametrize("version", ["0.4", "0.5"])
def test_an_ome_zarr_is_read_by_its_axes(tmp_path: Path, version: str) -> None:
    """Z is the plane, and T and C are rows and columns of positions, as in an OME-TIFF."""
    path = tmp_path / "scan.ome.zarr"
    write_zarr(path, FRAMES.transpose(1, 2, 0, 3, 4), "tczyx", version)
    with open_frames(path) as frames:
        assert len(frames) == 24 and frames.shape == (16, 18) and frames.dtype == np.uint16
        for k in range(24):
            np.testing.assert_array_equal(frames.read(k), FRAMES[tuple(frames.info(k).position)])
        np.testing.assert_array_equal(frames.read(3, (slice(2, 9), slice(5, 7))), frames.read(3)[2:9, 5:7])
    image = open_image(path / (".zattrs" if version == "0.4" else "zarr.json"))
    assert image.metadata["pixel_um"] == 0.5


@pytest.mark.parametrize("version", ["0.4", "0.5"])
def test_a_series_needs_its_order(tmp_path: Path, version: str) -> None:
    path = tmp_path / "scan.zarr"
    write_zarr(path, FRAMES.reshape(24, 16, 18), "tyx", version)
    with pytest.raises(InputError, match="a scan order"):
        open_frames(path)
    with open_frames(path, order="serpentine", plan_shape=(2, 3, 4)) as frames:
        assert [tuple(frames.info(k).position) for k in (3, 4)] == [(0, 0, 3), (0, 1, 3)]
        np.testing.assert_array_equal(frames.read(4), FRAMES[0, 1, 0])


def test_images_of_several_positions(tmp_path: Path) -> None:
    """Layout bioformats2raw: images 0, 1, … 11, each a stack of planes."""
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


@pytest.mark.parametrize("version", ["0.4", "0.5"])
def test_a_codec_of_another_program_is_named_with_the_remedy(tmp_path: Path, version: str) -> None:
    write_zarr(tmp_path / "s.zarr", FRAMES, "tczyx", version)
    place = tmp_path / "s.zarr" / "0" / (".zarray" if version == "0.4" else "zarr.json")
    said = json.loads(place.read_text())
    if version == "0.4":
        said["compressor"] = {"id": "foreign"}
    else:
        said["codecs"][-1] = {"name": "foreign", "configuration": {}}
    place.write_text(json.dumps(said))
    with pytest.raises(
        FileFormatError, match=r"codecs .* lossless, got .*foreign.*; write the image with zlib, zstd or"
    ):
        open_frames(tmp_path / "s.zarr")


def test_a_plain_array_of_a_scan(tmp_path: Path) -> None:
    zarr = pytest.importorskip("zarr", reason="zarr is not installed")
    zarr.save_array(tmp_path / "a.zarr", FRAMES, zarr_format=3)
    with open_frames(tmp_path / "a.zarr") as frames:
        np.testing.assert_array_equal(frames.read(23), FRAMES[1, 2, 3])
        assert tuple(frames.info(23).position) == (1, 2, 3)


def test_zarr_codecs_that_run_code_or_lose_information_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "s.zarr"
    write_zarr(path, FRAMES.reshape(24, 16, 18), "tyx", "0.4")
    place = path / "0" / ".zarray"
    said = json.loads(place.read_text())
    lossy = {"id": "quantize", "digits": 1, "dtype": "<f4"}
    for wrong, name in (
        ({"compressor": {"id": "pickle", "protocol": 5}}, "pickle"),
        ({"filters": [lossy]}, "quantize"),
    ):
        place.write_text(json.dumps(said | wrong))
        with pytest.raises((FileFormatError, UnsafeFileError), match=name):  # zarr itself refuses some
            open_frames(path, order="raster", plan_shape=(2, 3, 4))


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
    write_ndtiff(
        tmp_path / "scan",
        [({"row": y, "column": x, "z": z}, FRAMES[z, y, x], {"Exposure": 12.5}) for z, y, x in places],
    )
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
    order = plan.order_indices()
    names = ("XPosition_um_Intended", "YPosition_um_Intended", "ZPosition_um_Intended")
    shape = plan.camera.sensor.shape
    frames = {
        tuple(at): np.random.default_rng(k).integers(0, 4000, shape, np.uint16) for k, at in enumerate(order.tolist())
    }
    said = [dict(zip(names, map(float, place), strict=True)) for place in plan.stage_um(order)]
    write_ndtiff(
        tmp_path / "scan",
        [({"position": k}, frames[tuple(at)], said[k]) for k, at in enumerate(order.tolist())],
    )
    with open_frames(tmp_path / "scan", plan=plan) as source:
        assert len(source) == len(order)
        for k in range(len(source)):
            np.testing.assert_array_equal(source.read(k), frames[tuple(source.info(k).position)])
        assert any("stage coordinates" in note for note in source.metadata.notes)


def test_a_channel_of_ndtiff_is_named(tmp_path: Path) -> None:
    entries: Entries = [
        ({"row": 0, "column": k, "channel": name}, FRAMES[z, 0, k], {})
        for k in range(4)
        for z, name in enumerate(("A", "B"))
    ]
    write_ndtiff(tmp_path / "scan", entries)
    with pytest.raises(InputError, match="one of A, B, got none; name it as scan::A"):
        open_frames(tmp_path / "scan")
    with open_frames(f"{tmp_path / 'scan'}::B") as frames:
        np.testing.assert_array_equal(frames.read(2), FRAMES[1, 0, 2])


@pytest.mark.parametrize(
    ("change", "kind", "words"),
    [
        ({"file": "../other.tif"}, UnsafeFileError, "names of files in the same folder"),
        ({"file": "none.tif"}, StorageError, "No such file"),
        ({"numbers": (10_000, 18, 16, 4, 0, 0, 0, 0)}, FileFormatError, "all images of the index"),
        ({"numbers": (64, 18, 16, 2, 0, 0, 0, 0)}, FileFormatError, "grey data"),
        ({"numbers": (64, 18, 16, 9, 0, 0, 0, 0)}, FileFormatError, "uncompressed images, got type 9"),
        ({"numbers": (64, 1 << 31, 16, 4, 0, 0, 0, 0)}, UnsafeFileError, "px per side"),
        ({"cut": 12}, FileFormatError, "an intact NDTiff index"),
    ],
)
def test_damaged_indices_are_refused(tmp_path: Path, change: dict[str, Any], kind: type[Exception], words: str) -> None:
    write_ndtiff(tmp_path / "s", [({"row": 0, "column": 0}, FRAMES[0, 0, 0], {})])
    file, numbers = change.get("file", "scan_NDTiffStack.tif"), change.get("numbers", (64, 18, 16, 4, 0, 0, 0, 0))
    data = index_entry({"row": 0, "column": 0}, file, numbers)
    (tmp_path / "s" / "NDTiff.index").write_bytes(data[: len(data) - change.get("cut", 0)])
    with pytest.raises(kind, match=words) as raised:
        open_frames(tmp_path / "s")
    assert "\n" not in str(raised.value)
