"""List recordings, H, fits, reports, exports and volumes in folders, described by their headers alone."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from lfcal.acquire import NAME, SessionFile
from lfcal.acquire.recording import RECORD, intact
from lfcal.base import (
    FileFormatError,
    LfcalError,
    Merit,
    Progress,
    StorageError,
    Work,
    drained,
    format_count,
    format_length,
    format_number,
    format_seconds,
    map_npy,
    plain,
    storage_words,
    understood,
)
from lfcal.base.h5 import H5File
from lfcal.camera import ScanPlan
from lfcal.judge.dated import FIT, QUALITY, read_dated_fit, read_inspection
from lfcal.psf import FORMAT as PSF_FORMAT
from lfcal.psf import head_of
from lfcal.reconstruct import DATASET, VOLUME_FORMAT, open_ome_zarr, zarr_contents

__all__ = [
    "KINDS",
    "ListingProgress",
    "ResultList",
    "StoredResult",
    "detailed",
    "find_results",
    "iter_find_results",
    "picture_of",
    "read_result",
]

Kind = Literal["recording", "H", "fit", "report", "export", "volume", "unreadable"]
KINDS: tuple[Kind, ...] = ("recording", "H", "fit", "report", "export", "volume", "unreadable")
"""Kinds of results: a recorded session, H, a fit, a quality report, H for another program, a volume, or a damaged file
of one of these."""

DEPTH = 4
"""Number of levels of subfolders that are searched."""

MOST_FOLDERS = 20_000
MOST_IMAGES = 64
"""Largest number of TIFF and NPY files in a folder that are read; a folder with more contains frames."""

_IMAGES = (".tif", ".tiff", ".npy")

HEAD = 1 << 14
"""Number of bytes of a damaged TIFF file that are searched for the name of lfcal."""

EVERY_S = 0.2
"""Shortest time between two records of progress (s)."""

Facts = tuple[tuple[str, str], ...]


@dataclass(frozen=True)
class StoredResult:
    """Result stored in a file or folder.

    Attributes
    ----------
    path
        The file, or the folder of a recording, a fit or a report.
    kind
        Kind of the result, one of `KINDS`.
    when, dated
        Creation time (UTC), and whether the result states it; if it does not, ``when`` is the time of the file.
    bytes
        Size of the file, or of all files in the folder and its subfolders (bytes).
    facts
        Pairs of name and value, as text.
    verdict, merit
        Verdict and rating (``"good"``, ``"fair"``, ``"bad"``) that the result states; empty and ``"unknown"`` if there
        are none.
    problem
        Reason why the result cannot be read; empty if it can.

    Examples
    --------
    >>> from datetime import UTC, datetime
    >>> from pathlib import Path
    >>> from lfcal.judge import StoredResult
    >>> StoredResult(Path("scans/H.h5"), "H", datetime(2026, 3, 2, tzinfo=UTC)).name
    'H.h5'
    """

    path: Path
    kind: Kind
    when: datetime
    dated: bool = False
    bytes: int = 0
    facts: Facts = ()
    verdict: str = ""
    merit: Merit = "unknown"
    problem: str = ""

    @property
    def name(self) -> str:
        """Name of the file or folder."""
        return self.path.name

    def to_dict(self) -> dict[str, Any]:
        """Return the result as plain JSON types."""
        found: dict[str, Any] = plain({**self.__dict__, "when": self.when.isoformat(), "facts": dict(self.facts)})
        return found


@dataclass(frozen=True)
class ResultList:
    """The results found in some folders.

    Attributes
    ----------
    results
        The results, newest first.
    notes
        Notes on what could not be searched, one line each.
    """

    results: tuple[StoredResult, ...]
    notes: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class ListingProgress(Progress):
    """Progress with the results found since the previous record."""

    found: tuple[StoredResult, ...] = ()


def iter_find_results(*folders: str | os.PathLike[str], depth: int = DEPTH) -> Work[ResultList]:
    """Find recordings, H files, fits, quality reports, exports of H and volumes, without reading frames or H.

    The kind of a result is determined by its content. Files written by other software are left out. An lfcal file that
    cannot be read has the kind ``"unreadable"``, and ``problem`` states the reason.

    Parameters
    ----------
    folders
        Folders to search.
    depth
        Number of levels of subfolders that are searched.

    Yields
    ------
    ListingProgress
        Progress with the results found since the previous record.

    Examples
    --------
    >>> from lfcal.base import drain
    >>> from lfcal.judge import iter_find_results
    >>> [one.kind for one in drain(iter_find_results("session")).results]
    []
    """
    start, reported = time.perf_counter(), 0.0
    found: list[StoredResult] = []
    notes: list[str] = []
    shown = 0
    for place, entries in _folders(folders, depth, notes):
        for path in _candidates(place, entries):
            try:
                result = read_result(path)
            except OSError as error:  # it has been deleted meanwhile
                notes.append(storage_words(error, path))
                continue
            found += [] if result is None else [result]
            reported, shown = yield from _progress(place, found, shown, start, reported)
        reported, shown = yield from _progress(place, found, shown, start, reported)
    yield ListingProgress(len(found), 0, "done", time.perf_counter() - start, found=tuple(found[shown:]))
    return ResultList(tuple(sorted(found, key=lambda one: one.when, reverse=True)), tuple(dict.fromkeys(notes)))


find_results = drained(
    iter_find_results,
    """
    Examples
    --------
    >>> from lfcal.judge import find_results
    >>> for one in find_results("recorded").results:
    ...     print(one.kind, one.name, one.verdict)
    recording recorded complete: 627 positions
    """,
)


def _progress(
    place: Path, found: list[StoredResult], shown: int, start: float, reported: float
) -> Work[tuple[float, int]]:
    """Yield a record if the last one is old; return the time of the newest, and the number of results reported."""
    now = time.perf_counter()
    if now - reported < EVERY_S:
        return reported, shown
    yield ListingProgress(len(found), 0, f"searching {place.name or place}", now - start, found=tuple(found[shown:]))
    return now, len(found)


# -- folders -----------------------------------------------------------------------------------------------
def _folders(
    folders: Sequence[str | os.PathLike[str]], depth: int, notes: list[str]
) -> Iterator[tuple[Path, list[os.DirEntry[str]]]]:
    """Yield each folder once with its entries; folders that cannot be searched are added to ``notes``."""
    seen: set[tuple[int, int]] = set()
    waiting = [(Path(folder), depth) for folder in folders]
    while waiting:
        place, left = waiting.pop(0)
        try:
            mark = place.stat()
            if (mark.st_dev, mark.st_ino) in seen and mark.st_ino:
                continue
            seen.add((mark.st_dev, mark.st_ino))
            with os.scandir(place) as listed:
                entries = sorted(listed, key=lambda one: one.name)
            below = [Path(one.path) for one in entries if _is_folder(one)]
        except OSError as error:
            notes.append(storage_words(error, place))
            continue
        yield place, entries
        if left > 0:
            waiting += [(one, left - 1) for one in below]
        elif below:
            notes.append(
                f"{place}: its {format_count(len(below), 'folder', 'folders')} are nested too deeply; search "
                "this folder directly"
            )
        if len(seen) >= MOST_FOLDERS:
            notes.append(f"only the first {MOST_FOLDERS} folders were searched; choose a folder with fewer")
            return


def _is_folder(entry: os.DirEntry[str]) -> bool:
    """Return whether an entry is a folder that may contain results: not hidden, unfinished work or a Zarr store."""
    return entry.is_dir() and not entry.name.startswith(".") and not entry.name.endswith((".parts", ".zarr"))


def _candidates(place: Path, entries: Iterable[os.DirEntry[str]]) -> Iterator[Path]:
    """Yield the entries of a folder that may be results, and the folder itself if it may be one."""
    names = {one.name for one in entries}
    if names & _OF_FOLDERS.keys():
        yield place
    recorded = ("recording", "darks", "checks") if NAME in names else ()
    images = 0
    for one in entries:
        suffix = Path(one.name).suffix.lower()
        if suffix not in _OF_FILES or one.name.startswith(".") or (recorded and one.name.startswith(recorded)):
            continue
        images += suffix in _IMAGES
        if images <= MOST_IMAGES or suffix not in _IMAGES:
            yield Path(one.path)


def folder_bytes(folder: Path) -> int:
    """Return the size of all files in a folder and its subfolders (bytes)."""
    return sum(one.stat().st_size for one in folder.rglob("*") if one.is_file())


# -- one result --------------------------------------------------------------------------------------------
def read_result(path: str | os.PathLike[str]) -> StoredResult | None:
    """Read the facts about the result in a file or folder; return None if lfcal did not write it.

    Raises
    ------
    OSError
        If the path does not exist, or cannot be accessed.

    Examples
    --------
    >>> from lfcal.judge import read_result
    >>> one = read_result("H.h5")
    >>> print(one.kind, dict(one.facts)["Period"])
    H 19 × 33
    """
    place = Path(path)
    own = place.stat()
    if place.is_dir() and place.suffix.lower() == ".zarr":
        size, changed = folder_bytes(place), own.st_mtime
        read = _OF_FILES[".zarr"]
    elif place.is_dir():
        marker = next((name for name in _OF_FOLDERS if (place / name).is_file()), "")
        if not marker:
            return None
        size, changed = folder_bytes(place), (place / marker).stat().st_mtime
        read = _OF_FOLDERS[marker]
    else:
        size, changed = own.st_size, own.st_mtime
        read = _OF_FILES.get(place.suffix.lower(), _nothing)
    bare = StoredResult(place, "unreadable", datetime.fromtimestamp(changed, UTC), bytes=size)
    try:
        return read(place, bare)
    except LfcalError as error:
        place.stat()  # a file that no longer exists is not a damaged result
        return replace(bare, problem=" ".join(str(error).split()))


def _nothing(path: Path, bare: StoredResult) -> None:
    """Return None, because lfcal does not write such files."""


def _recording(folder: Path, bare: StoredResult) -> StoredResult | None:
    session = SessionFile.read(folder)
    missing = [name for name in session.recordings if not (folder / name).is_file()]
    if missing:
        raise StorageError.expected(
            str(folder / missing[0]), "the recorded frames", "no such file", "restore this file"
        )
    last, runs = (session.runs[-1] if session.runs else None), range(len(session.recordings))
    whole = last is not None and all(session.was_complete(run) for run in runs)
    count = int(session.chosen.sum()) if session.target is None else session.positions
    safe = "none" if last is None else f"{last.acknowledged} of {count} {'frames' if session.target else 'positions'}"
    facts = [
        *_plan_facts(session.plan),
        ("Exposure", ", ".join(format_seconds(one) for one in dict.fromkeys(session.plan.exposures))),
        ("Averaged frames", str(session.plan.frames_averaged)),
        ("Recorded", safe),
        ("Device", session.devices.camera),
        ("Stage", session.devices.stage),
    ]
    facts += [("Simulated as", session.devices.optics)] if session.devices.optics else []
    facts += [("Recordings", str(len(session.recordings)))] if len(session.recordings) > 1 else []
    facts += [("Time", format_seconds(sum(run.seconds for run in session.runs)))] if session.runs else []
    facts += [("Stage check", last.stage)] if last and last.stage else []
    facts += [("Ended", last.message)] if last and last.message else []
    words = f"complete: {count} {'frames' if session.target else 'positions'}" if whole else f"unfinished: {safe}"
    when = _time(session.runs[0].started) if session.runs else None
    return replace(
        bare,
        kind="recording",
        when=when or bare.when,
        dated=when is not None,
        facts=tuple(facts),
        verdict=words,
        merit="good" if whole else "fair",
    )


def _time(text: str) -> datetime | None:
    try:
        found = datetime.fromisoformat(text)
    except ValueError:
        return None
    return found.astimezone(UTC) if found.tzinfo else found.replace(tzinfo=UTC)


def _plan_facts(plan: ScanPlan) -> list[tuple[str, str]]:
    return [("Camera", plan.camera.name), *_shape_facts((*plan.shape[:3], *plan.cutout), plan.depths_um)]


def _shape_facts(shape: Sequence[int], depths: Iterable[float] = ()) -> list[tuple[str, str]]:
    """Return the facts of a matrix ``(nz, ny, nx, nt, ns)``."""
    known = [float(z) for z in depths if np.isfinite(z)]
    ends = [format_length(z) for z in (known[:1] + known[-1:])]
    return [
        ("Planes", str(shape[0])),
        *([("Depths", " to ".join(dict.fromkeys(ends)))] if ends else []),
        ("Period", f"{shape[1]} × {shape[2]}"),
        ("Cutout", f"{shape[3]} × {shape[4]}"),
    ]


def _fit(folder: Path, bare: StoredResult) -> StoredResult:
    fit = read_dated_fit(folder)
    values = [
        (name, f"{format_number(value)} ± {format_number(sigma, 2)} {fit.units[name]}".rstrip())
        for name, (value, sigma) in fit.values.items()
    ]
    depths = _shape_facts((len(fit.depths_um), 0, 0, 0, 0), fit.depths_um)[:2]
    facts = [("Camera", fit.camera.name), *depths, ("Unknowns", ", ".join(sorted(fit.groups))), *values]
    return replace(
        bare,
        kind="fit",
        when=fit.when,
        dated=fit.recorded is not None,
        facts=tuple(facts),
        verdict=fit.verdict,
        merit="good" if fit.complete else "fair",
    )


def _report(folder: Path, bare: StoredResult) -> StoredResult:
    found = read_inspection(folder, folder.name)
    counts = {merit: sum(one.merit == merit for one in found.values.values()) for merit in ("good", "fair", "bad")}
    facts = [("Checks", ", ".join(f"{n} {merit}" for merit, n in counts.items() if n))]
    facts += [("Period", f"{found.period[0]} × {found.period[1]}")] if found.period else []
    if found.faults is not None:
        shares = [f"{title} ({100 * share:.2g} % of the light)" for title, share in found.faults.items()]
        facts.append(("Faults", ", ".join(shares) or "none"))
    facts += [
        (one.title, f"{format_number(found.values[key].value)} {one.unit}".strip())
        for key, one in found.scales.items()
        if np.isfinite(found.values[key].value)
    ]
    return replace(
        bare,
        kind="report",
        when=found.when,
        dated=found.dated,
        facts=tuple(facts),
        verdict=found.verdict,
        merit=found.merit,
    )


def _hdf5(path: Path, bare: StoredResult) -> StoredResult | None:
    with H5File(path, only=("depths",)) as file:
        kind = file.attributes().text("format")
        if kind == VOLUME_FORMAT:
            shape = file.dataset_shape(DATASET)
            depths = file.values("depths") if "depths" in file.names() else ()
            return _volume(bare, shape, depths)
        if kind != PSF_FORMAT:
            return None
        head = head_of(file)
    facts = [("Camera", head.camera.name)] if head.camera is not None else []
    facts += _shape_facts(head.shape, head.depths)
    facts += [("Matrix", "HT")] if head.transposed else []
    return replace(bare, kind="H", facts=(*facts, *_made(head.provenance)))


def _made(provenance: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Return how H was made, if its provenance states it in the expected form."""
    said = {name: one for name, one in provenance.items() if isinstance(one, str | Mapping)}
    task, frames, devices = (said.get(name) for name in ("task", "frames", "devices"))
    facts = []
    if isinstance(task, Mapping) and isinstance(task.get("task"), str):
        facts.append(("Made by", f"lfcal {task['task']}"))
    elif "fit" in provenance or "simulated" in provenance:
        facts.append(("Made by", "a fit" if "fit" in provenance else "simulation"))
    if isinstance(frames, Mapping) and isinstance(frames.get("count"), int):
        facts.append(("Frames", str(frames["count"])))
    if isinstance(devices, Mapping) and isinstance(devices.get("camera"), str):
        facts.append(("Device", devices["camera"]))
    facts += [("Version", str(said["lfcal"]))] if isinstance(said.get("lfcal"), str) else []
    return facts


