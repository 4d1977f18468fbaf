"""Image files: they are recognised, opened as pages, and every declared size is checked."""

from __future__ import annotations

import os
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.base import (
    MAX_EXPANSION,
    MAX_SAMPLE,
    ZARR_MARKS,
    FileFormatError,
    InputError,
    LfcalError,
    Registry,
    UnsafeFileError,
    check_region,
    check_regular,
    format_bytes,
    storage_errors,
)

__all__ = [
    "FORMATS",
    "MAX_SIDE",
    "Format",
    "ImageFile",
    "check_declared",
    "check_grey",
    "check_samples",
    "container_in",
    "decoding",
    "image_suffixes",
    "open_image",
    "read_image",
    "split_dataset",
]

MAX_SIDE = 200_000


class ImageFile(ABC):
    """An open image file with pages of equal shape and dtype; reading is thread-safe.

    Attributes
    ----------
    path
        Path of the file.
    shape, dtype
        Shape ``(rows, columns)`` and sample type of every page.
    pages
        Number of pages.
    metadata
        Metadata of the pages by name: fields of `lfcal.frames.FrameMetadata` such as ``cfa`` and ``black_level``, and
        values of single pages such as ``positions``.
    """

    path: Path
    shape: tuple[int, int]
    dtype: np.dtype[Any]
    pages: int = 1
    metadata: Mapping[str, Any] = MappingProxyType({})

    @abstractmethod
    def read(self, page: int = 0) -> NDArray[Any]:
        """Return the page with index ``page`` as a new array ``(rows, columns)`` of `dtype`."""

    def read_region(self, page: int, rows: slice, columns: slice) -> NDArray[Any]:
        """Return the part ``[rows, columns]`` of the page with index ``page`` as a contiguous array."""
        rows, columns = check_region((rows, columns), self.shape)
        return np.ascontiguousarray(self.read(page)[rows, columns])

    def close(self) -> None:  # noqa: B027  most kinds keep nothing open
        """Close the file."""

    def check_page(self, page: int) -> int:
        """Return ``page``; raise `FileFormatError` unless it is the index of a page (0 to ``pages - 1``)."""
        if not 0 <= page < self.pages:
            raise FileFormatError.expected(
                str(self.path),
                f"page {page}",
                f"{self.pages} pages (0 … {self.pages - 1})",
                "copy the file again if it is incomplete, or correct the manifest",
            )
        return page


@dataclass(frozen=True, slots=True)
class Format:
    """Image format; its module defines it as ``FORMAT``.

    Attributes
    ----------
    name
        Display name.
    suffixes
        Suffixes of files of this format, in lower case with the dot; files with them are found in folders.
    recognises
        Function that takes the first 16 bytes and the path of a file, and returns whether it has this format.
    open
        Function that opens a file. Its arguments are the path, the component of a colour image (or None), and the
        dataset in the file (or None).
    rank
        Formats are tried in ascending rank; 0 for formats with a unique signature.
    in_folders
        Whether a folder may contain single frames in this format. False for a format such as HDF5, whose file contains
        all frames.
    """

    name: str
    suffixes: frozenset[str]
    recognises: Callable[[bytes, Path], bool]
    open: Callable[[Path, str | None, str | None], ImageFile]
    rank: int = 0
    in_folders: bool = True


@contextmanager
def decoding(path: Path, kind: str) -> Iterator[None]:
    """Context manager that converts errors of a decoder to a one-line `FileFormatError` with the ``path``.

    ``kind`` is the name of the format. Errors of lfcal and `MemoryError` pass unchanged. An `ImportError` becomes an
    `InputError` with a remedy, and an error of the operating system a `StorageError`.
    """
    try:
        yield
    except (LfcalError, MemoryError):
        raise
    except ImportError as error:
        # of a module, or of a function whose library cannot be loaded
        library = "rawpy" if "rawpy" in str(error) else "imagecodecs"
        raise InputError.expected(
            str(path),
            f"a working decoder for {kind} files",
            str(error),
            f"run: python -m pip install --force-reinstall {library}",
        ) from error
    except Exception as error:
        # an error with errno comes from the disk, not from damaged data
        if isinstance(error, OSError) and error.errno is not None:
            with storage_errors(path):
                raise
        # messages of decoders may be bytes, several lines or empty
        message = (
            error.args[0].decode(errors="replace") if error.args and isinstance(error.args[0], bytes) else str(error)
        )
        reason = " ".join(message.split())[:120] or type(error).__name__
        raise FileFormatError.expected(
            str(path), f"an intact {kind} file", f"damaged data ({reason})", "record or copy it again"
        ) from error


