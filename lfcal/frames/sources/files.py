"""Frames in files, with positions from a manifest, from names, from their order, or from the file itself."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from lfcal.base import FileFormatError, InputError, StorageError
from lfcal.frames.formats import ImageFile, container_in, image_suffixes, open_image
from lfcal.frames.lists import (
    TABLE_SUFFIXES,
    files_below,
    from_micromanager,
    from_names,
    from_stage,
    manifest_from,
    micromanager_list,
)
from lfcal.frames.manifest import FrameEntry, Manifest
from lfcal.frames.positions import NamePattern, first_number, guess_pattern, missing_numbers, natural_key
from lfcal.frames.source import Position
from lfcal.frames.sources.base import FrameOptions, SourceKind
from lfcal.frames.sources.folder import FolderSource

__all__ = ["SOURCE", "open_files", "open_unplaced"]


def open_files(path: Path, options: FrameOptions) -> FolderSource:
    """Open a folder, a manifest, a list, or a file with many frames; see `lfcal.frames.open_frames`."""
    ways = {"manifest": options.manifest, "pattern": options.pattern, "order": options.order}
    given = [name for name, value in ways.items() if value]
    if len(given) > 1:
        raise InputError.expected(
            "positions of the frames", "one source of them", " and ".join(given), "give only one of these"
        )
    root = path if path.is_dir() else path.parent
    listed, notes, facts = _listed(path, root, options)
    shape, last = options.plan_shape, facts.pop("frames_last", False)
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
        notes=(*notes, *_pixel_notes(options, facts)),
        facts=facts,
        origin=options.origin,
        frames_last=last,
    )


def open_unplaced(path: Path, colour: str | None = None) -> FolderSource:
    """Open all pages of an image file, or of all images in a folder, as frames without known positions.

    ``path`` is the file or the folder. ``colour`` is the component of colour images to read, as in `open_image`.

    Raises
    ------
    StorageError, FileFormatError, InputError
        If ``path`` does not exist, a file is not a valid image, or the folder contains no image, respectively.

    Examples
    --------
    >>> from pathlib import Path
    >>> from lfcal.frames import open_unplaced
    >>> with open_unplaced(Path("session/white")) as frames:
    ...     print(len(frames), frames.info(0).label)
    4 white_0.png
    """
    if not path.exists():
        raise StorageError(f"{path}: no such file or folder; check the name")
    root, names = path.parent, [path.name]
    if path.is_dir():
        root, names = path, [p.name for p in path.iterdir() if p.suffix.lower() in image_suffixes()]
        if not names:
            raise InputError.expected(f"frames in {path}", "images", "none", "give the folder that contains them")
    entries = []
    for name in sorted(names, key=natural_key):
        image = open_image(root / name, colour=colour)
        try:
            entries += [FrameEntry(name, Position(0, 0, 0), page) for page in range(image.pages)]
        finally:
            image.close()
    return FolderSource(root, Manifest(tuple(entries)), colour=colour)


def _listed(path: Path, root: Path, options: FrameOptions) -> tuple[Manifest, tuple[str, ...], dict[str, Any]]:
    """Return the manifest of the frames, notes on what was guessed, and the facts about all frames."""
    if isinstance(options.manifest, Manifest):
        return options.manifest, (), {}
    table = _table(path, options)
    if table is not None and table.name.endswith("metadata.txt"):
        return from_micromanager(table, root, options)
    if table is not None:
        return *manifest_from(table, root, options), {}
    if options.columns:
        raise InputError.expected(f"columns of {path}", "a list of frames", "none", "choose the list (--manifest)")
    if path.is_dir() and (described := container_in(path)) is not None:
        return _from_file(described, options, options.plan_shape)
    if path.is_dir():
        return *_from_folder(path, options), {}
    return _from_file(path, options, options.plan_shape)


def _pixel_notes(options: FrameOptions, facts: dict[str, Any]) -> list[str]:
    """Return a note if the pixel size that frames state is neither the sensor's nor that in the object."""
    stated = facts.get("pixel_um")
    if stated is None or options.plan is None:
        return []
    camera = options.plan.camera
    own = {"on the sensor": camera.sensor.pixel_um, "in the object": camera.step_um(0.0)}
    if any(abs(stated / size - 1) < 0.01 for size in own.values()):
        return []
    words = ", ".join(f"{size:.4g} µm {where}" for where, size in own.items())
    return [
        f"pixel size: {stated:.4g} µm in the frames, but in the camera {words}; check binning, objective and camera"
    ]


SOURCE = SourceKind("files", lambda _: True, open_files, rank=100)


def _bounded(manifest: Manifest, shape: tuple[int, int, int]) -> Manifest:
    if manifest.plan_shape is not None:
        raise InputError.expected(
            "scan shape",
            f"{manifest.plan_shape} as in the manifest",
            shape,
            "use the plan of this scan, or correct the manifest",
        )
    fields = {name: getattr(manifest, name) for name in ("shape", "dtype", "bit_depth", "cfa")}
    return Manifest(manifest.entries, plan_shape=shape, **fields)


