"""The list of a session's frames (file and page of each position), with its CSV and JSON files."""

from __future__ import annotations

import csv
import io
import json
import math
import os
import stat
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from lfcal.base import (
    FileFormatError,
    InputError,
    StorageError,
    UnsafeFileError,
    any_of,
    check_exposure,
    check_number,
    parse_json,
    read_text,
    write_text,
)
from lfcal.frames.cfa import check_cfa
from lfcal.frames.positions import NamePattern, check_plan_shape, natural_key, scan_positions
from lfcal.frames.source import Position

__all__ = ["FrameEntry", "Manifest", "read_manifest", "resolve_inside", "write_manifest"]

COLUMNS = ("file", "page", "z", "y", "x", "exposure_s", "dy", "dx")
"""Columns of a manifest; only file, z, y and x are required."""


@dataclass(frozen=True, slots=True)
class FrameEntry:
    """Entry of a manifest: the file, scan position and exposure time of a frame.

    Attributes
    ----------
    file
        Path relative to the session folder, with ``/`` between folders.
    position
        Scan position (z, y, x) of the point source.
    page
        Index of the page of a multi-page file, or of the frame in a stack, from 0.
    exposure_s
        Exposure time (s). None: unknown.
    dy, dx
        Displacement (rows, columns) of the paraxial image from its planned position on the sensor (px).

    Examples
    --------
    >>> from lfcal.frames import FrameEntry
    >>> entry = FrameEntry("z0/y03_x07.tif", (0, 3, 7), exposure_s=0.02)
    >>> print(entry.position, entry.page)
    Position(z=0, y=3, x=7) 0
    """

    file: str
    position: Position
    page: int = 0
    exposure_s: float | None = None
    dy: float = 0.0
    dx: float = 0.0

    def __post_init__(self) -> None:
        """Check every value."""
        name = self.file
        if not name or "\0" in name or "\\" in name:
            raise InputError.expected(
                "file of a frame",
                "a path relative to the manifest, with / between folders",
                repr(name),
                "correct this path",
            )
        # checked before any access to the file system: "..", drive letters and absolute paths would leave the folder
        if name[0] == "/" or name[1:2] == ":" or ".." in name.split("/"):
            raise _leads_out(name, "the session folder")
        object.__setattr__(self, "position", Position(*self.position))
        for value, what in zip((*self.position, self.page), ("z", "y", "x", "page"), strict=True):
            if type(value) is not int or not 0 <= value <= 10**9:  # build the message only if it is needed
                check_number(f"{what} of {name}", value, at_least=0, at_most=10**9, integer=True)
        if self.exposure_s is not None:
            check_exposure(f"exposure_s of {name}", self.exposure_s)
        for shift, what in ((self.dy, "dy"), (self.dx, "dx")):
            if type(shift) is not float or not math.isfinite(shift):
                check_number(f"{what} of {name} (px)", shift)


