"""Each kind of damaged, dangerous or wrong file gives one line that names it."""

from __future__ import annotations

import io
import struct
import sys
from collections.abc import Callable
from pathlib import Path

import cv2
import h5py
import numpy as np
import pytest
import tifffile

from lfcal.base.errors import FileFormatError, InputError, LfcalError, StorageError, UnsafeFileError
from lfcal.frames import open_image, read_image
from tests.frames.scenes import png_bytes, png_chunk, session, write_dng

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


def _npy_header(shape: tuple[int, ...]) -> bytes:
    head = f"{{'descr': '<u2', 'fortran_order': False, 'shape': {shape}, }}".ljust(117) + "\n"
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(head)) + head.encode() + bytes(64)


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


def _zeroed_strip() -> bytes:
    data = bytearray(_tiff(FRAME, metadata=None))
    with tifffile.TiffFile(io.BytesIO(bytes(data))) as file:
        tag = file.pages[0].tags[279]
        at, size = tag.valueoffset, tag.dtype
    struct.pack_into("<I" if size == 4 else "<H", data, at, 0)
    return bytes(data)


BAD: dict[str, tuple[str, Callable[[], bytes], type[LfcalError], str]] = {
    "empty file": ("a.png", lambda: b"", FileFormatError, "an empty file"),
    "text file": ("a.tif", lambda: b"hello, this is no image", FileFormatError, "an unknown format"),
    "PNG cut in the middle": ("a.png", lambda: _png()[:2000], FileFormatError, "the end is missing"),
    "PNG without its last chunk": ("a.png", lambda: _png()[:-12], FileFormatError, "the end is missing"),
    "PNG of a header only": ("a.png", lambda: _png()[:20], FileFormatError, "no header"),
    "PNG with one flipped byte": ("a.png", lambda: _flip(_png(), 1500), FileFormatError, "a wrong checksum at byte"),
    "PNG with too few pixels": (
        "a.png",
        lambda: png_bytes(40, 50, 16, 0, bytes(101 * 20)),
        FileFormatError,
        "missing",
    ),
    "PNG of 8-bit colour": ("a.png", lambda: png_bytes(4, 5, 8, 2, bytes(64)), FileFormatError, "3 samples of 8 bits"),
    "PNG with transparency": (
        "a.png",
        lambda: png_bytes(4, 5, 8, 4, bytes(44)),
        FileFormatError,
        "2 samples of 8 bits",
    ),
    "PNG with a palette": ("a.png", lambda: png_bytes(4, 5, 8, 3, bytes(24)), FileFormatError, "got a palette"),
    "PNG of single bits": ("a.png", lambda: png_bytes(4, 8, 1, 0, bytes(8)), FileFormatError, "1-bit samples"),
    "PNG of declared 60000 x 60000": (
        "a.png",
        lambda: png_bytes(60000, 60000, 16, 0, bytes(64)),
        UnsafeFileError,
        "7.2 GB declared in a file of",
    ),
    "PNG of no rows": ("a.png", lambda: png_bytes(0, 5, 16, 0, b""), UnsafeFileError, "0 x 5"),
    "JPEG": ("a.jpg", _jpeg, FileFormatError, "a JPEG image; JPEG compression loses information"),
    "JPEG named PNG": ("a.png", _jpeg, FileFormatError, "got a JPEG image"),
    "TIFF cut within the first page": ("a.tif", lambda: _tiff()[:3000], FileFormatError, "the file ends within page 1"),
    "TIFF cut in the last page": ("a.tif", lambda: _tiff()[:-17], FileFormatError, "the file ends within page 3"),
    "TIFF cut in its header": ("a.tif", lambda: _tiff()[:7], FileFormatError, "damaged data"),
    "TIFF whose pages run in a circle": ("a.tif", _tiff_loop, FileFormatError, "leads back to an earlier one"),
    "TIFF of declared 60000 x 60000": ("a.tif", _tiff_huge, UnsafeFileError, "7.2 GB declared in a file of"),
    "TIFF with an unwritten strip": ("a.tif", _zeroed_strip, FileFormatError, "samples of page 0 are missing"),
    "TIFF of JPEG data": (
        "a.tif",
        lambda: _tiff((FRAME // 16).astype(np.uint8), compression="jpeg"),
        FileFormatError,
        "got JPEG",
    ),
    "TIFF of 8-bit colour": (
        "a.tif",
        lambda: _tiff(np.zeros((4, 5, 3), np.uint8), photometric="rgb"),
        FileFormatError,
        "3 samples of 8",
    ),
    "TIFF with white at zero": (
        "a.tif",
        lambda: _tiff(FRAME, photometric="miniswhite"),
        FileFormatError,
        "photometric interpretation 0",
    ),
    "TIFF with damaged compression": (
        "a.tif",
        lambda: _flip(_tiff(FRAME, compression="zlib", metadata=None), 700),
        FileFormatError,
        "damaged data",
    ),
    "TIFF of complex numbers": (
        "a.tif",
        lambda: _tiff(FRAME.astype(np.complex64)),
        FileFormatError,
        "samples of 8 bits",
    ),
    "pickled npy": ("a.npy", lambda: _npy(np.array([{"a": 1}], object)), UnsafeFileError, "pickled Python objects"),
    "npy cut short": ("a.npy", lambda: _npy(STACK)[:-7], FileFormatError, "damaged data"),
    "npy of a declared petabyte": (
        "a.npy",
        lambda: _npy_header((1 << 19, 1 << 15, 1 << 15)),
        FileFormatError,
        "damaged",
    ),
    "npy of text": ("a.npy", lambda: _npy(np.array([["a", "b"]])), UnsafeFileError, "dtype <U1"),
    "npy of one axis": ("a.npy", lambda: _npy(np.arange(5)), FileFormatError, "shape (5,)"),
    "npy with a damaged header": (
        "a.npy",
        lambda: b"\x93NUMPY\x01\x00\x20\x00{'descr': __import__('os')}",
        FileFormatError,
        "damaged data",
    ),
    "npz archive": ("a.npz", lambda: b"PK\x03\x04" + bytes(30), FileFormatError, "a ZIP or .npz archive"),
    "HDF5 cut short": (
        "a.h5",
        lambda: b"\x89HDF\r\n\x1a\n" + bytes(200),
        FileFormatError,
        ("a damaged or different file"),
    ),
    "PGM cut short": ("a.pgm", lambda: b"P5 50 40 65535\n" + bytes(100), FileFormatError, "the file is cut short"),
    "PGM without a header": ("a.pgm", lambda: b"P5 fifty", FileFormatError, "a PGM header"),
    "RAW that is none": ("a.dng", lambda: b"II*\0" + bytes(400), FileFormatError, "camera RAW"),
    "ND2": (
        "a.nd2",
        lambda: b"\xda\xce\xbe\x0a" + bytes(60),
        FileFormatError,
        "a Nikon ND2 file; export it as OME-TIFF",
    ),
    "CZI": (
        "a.czi",
        lambda: b"ZISRAWFILE" + bytes(60),
        FileFormatError,
        "a Zeiss CZI file; export it as OME-TIFF, in ZEN",
    ),
    "LIF": ("a.lif", lambda: b"\x70\0\0\0" + bytes(60), FileFormatError, "a Leica LIF file; export it as OME-TIFF"),
    "DCIMG": ("a.dcimg", lambda: b"DCIMG" + bytes(60), FileFormatError, "a Hamamatsu DCIMG file; export it as TIFF"),
    "SIF": ("a.sif", lambda: b"Andor Technology Multi-Channel File", FileFormatError, "an Andor SIF file; export it"),
    "SEQ": ("a.seq", lambda: b"\xed\xfe\0\0N\0o\0", FileFormatError, "a StreamPix SEQ file; export it as TIFF"),
    "ASCII PGM": ("a.pgm", lambda: b"P2 2 2 9 1 2 3 4", FileFormatError, "a PGM image in ASCII; convert it without"),
    "BMP": ("a.bmp", lambda: b"BM" + bytes(60), FileFormatError, "a BMP image"),
}


@pytest.mark.parametrize("kind", BAD)
def test_bad_file_gives_one_line(tmp_path: Path, kind: str, capfd: pytest.CaptureFixture[str]) -> None:
    name, data, error, words = BAD[kind]
    path = tmp_path / name
    path.write_bytes(data())
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


BAD_H5: dict[str, tuple[Callable[[h5py.File], object], type[LfcalError], str]] = {
    "external link": (
        lambda f: f.__setitem__("frames", h5py.ExternalLink("b.h5", "/x")),
        UnsafeFileError,
        "ExternalLink",
    ),
    "dead link": (lambda f: f.__setitem__("frames", h5py.SoftLink("/x")), FileFormatError, "got a link to /x, which"),
    "external storage": (
        lambda f: f.create_dataset("frames", (2, 3, 4), "u2", external=[("/etc/passwd", 0, 48)]),
        UnsafeFileError,
        "external storage",
    ),
    "strings": (lambda f: f.create_dataset("frames", data=np.zeros((2, 3, 4), "S3")), UnsafeFileError, "dtype |S3"),
    "unwritten chunks": (
        lambda f: f.create_dataset("frames", (2, 30, 40), "u2", chunks=(1, 30, 40)),
        FileFormatError,
        "chunks written",
    ),
    "huge declared shape": (
        lambda f: f.create_dataset("frames", (1 << 20, 1 << 14, 1 << 14), "u2", chunks=(1, 64, 64)),
        UnsafeFileError,
        "TB",
    ),
    "two axes": (lambda f: f.create_dataset("frames", data=FRAME), FileFormatError, "numbers with axes"),
    "two stacks": (lambda f: [f.create_dataset(k, data=STACK) for k in "ab"], FileFormatError, "name it as a.h5::/"),
    "no stack": (lambda f: f.create_group("g"), FileFormatError, "got none; check the file"),
    "positions of another count": (
        lambda f: [f.create_dataset("frames", data=STACK), f.create_dataset("positions", data=np.zeros((3, 3), int))],
        FileFormatError,
        "one per frame, got (3, 3)",
    ),
}


@pytest.mark.parametrize("kind", BAD_H5)
def test_bad_hdf5_gives_one_line(tmp_path: Path, kind: str) -> None:
    make, error, words = BAD_H5[kind]
    path = tmp_path / "a.h5"
    _h5(path, make)
    with pytest.raises(error) as caught:
        open_image(path)
    assert words in str(caught.value) and "a.h5" in str(caught.value) and "\n" not in str(caught.value)


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


def test_truncated_raw(tmp_path: Path) -> None:
    write_dng(tmp_path / "a.dng", FRAME)
    data = (tmp_path / "a.dng").read_bytes()
    (tmp_path / "b.dng").write_bytes(data[:-500])
    with pytest.raises(FileFormatError, match=r"b\.dng: expected an intact camera RAW file, got damaged data \(Input"):
        read_image(tmp_path / "b.dng")


@pytest.mark.parametrize("pattern", [(0, 1, 0, 2), (1, 1, 0, 2), (0, 1, 2, 0)])
def test_raw_with_an_impossible_bayer_tag(tmp_path: Path, pattern: tuple[int, int, int, int]) -> None:
    write_dng(tmp_path / "a.dng", FRAME, pattern)
    with pytest.raises(FileFormatError, match="correct the Bayer tag"):
        open_image(tmp_path / "a.dng")


@pytest.mark.parametrize(("suffix", "library"), [("dng", "rawpy"), ("png", "imagecodecs")])
def test_a_decoder_that_cannot_be_loaded_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, suffix: str, library: str
) -> None:
    path = tmp_path / f"a.{suffix}"
    if suffix == "dng":
        write_dng(path, FRAME)
    else:
        path.write_bytes(_png())
    monkeypatch.setitem(sys.modules, library, None)
    with pytest.raises(InputError, match="expected a working decoder for") as raised:
        read_image(path)
    assert str(raised.value).endswith(f"; run: python -m pip install --force-reinstall {library}")


def test_missing_file_folder_and_unreadable_page(tmp_path: Path) -> None:
    with pytest.raises(StorageError, match="No such file or directory; check the path"):
        open_image(tmp_path / "a.png")
    with pytest.raises(StorageError, match="is a folder; give the path of a file"):
        open_image(tmp_path)


def test_chunk_helper_makes_a_file_that_reads() -> None:
    """The damaged PNG files above are damaged only where they say."""
    rows = b"".join(b"\0" + line.astype(">u2").tobytes() for line in FRAME)
    image = cv2.imdecode(np.frombuffer(png_bytes(40, 50, 16, 0, rows), np.uint8), cv2.IMREAD_UNCHANGED)
    np.testing.assert_array_equal(image, FRAME)
    assert len(png_chunk(b"IEND", b"")) == 12


@pytest.mark.parametrize("dtype", ["f2", "f4", "f8", ">f8"])
@pytest.mark.parametrize("kind", ["npy", "tif", "packed.tif", "h5"])
def test_float_samples_beyond_any_light(tmp_path: Path, kind: str, dtype: str) -> None:
    """NaN and infinity say that a pixel was not measured; other values beyond 1e12 would overflow later."""
    path = tmp_path / f"a.{kind}"

    def write(value: float) -> None:
        frame = FRAME.astype(dtype)
        frame[3, 4] = value
        if kind == "npy":
            np.save(path, frame)
        elif kind == "h5":
            _h5(path, lambda f: f.create_dataset("frames", data=frame[None]))
        else:
            tifffile.imwrite(path, frame, compression="zlib" if "packed" in kind else None)

    for value in (np.nan, np.inf, -np.inf, 0.0, -5.0, min(9e11, float(np.finfo(dtype).max))):
        write(value)
        np.testing.assert_equal(float(read_image(path)[3, 4]), float(np.dtype(dtype).type(value)))
    if dtype == "f2":
        return
    for value in (1.1e12, -2e12, float(np.finfo(dtype).max)):
        write(value)
        with pytest.raises(FileFormatError, match=r"expected samples up to 1e\+12, got"):
            read_image(path)


def test_whole_numbers_beyond_any_light(tmp_path: Path) -> None:
    for dtype in (np.uint64, np.int64):
        np.save(tmp_path / "a.npy", np.full((4, 5), 2**62, dtype))
        with pytest.raises(FileFormatError, match=r"got 4\.61e\+18"):
            read_image(tmp_path / "a.npy")
