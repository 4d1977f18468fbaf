"""Opening of a list file: lfcal's own manifest, or a list from another program."""

from __future__ import annotations

import csv
import math
import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.base import FileFormatError, InputError, StorageError, format_count, parse_json, read_text
from lfcal.frames.formats import container_in, image_suffixes, open_image
from lfcal.frames.lists.entries import located, manifest_of
from lfcal.frames.lists.listing import MAX_EXPOSURE_S, Listing, read_listing
from lfcal.frames.lists.motion import AUTO, CHECK, Part
from lfcal.frames.lists.table import LENGTHS, TABLE_SUFFIXES
from lfcal.frames.manifest import COLUMNS, Manifest, read_manifest
from lfcal.frames.orientation import AS_IS, Orientation, named_orientation
from lfcal.frames.part import parse_roi
from lfcal.frames.sources import FrameOptions

__all__ = [
    "any_listing",
    "from_micromanager",
    "from_names",
    "from_stage",
    "is_plain",
    "manifest_from",
    "micromanager_list",
    "read_micromanager",
    "reader",
    "sample_of",
]

_DARK = re.compile(r"\b(?:dark|background|off|closed)\b", re.IGNORECASE)
"""Names of channels without light."""

MOST_DARKS = 64
"""Largest number of dark frames that are averaged."""

SAMPLE = 50
"""Number of rows that show whether positions are numbers or coordinates."""


def is_plain(path: Path) -> bool:
    """Return whether a file is a manifest in lfcal's own form.

    It is a manifest if it has no suffix of a table, such as a JSON file, or if it is an empty CSV file. A CSV file with
    rows must have only lfcal's column names, and at least half of its positions must be whole numbers.
    """
    if path.suffix.lower() not in TABLE_SUFFIXES:
        return True
    lines = read_text(path, limit=256 << 20, foreign=True).splitlines()[: SAMPLE + 1]
    try:
        rows = list(csv.reader(lines, skipinitialspace=True))
    except csv.Error:  # another kind of list, whose reader reports the problem
        return False
    if not rows:
        return path.suffix.lower() == ".csv"
    header = [cell.strip() for cell in rows[0]]
    if "file" not in header or not set(header) <= set(COLUMNS):
        return False
    places = [row[header.index(axis)].strip() for row in rows[1:] for axis in "zyx" if _has(header, axis, row)]
    odd = sum(not cell.lstrip("+").isdigit() for cell in places)
    return path.suffix.lower() == ".csv" and 2 * odd <= max(len(places), 2)


def _has(header: list[str], axis: str, row: list[str]) -> bool:
    return axis in header and header.index(axis) < len(row)


def manifest_from(path: Path, root: Path, options: FrameOptions) -> tuple[Manifest, tuple[str, ...]]:
    """Return the manifest from the list at ``path``, whose files are below ``root``, and notes on what was guessed."""
    if not options.columns and options.first is None and is_plain(path):
        return read_manifest(path), ()
    return _placed(located(read_listing(path, options.columns), root), root, options)


def from_micromanager(
    path: Path, root: Path, options: FrameOptions
) -> tuple[Manifest, tuple[str, ...], dict[str, Any]]:
    """Return the manifest from Micro-Manager's ``metadata.txt`` at ``path``, notes, and facts about all frames.

    The files are below ``root``. Only one of several channels is read: the one named by the option
    ``columns="channel=NAME"``, or the only one whose name does not indicate dark frames. The facts are those of
    `read_micromanager`, but with the mean dark frame in ``darks``, by exposure time (s), if all dark frames have the
    same exposure.
    """
    role, _, channel = options.columns.partition("=")
    if options.columns and role.strip() != "channel":
        raise InputError.expected(f"columns of {path}", "channel=NAME", repr(options.columns), "leave the channel out")
    listing, facts = read_micromanager(path, channel.strip())
    dark = facts.pop("dark", None)
    if dark is not None:
        facts |= _darks(located(dark, root), root)
    return *_placed(located(listing, root), root, options), facts


