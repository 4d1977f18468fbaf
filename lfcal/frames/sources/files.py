"""Frames in files, with their positions from a manifest, the names, the order, or the file itself."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np

from lfcal.errors import FileFormatError, InputError
from lfcal.files import storage_errors
from lfcal.frames.formats.opening import image_suffixes, open_image
from lfcal.frames.manifest import FrameEntry, Manifest
from lfcal.frames.manifest_file import read_manifest
from lfcal.frames.positions import NamePattern, check_plan_shape, natural_key
from lfcal.frames.source import Position
from lfcal.frames.sources.base import FrameOptions, SourceKind
from lfcal.frames.sources.folder import FolderSource

__all__ = ["SOURCE", "open_files"]


def open_files(path: Path, options: FrameOptions) -> FolderSource:
    """Open a folder, a manifest, or one file of many frames; see `lfcal.frames.open_frames`."""
    shape = None if options.plan_shape is None else check_plan_shape(options.plan_shape)
    ways = {"manifest": options.manifest, "pattern": options.pattern, "order": options.order}
    given = [name for name, value in ways.items() if value]
    if len(given) > 1:
        raise InputError.expected(
            "positions of the frames", "one source of them", " and ".join(given), "give only one of these"
        )
    root = path if path.is_dir() else path.parent
    listed = _manifest(path, options.manifest) if not options.pattern and not options.order else None
    if listed is None and path.is_dir():
        listed = _from_folder(path, options, shape)
    elif listed is None:
        listed = _from_file(path, options, shape)
    if shape is not None and listed.plan_shape != shape:
        listed = _bounded(listed, shape)
    return FolderSource(
        root,
        listed,
        colour=options.colour,
        dataset=options.dataset,
        nan=options.nan,
        blank=options.blank,
        skip_damaged=options.skip_damaged,
    )


SOURCE = SourceKind("files", lambda _: True, open_files, rank=100)


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


def _from_folder(path: Path, options: FrameOptions, shape: tuple[int, int, int] | None) -> Manifest:
    pattern = options.pattern
    if pattern:
        form = NamePattern(pattern) if isinstance(pattern, str) else pattern
        return Manifest.from_names(_names(path, deep="/" in form.template), form, plan_shape=shape)
    if not options.order or shape is None:
        raise _where_from(path)
    names = [name for name in _names(path, deep=False) if Path(name).suffix.lower() in image_suffixes()]
    pages = [(name, 0) for name in sorted(names, key=natural_key)]
    if len(pages) != shape[0] * shape[1] * shape[2]:
        pages = [(name, k) for name, _ in pages for k in range(_count(path / name, options))]
    return Manifest.from_order(pages, shape, options.order)


def _names(root: Path, *, deep: bool) -> list[str]:
    """Return the relative paths of the files below ``root``, links to folders not followed, hidden files left out."""
    names = []
    with storage_errors(root):
        for folder, folders, files in os.walk(root):
            folders[:] = [name for name in folders if deep and not name.startswith(".")]
            base = Path(folder).relative_to(root).as_posix()
            names += [name if base == "." else f"{base}/{name}" for name in files if not name.startswith(".")]
    return names


def _count(path: Path, options: FrameOptions) -> int:
    image = open_image(path, colour=options.colour, dataset=options.dataset)
    image.close()
    return image.pages


def _from_file(path: Path, options: FrameOptions, shape: tuple[int, int, int] | None) -> Manifest:
    image = open_image(path, colour=options.colour, dataset=options.dataset)
    image.close()
    pages = [(path.name, k) for k in range(image.pages)]
    axes = image.metadata.get("scan_axes")
    if axes is not None:
        scanned, found = _along_axes(path, pages, *axes)
        if not options.order and found is not None:
            return Manifest.from_order(scanned, found, "raster")
        pages = scanned
    if options.order:
        if shape is None:
            raise _where_from(path)
        return Manifest.from_order(pages, shape, options.order)
    if image.metadata.get("plan_shape") is not None:
        return Manifest.from_order(pages, image.metadata["plan_shape"], "raster")
    if image.metadata.get("positions") is None:
        raise _where_from(path)
    return _from_tables(path, image.metadata, shape)


def _along_axes(
    path: Path, pages: list[tuple[str, int]], names: str, lengths: tuple[int, ...]
) -> tuple[list[tuple[str, int]], tuple[int, int, int] | None]:
    """Return the pages with depth planes (axis Z) slowest, and the scan's shape where the axes tell it.

    Three axes are depth plane, row and column of positions; two without Z are row and column of one plane; Z and one
    other are planes of positions in some order, which has to be said.
    """
    if len(lengths) > 3:
        raise FileFormatError.expected(
            f"{path}, axes of the pages", "three or fewer", names, "write a manifest that says which page is where"
        )
    number = np.arange(len(pages)).reshape(lengths)
    depth = names.find("Z")
    if depth > 0:
        number = np.moveaxis(number, depth, 0)
    scanned = [pages[k] for k in number.ravel().tolist()]
    if len(lengths) == 3:
        return scanned, (number.shape[0], number.shape[1], number.shape[2])
    return scanned, (1, *lengths) if depth < 0 else None  # type: ignore[return-value]  # two lengths are left


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