def check_declared(path: Path, shape: tuple[int, ...], itemsize: int, stored: int) -> None:
    """Raise `UnsafeFileError` if a header declares an impossible shape, or far more data than the file can contain.

    ``shape`` (rows and columns first) and ``itemsize`` (bytes) are declared by the header, and ``stored`` is the size
    of the stored data (bytes). Rows and columns must be 1 to `MAX_SIDE`. The declared data must not exceed
    `MAX_EXPANSION` times the stored data by more than 1 MiB.
    """
    rows, columns = shape[:2]
    if not (1 <= rows <= MAX_SIDE and 1 <= columns <= MAX_SIDE):
        raise UnsafeFileError.expected(
            str(path), f"frames of 1 … {MAX_SIDE} px per side", f"{rows} x {columns}", "check the file"
        )
    # Python integers: a forged header would overflow 64 bits
    nbytes = int(np.prod(shape, dtype=object)) * itemsize
    # a header that declares far more than its file can contain is a decompression bomb or damaged; 1 MB lets tiny files
    # pass
    if nbytes > MAX_EXPANSION * stored + (1 << 20):
        raise UnsafeFileError.expected(
            str(path),
            "a size the file can hold",
            f"{format_bytes(nbytes)} declared in a file of {format_bytes(stored)}",
            "the header is wrong; get the file from its source again",
        )


def check_samples(path: Path, samples: NDArray[Any]) -> NDArray[Any]:
    """Return ``samples``; raise `FileFormatError` if the absolute value of a finite one exceeds `MAX_SAMPLE`.

    NaN and infinity are accepted. They mark pixels without a measurement, which the caller handles.
    """
    # whole numbers of 32 bits cannot be so large
    if not samples.size or not (samples.dtype.kind == "f" or samples.dtype.itemsize == 8):
        return samples
    # also false if one is NaN: check the others then
    if max(float(samples.max()), -float(samples.min())) <= MAX_SAMPLE:
        return samples
    finite = np.abs(samples[np.isfinite(samples)].astype(np.float64))
    if finite.size and finite.max() > MAX_SAMPLE:
        raise FileFormatError.expected(
            str(path), f"samples up to {MAX_SAMPLE:g}", f"{finite.max():.3g}", "scale them, or record them again"
        )
    return samples


def check_grey(path: Path, components: int, colour: str | None, bits: int) -> None:
    """Raise `FileFormatError` unless an image is grey, or ``colour`` selects a component of a colour image.

    The image has ``components`` samples of ``bits`` bits per pixel.
    """
    if components == 1 or (components in (3, 4) and colour is not None):
        return
    raise FileFormatError.expected(
        str(path),
        "grey data, one sample per pixel",
        f"{components} samples of {bits} bits per pixel",
        "record grey or RAW frames" if components == 2 else 'record RAW, or use one colour: --channel G (colour="G")',
    )


FORMATS: Registry[Format] = Registry(
    "image format", "lfcal.frames.formats", "FORMAT", "lfcal.formats", order=lambda f: (f.rank, f.name)
)
"""All formats; the first that recognises a file opens it."""


def image_suffixes() -> frozenset[str]:
    """Return the suffixes of files to search for in a folder of frames."""
    return frozenset().union(*(form.suffixes for form in FORMATS if form.in_folders))


def open_image(path: str | os.PathLike[str], *, colour: str | None = None, dataset: str | None = None) -> ImageFile:
    """Open an image file in which each page is one frame.

    Supported formats are greyscale TIFF (with one or several pages, 16-bit and others), PNG, PGM, ``.npy`` arrays,
    FITS, HDF5 stacks, OME-Zarr, NDTiff, and camera RAW (the unprocessed mosaic). Plug-ins add others. The format is
    detected from the first bytes of the file. Exceptions are camera RAW, which is recognised by the suffix, and the
    folders of OME-Zarr and NDTiff. Give such a folder, or the file that describes it (``zarr.json``, ``NDTiff.index``).

    Parameters
    ----------
    path
        Path of the file. For a format with several datasets, one may be appended: ``scan.h5::/entry/data/data``.
    colour
        ``"R"``, ``"G"`` or ``"B"``: component to use from a lossless colour image. If None, a colour image raises an
        error, because the camera has processed its samples.
    dataset
        Path of the stack in an HDF5 file or of the image in an OME-Zarr, or channel of an NDTiff. None: the stack that
        is identified as the frames, all images of an OME-Zarr, or the only channel.

    Raises
    ------
    InputError
        If ``colour`` is none of these, a channel must be stated or does not exist, or a decoder cannot be loaded.
    FileFormatError
        If the file is damaged, truncated, lossily compressed or not an image, or if it is a colour image and
        ``colour`` is not given.
    UnsafeFileError
        If the file declares more data than its size allows, or contains Python objects.
    StorageError
        If the file cannot be read.

    Examples
    --------
    >>> from lfcal.frames import open_image
    >>> image = open_image("session/frames/z0_y00_x00.png")
    >>> print(image.pages, image.shape, image.dtype)
    1 (80, 96) uint16
    >>> image.close()
    """
    path, inside = split_dataset(path)
    if colour is not None and colour not in ("R", "G", "B"):
        raise InputError.expected("colour", "R, G or B", repr(colour), "choose one of these")
    if path.is_dir():
        path = container_in(path) or path
    head = _head(path)
    for form in FORMATS:
        if form.recognises(head, path):
            return form.open(path, colour, dataset or inside)
    names = ", ".join(form.name for form in FORMATS)
    raise FileFormatError.expected(str(path), names, _guess(head), _remedy(head))