def _matlab(path: Path, bare: StoredResult) -> StoredResult | None:
    with path.open("rb") as file:
        if file.read(10) == b"MATLAB 5.0":  # from other programs, because lfcal writes version 7.3
            return None
    with H5File(path, only=()) as stored:
        shape = stored.dataset_shape("H")
    # 4 axes: MATLAB drops trailing axes of length one
    return _export(bare, (1, *shape) if len(shape) == 4 else shape, "MATLAB") if len(shape) in (4, 5) else None


def _export(bare: StoredResult, shape: Sequence[int], form: str) -> StoredResult:
    return replace(bare, kind="export", facts=(("Format", form), *_shape_facts(shape)))


def _npy(path: Path, bare: StoredResult) -> StoredResult | None:
    values = map_npy(path)
    if values.ndim == 5:
        return _export(bare, values.shape, "NumPy")
    # whole numbers are frames
    return _volume(bare, values.shape) if values.ndim == 3 and values.dtype.kind == "f" else None


def _tiff(path: Path, bare: StoredResult) -> StoredResult | None:
    import tifffile

    try:
        with tifffile.TiffFile(path) as stored:
            words = f"{stored.ome_metadata or ''}{stored.imagej_metadata or ''}"
            if "lfcal" not in words:
                return None
            shape, first = stored.series[0].shape, stored.series[0].keyframe
            # if several images were written as one piece, a truncated file may contain the first one alone
            images = int((stored.imagej_metadata or {}).get("images", 1))
            end = max(stored.series[0].nbytes, images * first.nbytes) + first.dataoffsets[0]
            if end > bare.bytes:
                raise EOFError(f"{bare.bytes} of {end} bytes")
    except Exception as error:  # tifffile raises many kinds on damaged data
        if not _names_lfcal(path):  # files that may be of other programs are not reported as damaged
            return None
        raise _damaged_tiff(path, error) from error
    if "PSF matrix" not in words:
        return _volume(bare, shape)
    return replace(bare, kind="export", facts=(("Format", "TIFF"), _pixels(shape)))


