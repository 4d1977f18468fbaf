"""Every reader gives back the samples that were written, whole and by region."""

from __future__ import annotations

import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import cv2
import h5py
import hdf5plugin
import numpy as np
import pytest
import tifffile

from lfcal.base.errors import FileFormatError, InputError, StorageError
from lfcal.frames import open_frames, open_image, read_image
from lfcal.frames.formats.tiff import count_pages
from tests.frames.scenes import session

STACK = session((5, 24, 31))


def written(folder: Path, kind: str) -> Path:
    """Write ``STACK`` (or its first frame) as ``kind`` and return the file."""
    path = folder / f"frames.{kind.split('-')[0]}"
    options = {
        "tif": {"photometric": "minisblack"},
        "tif-deflate": {"photometric": "minisblack", "compression": "zlib", "predictor": True},
        "tif-lzw-strips": {"photometric": "minisblack", "compression": "lzw", "rowsperstrip": 7},
        "tif-tiles": {"photometric": "minisblack", "tile": (16, 16)},
        "tif-big-endian": {"photometric": "minisblack", "byteorder": ">", "metadata": None},
        "tif-bigtiff": {"photometric": "minisblack", "bigtiff": True},
        "tif-imagej": {"imagej": True},
    }
    if kind in options:
        tifffile.imwrite(path, STACK, **options[kind])
    elif kind == "npy":
        np.save(path, STACK)
    elif kind == "npy-swapped":
        np.save(path, STACK.astype(">u2"))
    elif kind.startswith("h5"):
        with h5py.File(path, "w") as file:
            how = {"chunks": (1, 24, 31), **hdf5plugin.Zstd()} if kind == "h5-zstd" else {}
            file.create_dataset("frames", data=STACK, **how)
    return path


MANY = [
    "tif",
    "tif-deflate",
    "tif-lzw-strips",
    "tif-tiles",
    "tif-big-endian",
    "tif-bigtiff",
    "tif-imagej",
    "npy",
    "npy-swapped",
    "h5",
    "h5-zstd",
]


@pytest.mark.parametrize("kind", MANY)
def test_stack_round_trip(tmp_path: Path, kind: str) -> None:
    image = open_image(written(tmp_path, kind))
    try:
        assert (image.pages, image.shape, image.dtype) == (5, (24, 31), np.dtype(np.uint16))
        for page in (4, 0, 2):
            frame = image.read(page)
            np.testing.assert_array_equal(frame, STACK[page])
            assert frame.flags.writeable and frame.flags.c_contiguous and frame.dtype.isnative
            part = image.read_region(page, slice(3, 17), slice(5, 6))
            np.testing.assert_array_equal(part, STACK[page, 3:17, 5:6])
        with pytest.raises(FileFormatError, match=r"expected page 5, got 5 pages \(0 … 4\)"):
            image.read(5)
        with pytest.raises(InputError, match="region rows"):
            image.read_region(0, slice(3, 25), slice(0, 3))
    finally:
        image.close()