def _table(path: Path, options: FrameOptions) -> Path | None:
    """Return the given manifest or list, or ``path`` if it is one, or the one in the folder; None without one."""
    if options.pattern or options.order:
        return None
    if options.manifest is not None:
        return Path(options.manifest)  # type: ignore[arg-type]  # a Manifest was taken before
    if path.suffix.lower() in (".json", *TABLE_SUFFIXES) and path.is_file():
        return path
    found = [path / name for name in ("manifest.json", "manifest.csv") if (path / name).is_file()]
    if len(found) > 1:
        raise InputError.expected(f"manifest in {path}", "one", "manifest.json and manifest.csv", "give the right one")
    if not found and path.is_dir() and options.plan is not None and (own := micromanager_list(path)) is not None:
        return own
    if not found and path.is_dir():
        lists = sorted(p for p in path.iterdir() if p.suffix.lower() in (".csv", ".tsv") and p.is_file())
        if len(lists) > 1:
            names = ", ".join(p.name for p in lists[:4])
            raise InputError.expected(f"list of frames in {path}", "one", names, "choose the right one (--manifest)")
        found = lists
    return found[0] if found else None


def _from_folder(path: Path, options: FrameOptions) -> tuple[Manifest, tuple[str, ...]]:
    shape, pattern = options.plan_shape, options.pattern
    if pattern:
        template = pattern.template if isinstance(pattern, NamePattern) else pattern
        return _by_pattern(files_below(path, deep="/" in template), pattern, options)
    names = [name for name in files_below(path, deep=False) if Path(name).suffix.lower() in image_suffixes()]
    if not names and not (names := _below(path)):
        raise InputError.expected(
            f"frames in {path}", "images (TIFF, PNG, NPY, RAW …)", "none", "give the folder that contains them"
        )
    if (path / "NDTiff.index").is_file() and not options.order:
        remedy = "state the order of the frames (--order), or copy the folder again"
        raise InputError.expected(f"positions of the frames in {path}", "an NDTiff index", "an empty one", remedy)
    if not options.order:
        return _by_guess(path, names, options)
    if shape is None:
        raise _where_from(path)
    pages = [(name, 0) for name in sorted(names, key=natural_key)]
    if len(pages) != shape[0] * shape[1] * shape[2]:
        pages = [(name, k) for name, _ in pages for k in range(_count(path / name, options))]
    gaps = missing_numbers(names)
    order = f"the file names skip {', '.join(map(str, gaps[:6]))}{' …' if len(gaps) > 6 else ''}" if gaps else ""
    try:
        manifest = Manifest.from_order(pages, shape, options.order)
    except InputError as error:
        if not order:
            raise
        raise InputError(f"{error}; {order}") from None
    return manifest, (f"order: {order}; the files are taken as consecutive",) if order else ()


def _by_pattern(
    names: list[str], pattern: str | NamePattern, options: FrameOptions
) -> tuple[Manifest, tuple[str, ...]]:
    """Return the frames whose names match; the number of the first position is detected if not given."""
    if isinstance(pattern, NamePattern):
        return Manifest.from_names(names, pattern, plan_shape=options.plan_shape), ()
    if options.first is not None:
        form = NamePattern(pattern, first=options.first)
        return Manifest.from_names(names, form, plan_shape=options.plan_shape), ()
    counted = Manifest.from_names(names, pattern)
    numbers = np.array([entry.position for entry in counted.entries])
    used = np.array(["{z" in pattern, True, True])
    wanted = None if options.plan_shape is None else np.array(options.plan_shape)[used]
    if first_number(numbers[:, used], wanted) == 0:
        return counted, ()
    form = NamePattern(pattern, first=1)
    note = "positions: counted from 1 in the names; if they are counted from 0, state that (--first 0)"
    return Manifest.from_names(names, form, plan_shape=options.plan_shape), (note,)


def _below(path: Path) -> list[str]:
    """Return the images in all folders below ``path``."""
    return [name for name in files_below(path, deep=True) if Path(name).suffix.lower() in image_suffixes()]


def _by_guess(path: Path, names: list[str], options: FrameOptions) -> tuple[Manifest, tuple[str, ...]]:
    """Return the frames by the pattern of their names, if it is unambiguous."""
    if options.plan is not None and (placed := from_names(path, names, options)) is not None:
        return placed
    guess = guess_pattern(names, options.plan_shape)
    if guess.certain:
        manifest, notes = _by_pattern(names, guess.templates[0], options)
        return manifest, (f"names: read as --pattern {guess.templates[0]!r}", *notes)
    if guess.templates:
        raise InputError.expected(
            f"positions of the frames in {path}",
            "a manifest or a name pattern",
            f"{guess.fitting} of {guess.names} names that look like {' or '.join(map(repr, guess.templates[:2]))}",
            f"give --pattern {guess.templates[0]!r}",
        )
    if guess.numbered:
        raise InputError.expected(
            f"positions of the frames in {path}",
            "a list of them, a name pattern, or a scan order",
            f"{guess.numbered} numbered files such as {names[0]}",
            "give their list (--manifest LIST), or state their order: --order serpentine or raster, with the plan of "
            "the scan",
        )
    raise _where_from(path)