@dataclass(frozen=True)
class Manifest:
    """List of all frames of a session, with the properties that every frame must have.

    Frames may be in any order; positions may be missing or repeated, but each page of a file may occur only once.

    Attributes
    ----------
    entries
        The frames.
    plan_shape
        Number of positions of the scan, ``(nz, ny, nx)``. None: unknown.
    shape, dtype
        Shape ``(rows, columns)`` (px) and sample type that every frame must have. If ``shape`` is None or ``dtype`` is
        an empty string, that of the first frame is used.
    bit_depth
        Number of bits that a sample may use. None: not checked.
    cfa
        Colour filter pattern in row-major order that the frames must have; empty: not checked.

    Raises
    ------
    InputError
        If there are no entries, a value is invalid, a position is outside ``plan_shape``, or a page is listed twice.

    Examples
    --------
    >>> from lfcal.frames import Manifest
    >>> names = ["y0_x0.png", "y0_x2.png", "notes.txt"]
    >>> manifest = Manifest.from_names(names, "y{y}_x{x}.png", plan_shape=(1, 1, 3))
    >>> missing, several = manifest.coverage()
    >>> print(len(manifest.entries), missing, several)
    2 (Position(z=0, y=0, x=1),) ()
    """

    entries: tuple[FrameEntry, ...]
    plan_shape: tuple[int, int, int] | None = None
    shape: tuple[int, int] | None = None
    dtype: str = ""
    bit_depth: int | None = None
    cfa: str = ""

    def __post_init__(self) -> None:
        """Check every value."""
        object.__setattr__(self, "entries", tuple(self.entries))
        if not self.entries:
            raise InputError.expected(
                "frames of the session", "at least one", "none", "add a row for each frame to the manifest"
            )
        check_cfa(self.cfa)
        if self.bit_depth is not None:
            check_number("bit depth", self.bit_depth, at_least=1, at_most=32, integer=True)
        if self.shape is not None:
            object.__setattr__(self, "shape", _pair(self.shape))
        if self.dtype:
            object.__setattr__(self, "dtype", _dtype(self.dtype))
        if self.plan_shape is not None:
            self._check_positions()
        seen: set[tuple[str, int]] = set()
        for entry in self.entries:
            if (entry.file, entry.page) in seen:
                raise InputError.expected(
                    f"{entry.file} page {entry.page}", "one position", "several", "list every file and page once"
                )
            seen.add((entry.file, entry.page))

    def _check_positions(self) -> None:
        shape = check_plan_shape(self.plan_shape or ())
        object.__setattr__(self, "plan_shape", shape)
        for entry in self.entries:
            for value, n, axis in zip(entry.position, shape, "zyx", strict=True):
                if value >= n:
                    raise InputError.expected(
                        f"{axis} of {entry.file} page {entry.page}",
                        f"0 … {n - 1}",
                        value,
                        "correct this number, or the scan shape",
                    )

    def coverage(self) -> tuple[tuple[Position, ...], tuple[Position, ...]]:
        """Return the positions (z, y, x) without a frame, and those with several frames.

        If ``plan_shape`` is unknown, the scan is assumed to be the smallest box from (0, 0, 0) that contains all
        positions.
        """
        box = self.plan_shape or tuple(1 + max(e.position[k] for e in self.entries) for k in range(3))
        check_plan_shape(box)
        count = np.zeros(box, np.int32)
        # add.at counts repeated positions; plain indexing would count them once
        np.add.at(count, tuple(np.array([e.position for e in self.entries]).T), 1)
        missing, several = (tuple(Position(*p) for p in np.argwhere(mask).tolist()) for mask in (count == 0, count > 1))
        return missing, several

    @classmethod
    def from_names(
        cls, names: Iterable[str], pattern: str | NamePattern, *, plan_shape: tuple[int, int, int] | None = None
    ) -> Manifest:
        """Return the manifest of the relative paths ``names`` that match ``pattern``; other paths are ignored.

        ``pattern`` is a `NamePattern` or its template. ``plan_shape`` is the number of positions of the scan, ``(nz,
        ny, nx)``. None: unknown.

        Raises
        ------
        InputError
            If no path matches, or a position is outside ``plan_shape``.
        """
        form = NamePattern(pattern) if isinstance(pattern, str) else pattern
        # natural order, so that img10 comes after img9
        names = sorted(names, key=natural_key)
        found = [(name, form.parse(name)) for name in names]
        entries = tuple(FrameEntry(name, hit[0], hit[1]) for name, hit in found if hit is not None)
        if not entries:
            example = repr(names[0]) if names else "an empty folder"
            raise InputError.expected(
                "files", f"names like {form.template!r}", example, "give the pattern of these names"
            )
        return cls(entries, plan_shape=plan_shape)

    @classmethod
    def from_order(
        cls, pages: Iterable[tuple[str, int]], plan_shape: tuple[int, int, int], order: str, *, early: bool = False
    ) -> Manifest:
        """Return the manifest of ``pages``, which are pairs (file, page index) in the order of recording.

        ``plan_shape`` is the number of positions of the scan, ``(nz, ny, nx)``, and ``order`` its scan order, as in
        `scan_positions`. If ``early`` is True, there may be fewer pages than positions, because the scan stopped before
        its end.

        Raises
        ------
        InputError
            If the number of pages differs from the number of positions, and ``early`` does not allow this: the order
            does not show which pages are missing.
        """
        pages, positions = list(pages), scan_positions(plan_shape, order)
        if early and 0 < len(pages) < len(positions):
            positions = positions[: len(pages)]
        if len(pages) != len(positions):
            nz, ny, nx = plan_shape
            raise InputError.expected(
                "frames",
                f"{len(positions)} for a scan of {nz} x {ny} x {nx}",
                len(pages),
                "write a manifest that lists the recorded ones",
            )
        entries = tuple(FrameEntry(file, p, page) for (file, page), p in zip(pages, positions, strict=True))
        return cls(entries, plan_shape=plan_shape)


