"""Every reader gives back the samples that were written, whole and by region: TIFF, PNG, FITS, other packages."""

from __future__ import annotations

import os
import struct
import subprocess
import sys
import zlib
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import cv2
import h5py
import hdf5plugin
import numpy as np
import pytest
import tifffile
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from lfcal.base.errors import FileFormatError, InputError, StorageError, UnsafeFileError
from lfcal.base.registry import Registry
from lfcal.frames import open_frames, open_image, read_image
from lfcal.frames.formats import image_file
from lfcal.frames.formats.tiff import count_pages
from tests.distribution import code_of, install
from tests.frames.scenes import png_chunk, session

STACK = session((5, 24, 31))


TIFF: dict[str, dict[str, Any]] = {
    "tif": {},
    "tif-deflate": {"compression": "zlib", "predictor": True},
    "tif-lzw-strips": {"compression": "lzw", "rowsperstrip": 7},
    "tif-tiles": {"tile": (16, 16)},
    "tif-big-endian": {"byteorder": ">", "metadata": None},
    "tif-bigtiff": {"bigtiff": True},
    "tif-imagej": {"imagej": True},
}
MANY = [*TIFF, "npy", "npy-swapped", "h5", "h5-zstd"]


def written(folder: Path, kind: str) -> Path:
    """Write ``STACK`` as ``kind`` and return the file."""
    path = folder / f"frames.{kind.split('-')[0]}"
    if kind in TIFF:
        tifffile.imwrite(path, STACK, **{"photometric": "minisblack"} | TIFF[kind])
    elif kind.startswith("npy"):
        np.save(path, STACK.astype(">u2" if kind == "npy-swapped" else "u2"))
    else:
        with h5py.File(path, "w") as file:
            how = {"chunks": (1, 24, 31), **hdf5plugin.Zstd()} if kind == "h5-zstd" else {}
            file.create_dataset("frames", data=STACK, **how)
    return path


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