CONTAINERS = ("NDTiff.index", *ZARR_MARKS)
"""Names of the files that describe a folder with all frames, in the order in which they are searched."""


def container_in(folder: Path) -> Path | None:
    """Return the file that describes the frames of a whole folder; None for a folder of separate files."""
    found = (folder / name for name in CONTAINERS)
    return next((path for path in found if path.is_file() and path.stat().st_size), None)


def split_dataset(path: str | os.PathLike[str]) -> tuple[Path, str | None]:
    """Return the file and the dataset of a path like ``scan.h5::/entry/data/data``.

    The dataset is None if ``path`` exists as a whole or does not name one.
    """
    whole = Path(path)
    file, mark, name = os.fspath(path).partition("::")
    return (whole, None) if not mark or whole.exists() else (Path(file), name.strip("/") or None)


def read_image(path: str | os.PathLike[str], page: int = 0, *, colour: str | None = None) -> NDArray[Any]:
    """Read the page with index ``page`` of an image file, ``(rows, columns)``.

    ``path`` and ``colour``, and the errors raised, are those of `open_image`.

    Examples
    --------
    >>> from lfcal.frames import read_image
    >>> white = read_image("session/white/white_0.png")
    >>> print(white.shape, white.max())
    (80, 96) 2547
    """
    image = open_image(path, colour=colour)
    try:
        return image.read(image.check_page(page))
    finally:
        image.close()


def _head(path: Path) -> bytes:
    check_regular(path)
    with storage_errors(path), path.open("rb") as file:
        head = file.read(16)
    if not head:
        raise FileFormatError.expected(str(path), "an image", "an empty file", "record or copy it again")
    return head


_KINDS = {
    b"\xff\xd8": "a JPEG image",
    b"BM": "a BMP image",
    b"GIF8": "a GIF image",
    b"PK": "a ZIP or .npz archive",
    b"\x1f\x8b": "a gzip archive",
    b"RIFF": "a WebP image or a video",
    b"P6": "a colour PPM image",
    b"P2": "a PGM image in ASCII",
    b"\xda\xce\xbe\x0a": "a Nikon ND2 file",
    b"ZISRAWFILE": "a Zeiss CZI file",
    b"\x70\0\0\0": "a Leica LIF file",
    b"\xd0\xcf\x11\xe0": "an Olympus OIB or Zeiss ZVI file",
    b"DCIMG": "a Hamamatsu DCIMG file",
    b"Andor Technology": "an Andor SIF file",
    b"\xed\xfe\0\0": "a StreamPix SEQ file",
}

_REMEDIES = {
    b"PK": "unpack it, or save an array with numpy.save",
    b"\x1f\x8b": "unpack it",
    b"\xff\xd8": "JPEG compression loses information that calibration needs; record RAW, 16-bit TIFF or PNG",
    b"\xda\xce\xbe\x0a": "export it as OME-TIFF, in NIS-Elements or with Bio-Formats' bfconvert",
    b"ZISRAWFILE": "export it as OME-TIFF, in ZEN or with Bio-Formats' bfconvert",
    b"\x70\0\0\0": "export it as OME-TIFF, in LAS X or with Bio-Formats' bfconvert",
    b"\xd0\xcf\x11\xe0": "export it as OME-TIFF, with Bio-Formats' bfconvert",
    b"DCIMG": "export it as TIFF, in HCImage",
    b"Andor Technology": "export it as TIFF, in Solis",
    b"\xed\xfe\0\0": "export it as TIFF, in StreamPix",
}
"""Remedies for kinds of files, by the start of the file; all others should be converted."""


def _guess(head: bytes) -> str:
    return next((kind for magic, kind in _KINDS.items() if head.startswith(magic)), "an unknown format")


def _remedy(head: bytes) -> str:
    other = "convert it without loss to 16-bit TIFF or PNG"
    return next((remedy for magic, remedy in _REMEDIES.items() if head.startswith(magic)), other)
