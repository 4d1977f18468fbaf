"""Frames to H: corrected, cropped with the shifting cutout, stacked plane by plane."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from functools import partial
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfcal.camera import Camera
from lfcal.errors import InputError
from lfcal.frames.source import FrameSource, Position
from lfcal.progress import Clock, Work, drain
from lfcal.psf.cutout import Cutout, frame_origin
from lfcal.psf.matrix import PSFMatrix
from lfcal.psf.opening import open_psf
from lfcal.psf.store import PSFWriter
from lfcal.threads import worker_count

__all__ = ["AssemblyReport", "Corrections", "assemble", "iter_assemble"]


Region = tuple[slice, slice]


class Corrections(Protocol):
    """What assembly needs of a correction chain (`lfcal.frames.CorrectionChain`)."""

    @property
    def shape(self) -> tuple[int, int] | None:
        """Rows and columns of the sensor the chain fits; None: any."""
        ...

    @property
    def margin(self) -> int:
        """Pixels around a region that its correction looks at."""
        ...

    @property
    def measures_frames(self) -> bool:
        """Whether the whole frame is needed to know its background."""
        ...

    def apply_region(
        self,
        part: NDArray[Any],
        region: Region,
        *,
        inside: Region | None = None,
        exposure_s: float | None = None,
        background: tuple[float, float, float] | None = None,
    ) -> NDArray[np.float32]:
        """Return the corrected values of ``inside`` from the raw ones of ``region``, signed."""
        ...

    def measure(
        self, read: Callable[[Region], NDArray[Any]], shape: tuple[int, int], *, exposure_s: float | None = None
    ) -> tuple[float, float, float]:
        """Return the background of one whole frame."""
        ...

    def saturated(self, frame: NDArray[Any]) -> int:
        """Return the number of saturated pixels of a raw frame."""
        ...

    def describe(self) -> dict[str, Any]:
        """Return the chain as plain JSON types."""
        ...


@dataclass(frozen=True)
class AssemblyReport:
    """What was assembled, and what is not there.

    Attributes
    ----------
    matrix
        The assembled H, opened from the file, or in memory.
    frames
        Frames read.
    missing, duplicates
        Positions without a frame, and positions with several (the last one counts).
    saturated
        Frames with saturated pixels.
    padded
        Positions whose cutout leaves the sensor and was padded with zeros.
    residual_px
        Largest sub-pixel distance (rows, columns) that ``nearest`` left between point and cutout.
    """

    matrix: PSFMatrix
    frames: int
    missing: tuple[Position, ...] = ()
    duplicates: tuple[Position, ...] = ()
    saturated: int = 0
    padded: tuple[Position, ...] = ()
    residual_px: tuple[float, float] = (0.0, 0.0)
    notes: tuple[str, ...] = field(default=())


@dataclass(frozen=True)
class _Job:
    """Everything one frame needs; shared by the threads."""

    source: FrameSource
    cutout: Cutout
    corrections: Corrections | None
    drift: NDArray[np.float64] | None


def iter_assemble(
    source: FrameSource,
    shape: tuple[int, int, int],
    cutout: Cutout,
    out: str | os.PathLike[str] | None = None,
    *,
    corrections: Corrections | None = None,
    depths: ArrayLike | None = None,
    camera: Camera | None = None,
    drift: ArrayLike | None = None,
    strict: bool = False,
    dtype: str = "float32",
    compression: str = "gzip",
    provenance: Mapping[str, Any] | None = None,
    workers: int | None = None,
) -> Work[AssemblyReport]:
    """Assemble H from frames, streaming: at most two planes are in memory, the file appears whole or not.

    Parameters
    ----------
    source
        The frames, in any order.
    shape
        ``(nz, ny, nx)`` positions of the plan.
    cutout
        The shifting cutout.
    out
        H file to write; None keeps H in memory as float32.
    corrections
        Applied to the pixels of each cutout before they are moved; None leaves samples as they are.
    depths, camera, provenance
        Stored with H.
    drift
        ``(len(source), 2)`` how far the image of each frame is off its place (rows, columns; px); None asks
        the source, whose manifest may say it.
    strict
        Missing and duplicate positions are errors instead of being recorded in the file.
    dtype, compression, workers
        As in `PSFWriter`.

    Raises
    ------
    InputError
        If a frame lies outside the plan, is not finite, or its cutout leaves the sensor (with the position).
    """
    frames, duplicates = _by_position(source, shape)
    missing = tuple(Position(*map(int, p)) for p in np.argwhere(frames < 0))
    _check_complete(source, shape, frames, missing, duplicates, strict)
    offsets = None if drift is None else np.asarray(drift, np.float64)
    if offsets is not None and offsets.shape != (len(source), 2):
        raise InputError.expected("drift", f"shape ({len(source)}, 2)", offsets.shape, "one row per frame")
    if corrections is not None and corrections.shape is not None and not hasattr(source, "origin"):
        if tuple(corrections.shape) != tuple(source.shape):
            raise InputError.expected(
                "dark or white frame",
                f"shape {tuple(source.shape)} of the frames",
                tuple(corrections.shape),
                "take all frames with one sensor setting",
            )
    job = _Job(source, cutout, corrections, offsets)
    counts = np.zeros(shape, np.uint16)
    for position in (source.position(k) for k in range(len(source))):
        counts[position] += 1
    padded, residual = _check_windows(job, frames)
    history = {
        "frames": len(source),
        "cutout": {"interpolation": cutout.interpolation, "outside": cutout.outside, "scale": list(cutout.scale)},
        "corrections": corrections.describe() if corrections is not None else {},
        **(provenance or {}),
    }
    meta: dict[str, Any] = {"depths": depths, "camera": camera, "anchor": cutout.anchor}
    sink: _Memory | PSFWriter
    if out is None:
        sink = _Memory(shape, cutout.shape, meta, history)
    else:
        options = {"dtype": dtype, "compression": compression, "provenance": history, "workers": workers, **meta}
        sink = PSFWriter(out, (*shape, *cutout.shape), **options)
    saturated = np.zeros(shape, np.uint32)
    clock = Clock("assemble frames", int((frames >= 0).sum()))
    done = 0
    with sink, ThreadPoolExecutor(worker_count(workers)) as pool:
        yield clock.at(0)
        for z in range(shape[0]):
            plane = np.zeros((*shape[1:], *cutout.shape), np.float32)
            fill = partial(_fill_row, job, z, frames[z], plane, saturated)
            results = pool.map(fill, range(shape[1]))
            try:
                for count in results:
                    done += count
                    yield clock.at(done)
            except BaseException:
                pool.shutdown(cancel_futures=True)
                raise
            if not plane.any() and (frames[z] >= 0).any():
                first = job.source.label(int(frames[z].max()))
                raise InputError.expected(
                    f"plane {z}",
                    "light in its cutouts",
                    f"only zeros ({first} and others)",
                    "check exposure, anchor and dark frame",
                )
            sink.write_plane(z, plane, recorded=counts[z], saturated=saturated[z])
    matrix = sink.matrix() if isinstance(sink, _Memory) else open_psf(sink.path)
    return AssemblyReport(
        matrix,
        done,
        missing,
        duplicates,
        int((saturated > 0).sum()),
        padded,
        residual,
        _notes(missing, duplicates, padded, int((saturated > 0).sum())),
    )


def assemble(source: FrameSource, shape: tuple[int, int, int], cutout: Cutout, **options: Any) -> AssemblyReport:
    """Assemble H at once; options as in `iter_assemble`."""
    return drain(iter_assemble(source, shape, cutout, **options))


class _Memory:
    """The same as `PSFWriter`, in memory."""

    def __init__(
        self, shape: tuple[int, int, int], cutout: tuple[int, int], meta: dict[str, Any], history: dict[str, Any]
    ) -> None:
        self.values = np.zeros((*shape, *cutout), np.float32)
        self.recorded, self.saturated = np.zeros(shape, np.uint16), np.zeros(shape, np.uint32)
        self.meta, self.history = meta, history

    def __enter__(self) -> None:
        pass

    def __exit__(self, *_: object) -> None:
        pass

    def write_plane(self, z: int, plane: NDArray[Any], *, recorded: ArrayLike, saturated: ArrayLike) -> None:
        if not np.isfinite(plane.sum(dtype=np.float64)):
            raise InputError.expected(
                f"plane {z}", "finite values", "NaN or infinity", "find the frame and record it again"
            )
        self.values[z], self.recorded[z], self.saturated[z] = plane, recorded, saturated

    def matrix(self) -> PSFMatrix:
        return PSFMatrix(
            self.values, recorded=self.recorded, saturated=self.saturated, provenance=self.history, **self.meta
        )


def _by_position(source: FrameSource, shape: tuple[int, int, int]) -> tuple[NDArray[np.int64], tuple[Position, ...]]:
    """Return the frame index of each position (-1: none) and the positions given more than once."""
    frames = np.full(shape, -1, np.int64)
    duplicates: dict[Position, None] = {}
    for index in range(len(source)):
        position = Position(*source.position(index))
        if not all(0 <= p < n for p, n in zip(position, shape, strict=True)):
            where = f"{source.label(index)} at (z, y, x) = {tuple(position)}"
            raise InputError.expected(where, f"a position inside {shape}", "one outside", "check manifest and plan")
        if frames[position] >= 0:
            duplicates[position] = None
        frames[position] = index
    return frames, tuple(duplicates)


def _check_complete(
    source: FrameSource,
    shape: tuple[int, int, int],
    frames: NDArray[np.int64],
    missing: tuple[Position, ...],
    duplicates: tuple[Position, ...],
    strict: bool,
) -> None:
    if not (frames >= 0).any():
        raise InputError.expected("frames", f"some of {int(np.prod(shape))}", "none", "check folder and pattern")
    if strict and missing:
        what = f"{len(missing)} missing, first (z, y, x) = {tuple(missing[0])}"
        raise InputError.expected("positions", "a frame at every one", what, "record them or drop strict")
    if strict and duplicates:
        what = f"{len(duplicates)} given twice, first (z, y, x) = {tuple(duplicates[0])}"
        raise InputError.expected("positions", "one frame at each", what, "remove one or drop strict")


def _check_windows(job: _Job, frames: NDArray[np.int64]) -> tuple[tuple[Position, ...], tuple[float, float]]:
    """Return padded positions and largest residual; a cutout off the sensor is an error before any work."""
    padded: list[Position] = []
    largest = [0.0, 0.0]
    height, width = job.source.shape
    for z, y, x in np.argwhere(frames >= 0):
        position = Position(int(z), int(y), int(x))
        index = int(frames[position])
        window = job.cutout.window(position, _drift(job, index))
        largest = [max(largest[0], abs(window.row_residual)), max(largest[1], abs(window.column_residual))]
        row, column = frame_origin(job.source, index)
        top, left = window.row - row, window.column - column
        nt, ns = job.cutout.reach
        if top < 0 or left < 0 or top + nt > height or left + ns > width:
            if job.cutout.outside == "error":
                where = f"cutout of {job.source.label(index)}, (z, y, x) = {tuple(position)}"
                got = f"rows {top}..{top + nt - 1}, columns {left}..{left + ns - 1}"
                wanted = f"rows 0..{height - 1}, columns 0..{width - 1}"
                raise InputError.expected(where, wanted, got, "move the anchor, shrink the cutout, or pad")
            padded.append(position)
    return tuple(padded), (largest[0], largest[1])


def _drift(job: _Job, index: int) -> tuple[float, float]:
    if job.drift is not None:
        return float(job.drift[index, 0]), float(job.drift[index, 1])
    known = getattr(job.source, "drift", None)
    return (0.0, 0.0) if known is None else known(index)


def _fill_row(
    job: _Job,
    z: int,
    frames: NDArray[np.int64],
    plane: NDArray[np.float32],
    saturated: NDArray[np.uint32],
    y: int,
) -> int:
    """Read, correct and crop the frames of one source row into ``plane[y]``; return how many there were."""
    columns = np.flatnonzero(frames[y] >= 0).tolist()
    for x in columns:
        plane[y, x], saturated[z, y, x] = _cut_frame(job, Position(z, y, x), int(frames[y, x]))
    return len(columns)


def _cut_frame(job: _Job, position: Position, index: int) -> tuple[NDArray[np.float32], int]:
    frame = job.source.read(index)
    where = f"{job.source.label(index)}, (z, y, x) = {tuple(position)}"
    if frame.ndim != 2 or frame.shape != tuple(job.source.shape):
        raise InputError.expected(where, f"{job.source.shape} pixels", frame.shape, "take the frame again")
    window = job.cutout.window(position, _drift(job, index))
    origin = frame_origin(job.source, index)
    rows, columns = (
        slice(part.start - start, part.stop - start)
        for part, start in zip(job.cutout.region(window), origin, strict=True)
    )
    saturated = 0
    if job.corrections is None:
        values = _region(frame, rows, columns)
    else:
        saturated = job.corrections.saturated(frame)
        if saturated == frame.size:
            raise InputError.expected(where, "a point on a dark ground", "every pixel saturated", "expose shorter")
        values = _corrected(job, index, frame, origin, (rows, columns))
    if values.dtype.kind == "f" and not np.isfinite(values).all():
        raise InputError.expected(where, "finite values", "NaN or infinity", "take the frame again or leave it out")
    return job.cutout.resample(values, window), saturated


def _corrected(
    job: _Job, index: int, frame: NDArray[Any], origin: tuple[int, int], region: Region
) -> NDArray[np.float32]:
    """Return the corrected values of a region (in frame pixels; zeros beyond the frame).

    Corrections live on the sensor, so a frame that is itself a cutout is handed over with its origin.
    """
    chain = job.corrections
    assert chain is not None
    if chain.measures_frames and origin != (0, 0):
        raise InputError.expected(
            "background",
            "a constant for frames that are cutouts",
            "one measured on whole frames",
            "use a constant background",
        )
    exposure = getattr(job.source, "exposure_s", None)
    seconds = None if exposure is None else exposure(index)

    def on_sensor(part: Region) -> Region:
        return (
            slice(part[0].start + origin[0], part[0].stop + origin[0]),
            slice(part[1].start + origin[1], part[1].stop + origin[1]),
        )

    inside = _clipped(region, frame.shape)
    grown = _clipped(tuple(slice(p.start - chain.margin, p.stop + chain.margin) for p in region), frame.shape)
    background = chain.measure(lambda part: frame[part], (frame.shape[0], frame.shape[1]), exposure_s=seconds)
    fixed = chain.apply_region(
        frame[grown], on_sensor(grown), inside=on_sensor(inside), exposure_s=seconds, background=background
    )
    if inside == region:
        return fixed
    out = np.zeros((region[0].stop - region[0].start, region[1].stop - region[1].start), np.float32)
    top, left = inside[0].start - region[0].start, inside[1].start - region[1].start
    out[top : top + fixed.shape[0], left : left + fixed.shape[1]] = fixed
    return out


def _clipped(region: tuple[slice, ...], shape: tuple[int, ...]) -> Region:
    """Return the part of ``region`` that lies inside a frame of ``shape``."""
    rows, columns = (
        slice(min(max(part.start, 0), n), min(max(part.stop, 0), n)) for part, n in zip(region, shape, strict=True)
    )
    return rows, columns


def _region(frame: NDArray[Any], rows: slice, columns: slice) -> NDArray[Any]:
    """Return a region that may reach beyond the frame, with zeros there."""
    inside = _clipped((rows, columns), frame.shape)
    if inside == (rows, columns):
        return frame[inside]
    out = np.zeros((rows.stop - rows.start, columns.stop - columns.start), frame.dtype)
    top, left = inside[0].start - rows.start, inside[1].start - columns.start
    part = frame[inside]
    out[top : top + part.shape[0], left : left + part.shape[1]] = part
    return out


def _notes(
    missing: tuple[Position, ...], duplicates: tuple[Position, ...], padded: tuple[Position, ...], saturated: int
) -> tuple[str, ...]:
    notes = []
    if missing:
        notes.append(f"{len(missing)} positions are missing, first (z, y, x) = {tuple(missing[0])}")
    if duplicates:
        notes.append(f"{len(duplicates)} positions were given more than once; the last frame counts")
    if padded:
        notes.append(f"{len(padded)} cutouts leave the sensor and are padded with zeros")
    if saturated:
        notes.append(f"{saturated} frames have saturated pixels")
    return tuple(notes)
