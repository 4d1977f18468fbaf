"""Image files opened by the kind that their first bytes show; the suffix does not count."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from lfcal.base import FileFormatError, InputError, Registry, check_regular, storage_errors
from lfcal.frames.formats.image_file import Format, ImageFile

__all__ = ["FORMATS", "image_suffixes", "open_image", "read_image"]

FORMATS: Registry[Format] = Registry(
    "image format", "lfcal.frames.formats", "FORMAT", "lfcal.formats", order=lambda f: (f.rank, f.name)
)
"""Every format there is; the first that recognises a file opens it."""


def image_suffixes() -> frozenset[str]:
    """Return the endings of files that are looked for in a folder of frames."""
    return frozenset().union(*(form.suffixes for form in FORMATS if form.in_folders))


def open_image(path: str | os.PathLike[str], *, colour: str | None = None, dataset: str | None = None) -> ImageFile:
    """Open an image file of pages, each one frame.

    16-bit and other grey TIFF (single and multi-page), PNG, PGM, ``.npy`` arrays, HDF5 stacks, camera RAW (the mosaic
    as it is), and what other packages add. The format is detected by the first bytes, not by the name, except for
    camera RAW.

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

    Examples
    --------
    >>> from lfcal.frames import open_image
    >>> image = open_image("session/frames/z0_y00_x00.png")
    >>> print(image.pages, image.shape, image.dtype)
    1 (80, 96) uint16
    >>> image.close()
    """
    path = Path(path)
    if colour is not None and colour not in ("R", "G", "B"):
        raise InputError.expected("colour", "R, G or B", repr(colour), "choose one of these")
    head = _head(path)
    for form in FORMATS:
        if form.recognises(head, path):
            return form.open(path, colour, dataset)
    names = ", ".join(form.name for form in FORMATS)
    raise FileFormatError.expected(str(path), names, _guess(head), _remedy(head))


def read_image(path: str | os.PathLike[str], page: int = 0, *, colour: str | None = None) -> NDArray[Any]:
    """Return one page of an image file, ``(rows, columns)``: for dark and white frames. Raises as `open_image`.

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
