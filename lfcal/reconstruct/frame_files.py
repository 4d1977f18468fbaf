"""Find the frames of a reconstruction, prepare them, and name the files of their volumes."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.acquire import NAME, RecordingSource
from lfcal.base import FileFormatError, InputError, check_zarr
from lfcal.frames import CorrectionChain, Dark, White, files_of, natural_key, open_image, read_image
from lfcal.frames.corrections import frame_map, read_average
from lfcal.frames.formats import container_in, image_suffixes
from lfcal.psf import PSFMatrix
from lfcal.reconstruct.metric_grid import MetricGrid
from lfcal.reconstruct.projectors import Projector
from lfcal.reconstruct.resample import Resampling
from lfcal.reconstruct.volumes import SUFFIXES, VolumeFacts, check_suffix, write_volumes
from lfcal.records import LightFieldSettings
from lfcal.work import stamp_of

__all__ = [
    "Cleaner",
    "FrameFile",
    "Save",
    "Saved",
    "cleaner",
    "frames_of",
    "is_series",
    "placed_anchor",
    "read_frame",
    "related",
    "saving",
    "targets_of",
]

Cleaner = Callable[["NDArray[Any]"], "NDArray[Any]"]
"""Function that prepares a frame for its reconstruction."""


@dataclass(frozen=True)
class FrameFile:
    """Location of one frame of a series.

    Attributes
    ----------
    name
        Name of the frame.
    file, page
        Image file, and number of the page in it; or folder of a session, and number of the frame in the order of
        recording. Both numbers start at 0.
    time_s
        Time of recording since the start of the session (s); None if the frame is from an image file.
    """

    name: str
    file: Path
    page: int
    time_s: float | None = None

    def read(self, shape: tuple[int, int] | None = None) -> NDArray[Any]:
        """Return the samples ``(rows, columns)`` of the frame; ``shape`` is as in `read_frame`."""
        return read_frame(self.file, self.page, shape)

    @property
    def inputs(self) -> tuple[str, ...]:
        """Absolute paths of the files that contain the frame."""
        files = files_of(self.file)
        if container_in(self.file.parent) == self.file:  # the other files of the folder contain the samples
            files = [path for path in self.file.parent.rglob("*") if path.is_file()]
        return tuple(os.path.abspath(path) for path in sorted(files))


def read_frame(file: Path, page: int, shape: tuple[int, int] | None = None) -> NDArray[Any]:
    """Return the samples ``(rows, columns)`` of one page of an image file, or of one frame of a session.

    ``page`` is the number of the page or frame, from 0. ``shape`` is that of the first frame of the series; None: any.

    Raises
    ------
    FileFormatError
        If the file is damaged, or the frame does not have this ``shape``.
    """
    if file.is_dir():
        source, order = _session(file)
        found = source.read(order[page])
    else:
        found = read_image(file, page)
    if shape is not None and found.shape != shape:
        wanted, got = (" x ".join(map(str, size)) + " pixels" for size in (shape, found.shape))
        remedy = "reconstruct frames of another size separately"
        what = f"page {page} of {file}" if page else str(file)
        raise FileFormatError.expected(what, f"{wanted}, as in the first frame", got, remedy)
    return found


def frames_of(path: Path) -> list[FrameFile]:
    """Return the frames of a series: the pages of an image file, the images of a folder, or the frames of a session.

    A folder may also be an OME-Zarr or an NDTiff. Images are in natural order of their names, frames of a session in
    the order of recording.

    Raises
    ------
    InputError
        If there are no frames, two have the same name, or the frames of a session show different parts of the sensor.
    """
    if is_session(path):
        return _frames_of_session(path)
    described = container_in(path) if path.is_dir() else None
    files = [described or path]
    if path.is_dir() and described is None:
        names = sorted((p.name for p in path.iterdir() if p.suffix.lower() in image_suffixes()), key=natural_key)
        files = [path / name for name in names]
    if not files:
        raise InputError.expected(f"frames in {path}", "at least one image", "none", "check the folder")
    found = []
    for file in files:
        # opened only for the number of pages; each page is read when it is needed
        image = open_image(file)
        image.close()
        stem = file.stem if described is None else path.name.partition(".")[0]
        for page in range(image.pages):
            found.append(FrameFile(stem if image.pages == 1 else f"{stem}_{page:04d}", file, page))
    names = [frame.name for frame in found]
    if len(set(names)) < len(names):
        twice = next(name for name in names if names.count(name) > 1)
        raise InputError.expected("names of the frames", "unique names", f"{twice} twice", "rename one of them")
    return found


def is_session(path: Path) -> bool:
    """Return whether ``path`` is the folder of a session recorded by `lfcal acquire`."""
    return (path / NAME).is_file()


def is_series(path: Path) -> bool:
    """Return whether ``path`` may contain several frames: a folder, a session, or an image file of several pages."""
    if path.is_dir():
        return True
    if not path.is_file():
        return False
    image = open_image(path)
    image.close()
    return image.pages > 1


def _session(path: Path) -> tuple[RecordingSource, tuple[int, ...]]:
    """Return a session, and the indices of its frames in the order of recording."""
    return _opened(os.path.abspath(path), stamp_of(FrameFile("", path, 0).inputs))


@lru_cache(maxsize=1)
def _opened(folder: str, _: str) -> tuple[RecordingSource, tuple[int, ...]]:
    # once for all frames of a series, because opening reads the whole recording
    source = RecordingSource(Path(folder))
    return source, tuple(sorted(range(len(source)), key=lambda k: float(source.record(k)["elapsed_s"])))


def _frames_of_session(path: Path) -> list[FrameFile]:
    source, order = _session(path)
    places = {source.info(k).origin for k in order}
    if len(places) > 1:
        got = f"{len(places)} positions, as in a scan of cutouts"
        raise InputError.expected(f"frames of {path}", "one position on the sensor", got, "record whole frames")
    times = [float(source.record(k)["elapsed_s"]) for k in order]
    return [FrameFile(f"{path.name}_{n:04d}", path, n, t) for n, t in enumerate(times)]


def placed_anchor(path: Path, H: PSFMatrix, resample: bool | None) -> tuple[float, float] | None:
    """Return the anchor (row, column) of H (px) in frames of a session that do not start at pixel (0, 0).

    None for other frames: the anchor stored in H applies. ``resample`` states whether to resample frames; None: only if
    the lattice drifts.

    Raises
    ------
    InputError
        If ``resample`` is True, because frames of part of the sensor cannot be resampled.
    """
    if not is_session(path):
        return None
    row, column = _session(path)[0].info(0).origin
    if (row, column) == (0, 0):
        return None
    if resample:
        raise InputError.expected(
            "--resample", "whole frames", f"frames that start at (row, column) {(row, column)}", "record whole frames"
        )
    return H.anchor[0] - row, H.anchor[1] - column


def cleaner(light_field: LightFieldSettings, view: Resampling | None) -> Cleaner:
    """Return a function that applies the dark frame, white image, mask and resampling to a frame.

    Masked pixels become NaN. Steps without settings are omitted; None as ``view`` means no resampling.
    """
    dark, white, mask = light_field.dark, light_field.white, light_field.mask
    level = read_average(dark) if dark else None
    steps: list[Any] = [] if level is None else [Dark(level)]
    if white:
        steps.append(White(read_average(white), 0.0 if level is None else level))
    chain = CorrectionChain(tuple(steps))
    masked = lru_cache(maxsize=1)(lambda shape: frame_map(mask, "mask", shape))

    def clean(frame: NDArray[Any]) -> NDArray[Any]:
        done = chain.apply(frame) if steps else np.array(frame, np.float32)
        if mask:
            done[masked(frame.shape)] = np.nan
        return done if view is None else view.apply(done)

    return clean


LONG = (".ome.tif", ".ome.tiff", ".ome.zarr")
"""Suffixes of volume files that consist of two parts."""

Save = Callable[[str, "NDArray[Any] | None", Mapping[str, Any]], None]
"""Function that saves a volume: it takes the name of the frame, the volume (None: there is none), and metadata."""

Saved = Callable[[], AbstractContextManager[Save]]
"""Context manager that provides a `Save` function; files of several volumes are complete at its end."""


def targets_of(frames: Sequence[FrameFile], out: Path, suffix: str | None) -> dict[str, Path]:
    """Return the file for the volume of each frame, by the frame's name.

    Without a ``suffix``, or if ``out`` has the suffix of a volume file, ``out`` is the file for all volumes. Otherwise,
    each frame has a file with this ``suffix`` in the folder ``out``.

    Raises
    ------
    InputError
        If the suffix is not that of a volume file, or the library that writes it is not installed.
    """
    whole = suffix is None or out.suffix.lower() in SUFFIXES
    found = {f.name: check_suffix(out if whole else out / f"{f.name}{suffix}") for f in frames}
    if any(path.suffix.lower() == ".zarr" for path in found.values()):
        check_zarr()
    return found


def related(out: Path, ending: str, suffix: str = "") -> Path:
    """Return the path of a file next to ``out``, with ``ending`` after its name, and the same or another suffix."""
    own = "".join(out.suffixes[-2:]) if out.name.lower().endswith(LONG) else out.suffix
    return out.with_name(out.name[: len(out.name) - len(own)] + ending + (suffix or own))


@contextmanager
def saving(
    P: Projector,
    voxel: tuple[float, float] | None,
    targets: Mapping[str, Path],
    details: Mapping[str, Any],
    shape: tuple[int, ...],
    *,
    grid: MetricGrid | None,
    times_s: Sequence[float | None],
    of_frames: Mapping[str, Mapping[str, Any]] | None = None,
) -> Iterator[Save]:
    """Yield a function that saves the volume of a frame, either to a separate file or to a file for all frames.

    For a frame without a volume, no separate file is written; in a file for all frames, its volume is NaN. Such a file
    contains the volumes in the order of the calls.

    Parameters
    ----------
    P
        Projector that provides the depths.
    voxel
        Sides (y, x) of a voxel (µm); None if unknown.
    targets
        File of each frame's volume, by the frame's name.
    details
        Additional metadata to store in all files.
    shape
        Shape ``(nz, Y, X)`` of a written volume.
    grid
        Grid of voxels of one size to which volumes are resampled. None: no resampling.
    times_s
        Time of each frame (s); None for unknown times.
    of_frames
        Additional metadata of each frame, by its name. None: there are none.
    """
    own = of_frames or {}
    depths = P.known_depths
    origin = None if grid is None else grid.origin_um
    if grid is not None:
        details = {**details, "voxel_um": grid.voxel_um, "origin_um": grid.origin_um}

    def placed(volume: NDArray[Any]) -> NDArray[Any]:
        return np.ascontiguousarray(volume if grid is None else grid.apply(volume), np.float32)

    files = list(dict.fromkeys(targets.values()))
    if len(files) == 1 and len(targets) > 1:
        known = [float(t) for t in times_s if t is not None]
        times = known if len(known) == len(targets) else None
        listed = {
            key: [own.get(name, {}).get(key) for name in targets]
            for key in sorted({k for v in own.values() for k in v})
        }
        facts = VolumeFacts(depths, voxel, {**details, **listed, "frames": list(targets)}, origin, times)
        with write_volumes(files[0], (len(targets), *shape), facts) as add:
            nothing = np.broadcast_to(np.float32(np.nan), shape)
            yield lambda _, volume, known: add(nothing if volume is None else placed(volume))
        return

    times_of = dict(zip(targets, times_s, strict=True))

    def save(name: str, volume: NDArray[Any] | None, known: Mapping[str, Any]) -> None:
        if volume is None:
            return
        time = times_of[name]
        times = None if time is None else [time]
        facts = VolumeFacts(depths, voxel, {**details, "frame": name, **own.get(name, {}), **known}, origin, times)
        with write_volumes(targets[name], shape, facts) as add:
            add(placed(volume))

    yield save