def test_single_frames_and_their_sample_types(tmp_path: Path) -> None:
    for suffix in ("png", "pgm", "tif"):
        for dtype in (np.uint8, np.uint16):
            frame, path = (STACK[0] // 16).astype(dtype), tmp_path / f"a.{suffix}"
            assert cv2.imwrite(str(path), frame)
            read = read_image(path)
            assert read.dtype == dtype and np.array_equal(read, frame), (suffix, dtype)
    for dtype in (np.float32, np.float64, np.int16, np.uint32):
        frame = STACK[0].astype(dtype) - (100 if np.dtype(dtype).kind != "u" else 0)
        tifffile.imwrite(tmp_path / "a.tif", frame)
        read = read_image(tmp_path / "a.tif")
        assert read.dtype == dtype and np.array_equal(read, frame), dtype
    # the content says what a file is, not its name
    (tmp_path / "a.png").rename(tmp_path / "b.tif")
    np.testing.assert_array_equal(read_image(tmp_path / "b.tif"), STACK[0] // 16)


def test_pgm_keeps_samples_and_takes_the_highest_value_as_saturation(tmp_path: Path) -> None:
    head = b"P5 # camera 7\n31\n# a line\n24 4095\n"
    (tmp_path / "a.pgm").write_bytes(head + STACK[0].astype(">u2").tobytes())
    image = open_image(tmp_path / "a.pgm")
    np.testing.assert_array_equal(image.read(), STACK[0])
    np.testing.assert_array_equal(image.read_region(0, slice(2, 9), slice(30, 31)), STACK[0, 2:9, 30:31])
    assert image.metadata["saturation"] == 4095


def test_components_of_colour_images_are_in_rgb_order(tmp_path: Path) -> None:
    rgb = session((24, 31, 3))
    assert cv2.imwrite(str(tmp_path / "a.png"), rgb[..., ::-1])  # OpenCV writes BGR
    tifffile.imwrite(tmp_path / "a.tif", rgb, photometric="rgb")
    planes = np.ascontiguousarray(rgb.transpose(2, 0, 1))
    tifffile.imwrite(tmp_path / "b.tif", planes, photometric="rgb", planarconfig="separate")
    for name in ("a.png", "a.tif", "b.tif"):
        for k, colour in enumerate("RGB"):
            np.testing.assert_array_equal(read_image(tmp_path / name, colour=colour), rgb[..., k], err_msg=name)
    for name in ("a.png", "a.tif"):
        with pytest.raises(FileFormatError, match="3 samples of 16 bits per pixel; record RAW, or use one"):
            read_image(tmp_path / name)


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
    (tmp_path / "a.tif").write_bytes((tmp_path / "a.tif").read_bytes()[:-10])
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

    def written(name: str, stored: np.ndarray, offset: float, slope: float) -> Path:
        pages = f"images={len(stored)}\nslices={len(stored)}\n" if stored.ndim == 3 else ""
        text = f"ImageJ=1.53t\n{pages}cf=0\nc0={offset}\nc1={slope}\nvunit=Gray Value\n"
        options: dict[str, Any] = {"compression": compression, "photometric": "minisblack", "metadata": None}
        tifffile.imwrite(tmp_path / name, stored.astype(np.uint16), description=text, software=None, **options)
        return tmp_path / name

    image = open_image(written("signed.tif", signed + 32768, -32768, 1))
    assert image.dtype == np.int32
    np.testing.assert_array_equal([image.read(k) for k in range(3)], signed)
    np.testing.assert_array_equal(image.read_region(2, slice(1, 3), slice(2, 5)), signed[2, 1:3, 2:5])
    image.close()
    wide = open_image(written("wide.tif", np.arange(20).reshape(4, 5), 1 << 32, 1))
    assert wide.read().min() == 1 << 32, "more than 32-bit integers hold"
    wide.close()
    path = written("half.tif", np.rint((signed + 100.5) / 0.5), -100.5, 0.5)
    with open_frames(path, order="raster", plan_shape=(1, 1, 3)) as frames:
        np.testing.assert_allclose(frames.read(1), signed[1], atol=0.26)
        assert frames.metadata.notes == ("ImageJ's calibration is applied: -100.5 + 0.5 x the stored value",)


# -- PNG ---------------------------------------------------------------------------------------------------------------


def png(image: np.ndarray, filters: list[int], *, rows: bytes | None = None, parts: int = 1) -> bytes:
    """Write a grey PNG with the given filter of each row; the bytes of filtered rows may be given instead."""
    size = image.dtype.itemsize
    raw = image.astype(image.dtype.newbyteorder(">")).view(np.uint8).reshape(len(image), -1).astype(int)
    stream = b""
    for r, line in enumerate(raw):
        above = raw[r - 1] if r else np.zeros_like(line)
        left = np.concatenate([np.zeros(size, int), line[:-size]])
        corner = np.concatenate([np.zeros(size, int), above[:-size]])
        p = left + above - corner
        near = [np.abs(p - left), np.abs(p - above), np.abs(p - corner)]
        paeth = np.where((near[0] <= near[1]) & (near[0] <= near[2]), left, np.where(near[1] <= near[2], above, corner))
        guess = [0, left, above, (left + above) // 2, paeth][filters[r]]
        stream += bytes([filters[r]]) + ((line - guess) % 256).astype(np.uint8).tobytes()
    packed = zlib.compress(stream if rows is None else rows)
    header = struct.pack(">IIBBBBB", image.shape[1], image.shape[0], 8 * size, 0, 0, 0, 0)
    step = -(-len(packed) // parts)
    idat = b"".join(png_chunk(b"IDAT", packed[k : k + step]) for k in range(0, len(packed), step))
    return b"\x89PNG\r\n\x1a\n" + png_chunk(b"IHDR", header) + idat + png_chunk(b"IEND", b"")


@given(st.data())
@settings(derandomize=True, deadline=None, max_examples=50)
def test_every_filter_of_png_against_libpng(tmp_path_factory: pytest.TempPathFactory, data: st.DataObject) -> None:
    rows, columns = data.draw(st.integers(1, 9)), data.draw(st.integers(1, 17))
    dtype = data.draw(st.sampled_from([np.uint8, np.uint16]))
    filters = data.draw(st.lists(st.integers(0, 4), min_size=rows, max_size=rows))
    rng = np.random.default_rng(data.draw(st.integers(0, 1000)))
    image = rng.integers(0, np.iinfo(dtype).max, (rows, columns), dtype, endpoint=True)
    path = tmp_path_factory.getbasetemp() / "filters.png"
    path.write_bytes(png(image, filters, parts=data.draw(st.integers(1, 3))))
    np.testing.assert_array_equal(cv2.imread(str(path), cv2.IMREAD_UNCHANGED), image, err_msg="the test's writer")
    found = read_image(path)
    np.testing.assert_array_equal(found, image)
    assert found.dtype == dtype and found.dtype.isnative


def test_png_streams_that_lie(tmp_path: Path) -> None:
    image = np.arange(12, dtype=np.uint16).reshape(3, 4)
    for rows, words in (
        (b"\x00" + bytes(8) + b"\x07" + bytes(8) + b"\x00" + bytes(8), "got damaged data .*an unknown filter in row 1"),
        (b"\x00" + bytes(8), "got damaged data .*missing pixels"),
        (bytes(1000), ""),
    ):
        (tmp_path / "a.png").write_bytes(png(image, [0, 0, 0], rows=rows))
        with pytest.raises(FileFormatError, match=f"a.png: expected an intact PNG file, {words}"):
            read_image(tmp_path / "a.png")


def test_interlaced_png_images_still_open(tmp_path: Path) -> None:
    """One pixel is the same interlaced or not."""
    data = bytearray(png(np.array([[513]], np.uint16), [0]))
    data[28] = 1
    data[29:33] = struct.pack(">I", zlib.crc32(data[12:29]))
    (tmp_path / "a.png").write_bytes(data)
    assert read_image(tmp_path / "a.png").tolist() == [[513]]


# -- FITS --------------------------------------------------------------------------------------------------------------


CUBE = np.random.default_rng(0).integers(0, 60_000, (4, 5, 7)).astype(np.uint16)


def fits(data: NDArray[Any] | None, first: str = "SIMPLE  =                    T", **cards: Any) -> bytes:
    """Return one header with its data."""
    bits = {"u1": 8, "i2": 16, "i4": 32, "i8": 64, "f4": -32, "f8": -64}
    lengths = () if data is None else data.shape[::-1]
    known = {"BITPIX": 8 if data is None else bits[data.dtype.str[1:]], "NAXIS": len(lengths)}
    known |= {f"NAXIS{k + 1}": n for k, n in enumerate(lengths)} | cards
    lines = [first, *(f"{name:<8}= {value!s:>20} / a comment" for name, value in known.items()), "END"]
    head = "".join(line.ljust(80) for line in lines).encode()
    body = b"" if data is None else data.astype(data.dtype.newbyteorder(">")).tobytes()
    return b"".join(part + bytes(-len(part) % 2880) for part in (head.ljust(-(-len(head) // 2880) * 2880), body))


FITS: list[tuple[NDArray[Any], dict[str, Any], NDArray[Any]]] = [
    ((CUBE.astype(int) - 32768).astype("i2"), {"BZERO": 32768, "BSCALE": 1}, CUBE),
    (CUBE.astype("i4"), {}, CUBE.astype(np.int32)),
    ((CUBE.astype(np.int64) - (1 << 31)).astype("i4"), {"BZERO": 1 << 31}, CUBE.astype(np.uint32)),
    (CUBE.astype("f4"), {}, CUBE.astype(np.float32)),
    ((CUBE // 4).astype("i2"), {"BSCALE": "0.5", "BZERO": "1.5E+1"}, (CUBE // 4 * 0.5 + 15).astype(np.float32)),
    ((CUBE % 200).astype("u1"), {}, (CUBE % 200).astype(np.uint8)),
    (CUBE.astype("f8"), {}, CUBE.astype(np.float64)),
]


def test_samples_of_fits_are_those_that_the_file_states(tmp_path: Path) -> None:
    path = tmp_path / "a.fits"
    for stored, cards, expected in FITS:
        path.write_bytes(fits(stored, EXPTIME="0.25", OBJECT="'it''s'", **cards))
        image = open_image(path)
        assert (image.dtype, image.pages, image.shape) == (expected.dtype, 4, (5, 7)), cards
        np.testing.assert_array_equal([image.read(k) for k in range(4)], expected, err_msg=str(cards))
        np.testing.assert_array_equal(image.read_region(2, slice(1, 4), slice(2, 6)), expected[2, 1:4, 2:6])
        image.close()
    with open_frames(path, order="raster", plan_shape=(1, 2, 2)) as frames:
        assert frames.info(3).exposure_s == 0.25


def test_the_first_image_of_fits_is_read_and_blank_samples_are_nan(tmp_path: Path) -> None:
    table = fits(CUBE[0].astype("u1"), "XTENSION= 'BINTABLE'", PCOUNT=3, GCOUNT=1)
    image = fits(CUBE[1].astype("i4"), "XTENSION= 'IMAGE   '", PCOUNT=0, GCOUNT=1)
    (tmp_path / "a.fit").write_bytes(fits(None) + table + image)
    np.testing.assert_array_equal(open_image(tmp_path / "a.fit").read(), CUBE[1])
    values = CUBE[0].astype("i2")
    (tmp_path / "b.fits").write_bytes(fits(values, BLANK=int(values[1, 2])))
    np.testing.assert_array_equal(np.isnan(open_image(tmp_path / "b.fits").read()), values == values[1, 2])


def test_damaged_fits_files_give_one_line(tmp_path: Path) -> None:
    whole, table = fits(CUBE.astype("i4")), "XTENSION= 'BINTABLE'"
    packed = fits(None) + fits(CUBE[0].astype("u1"), table, ZIMAGE="T", PCOUNT=0)
    bad: dict[bytes, str] = {
        whole[:3200]: "the file is cut short",
        whole[:1000]: "a header that ends with END",
        fits(None): "got no data; export it uncompressed",
        packed: "got no data, a compressed table; export it uncompressed",
        fits(None, NAXIS=10**9): "got 999 axes; export it",
        fits(None, NAXIS=1, NAXIS1=5, BITPIX="1E300"): "an image with 2, 3 or 5 axes",
        fits(None) + fits(CUBE[0].astype("u1"), table, PCOUNT=-(10**9)): "got no data, a table",
        fits(None, NAXIS=2, NAXIS1=60_000, NAXIS2=60_000, BITPIX=64): "declared in a file of",
    }
    for data, words in bad.items():
        (tmp_path / "a.fits").write_bytes(data)
        error = UnsafeFileError if "declared" in words else FileFormatError
        with pytest.raises(error, match=words) as caught:
            open_image(tmp_path / "a.fits")
        assert "\n" not in str(caught.value)


# -- formats of other packages -----------------------------------------------------------------------------------------


def test_the_documented_format_of_another_package_reads_frames(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """The example is complete: it is found by its entry point, and read by everything that reads frames."""
    frames = np.random.default_rng(0).integers(0, 4095, (3, 20, 30)).astype(np.uint16)
    (block,) = code_of("extending.md", "A frame format")
    install(monkeypatch, tmp_path, "lab_formats", block, {"lfcal.formats": "flat = lab_formats:FORMAT"})
    fresh: Registry = Registry(
        "image format", "lfcal.frames.formats", "FORMAT", "lfcal.formats", order=lambda f: (f.rank, f.name)
    )
    monkeypatch.setattr(image_file, "FORMATS", fresh)
    assert "camera dump" in fresh and not fresh.failures()
    assert ".flat" in image_file.image_suffixes()
    path = tmp_path / "run.flat"
    path.write_bytes(b"FLAT" + struct.pack("<3I", *frames.shape) + frames.astype("<u2").tobytes())
    image = image_file.open_image(path)
    assert (image.pages, image.shape, image.dtype) == (3, (20, 30), np.dtype(np.uint16))
    np.testing.assert_array_equal(image.read_region(1, slice(3, 9), slice(5, 7)), frames[1, 3:9, 5:7])
    with open_frames(path, order="raster", plan_shape=(1, 1, 3)) as source:
        assert (len(source), source.metadata.bit_depth, source.samples(2).saturated) == (3, 12, 0)
        np.testing.assert_array_equal(source.read(2), frames[2])
    path.write_bytes(path.read_bytes()[:-1])
    with pytest.raises(Exception, match=r"run\.flat") as caught:
        image_file.read_image(path, 2)
    assert "\n" not in str(caught.value)
