"""Image files: found out by their first bytes, opened as pages, never trusted."""

from __future__ import annotations

import os
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.errors import FileFormatError, InputError, LfcalError, StorageError, UnsafeFileError, expectation
from lfcal.files import MAX_EXPANSION, storage_errors
from lfcal.frames.regions import check_region
from lfcal.units import format_bytes

__all__ = ["IMAGE_SUFFIXES", "RAW_SUFFIXES", "ImageFile", "open_image", "read_image"]

RAW_SUFFIXES = frozenset(
    ".3fr .arw .cr2 .cr3 .crw .dcr .dng .erf .iiq .kdc .mef .mos .mrw .nef .nrw .orf .pef .raf .rw2 .rwl .sr2 .srf"
    " .srw .x3f".split()
)
"""Names of camera RAW files; they are told by name, as most look like TIFF inside."""

HDF5_SUFFIXES = frozenset({".h5", ".hdf5", ".mat"})

IMAGE_SUFFIXES = frozenset({".tif", ".tiff", ".png", ".pgm", ".npy"} | RAW_SUFFIXES)
"""Names of the files that are looked for in a folder."""

MAX_SIDE = 200_000


class ImageFile(ABC):
    """Pages of equal shape and dtype in one file; reading is safe from several threads.

    Attributes
    ----------
    path
        The file.
    shape, dtype
        Rows and columns, and sample type, of every page.
    pages
        Number of pages.
    metadata
        What the file says of them: ``cfa``, ``black_level``, ``saturation``, ``gains``, ``positions`` …
    """

    path: Path
    shape: tuple[int, int]
    dtype: np.dtype[Any]
    pages: int = 1
    metadata: Mapping[str, Any] = MappingProxyType({})

    @abstractmethod
    def read(self, page: int = 0) -> NDArray[Any]:
        """Return ``page`` as a new array ``(rows, columns)`` of `dtype`."""

    def read_region(self, page: int, rows: slice, columns: slice) -> NDArray[Any]:
        """Return the part ``[rows, columns]`` of ``page``."""
        rows, columns = check_region((rows, columns), self.shape)
        return np.ascontiguousarray(self.read(page)[rows, columns])

    def close(self) -> None:  # noqa: B027  most kinds keep nothing open
        """Release the file."""

    def check_page(self, page: int) -> int:
        """Return ``page`` or raise `FileFormatError` where the file has fewer."""
        if not 0 <= page < self.pages:
            raise FileFormatError(
                expectation(str(self.path), f"page {page}", f"{self.pages} pages (0 … {self.pages - 1})",
                            "the file is cut short or the manifest is wrong")
            )  # fmt: skip
        return page