def _names_lfcal(path: Path) -> bool:
    with path.open("rb") as file:
        return b"lfcal" in file.read(HEAD)


def _damaged_tiff(path: Path, error: Exception) -> StorageError:
    said = " ".join(str(error).split())[:120] or type(error).__name__
    return StorageError.expected(str(path), "an intact TIFF file", said, "copy the file again")


def _pixels(shape: Sequence[int]) -> tuple[str, str]:
    return "Shape", " × ".join(map(str, shape))


def _zarr(path: Path, bare: StoredResult) -> StoredResult | None:
    array, _, own = zarr_contents(path)
    return _volume(bare, array.shape[-3:], own.get("depths_um", ())) if own else None


def _volume(bare: StoredResult, shape: Sequence[int], depths: Iterable[float] = ()) -> StoredResult:
    if not 2 <= len(shape) <= 4:
        raise FileFormatError.expected(
            str(bare.path), "a volume (z, y, x)", tuple(shape) or "none", "copy the file again"
        )
    sides = (1, *shape)[-3:]
    ends = [pair for pair in _shape_facts((*sides, 0, 0), depths) if pair[0] == "Depths"]
    series = [("Volumes", str(shape[0]))] if len(shape) == 4 else []
    return replace(bare, kind="volume", facts=(_pixels(sides), *series, *ends))