def resolve_inside(root: str | os.PathLike[str], names: Iterable[str]) -> dict[str, Path]:
    """Return the paths, by name, of the files ``names`` below ``root``, with links resolved.

    All files must be inside ``root``, or be content that git-annex stores in the repository that contains ``root``.

    Raises
    ------
    UnsafeFileError
        If a file is outside ``root`` after links and ``..`` are resolved.
    StorageError
        If a file does not exist or is not a regular file.
    """
    base = _follow(str(root), str(root))
    folders: dict[str, str] = {}
    found = {}
    for name in names:
        head, tail = os.path.split(name)
        # each folder is resolved once: a session has a hundred thousand files in a few of them
        if head not in folders:
            folders[head] = _follow(os.path.join(base, head), name)
        path = os.path.join(folders[head], tail)
        try:
            # lstat shows links; most files are not links, and need no further call
            kind = os.lstat(path).st_mode
            if stat.S_ISLNK(kind) or tail in ("", ".", ".."):
                path = _follow(path, name)
                kind = os.stat(path).st_mode
        except (OSError, ValueError):
            kind = 0
        # a link may lead outside the folder although its name passed all checks
        if os.path.commonpath((base, path)) != base and not _is_annexed(base, path):
            raise _leads_out(name, base)
        if not stat.S_ISREG(kind):
            raise StorageError(f"{Path(base, name)}: no such file; copy it there or remove it from the manifest")
        found[name] = Path(path)
    return found


def _is_annexed(base: str, path: str) -> bool:
    """Return whether ``path`` is content that git-annex stores in the repository that contains ``base``."""
    repository, mark, _ = path.partition(os.path.join(os.sep, ".git", "annex", "objects", ""))
    return bool(mark) and os.path.commonpath((base, repository)) == repository


def _follow(path: str, name: str) -> str:
    """Return ``path`` with all links resolved."""
    try:
        return os.path.realpath(path)
    except (OSError, ValueError) as error:
        raise StorageError(f"{name}: the path cannot be followed; check it and its links") from error


def _leads_out(name: str, folder: str) -> UnsafeFileError:
    return UnsafeFileError.expected(
        f"file of a frame {name!r}", f"a path inside {folder}", "one outside", "copy the file into the folder"
    )


def number(text: object, what: str, *, integer: bool = False) -> Any:
    """Return the finite number in ``text``, which must be a whole number if ``integer``.

    Raises
    ------
    FileFormatError
        If ``text`` is no such number. The message calls it ``what``.
    """
    try:
        value = int(str(text)) if integer else float(str(text))
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        wanted = "a whole number" if integer else "a number"
        raise FileFormatError.expected(what, wanted, repr(text), f"write {wanted}")
    return value