def _count(path: Path, options: FrameOptions) -> int:
    image = open_image(path, colour=options.colour, dataset=options.dataset)
    image.close()
    return image.pages


def _from_file(
    path: Path, options: FrameOptions, shape: tuple[int, int, int] | None
) -> tuple[Manifest, tuple[str, ...], dict[str, Any]]:
    image = open_image(path, colour=options.colour, dataset=options.dataset)
    image.close()
    facts = {"pixel_um": image.metadata["pixel_um"]} if "pixel_um" in image.metadata else {}
    if image.metadata.get("stage_um") is not None and options.plan is not None and not options.order:
        return *from_stage(path, image.metadata, options), facts
    notes = list(image.metadata.get("order_notes", ()))
    order = image.metadata.get("page_order") or [("", k) for k in range(image.pages)]
    if _is_frames_last(path, image, options):
        facts["frames_last"] = True
        count, rows, columns = image.shape[1], image.pages, image.shape[0]
        order = [("", k) for k in range(count)]
        notes.append(f"frames: {count} along the last axis of {path.name}, each of {rows} x {columns} px")
    pages = [(file or path.name, page) for file, page in order]
    listed = _of_pages(path, image, pages, options, shape)
    exposures = image.metadata.get("exposure_s")
    if exposures is not None and all(entry.exposure_s is None for entry in listed.entries):
        entries = tuple(replace(entry, exposure_s=float(exposures[entry.page])) for entry in listed.entries)
        listed = replace(listed, entries=entries)
    if options.order and shape is not None and len(listed.entries) < (count := int(np.prod(shape))):
        there = len(listed.entries)
        notes.append(
            f"frames: {there} for {count} positions; they are taken as the first {there} of a scan that stopped early"
        )
    return listed, tuple(notes), facts


def _is_frames_last(path: Path, image: ImageFile, options: FrameOptions) -> bool:
    """Return whether the frames of a stack run along its last axis, by the number of positions.

    Raises
    ------
    FileFormatError
        If the file may also be a scan that stopped early, and the size of the sensor does not decide this.
    """
    shape, known = options.plan_shape, image.metadata
    if not options.order or shape is None or {"scan_axes", "plan_shape"} & set(known):
        return False
    count = int(np.prod(shape))
    if image.shape[1] != count or image.pages == count:
        return False
    sensor = None if options.plan is None else set(options.plan.camera.sensor.shape)
    first, last = set(image.shape) == sensor, {image.pages, image.shape[0]} == sensor
    if first != last:
        return last
    if image.pages > count:
        return True
    remedy = "put the frames along the first axis, for example with numpy.moveaxis(frames, -1, 0)"
    got = f"{image.pages} along the first axis and {count} along the last"
    raise FileFormatError.expected(str(path), f"{count} frames along one axis", got, remedy)


def _of_pages(
    path: Path,
    image: ImageFile,
    pages: list[tuple[str, int]],
    options: FrameOptions,
    shape: tuple[int, int, int] | None,
) -> Manifest:
    """Return the manifest of the pages of one file; positions come from its axes, the order, or its tables."""
    axes = image.metadata.get("scan_axes")
    if axes is not None:
        scanned, found = _along_axes(path, pages, *axes)
        if not options.order and found is not None:
            return Manifest.from_order(scanned, found, "raster")
        pages = scanned
    if options.order:
        if shape is None:
            raise _where_from(path)
        return Manifest.from_order(pages, shape, options.order, early=True)
    if image.metadata.get("plan_shape") is not None:
        return Manifest.from_order(pages, image.metadata["plan_shape"], "raster")
    if image.metadata.get("positions") is None:
        raise _where_from(path)
    return _from_tables(path, image.metadata, shape)


def _along_axes(
    path: Path, pages: list[tuple[str, int]], names: str, lengths: tuple[int, ...]
) -> tuple[list[tuple[str, int]], tuple[int, int, int] | None]:
    """Return the pages with depth planes (axis Z) slowest, and the scan's shape if the axes define it.

    Three axes are depth plane, row and column of positions; two without Z are row and column of one plane. Z and one
    other axis are planes of positions in an order that must be stated.
    """
    if len(lengths) > 3:
        raise FileFormatError.expected(
            f"{path}, axes of the pages", "three or fewer", names, "write a manifest with the position of each page"
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
        "give their list (--manifest LIST; columns file, z, y, x), or state how names or order define the positions: "
        "--pattern 'z{z}_y{y}_x{x}.png', or --order with --plan",
    )
