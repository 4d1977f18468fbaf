"""Each kind of damaged, dangerous or wrong file gives one line that names it."""

from __future__ import annotations

import io
import os
import struct
import sys
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import h5py
import numpy as np
import pytest
import tifffile

from lfcal.base.errors import FileFormatError, InputError, LfcalError, StorageError, UnsafeFileError
from lfcal.base.progress import drain
from lfcal.frames import FolderSource, iter_undamaged, open_frames, open_image, read_image
from lfcal.frames.damage import frame_errors
from lfcal.frames.formats._decoder_messages import caught_messages
from lfcal.frames.source import Position
from tests.frames.scenes import png_bytes, session, write_dng

FRAME = session((40, 50))
STACK = session((4, 40, 50))


def _png() -> bytes:
    done, data = cv2.imencode(".png", FRAME)
    assert done
    return bytes(data)


def _tiff(array: np.ndarray = STACK, **options: object) -> bytes:
    file = io.BytesIO()
    tifffile.imwrite(file, array, **{"photometric": "minisblack", **options})
    return file.getvalue()


def _npy(array: np.ndarray) -> bytes:
    file = io.BytesIO()
    np.save(file, array, allow_pickle=True)
    return file.getvalue()


def _flip(data: bytes, at: int) -> bytes:
    return data[:at] + bytes([data[at] ^ 0x55]) + data[at + 1 :]


NPY = b"\x93NUMPY\x01\x00"


def _npy_header(shape: tuple[int, ...]) -> bytes:
    head = f"{{'descr': '<u2', 'fortran_order': False, 'shape': {shape}, }}".ljust(117) + "\n"
    return NPY + struct.pack("<H", len(head)) + head.encode() + bytes(64)


def _tiff_loop() -> bytes:
    data = bytearray(_tiff(FRAME, metadata=None))
    first = struct.unpack_from("<I", data, 4)[0]
    tags = struct.unpack_from("<H", data, first)[0]
    struct.pack_into("<I", data, first + 2 + 12 * tags, first)
    return bytes(data)


def _tiff_huge() -> bytes:
    """Return a compressed TIFF whose header claims 60,000 rows of 60,000 pixels."""
    data = bytearray(_tiff(FRAME, metadata=None, compression="zlib"))
    first = struct.unpack_from("<I", data, 4)[0]
    for k in range(struct.unpack_from("<H", data, first)[0]):
        at = first + 2 + 12 * k
        if struct.unpack_from("<H", data, at)[0] in (256, 257, 278):
            struct.pack_into("<HII", data, at + 2, 4, 1, 60000)
    return bytes(data)