def entry_from(record: Mapping[str, Any], where: str) -> FrameEntry:
    """Return the entry defined by ``record``, a row or JSON object of a manifest; messages call it ``where``."""
    unknown = sorted(str(key) for key in record if key not in COLUMNS)
    missing = [key for key in ("file", "z", "y", "x") if record.get(key) in (None, "")]
    if unknown or missing:
        got = f"unknown {unknown[0]!r}" if unknown else f"no {missing[0]!r}"
        raise FileFormatError.expected(where, f"columns {', '.join(COLUMNS)}", got, "rename or fill the column")
    given = {key: value for key, value in record.items() if value not in (None, "")}
    place = Position(*(number(given[key], f"{where}, {key}", integer=True) for key in "zyx"))
    values = {key: number(given[key], f"{where}, {key}") for key in ("exposure_s", "dy", "dx") if key in given}
    page = number(given.get("page", 0), f"{where}, page", integer=True)
    try:
        return FrameEntry(str(given["file"]), place, page, **values)
    except InputError as error:
        raise type(error)(f"{where}: {error}") from error


def _pair(shape: Any) -> tuple[int, int]:
    if not isinstance(shape, tuple | list) or len(shape) != 2:
        raise InputError.expected("frame shape", "(rows, columns)", shape, "give two whole numbers")
    for n in shape:
        check_number("frame rows and columns", n, at_least=1, at_most=200_000, integer=True)
    return int(shape[0]), int(shape[1])


def _dtype(name: str) -> str:
    allowed = ("uint8", "uint16", "int16", "uint32", "int32", "float32", "float64")
    if name not in allowed:
        raise InputError.expected("frame dtype", any_of(allowed), repr(name), "choose one of these")
    return name


FORMAT = "lfcal-manifest"
VERSION = 1
MAX_BYTES = 256 << 20
_EXPECTED = ("plan_shape", "shape", "dtype", "bit_depth", "cfa")


def read_manifest(path: str | os.PathLike[str]) -> Manifest:
    """Read a manifest from ``path``: ``.csv`` (frames only) or ``.json`` (frames and their common properties).

    A CSV file has a header with ``file, z, y, x`` and any of ``page, exposure_s, dy, dx``, followed by one row per
    frame (as in `FrameEntry`). A JSON file is an object with the entry ``frames``, a list of objects with the same
    names, or only this list. The object may also have the entries ``plan_shape`` (nz, ny, nx), ``shape`` (rows,
    columns), ``dtype``, ``bit_depth`` and ``cfa``.

    Raises
    ------
    FileFormatError, InputError
        If the manifest is invalid; the message states the file, and the line or frame with the problem.
    UnsafeFileError
        If the path of a frame leads out of the session folder.
    StorageError
        If the file cannot be read.

    Examples
    --------
    >>> from lfcal.frames import read_manifest
    >>> manifest = read_manifest("session/frames/manifest.csv")
    >>> print(len(manifest.entries), manifest.entries[-1].file, manifest.entries[-1].position)
    1254 z1_y00_x00.png Position(z=1, y=0, x=0)
    """
    path = Path(path)
    text = read_text(path, limit=MAX_BYTES)
    if path.suffix.lower() == ".csv":
        return _named(path, tuple(_csv_rows(path, text)), {})
    if path.suffix.lower() == ".json":
        return _from_json(path, text)
    raise FileFormatError.expected(str(path), "a .csv or .json manifest", repr(path.suffix), "rename it")


