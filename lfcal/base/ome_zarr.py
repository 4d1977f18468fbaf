"""Safe reading of OME-Zarr (https://ngff.openmicroscopy.org/, versions 0.4 and 0.5) and of plain zarr arrays."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lfcal.base.errors import FileFormatError, InputError, LfcalError, StorageError, UnsafeFileError
from lfcal.base.files import MAX_EXPANSION, storage_errors, storage_words

if TYPE_CHECKING:
    from types import ModuleType

__all__ = ["ZARR_MARKS", "check_stored", "check_zarr", "ome_images", "understood"]

ZARR_MARKS = ("zarr.json", ".zattrs", ".zgroup", ".zarray")
"""Names of the files that make a folder a zarr group or array."""

LOSSLESS = frozenset(
    (
        *("blosc", "bytes", "bz2", "delta", "gzip", "lz4", "lzma", "sharding_indexed", "shuffle", "transpose", "zlib"),
        *("adler32", "crc32", "crc32c", "fletcher32", "zstd"),
    )
)
"""Names of the codecs that may be used: others lose information, or run code from the file (pickle)."""

CODEC_REMEDY = "write the image with zlib, zstd or blosc"

Image = tuple[Any, dict[str, Any]]
"""Array of full resolution, which is not read yet, and the metadata of its image; empty for a plain array."""


def check_zarr() -> ModuleType:
    """Return the module zarr.

    Raises
    ------
    InputError
        If zarr is not installed.
    """
    try:
        import zarr
    except ImportError:
        raise InputError('OME-Zarr files need the library zarr; install it with pip install "lfcal[zarr]"') from None
    found: ModuleType = zarr
    return found


@contextmanager
def understood(source: Path, wanted: str, remedy: str) -> Iterator[None]:
    """Return a context in which errors of the disk become a `StorageError`, and others a `FileFormatError`.

    `LfcalError` is not changed. ``source`` is the folder that is read. ``wanted`` and ``remedy`` state in the
    message what was expected and what to do.
    """
    try:
        yield
    except LfcalError:
        raise
    except Exception as error:  # zarr and its codecs raise various errors for other folders
        if isinstance(error, OSError) and error.errno is not None:
            raise StorageError(storage_words(error, source)) from error
        if type(error).__name__ == "UnknownCodecError":  # of zarr and of numcodecs
            wanted, remedy = "codecs that are safe and lossless", CODEC_REMEDY
        reason = " ".join(str(error).split())[:120] or type(error).__name__
        raise FileFormatError.expected(str(source), wanted, reason, remedy) from error


def ome_images(source: Path, name: str = "") -> tuple[list[Image], dict[str, Any]]:
    """Return the images of an OME-Zarr in their order, and the attributes of the folder or of its entry ``name``.

    Each image is a pair: the zarr array of full resolution, which is not read yet, and its metadata (empty for a plain
    array).

    Parameters
    ----------
    source
        Folder of one image, of several (layout ``bioformats2raw``, or several ``multiscales``) or of a plate; or of a
        plain zarr array.
    name
        Path of an image, group or array in the folder; empty: the folder itself.

    Raises
    ------
    FileFormatError, UnsafeFileError, StorageError, InputError
        If the folder does not contain images of numbers, uses a codec that is lossy or not safe, or cannot be read.
        Also if zarr is not installed.
    """
    zarr = check_zarr()
    with storage_errors(source):
        if not source.exists():
            raise StorageError(f"{source}: no such file or folder; check the path")
    with understood(source, "an OME-Zarr image", "choose another image"):
        node = zarr.open(source, mode="r")
        node = node[name] if name else node
        images = [(node, {})] if isinstance(node, zarr.Array) else list(_images(node))
        if not images:
            raise ValueError("no image")
        for array, image in images:
            _check_array(source, array, image)
        return images, dict(node.attrs)


def _images(group: Any) -> Iterator[Image]:
    """Yield the images of a group, of the fields of its plate, or of its numbered groups."""
    said = dict(group.attrs)
    said = dict(said.get("ome", said))
    for image in said.get("multiscales", ()):
        yield group[str(image["datasets"][0]["path"])], dict(image)
    for well in said.get("plate", {}).get("wells", ()):
        yield from _images(group[str(well["path"])])
    for field in said.get("well", {}).get("images", ()):
        yield from _images(group[str(field["path"])])
    if "bioformats2raw.layout" in said:
        for key in sorted((key for key in group.group_keys() if key.isdigit()), key=int):
            yield from _images(group[key])


def _check_array(source: Path, array: Any, image: Mapping[str, Any]) -> None:
    """Raise unless an array has numbers, axes for its image, and only codecs that are safe and lossless."""
    if array.dtype.kind not in "iuf" or 0 in array.shape:
        raise FileFormatError.expected(
            str(source), "an array of numbers", f"{array.dtype} of shape {array.shape}", "choose another image"
        )
    axes = image.get("axes", ())
    if axes and len(axes) != len(array.shape):
        raise FileFormatError.expected(str(source), f"{len(array.shape)} axes", len(axes), "copy the file again")
    said = array.metadata.to_dict()
    if said.get("zarr_format") == 2:
        steps = [said.get("compressor"), *(said.get("filters") or ())]
        names = {str(dict(step)["id"]) for step in steps if step}
    else:
        names = set(_codecs(said.get("codecs", ())))
    if other := sorted(names - LOSSLESS):
        raise UnsafeFileError.expected(str(source), "codecs that are safe and lossless", ", ".join(other), CODEC_REMEDY)


def _codecs(steps: Any) -> Iterator[str]:
    """Yield the names of codecs of zarr format 3, including those within shards."""
    for step in steps:
        yield str(step["name"]).removeprefix("numcodecs.")
        inner = step.get("configuration") or {}
        yield from _codecs((*inner.get("codecs", ()), *inner.get("index_codecs", ())))


def check_stored(source: Path, arrays: list[Any]) -> None:
    """Raise `FileFormatError` if ``arrays`` are more than `MAX_EXPANSION` times as large as all files in ``source``."""
    nbytes = sum(math.prod(array.shape) * array.dtype.itemsize for array in arrays)
    with storage_errors(source):
        held = sum(path.stat().st_size for path in source.rglob("*") if path.is_file())
    if nbytes > MAX_EXPANSION * held:
        raise FileFormatError.expected(
            str(source), f"chunks of {nbytes} bytes on disk", f"{held} bytes", "copy the file again"
        )