def _darks(listing: Listing, root: Path) -> dict[str, Any]:
    """Return the mean of a list's dark frames by exposure time; empty if exposures are unknown or differ."""
    from lfcal.frames.corrections import Dark, average_frames

    read, times = reader(listing, root), listing.exposures
    if times is None or len(set(times)) != 1:
        return {}
    step = -(-len(listing) // MOST_DARKS)
    chosen = range(0, len(listing), step)
    return {"darks": {times[0]: Dark(average_frames(read(k) for k in chosen), count=len(chosen))}}


def any_listing(path: Path, columns: str = "") -> Listing:
    """Return the frames listed in a table, in Micro-Manager's metadata, or in an image file with stage coordinates.

    ``path`` may also be a folder that contains one file with the description of all frames. ``columns`` assigns the
    columns of a table, as in `read_listing`.

    Raises
    ------
    FileFormatError
        If the file is damaged, or is an image file without stage coordinates.
    """
    if path.name.endswith("metadata.txt"):
        return read_micromanager(path)[0]
    path = (container_in(path) if path.is_dir() else None) or path
    if path.suffix.lower() not in image_suffixes() and container_in(path.parent) != path:
        return read_listing(path, columns)
    image = open_image(path)
    image.close()
    if image.metadata.get("stage_um") is None:
        raise FileFormatError.expected(
            str(path), "stage coordinates of every page in its metadata", "none", "give a list of the frames"
        )
    return stage_listing(path, image.metadata)


def from_stage(path: Path, metadata: Mapping[str, Any], options: FrameOptions) -> tuple[Manifest, tuple[str, ...]]:
    """Return the manifest of the multi-page file ``path``, and notes on how positions were determined.

    ``metadata`` are those of the file, with the stage coordinates.
    """
    return _placed(stage_listing(path, metadata), path.parent, options)


_COORDINATE = re.compile(r"(?<![A-Za-z])([xyz])[_=]?([+-]?\d+(?:[.,]\d+)?)(um|µm|μm|mm|nm)(?![A-Za-z])", re.IGNORECASE)


def from_names(root: Path, names: Sequence[str], options: FrameOptions) -> tuple[Manifest, tuple[str, ...]] | None:
    """Return the manifest of files named like ``x-1.25um_y+0.42um_z-20um.tif``, and notes.

    The result is None if a name does not contain both x and y.

    Raises
    ------
    FileFormatError
        If only some names contain z.
    """
    places = np.full((len(names), 3), np.nan)
    for row, name in enumerate(names):
        found = {axis.lower(): (number, unit) for axis, number, unit in _COORDINATE.findall(Path(name).stem)}
        if not {"x", "y"} <= set(found):
            return None
        for axis, (number, unit) in found.items():
            places[row, "xyz".index(axis)] = float(number.replace(",", ".")) * LENGTHS[unit.lower()]
    example = names[0]
    if np.isnan(places[:, 2]).any() and not np.isnan(places[:, 2]).all():
        raise FileFormatError.expected(
            f"z in the file names of {root}",
            "z in all names, or in none",
            "z in only some names",
            "rename the files, so that all or none of the names contain z",
        )
    notes = (f"positions: stage coordinates in the file names, such as {example}",)
    listing = Listing(f"the names in {root.name}", tuple(names), (0,) * len(names), places, "um", notes=notes)
    return _placed(listing, root, options)


def stage_listing(path: Path, metadata: Mapping[str, Any]) -> Listing:
    """Return the pages listed in ``metadata`` of the file ``path``, with their stage coordinates and exposure times.

    The exposure times are None if unknown or longer than `MAX_EXPOSURE_S`.

    Raises
    ------
    StorageError
        If a listed file is not in the folder of ``path``.
    """
    exposures = metadata.get("stage_exposure_s")
    named = [(file or path.name, page) for file, page in metadata["stage_pages"]]
    files, pages = zip(*named, strict=True)
    for file in sorted(set(files)):
        if file != Path(file).name or not (path.parent / file).is_file():
            remedy = "copy it there under this name, or list the frames that are there (--manifest LIST)"
            raise StorageError(
                f"{path}: {format_count(files.count(file), 'plane is', 'planes are')} in {file!r}, which is not in the "
                f"same folder; {remedy}"
            )
    places = metadata["stage_um"]
    times = None if exposures is None else tuple(exposures.tolist())
    notes = [f"positions: stage coordinates that {path.name} states for its {len(pages)} pages"]
    notes += metadata.get("order_notes", ())
    if times is not None and max(times) > MAX_EXPOSURE_S:
        # some programs write microseconds where the format requires seconds
        notes.append(f"exposures: ignored, because {max(times):g} s in {path.name} is implausible")
        times = None
    return Listing(path.name, files, pages, places, "um", times, notes=tuple(notes))


def _placed(listing: Listing, root: Path, options: FrameOptions) -> tuple[Manifest, tuple[str, ...]]:
    orientation = options.orientation if options.orientation in (CHECK, AUTO) else ""
    turn = None if orientation else named_orientation(options.orientation)
    return manifest_of(
        listing,
        plan=options.plan,
        plan_shape=options.plan_shape,
        first=options.first,
        read=reader(listing, root, options.colour, turn),
        orientation=orientation,
        part=None if options.origin is None else Part(options.origin, AS_IS if turn is None else turn.name),
    )


def sample_of(listing: Listing, root: Path) -> tuple[tuple[int, int], str | None, Any]:
    """Return shape, colour component and region of the first frame of a list from `located`.

    The shape is (rows, columns). The component is ``"G"`` for colour images, otherwise None. The region of the sensor
    is (column, row, width, height); None: not stated.
    """
    path = root / listing.files[0]
    colour = None
    try:
        image = open_image(path)
    except FileFormatError:
        colour = "G"
        # damaged grey frames fail again, with the same message
        image = open_image(path, colour=colour)
    image.close()
    return image.shape, colour, image.metadata.get("roi") or listing.roi


def reader(listing: Listing, root: Path, colour: str | None = None, turn: Orientation | None = None) -> Any:
    """Return a function that reads the frame in row k of a list from `located`.

    ``root`` is the folder of its files. ``colour`` is the component to read from colour images; None: grey images.
    ``turn`` is applied to each frame to make it upright; None: frames are returned as delivered.
    """

    def read(k: int) -> NDArray[Any]:
        image = open_image(root / listing.files[k], colour=colour)
        try:
            frame = image.read(image.check_page(listing.pages[k]))
            return frame if turn is None else turn.apply(frame)
        finally:
            image.close()

    return read


MAX_BYTES = 1 << 30


_PLACES = ("XPositionUm", "YPositionUm", "ZPositionUm")


def micromanager_list(folder: Path) -> Path | None:
    """Return the only metadata file (``*metadata.txt``) of a Micro-Manager folder; None if there is none or several."""
    found = sorted(path for path in folder.glob("*metadata.txt") if path.is_file())
    return found[0] if len(found) == 1 else None


def read_micromanager(path: Path, channel: str = "") -> tuple[Listing, dict[str, Any]]:
    """Return the frames in a Micro-Manager metadata file with their stage coordinates, and facts about all frames.

    The file is ``metadata.txt`` or ``…_metadata.txt``. Versions 1.4 (``FrameKey-…``) and 2.0 (``Metadata-…``) are
    supported, with the entries ``XPositionUm``, ``YPositionUm``, ``ZPositionUm``, ``Exposure-ms`` and ``FileName``. The
    facts, if known, are ``pixel_um`` (``PixelSizeUm``, in object space), ``bit_depth``, ``saturation`` (the largest
    value with this number of bits), and ``roi`` (``ROI``, the region of the camera as column, row, width and height).
    ``dark`` is the `Listing` of the only channel whose name indicates dark frames. Of the other channels, only
    ``channel`` is read; it may be empty if there is only one.

    Raises
    ------
    FileFormatError
        If the file is not from Micro-Manager, or an entry has no x or y coordinate. Also if ``channel`` does not exist,
        or it is empty and there are several.
    """
    body = parse_json(read_text(path, limit=MAX_BYTES), str(path), finite=False)
    entries = list(_frames(body))
    if not entries:
        raise FileFormatError.expected(
            str(path),
            "Micro-Manager's metadata of each frame",
            "none",
            "choose another list of the frames (--manifest)",
        )
    entries, dark, notes = _of_channel(path, entries, channel)
    listing = _listing(path, entries, (f"positions: stage coordinates that Micro-Manager wrote to {path.name}", *notes))
    facts: dict[str, Any] = {"dark": _listing(path, dark, ())} if dark else {}
    size, bits = _optional(entries[0].get("PixelSizeUm")), _optional(entries[0].get("BitDepth"))
    if size:
        facts["pixel_um"] = size
    if bits and 1 <= bits <= 16:
        facts |= {"bit_depth": int(bits), "saturation": float((1 << int(bits)) - 1)}
    if (roi := parse_roi(entries[0].get("ROI"))) is not None:
        facts["roi"] = roi
    return replace(listing, roi=roi), facts


def _listing(path: Path, entries: list[dict[str, Any]], notes: tuple[str, ...]) -> Listing:
    places = np.array([[_number(path, entry, key) for key in _PLACES] for entry in entries])
    slices = np.array([_optional(entry.get("SliceIndex", entry.get("Slice"))) or 0 for entry in entries])
    # a stage that the camera triggers does not report where it is: all slices of a stack have one z
    if counted := bool(np.ptp(places[:, 2]) == 0 and np.ptp(slices) > 0):
        places[:, 2] = slices
        notes = (
            *notes,
            "planes: numbered by SliceIndex, because ZPositionUm is the same in all slices (a sequenced stack)",
        )
    exposures = [_optional(entry.get("Exposure-ms")) for entry in entries]
    known = tuple(ms / 1e3 for ms in exposures if ms is not None and ms > 0)
    files, pages = tuple(str(entry["FileName"]) for entry in entries), tuple(entry.get("page", 0) for entry in entries)
    times = known if len(known) == len(files) else None
    return Listing(path.name, files, pages, places, "um", times, notes=notes, counted=counted)


def _of_channel(
    path: Path, entries: list[dict[str, Any]], wanted: str
) -> tuple[list[dict[str, Any]], list[dict[str, Any]], tuple[str, ...]]:
    """Return the entries of one channel, those of a dark channel, and a note if there are several channels."""
    names = list(dict.fromkeys(str(entry.get("Channel", "")) for entry in entries))
    dark = [name for name in names if _DARK.search(name)]
    light = [name for name in names if name not in dark]
    if len(names) < 2 and wanted in ("", *names):
        return entries, [], ()
    seen: Counter[str] = Counter()
    for entry in entries:  # of a file of many pages the rows are its pages in their order
        entry["page"] = seen[str(entry["FileName"])]
        seen[str(entry["FileName"])] += 1
    chosen = wanted or (light[0] if len(light) == 1 else "")
    if chosen not in names:
        listed = ", ".join(map(repr, names))
        expected, got = (f"one of {listed}", repr(wanted)) if wanted else ("one", listed)
        raise FileFormatError.expected(
            f"{path}, channel",
            expected,
            got,
            f"choose one in the contents of the columns (--columns 'channel={(light or names)[0]}')",
        )
    of = {name: [entry for entry in entries if str(entry.get("Channel", "")) == name] for name in (chosen, *dark)}
    used = of[dark[0]] if len(dark) == 1 and chosen not in dark else []
    note = f"channels: {chosen!r} is used, out of {', '.join(map(repr, names))}"
    return of[chosen], used, (f"{note}; {dark[0]!r} contains its dark frames" if used else note,)


def _frames(body: Any) -> Iterator[dict[str, Any]]:
    """Yield the entry of each frame, in the order of the file."""
    if not isinstance(body, dict):
        return
    for key, entry in body.items():
        if str(key).startswith(("FrameKey", "Metadata-")) and isinstance(entry, dict) and entry.get("FileName"):
            yield entry


def _number(path: Path, entry: dict[str, Any], key: str) -> float:
    value = _optional(entry.get(key))
    if value is None and key != "ZPositionUm":
        raise FileFormatError.expected(
            f"{path}, {key} of {entry['FileName']}",
            "a number",
            entry.get(key),
            "record with the stage's position, or give a list",
        )
    return math.nan if value is None else value


def _optional(value: Any) -> float | None:
    try:
        number = float(value)
    except (TypeError, ValueError):
        return None
    return number if math.isfinite(number) else None