def write_manifest(path: str | os.PathLike[str], manifest: Manifest) -> None:
    """Write ``manifest`` atomically to ``path`` (``.csv`` or ``.json``); a CSV file contains only the frames.

    Raises
    ------
    InputError
        If the suffix is neither, or CSV is requested for a manifest with common properties.
    StorageError
        If the file cannot be written.

    Examples
    --------
    >>> from pathlib import Path
    >>> from lfcal.frames import Manifest, write_manifest
    >>> write_manifest("list.csv", Manifest.from_names(["y0_x0.png", "y0_x1.png"], "y{y}_x{x}.png"))
    >>> print(Path("list.csv").read_text(encoding="utf-8"))
    file,page,z,y,x
    y0_x0.png,0,0,0,0
    y0_x1.png,0,0,0,1
    """
    path = Path(path)
    suffix = path.suffix.lower()
    expected = {key: value for key in _EXPECTED if (value := getattr(manifest, key)) not in (None, "")}
    if suffix == ".json":
        body = {"format": FORMAT, "version": VERSION, **expected, "frames": [_record(e) for e in manifest.entries]}
        text = json.dumps(body, indent=1, ensure_ascii=False, allow_nan=False)
    elif suffix == ".csv":
        if expected:
            raise InputError.expected(
                f"manifest {path}", "JSON for values that CSV cannot store", ", ".join(expected), "name it .json"
            )
        text = _csv_text(manifest)
    else:
        raise InputError.expected(f"manifest {path}", "a name ending in .csv or .json", repr(suffix), "rename it")
    write_text(path, text)


def _record(entry: FrameEntry) -> dict[str, Any]:
    values = {"file": entry.file, "page": entry.page, **entry.position._asdict()}
    optional = {"exposure_s": entry.exposure_s, "dy": entry.dy or None, "dx": entry.dx or None}
    return values | {key: value for key, value in optional.items() if value is not None}


def _csv_text(manifest: Manifest) -> str:
    records = [_record(entry) for entry in manifest.entries]
    # columns that no frame uses are left out, so that a plain list stays readable
    columns = [name for name in COLUMNS if any(name in record for record in records)]
    buffer = io.StringIO()
    writer = csv.DictWriter(buffer, columns, restval="", lineterminator="\n")
    writer.writeheader()
    writer.writerows(records)
    return buffer.getvalue()


def _csv_rows(path: Path, text: str) -> list[FrameEntry]:
    reader = csv.DictReader(io.StringIO(text, newline=""), restkey="surplus values", skipinitialspace=True)
    entries = []
    try:
        for row in reader:
            entries.append(entry_from(row, f"{path.name} line {reader.line_num}"))
    except csv.Error as error:
        raise FileFormatError.expected(f"manifest {path}", "CSV", str(error), "save it again") from error
    return entries


def _from_json(path: Path, text: str) -> Manifest:
    body = parse_json(text, f"manifest {path}", remedy="write it again")
    body = {"frames": body} if isinstance(body, list) else body
    frames = body.get("frames") if isinstance(body, dict) else None
    if not isinstance(frames, list) or not all(isinstance(f, dict) for f in frames):
        raise FileFormatError.expected(
            f"manifest {path}",
            'a list of objects under "frames"',
            "content of another form",
            "write the manifest as docs/files.md describes",
        )
    known = {"format", "version", "frames", *_EXPECTED}
    unknown = sorted(set(body) - known)
    if unknown or body.get("format", FORMAT) != FORMAT or body.get("version", VERSION) != VERSION:
        got = f"{unknown[0]!r}" if unknown else f"{body.get('format')!r} version {body.get('version')!r}"
        raise FileFormatError.expected(f"manifest {path}", f"{FORMAT} version {VERSION}", got, "correct the file")
    entries = tuple(entry_from(f, f"{path.name} frame {k}") for k, f in enumerate(frames))
    expected = {key: body[key] for key in _EXPECTED if body.get(key) is not None}
    # lists of JSON become the tuples that the manifest compares with array shapes
    return _named(path, entries, {k: tuple(v) if isinstance(v, list) else v for k, v in expected.items()})


def _named(path: Path, entries: tuple[FrameEntry, ...], expected: dict[str, Any]) -> Manifest:
    """Return the manifest of ``entries``; error messages start with the name of the file ``path``."""
    try:
        return Manifest(entries, **expected)
    except InputError as error:
        raise type(error)(f"{path.name}: {error}") from error
