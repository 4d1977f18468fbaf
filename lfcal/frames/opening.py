"""The one way in: frames from a folder, a manifest, or a stack in one file."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from lfcal.errors import FileFormatError, InputError, StorageError
from lfcal.files import storage_errors
from lfcal.frames.folder import FolderSource
from lfcal.frames.formats.opening import IMAGE_SUFFIXES, open_image
from lfcal.frames.manifest import FrameEntry, Manifest
from lfcal.frames.manifest_file import read_manifest
from lfcal.frames.positions import NamePattern, check_plan_shape, natural_key
from lfcal.frames.source import Position

__all__ = ["open_frames"]


def open_frames(
    path: str | os.PathLike[str],
    *,
    manifest: str | os.PathLike[str] | Manifest | None = None,
    pattern: str | NamePattern | None = None,
    order: str | None = None,
    plan_shape: Sequence[int] | None = None,
    colour: str | None = None,
    dataset: str | None = None,
    nan: str = "reject",
    blank: str = "reject",
) -> FolderSource:
    """Open recorded frames together with the position of each.

    The position comes from exactly one of: a manifest, the file names, the scan order, or the file itself (axes
    of a 5-D stack, or ``positions`` beside the frames of an HDF5 file).

    Parameters
    ----------
    path
        A folder of images, a manifest (``.csv``, ``.json``; its files lie beside it), or a file of many frames
        (multi-page TIFF, ``.npy``, HDF5).
    manifest
        Manifest or its file; a folder's own ``manifest.json`` or ``manifest.csv`` is found without it.
    pattern
        File names with the position, e.g. ``"z{z}_y{y}_x{x}.png"``.
    order
        ``"serpentine"`` or ``"raster"``: frames in the natural order of names and pages; needs ``plan_shape``.
    plan_shape
        Positions of the scan ``(nz, ny, nx)``; with a manifest or pattern no position may lie outside it.
    colour, dataset
        As in `open_image`.
    nan, blank
        As in `lfcal.frames.folder.check_frame`.

    Raises
    ------
    LfcalError
        One line with the file and what is wrong with it.
    """
    path = Path(path)
    if not path.exists():
        raise StorageError(f"{path}: no such file or folder; check the path")
    shape = None if plan_shape is None else check_plan_shape(plan_shape)
    given = [name for name, value in (("manifest", manifest), ("pattern", pattern), ("order", order)) if value]
    if len(given) > 1:
        raise InputError.expected(
            "positions of the frames", "one source of them", " and ".join(given), "give only one of these"
        )
    root = path if path.is_dir() else path.parent
    listed = _manifest(path, manifest) if not pattern and not order else None
    if listed is None and path.is_dir():
        listed = _from_folder(path, pattern, order, shape, colour, dataset)
    elif listed is None:
        listed = _from_file(path, order, shape, colour, dataset)
    if shape is not None and listed.plan_shape != shape:
        listed = _bounded(listed, shape)
    return FolderSource(root, listed, colour=colour, dataset=dataset, nan=nan, blank=blank)


def _bounded(manifest: Manifest, shape: tuple[int, int, int]) -> Manifest:
    if manifest.plan_shape is not None:
        raise InputError.expected(
            "scan shape", f"{manifest.plan_shape} as the manifest says", shape, "leave it out or correct it"
        )
    fields = {name: getattr(manifest, name) for name in ("shape", "dtype", "bit_depth", "cfa")}
    return Manifest(manifest.entries, plan_shape=shape, **fields)


def _manifest(path: Path, manifest: str | os.PathLike[str] | Manifest | None) -> Manifest | None:
    """Return the manifest that is given, that ``path`` is, or that lies in the folder ``path``; None without."""
    if isinstance(manifest, Manifest):
        return manifest
    if manifest is not None:
        return read_manifest(manifest)
    if path.suffix.lower() in (".csv", ".json") and path.is_file():
        return read_manifest(path)
    found = [path / name for name in ("manifest.json", "manifest.csv") if (path / name).is_file()]
    if len(found) > 1:
        raise InputError.expected(f"manifest in {path}", "one", "manifest.json and manifest.csv", "name the right one")
    return read_manifest(found[0]) if found else None


def _from_folder(
    path: Path,
    pattern: str | NamePattern | None,
    order: str | None,
    shape: tuple[int, int, int] | None,
    colour: str | None,
    dataset: str | None,
) -> Manifest:
    if pattern:
        form = NamePattern(pattern) if isinstance(pattern, str) else pattern
        return Manifest.from_names(_names(path, deep="/" in form.template), form, plan_shape=shape)
    if not order or shape is None:
        raise _where_from(path)
    names = [name for name in _names(path, deep=False) if Path(name).suffix.lower() in IMAGE_SUFFIXES]
    pages = [(name, 0) for name in sorted(names, key=natural_key)]
    if len(pages) != shape[0] * shape[1] * shape[2]:
        pages = [(name, k) for name, _ in pages for k in range(_count(path / name, colour, dataset))]
    return Manifest.from_order(pages, shape, order)


def _names(root: Path, *, deep: bool) -> list[str]:
    """Return the relative paths of the files below ``root``, links to folders not followed, hidden files left out."""
    names = []
    with storage_errors(root):
        for folder, folders, files in os.walk(root):
            folders[:] = [name for name in folders if deep and not name.startswith(".")]
            base = Path(folder).relative_to(root).as_posix()
            names += [name if base == "." else f"{base}/{name}" for name in files if not name.startswith(".")]
    return names


def _count(path: Path, colour: str | None, dataset: str | None) -> int:
    image = open_image(path, colour=colour, dataset=dataset)
    image.close()
    return image.pages


def _from_file(
    path: Path,
    order: str | None,
    shape: tuple[int, int, int] | None,
    colour: str | None,
    dataset: str | None,
) -> Manifest:
    image = open_image(path, colour=colour, dataset=dataset)
    image.close()
    pages = [(path.name, k) for k in range(image.pages)]
    if order:
        if shape is None:
            raise _where_from(path)
        return Manifest.from_order(pages, shape, order)
    if image.metadata.get("plan_shape") is not None:
        return Manifest.from_order(pages, image.metadata["plan_shape"], "raster")
    if image.metadata.get("positions") is None:
        raise _where_from(path)
    return _from_tables(path, image.metadata, shape)


def _from_tables(path: Path, metadata: Any, shape: tuple[int, int, int] | None) -> Manifest:
    positions, exposures = metadata["positions"], metadata.get("exposure_s")
    if positions.dtype.kind not in "iu" or positions.min() < 0:
        raise FileFormatError.expected(
            f"{path}:/positions",
            "whole numbers from 0",
            f"{positions.dtype} from {positions.min()}",
            "correct the file",
        )
    entries = tuple(
        FrameEntry(path.name, Position(*row), k, None if exposures is None else float(exposures[k]))
        for k, row in enumerate(positions.tolist())
    )
    return Manifest(entries, plan_shape=shape)


def _where_from(path: Path) -> InputError:
    return InputError.expected(
        f"positions of the frames in {path}",
        "a manifest, a name pattern, or a scan order with the scan shape",
        "none",
        'add manifest.csv (file,z,y,x), or give for example "z{z}_y{y}_x{x}.png", or order and nz, ny, nx',
    )