def open_image(path: str | os.PathLike[str], *, colour: str | None = None, dataset: str | None = None) -> ImageFile:
    """Open an image file of pages, each one frame.

    16-bit and other grey TIFF (single and multi-page), PNG, PGM, ``.npy`` arrays, HDF5 stacks, and camera RAW (the
    mosaic as it is). The kind is told by the first bytes, not by the name, except for camera RAW.

    Parameters
    ----------
    path
        The file.
    colour
        ``"R"``, ``"G"`` or ``"B"``: the component taken of a lossless colour image. Without it a colour image is
        refused, as its samples have been through a camera's processing.
    dataset
        The stack of an HDF5 file; None takes ``frames`` or the only one.

    Raises
    ------
    FileFormatError
        If the file is damaged, cut short, compressed with loss, not an image, or colour without ``colour``.
    UnsafeFileError
        If it asks for more memory than its size warrants, or holds Python objects.
    StorageError
        If it cannot be read.
    """
    path = Path(path)
    if colour is not None and colour not in ("R", "G", "B"):
        raise InputError(expectation("colour", "R, G or B", repr(colour), "choose one of these"))
    head = _head(path)
    if path.suffix.lower() in RAW_SUFFIXES:
        from lfcal.frames.raw import RawImage

        return RawImage(path)
    if head.startswith(b"\x89PNG\r\n\x1a\n"):
        from lfcal.frames.png import PngImage

        return PngImage(path, colour)
    if head[:4] in (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+"):
        from lfcal.frames.tiff import TiffImage

        return TiffImage(path, colour)
    if head.startswith(b"\x93NUMPY"):
        from lfcal.frames.npy import NpyImage

        return NpyImage(path)
    if head.startswith(b"\x89HDF") or path.suffix.lower() in HDF5_SUFFIXES:
        from lfcal.frames.hdf5 import Hdf5Image

        return Hdf5Image(path, dataset)
    if head[:2] == b"P5":
        from lfcal.frames.pgm import PgmImage

        return PgmImage(path)
    raise FileFormatError(
        expectation(str(path), "TIFF, PNG, PGM, NPY, HDF5 or camera RAW", _guess(head), _remedy(head))
    )


def read_image(path: str | os.PathLike[str], page: int = 0, *, colour: str | None = None) -> NDArray[Any]:
    """Return one page of an image file, ``(rows, columns)``: for dark and white frames. Raises as `open_image`."""
    image = open_image(path, colour=colour)
    try:
        return image.read(image.check_page(page))
    finally:
        image.close()


def _head(path: Path) -> bytes:
    if path.is_dir():
        raise StorageError(f"{path}: is a folder; name a file in it")
    with storage_errors(path), path.open("rb") as file:
        head = file.read(16)
    if not head:
        raise FileFormatError(expectation(str(path), "an image", "an empty file", "record or copy it again"))
    return head


_KINDS = {
    b"\xff\xd8": "a JPEG picture",
    b"BM": "a BMP picture",
    b"GIF8": "a GIF picture",
    b"PK": "a ZIP or .npz archive",
    b"RIFF": "a WebP picture or a video",
    b"P6": "a colour PPM picture",
}


def _guess(head: bytes) -> str:
    return next((kind for magic, kind in _KINDS.items() if head.startswith(magic)), "something else")


def _remedy(head: bytes) -> str:
    if head.startswith(b"\xff\xd8"):
        return "JPEG loses what calibration needs; record RAW, 16-bit TIFF or PNG"
    return "convert it without loss to 16-bit TIFF or PNG"


@contextmanager
def decoding(path: Path, kind: str) -> Iterator[None]:
    """Turn whatever a decoder raises into one line of `FileFormatError` that names the file."""
    try:
        yield
    except (LfcalError, MemoryError):
        raise
    except Exception as error:
        if isinstance(error, OSError) and error.errno is not None:
            with storage_errors(path):
                raise
        said = error.args[0].decode(errors="replace") if error.args and isinstance(error.args[0], bytes) else str(error)
        reason = " ".join(said.split())[:120] or type(error).__name__
        raise FileFormatError(
            expectation(str(path), f"an intact {kind} file", f"damaged data ({reason})", "record or copy it again")
        ) from error


def check_declared(path: Path, shape: tuple[int, ...], itemsize: int, stored: int) -> None:
    """Raise unless ``shape`` is that of a frame and its bytes are believable for ``stored`` bytes of file."""
    rows, columns = shape[:2]
    if not (1 <= rows <= MAX_SIDE and 1 <= columns <= MAX_SIDE):
        raise UnsafeFileError(
            expectation(str(path), f"frames of 1 … {MAX_SIDE} px a side", f"{rows} x {columns}", "check the file")
        )
    nbytes = int(np.prod(shape, dtype=object)) * itemsize
    if nbytes > MAX_EXPANSION * stored + (1 << 20):
        raise UnsafeFileError(
            expectation(str(path), "a size the file can hold",
                        f"{format_bytes(nbytes)} declared in a file of {format_bytes(stored)}",
                        "the header is wrong; take it from its source again")
        )  # fmt: skip


def check_grey(path: Path, components: int, colour: str | None, bits: int) -> None:
    """Raise unless an image of ``components`` samples per pixel can be taken as data."""
    if components == 1 or (components in (3, 4) and colour is not None):
        return
    raise FileFormatError(
        expectation(str(path), "grey data, one sample per pixel", f"{components} samples of {bits} bits per pixel",
                    "record grey or RAW" if components == 2 or bits < 16 else 'record RAW, or take one with colour="G"')
    )  # fmt: skip