def _jpeg() -> bytes:
    return bytes(cv2.imencode(".jpg", (FRAME // 16).astype(np.uint8))[1])


def _tiff_damaged() -> bytes:
    return _flip(_tiff(FRAME, compression="zlib", metadata=None), 700)


def _zeroed_strip() -> bytes:
    data = bytearray(_tiff(FRAME, metadata=None))
    with tifffile.TiffFile(io.BytesIO(bytes(data))) as file:
        tag = file.pages[0].tags[279]
        struct.pack_into("<I" if tag.dtype == 4 else "<H", data, tag.valueoffset, 0)
    return bytes(data)


BAD: dict[str, tuple[str, Callable[[], bytes], str]] = {
    "empty file": ("a.png", lambda: b"", "an empty file"),
    "text file": ("a.tif", lambda: b"hello, this is no image", "an unknown format"),
    "PNG cut in the middle": ("a.png", lambda: _png()[:2000], "the end is missing"),
    "PNG without its last chunk": ("a.png", lambda: _png()[:-12], "the end is missing"),
    "PNG of a header only": ("a.png", lambda: _png()[:20], "no header"),
    "PNG with one flipped byte": ("a.png", lambda: _flip(_png(), 1500), "a wrong checksum at byte"),
    "PNG with too few pixels": ("a.png", lambda: png_bytes(40, 50, 16, 0, bytes(101 * 20)), "missing"),
    "PNG of 8-bit colour": ("a.png", lambda: png_bytes(4, 5, 8, 2, bytes(64)), "3 samples of 8 bits"),
    "PNG with transparency": ("a.png", lambda: png_bytes(4, 5, 8, 4, bytes(44)), "2 samples of 8 bits"),
    "PNG with a palette": ("a.png", lambda: png_bytes(4, 5, 8, 3, bytes(24)), "got a palette"),
    "PNG of single bits": ("a.png", lambda: png_bytes(4, 8, 1, 0, bytes(8)), "1-bit samples"),
    "PNG of declared 60000 x 60000": ("a.png", lambda: png_bytes(60000, 60000, 16, 0, bytes(64)), "7.2 GB declared in"),
    "PNG of no rows": ("a.png", lambda: png_bytes(0, 5, 16, 0, b""), "0 x 5"),
    "JPEG": ("a.jpg", _jpeg, "a JPEG image; JPEG compression loses information"),
    "JPEG named PNG": ("a.png", _jpeg, "got a JPEG image"),
    "TIFF cut within the first page": ("a.tif", lambda: _tiff()[:3000], "the file ends within page 1"),
    "TIFF cut in the last page": ("a.tif", lambda: _tiff()[:-17], "the file ends within page 3"),
    "TIFF cut in its header": ("a.tif", lambda: _tiff()[:7], "damaged data"),
    "TIFF whose pages run in a circle": ("a.tif", _tiff_loop, "leads back to an earlier one"),
    "TIFF of declared 60000 x 60000": ("a.tif", _tiff_huge, "7.2 GB declared in a file of"),
    "TIFF with an unwritten strip": ("a.tif", _zeroed_strip, "samples of page 0 are missing"),
    "TIFF of JPEG data": ("a.tif", lambda: _tiff((FRAME // 16).astype(np.uint8), compression="jpeg"), "got JPEG"),
    "TIFF of 8-bit colour": ("a.tif", lambda: _tiff(np.zeros((4, 5, 3), "u1"), photometric="rgb"), "3 samples of 8"),
    "TIFF with white at zero": (
        "a.tif",
        lambda: _tiff(FRAME, photometric="miniswhite"),
        "photometric interpretation 0",
    ),
    "TIFF with damaged compression": ("a.tif", _tiff_damaged, "damaged data"),
    "TIFF of complex numbers": ("a.tif", lambda: _tiff(FRAME.astype(np.complex64)), "samples of 8 bits"),
    "pickled npy": ("a.npy", lambda: _npy(np.array([{"a": 1}], object)), "pickled Python objects"),
    "npy cut short": ("a.npy", lambda: _npy(STACK)[:-7], "damaged data"),
    "npy of a declared petabyte": ("a.npy", lambda: _npy_header((1 << 19, 1 << 15, 1 << 15)), "damaged"),
    "npy of text": ("a.npy", lambda: _npy(np.array([["a", "b"]])), "dtype <U1"),
    "npy of one axis": ("a.npy", lambda: _npy(np.arange(5)), "shape (5,)"),
    "npy with a call in its header": ("a.npy", lambda: NPY + b"\x20\x00{'descr': __import__('os')}", "damaged data"),
    "npz archive": ("a.npz", lambda: b"PK\x03\x04" + bytes(30), "a ZIP or .npz archive"),
    "HDF5 cut short": ("a.h5", lambda: b"\x89HDF\r\n\x1a\n" + bytes(200), "a damaged or different file"),
    "PGM cut short": ("a.pgm", lambda: b"P5 50 40 65535\n" + bytes(100), "the file is cut short"),
    "PGM without a header": ("a.pgm", lambda: b"P5 fifty", "a PGM header"),
    "RAW that is none": ("a.dng", lambda: b"II*\0" + bytes(400), "camera RAW"),
    "ND2": ("a.nd2", lambda: b"\xda\xce\xbe\x0a" + bytes(60), "a Nikon ND2 file; export it as OME-TIFF"),
    "CZI": ("a.czi", lambda: b"ZISRAWFILE" + bytes(60), "a Zeiss CZI file; export it as OME-TIFF, in ZEN"),
    "LIF": ("a.lif", lambda: b"\x70\0\0\0" + bytes(60), "a Leica LIF file; export it as OME-TIFF"),
    "DCIMG": ("a.dcimg", lambda: b"DCIMG" + bytes(60), "a Hamamatsu DCIMG file; export it as TIFF"),
    "SIF": ("a.sif", lambda: b"Andor Technology Multi-Channel File", "an Andor SIF file; export it"),
    "SEQ": ("a.seq", lambda: b"\xed\xfe\0\0N\0o\0", "a StreamPix SEQ file; export it as TIFF"),
    "ASCII PGM": ("a.pgm", lambda: b"P2 2 2 9 1 2 3 4", "a PGM image in ASCII; convert it without"),
    "BMP": ("a.bmp", lambda: b"BM" + bytes(60), "a BMP image"),
}
UNSAFE = ("declared 60000", "of no rows", "pickled", "npy of text")
"""Parts of the names of cases that are refused as unsafe; all others are refused as files of a wrong format."""


@pytest.mark.parametrize("kind", BAD)
def test_bad_file_gives_one_line(tmp_path: Path, kind: str, capfd: pytest.CaptureFixture[str]) -> None:
    name, data, words = BAD[kind]
    path = tmp_path / name
    path.write_bytes(data())
    error = UnsafeFileError if any(part in kind for part in UNSAFE) else FileFormatError
    with pytest.raises(error) as caught:
        read_image(path)
    message = str(caught.value)
    assert type(caught.value) is error
    assert str(path) in message and words in message and "\n" not in message and len(message) < 400
    assert capfd.readouterr().out == ""
    assert [p.name for p in tmp_path.iterdir()] == [name]


def _h5(path: Path, make: Callable[[h5py.File], object]) -> None:
    with h5py.File(path, "w") as file:
        make(file)


def _of(**options: Any) -> Callable[[h5py.File], object]:
    """Return what makes the dataset ``frames``."""
    return lambda file: file.create_dataset("frames", **options)


def _positions_of_another_count(file: h5py.File) -> None:
    file["frames"], file["positions"] = STACK, np.zeros((3, 3), int)


HUGE = (1 << 20, 1 << 14, 1 << 14)
BAD_H5: dict[str, tuple[Callable[[h5py.File], object], type[LfcalError], str]] = {
    "external link": (
        lambda f: f.__setitem__("frames", h5py.ExternalLink("b.h5", "/x")),
        UnsafeFileError,
        "ExternalLi",
    ),
    "dead link": (lambda f: f.__setitem__("frames", h5py.SoftLink("/x")), FileFormatError, "got a link to /x, which"),
    "external storage": (
        _of(shape=(2, 3, 4), dtype="u2", external=[("/etc/passwd", 0, 48)]),
        UnsafeFileError,
        "external storage",
    ),
    "strings": (_of(data=np.zeros((2, 3, 4), "S3")), UnsafeFileError, "dtype |S3"),
    "unwritten chunks": (_of(shape=(2, 30, 40), dtype="u2", chunks=(1, 30, 40)), FileFormatError, "chunks written"),
    "huge declared shape": (_of(shape=HUGE, dtype="u2", chunks=(1, 64, 64)), UnsafeFileError, "TB"),
    "two axes": (_of(data=FRAME), FileFormatError, "numbers with axes"),
    "two stacks": (lambda f: [f.create_dataset(k, data=STACK) for k in "ab"], FileFormatError, "name it as a.h5::/"),
    "no stack": (lambda f: f.create_group("g"), FileFormatError, "got none; check the file"),
    "positions of another count": (_positions_of_another_count, FileFormatError, "one per frame, got (3, 3)"),
}


def test_bad_hdf5_gives_one_line(tmp_path: Path) -> None:
    for kind, (make, error, words) in BAD_H5.items():
        _h5(tmp_path / "a.h5", make)
        with pytest.raises(error) as caught:
            open_image(tmp_path / "a.h5")
        message = str(caught.value)
        assert words in message and "a.h5" in message and "\n" not in message, kind


def test_damaged_hdf5_chunk_is_found_by_its_checksum(tmp_path: Path) -> None:
    path = tmp_path / "a.h5"
    with h5py.File(path, "w") as file:
        data = file.create_dataset("frames", data=STACK, chunks=(1, 40, 50), fletcher32=True)
        at = data.id.get_chunk_info(2).byte_offset
    path.write_bytes(_flip(path.read_bytes(), at + 100))
    image = open_image(path)
    np.testing.assert_array_equal(image.read(1), STACK[1])
    with pytest.raises(FileFormatError, match=r"a\.h5:/frames, chunk \(2, 0, 0\): expected checksum"):
        image.read(2)
    image.close()


def test_truncated_raw_files_and_impossible_bayer_tags(tmp_path: Path) -> None:
    path = tmp_path / "a.dng"
    write_dng(path, FRAME)
    path.write_bytes(path.read_bytes()[:-500])
    with pytest.raises(FileFormatError, match=r"a\.dng: expected an intact camera RAW file, got damaged data \(Input"):
        read_image(path)
    for pattern in ((0, 1, 0, 2), (1, 1, 0, 2), (0, 1, 2, 0)):
        write_dng(path, FRAME, pattern)
        with pytest.raises(FileFormatError, match="correct the Bayer tag"):
            open_image(path)


def test_a_decoder_that_cannot_be_loaded_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_dng(tmp_path / "a.dng", FRAME)
    (tmp_path / "a.png").write_bytes(_png())
    for suffix, library in (("dng", "rawpy"), ("png", "imagecodecs")):
        monkeypatch.setitem(sys.modules, library, None)
        with pytest.raises(InputError, match="expected a working decoder for") as raised:
            read_image(tmp_path / f"a.{suffix}")
        assert str(raised.value).endswith(f"; run: python -m pip install --force-reinstall {library}")


def test_a_missing_file_and_a_folder_are_named(tmp_path: Path) -> None:
    with pytest.raises(StorageError, match="No such file or directory; check the path"):
        open_image(tmp_path / "a.png")
    with pytest.raises(StorageError, match="is a folder; give the path of a file"):
        open_image(tmp_path)


def test_the_png_files_above_are_damaged_only_where_they_say() -> None:
    rows = b"".join(b"\0" + line.astype(">u2").tobytes() for line in FRAME)
    image = cv2.imdecode(np.frombuffer(png_bytes(40, 50, 16, 0, rows), np.uint8), cv2.IMREAD_UNCHANGED)
    np.testing.assert_array_equal(image, FRAME)


@pytest.mark.parametrize("kind", ["npy", "tif", "packed.tif", "h5"])
def test_float_samples_beyond_any_light_are_refused(tmp_path: Path, kind: str) -> None:
    """NaN and infinity say that a pixel was not measured; other values beyond 1e12 would overflow later."""
    path = tmp_path / f"a.{kind}"

    def write(value: float, dtype: str) -> None:
        frame = FRAME.astype(dtype)
        frame[3, 4] = value
        if kind == "npy":
            np.save(path, frame)
        elif kind == "h5":
            _h5(path, _of(data=frame[None]))
        else:
            tifffile.imwrite(path, frame, compression="zlib" if "packed" in kind else None)

    for dtype in ("f2", "f4", "f8", ">f8"):
        largest = float(np.finfo(dtype).max)
        for value in (np.nan, np.inf, -np.inf, 0.0, -5.0, min(9e11, largest)):
            write(value, dtype)
            np.testing.assert_equal(float(read_image(path)[3, 4]), float(np.dtype(dtype).type(value)))
        for value in (1.1e12, -2e12, largest) if dtype != "f2" else ():
            write(value, dtype)
            with pytest.raises(FileFormatError, match=r"expected samples up to 1e\+12, got"):
                read_image(path)


def test_whole_numbers_beyond_any_light_are_refused(tmp_path: Path) -> None:
    for dtype in (np.uint64, np.int64):
        np.save(tmp_path / "a.npy", np.full((4, 5), 2**62, dtype))
        with pytest.raises(FileFormatError, match=r"got 4\.61e\+18"):
            read_image(tmp_path / "a.npy")


# -- what decoders in C print ------------------------------------------------------------------------------------------


def test_messages_of_decoders_are_caught_and_other_words_passed_on(capfd: pytest.CaptureFixture[str]) -> None:
    with caught_messages("a.png") as complaint:
        os.write(2, b"libpng error: bad, a.png\nwords of another thread\n")
    assert complaint() == "libpng error: bad, a.png"
    assert capfd.readouterr().err == "words of another thread\n"


def test_messages_of_decoders_in_several_threads_are_kept_apart(capfd: pytest.CaptureFixture[str]) -> None:
    found: dict[int, str] = {}
    both = threading.Barrier(4)

    def work(k: int) -> None:
        with caught_messages(f"file {k}.png") as complaint:
            both.wait()
            os.write(2, f"libpng error: file {k}.png\n".encode())
            both.wait()
        found[k] = complaint()

    threads = [threading.Thread(target=work, args=(k,)) for k in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert found == {k: f"libpng error: file {k}.png" for k in range(4)}
    os.write(2, b"after\n")
    assert capfd.readouterr().err == "after\n"


def test_images_are_read_without_room_for_temporary_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object, **__: object) -> None:
        raise OSError(28, "No space left on device")

    frame = np.arange(24, dtype=np.uint16).reshape(4, 6)
    cv2.imwrite(str(tmp_path / "a.png"), frame)
    assert read_image(tmp_path / "a.png").shape == frame.shape, "the decoder's kernels are compiled by now"
    monkeypatch.setattr("tempfile.TemporaryFile", full)
    assert np.array_equal(read_image(tmp_path / "a.png"), frame)


# -- damaged frames of a folder ----------------------------------------------------------------------------------------


FRAMES = np.random.default_rng(1).integers(100, 900, (2, 3, 12, 14), dtype=np.uint16)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for y, x in np.ndindex(2, 3):
        tifffile.imwrite(tmp_path / f"y{y}_x{x}.tif", FRAMES[y, x], photometric="minisblack")
    return tmp_path


def spoil(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:-20])


def opened(folder: Path, **how: Any) -> FolderSource:
    return open_frames(folder, pattern="y{y}_x{x}.tif", **how)


def test_a_damaged_frame_is_named_with_its_position_and_one_remedy(folder: Path) -> None:
    spoil(folder / "y1_x2.tif")
    with opened(folder) as source:
        bad = next(k for k in range(6) if source.info(k).position == Position(0, 1, 2))
        words = r"y1_x2\.tif, \(z, y, x\) = \(0, 1, 2\): .*--skip-damaged\)$"
        with pytest.raises(FileFormatError, match=words) as caught:
            source.read(bad)
        assert "\n" not in str(caught.value)
    for remedy, said in (
        ("copy it again", "copy it again, or leave it out (--skip-damaged)"),
        ("copy it again, or leave it out", "copy it again, or leave it out (--skip-damaged)"),
        ("leave it out", "leave it out (--skip-damaged)"),
    ):
        for name in ("a.tif", "/data/frames/a.tif"):
            wrong = FileFormatError.expected(name, "16 bits", "8", remedy)
            with pytest.raises(FileFormatError) as caught, frame_errors("a.tif", Position(0, 1, 2)):
                raise wrong
            assert str(caught.value) == f"a.tif, (z, y, x) = (0, 1, 2): expected 16 bits, got 8; {said}"


@pytest.mark.parametrize("names", [(), ("y1_x2",), ("y0_x0",), ("y0_x0", "y0_x1", "y1_x0")])
def test_damaged_frames_are_left_out_and_listed(folder: Path, names: tuple[str, ...]) -> None:
    for name in names:
        spoil(folder / f"{name}.tif")
    with opened(folder, skip_damaged=bool(names)) as source:
        part = drain(iter_undamaged(source, workers=2))
        assert [found.label for found in part.metadata.left_out] == [f"{name}.tif" for name in names]
        assert len(part) == 6 - len(names)
        for k in range(len(part)):
            _, y, x = part.info(k).position
            assert np.array_equal(part.read(k), FRAMES[y, x])
            assert np.array_equal(part.samples(k, (slice(2, 5), slice(3, 9))).values, FRAMES[y, x, 2:5, 3:9])
        assert names or [p.done for p in iter_undamaged(source)] == [0, 6]


def test_a_folder_of_damaged_frames_only_is_an_error(folder: Path) -> None:
    for path in folder.glob("*.tif"):
        spoil(path)
    words = "expected at least one readable frame, got only damaged ones"
    with opened(folder, skip_damaged=True) as source, pytest.raises(FileFormatError, match=words):
        drain(iter_undamaged(source))