Reader = Callable[[Path, StoredResult], StoredResult | None]

_OF_FOLDERS: dict[str, Reader] = {NAME: _recording, FIT: _fit, QUALITY: _report}
"""Function that reads the result in a folder, by the name of a file in the folder."""

_OF_FILES: dict[str, Reader] = {
    ".h5": _hdf5,
    ".hdf5": _hdf5,
    ".mat": _matlab,
    ".npy": _npy,
    ".tif": _tiff,
    ".tiff": _tiff,
    ".zarr": _zarr,
}
"""Function that reads a result, by the suffix of its file."""


# -- details of one result ---------------------------------------------------------------------------------
def detailed(result: StoredResult) -> StoredResult:
    """Return a recording with facts that need more time to read, such as the light of its frames.

    A ``result`` of another kind, or one that cannot be read, is returned unchanged.
    """
    if result.kind != "recording" or result.problem:
        return result
    with H5File(result.path / "recording.h5", only=("records",)) as file:
        records = file.dataset("records", dtype=RECORD).read()
    records = records[intact(records)]
    if not len(records):
        return result
    light, ends = records["energy"], records["time_s"][[0, -1]]
    spread = float(np.std(light) / np.mean(light)) if np.mean(light) else 0.0
    saturated = int(np.count_nonzero(records["saturated"]))
    facts = [
        ("Light per frame", f"{np.mean(light):.4g} counts ± {100 * spread:.2g} %"),
        ("Brightest pixel", f"{np.max(records['peak']):.4g} counts"),
        ("Saturated frames", str(saturated)),
        ("First to last frame", format_seconds(float(ends[1] - ends[0]))),
    ]
    return replace(result, facts=(*result.facts, *facts))


