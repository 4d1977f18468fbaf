"""Manifests as CSV and JSON files."""

from __future__ import annotations

import csv
import io
import json
import os
from pathlib import Path
from typing import Any

from lfcal.base import FileFormatError, InputError, parse_json, read_text, replace_whole, storage_errors
from lfcal.frames.manifest import COLUMNS, FrameEntry, Manifest, entry_from

__all__ = ["read_manifest", "write_manifest"]

FORMAT = "lfcal-manifest"
VERSION = 1
MAX_BYTES = 256 << 20
_EXPECTED = ("plan_shape", "shape", "dtype", "bit_depth", "cfa")


def read_manifest(path: str | os.PathLike[str]) -> Manifest:
    """Read a manifest from ``.csv`` (frames only) or ``.json`` (frames and what each must be).

    CSV: a header with ``file, z, y, x`` and any of ``page, exposure_s, dy, dx``, then one row per frame. JSON: an
    object with ``frames``, a list of objects with the same names, and any of ``plan_shape`` (nz, ny, nx),
    ``shape`` (rows, columns), ``dtype``, ``bit_depth``, ``cfa``; or just the list.

    Raises
    ------
    FileFormatError, InputError
        With file, line and column of what is wrong.
    UnsafeFileError
        If a frame's file is not below the session folder.
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
    """Write ``manifest`` to ``.csv`` or ``.json``, whole or not at all; CSV holds the frames alone.

    Raises
    ------
    InputError
        If the name ends otherwise, or CSV is asked for and the manifest says what frames must be.
    StorageError
        If it cannot be written.

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
                f"manifest {path}", "JSON for what CSV cannot hold", ", ".join(expected), "name it .json"
            )
        text = _csv_text(manifest)
    else:
        raise InputError.expected(f"manifest {path}", "a name ending in .csv or .json", repr(suffix), "rename it")
    with storage_errors(path), replace_whole(path) as part:
        part.write_text(text, encoding="utf-8")


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
            f"manifest {path}", 'a list of objects under "frames"', "something else", "correct the file"
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
    """Return the manifest, with the file named in what is wrong with it."""
    try:
        return Manifest(entries, **expected)
    except InputError as error:
        raise type(error)(f"{path.name}: {error}") from error