@pytest.mark.parametrize("kind", ["tif-deflate", "tif", "h5-zstd", "npy"])
def test_reading_in_threads(tmp_path: Path, kind: str) -> None:
    image = open_image(written(tmp_path, kind))
    try:
        with ThreadPoolExecutor(8) as pool:
            frames = list(pool.map(lambda k: image.read(k % 5), range(100)))
    finally:
        image.close()
    assert all(np.array_equal(frame, STACK[k % 5]) for k, frame in enumerate(frames))


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("suffix", ["png", "pgm", "tif"])
def test_single_frame_round_trip(tmp_path: Path, dtype: type, suffix: str) -> None:
    frame = (STACK[0] // 16).astype(dtype)
    assert cv2.imwrite(str(tmp_path / f"a.{suffix}"), frame)
    read = read_image(tmp_path / f"a.{suffix}")
    assert read.dtype == dtype
    np.testing.assert_array_equal(read, frame)


def test_pgm_keeps_samples_and_takes_the_highest_value_as_saturation(tmp_path: Path) -> None:
    head = b"P5 # camera 7\n31\n# a line\n24 4095\n"
    (tmp_path / "a.pgm").write_bytes(head + STACK[0].astype(">u2").tobytes())
    image = open_image(tmp_path / "a.pgm")
    np.testing.assert_array_equal(image.read(), STACK[0])
    np.testing.assert_array_equal(image.read_region(0, slice(2, 9), slice(30, 31)), STACK[0, 2:9, 30:31])
    assert image.metadata["saturation"] == 4095


@pytest.mark.parametrize("dtype", [np.float32, np.float64, np.int16, np.uint32])
def test_other_sample_types_of_tiff(tmp_path: Path, dtype: type) -> None:
    frame = STACK[0].astype(dtype) - (100 if np.dtype(dtype).kind != "u" else 0)
    tifffile.imwrite(tmp_path / "a.tif", frame)
    assert read_image(tmp_path / "a.tif").dtype == dtype
    np.testing.assert_array_equal(read_image(tmp_path / "a.tif"), frame)


@pytest.mark.parametrize("suffix", ["png", "tif"])
def test_component_of_a_colour_image_in_rgb_order(tmp_path: Path, suffix: str) -> None:
    rgb = session((24, 31, 3))
    if suffix == "png":
        assert cv2.imwrite(str(tmp_path / "a.png"), rgb[..., ::-1])  # OpenCV writes BGR
    else:
        tifffile.imwrite(tmp_path / "a.tif", rgb, photometric="rgb")
    for k, colour in enumerate("RGB"):
        np.testing.assert_array_equal(read_image(tmp_path / f"a.{suffix}", colour=colour), rgb[..., k])
    with pytest.raises(FileFormatError, match="3 samples of 16 bits per pixel; record RAW, or use one"):
        read_image(tmp_path / f"a.{suffix}")


def test_planar_colour_tiff(tmp_path: Path) -> None:
    rgb = session((3, 24, 31))
    tifffile.imwrite(tmp_path / "a.tif", rgb, photometric="rgb", planarconfig="separate")
    np.testing.assert_array_equal(read_image(tmp_path / "a.tif", colour="B"), rgb[2])


def test_kind_is_told_by_content_not_by_name(tmp_path: Path) -> None:
    assert cv2.imwrite(str(tmp_path / "a.png"), STACK[0])
    (tmp_path / "a.png").rename(tmp_path / "a.tif")
    np.testing.assert_array_equal(read_image(tmp_path / "a.tif"), STACK[0])


def test_imagej_file_with_many_images_behind_one_page(tmp_path: Path) -> None:
    description = "ImageJ=1.53t\nimages=5\nslices=5\nloop=false\n"
    tifffile.imwrite(tmp_path / "a.tif", STACK[0], description=description, metadata=None, byteorder=">")
    with (tmp_path / "a.tif").open("ab") as file:
        file.write(STACK[1:].astype(">u2").tobytes())
    assert count_pages(tmp_path / "a.tif") == 1
    image = open_image(tmp_path / "a.tif")
    assert image.pages == 5
    for page in range(5):
        np.testing.assert_array_equal(image.read(page), STACK[page])
    image.close()
    data = (tmp_path / "a.tif").read_bytes()
    (tmp_path / "a.tif").write_bytes(data[:-10])
    image = open_image(tmp_path / "a.tif")
    with pytest.raises(FileFormatError, match="samples of page 4 are missing"):
        image.read(4)
    image.close()


def test_import_of_the_package_loads_no_reader() -> None:
    code = (
        "import sys, lfcal.frames as f; f.open_frames; "
        "print([m for m in ('cv2', 'rawpy', 'tifffile', 'h5py', 'numba') if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="this system has no named pipes")
def test_a_pipe_is_refused(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "a.png")
    with pytest.raises(StorageError, match="is a pipe or a device"):
        read_image(tmp_path / "a.png")


@pytest.mark.parametrize("compression", [None, "zlib"])
def test_the_calibration_of_imagej_is_applied(tmp_path: Path, compression: str | None) -> None:
    """ImageJ stores signed 16-bit samples as unsigned ones with an offset (tlnagy/TiffImages.jl, cpp-tiff#10)."""
    signed = np.arange(-30, 30, dtype=np.int32).reshape(3, 4, 5)
    words = "ImageJ=1.53t\nimages=3\nslices=3\ncf=0\nc0={}\nc1={}\nvunit=Gray Value\n"

    def written(name: str, offset: float, slope: float) -> Path:
        stored = np.rint((signed - offset) / slope).astype(np.uint16)
        text = words.format(offset, slope)
        options: dict[str, Any] = {"compression": compression, "photometric": "minisblack", "metadata": None}
        tifffile.imwrite(tmp_path / name, stored, description=text, software=None, **options)
        return tmp_path / name

    image = open_image(written("signed.tif", -32768, 1))
    assert image.dtype == np.int32
    np.testing.assert_array_equal([image.read(k) for k in range(3)], signed)
    np.testing.assert_array_equal(image.read_region(2, slice(1, 3), slice(2, 5)), signed[2, 1:3, 2:5])
    image.close()
    stored = np.arange(20, dtype=np.uint16).reshape(4, 5)
    options: dict[str, Any] = {"compression": compression, "photometric": "minisblack", "metadata": None}
    text = words.replace("images=3\nslices=3\n", "").format(1 << 32, 1)
    tifffile.imwrite(tmp_path / "wide.tif", stored, description=text, software=None, **options)
    wide = open_image(tmp_path / "wide.tif")
    assert wide.read().min() == 1 << 32, "more than 32-bit integers hold"
    wide.close()
    with open_frames(written("half.tif", -100.5, 0.5), order="raster", plan_shape=(1, 1, 3)) as frames:
        np.testing.assert_allclose(frames.read(1), signed[1], atol=0.26)
        assert frames.metadata.notes == ("ImageJ's calibration is applied: -100.5 + 0.5 x the stored value",)