def picture_of(result: StoredResult) -> NDArray[Any] | None:
    """Return an image of a result, such as the middle frame, or the sum of the patterns in the middle plane of H.

    The image is ``(rows, columns)``; None if the result has no image or ``problem`` states that it cannot be read.

    Raises
    ------
    LfcalError
        If the result cannot be read.

    Examples
    --------
    >>> from lfcal.judge import picture_of, read_result
    >>> picture_of(read_result("H.h5")).shape
    (55, 55)
    """
    path, suffix = result.path, result.path.suffix.lower()
    if result.problem or result.kind not in ("recording", "H", "export", "volume"):
        return None
    if result.kind == "recording":
        return _middle(path / "recording.h5", "frames")
    if result.kind == "H":
        return _sum_of(path)
    if suffix == ".mat":
        return _middle(path, "H")
    if suffix in (".h5", ".hdf5"):
        return _middle(path, DATASET)
    if suffix == ".npy":
        return _image(map_npy(path))
    if suffix == ".zarr":
        return _of_zarr(path)
    return _of_tiff(path) if suffix in (".tif", ".tiff") else None


def _of_zarr(path: Path) -> NDArray[Any]:
    array = open_ome_zarr(path)[0]
    with understood(path, "intact chunks", "copy it again"):
        return np.asarray(array[tuple(n // 2 for n in array.shape[:-2])])


def _sum_of(path: Path) -> NDArray[Any] | None:
    """Return the sum of the middle plane of an H file. None: the file has none."""
    with H5File(path, only=("depth_sum",)) as file:
        sums = file.dataset("depth_sum") if "depth_sum" in file.names() else None
        return None if sums is None or sums.ndim != 3 else sums.read(sums.shape[0] // 2)


def _middle(path: Path, name: str) -> NDArray[Any]:
    with H5File(path, only=(name,)) as file:
        return _image(file.dataset(name, holes=True).read_middle())


def _image(values: NDArray[Any]) -> NDArray[Any]:
    """Return the middle one of the images along the last two axes."""
    while values.ndim > 2:
        values = values[len(values) // 2]
    return np.array(values)


def _of_tiff(path: Path) -> NDArray[Any]:
    import tifffile

    try:
        with tifffile.TiffFile(path) as stored:
            series = stored.series[0]
            # files that lfcal wrote in one piece have one page for all images
            shown = tifffile.memmap(path) if series.dataoffset is not None else series.pages[len(series.pages) // 2]
            return _image(shown if isinstance(shown, np.ndarray) else shown.asarray())
    except Exception as error:  # tifffile raises many kinds on damaged data
        raise _damaged_tiff(path, error) from error
