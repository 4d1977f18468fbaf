"""Frames to H: cropped with the shifting cutout, stacked plane by plane.

Frames come as a source gives them; whoever wants them corrected hands over the corrected view.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import partial
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfcal.camera import Camera
from lfcal.errors import InputError
from lfcal.frames.orientation import AS_IS
from lfcal.frames.source import FrameSource, LeftOut, Position
from lfcal.progress import Clock, Work, drain
from lfcal.psf.assembly_report import AssemblyReport
from lfcal.psf.cutout import Cutout
from lfcal.psf.facts import Facts, pack_valid, stacked
from lfcal.psf.filling import Fill
from lfcal.psf.gather import Gatherer, by_position
from lfcal.psf.matrix import PSFMatrix
from lfcal.psf.opening import open_psf
from lfcal.psf.store import PSFWriter
from lfcal.threads import worker_count

__all__ = ["assemble", "iter_assemble"]


class _Sink(Protocol):
    """Where planes go: a file or memory."""

    def __enter__(self) -> Any: ...

    def __exit__(self, *_: Any) -> None: ...

    def write_plane(
        self, z: int, plane: NDArray[Any], *, facts: Facts, uncertainty: NDArray[np.float32] | None = None
    ) -> None: ...


def iter_assemble(
    source: FrameSource,
    shape: tuple[int, int, int],
    cutout: Cutout,
    out: str | os.PathLike[str] | None = None,
    *,
    depths: ArrayLike | None = None,
    camera: Camera | None = None,
    drift: ArrayLike | None = None,
    strict: bool = False,
    dtype: str = "float32",
    compression: str = "gzip",
    provenance: Mapping[str, Any] | None = None,
    fill: Fill | None = None,
    workers: int | None = None,
) -> Work[AssemblyReport]:
    """Assemble H from frames, streaming: at most two planes are in memory, the file appears whole or not.

    Parameters
    ----------
    source
        The frames, in any order; their samples are taken as they are.
    shape
        ``(nz, ny, nx)`` positions of the plan.
    cutout
        The shifting cutout.
    out
        H file to write; None keeps H in memory as float32.
    depths, camera, provenance
        Stored with H.
    drift
        ``(len(source), 2)`` how far the image of each frame is off its place (rows, columns; px); None asks
        the source, whose manifest may say it.
    strict
        Missing and repeated positions are errors instead of being recorded in the file.
    fill
        Fills missing positions, which stay marked as never recorded; None leaves them 0.
    dtype, compression, workers
        As in `PSFWriter`.

    Raises
    ------
    InputError
        If a frame lies outside the plan, is not finite, or its cutout leaves the sensor (with the position).
    """
    infos = tuple(source.info(k) for k in range(len(source)))
    order, starts = by_position(infos, shape)
    counts = np.diff(starts).reshape(shape)
    missing, repeated = (_positions(mask) for mask in (counts == 0, counts > 1))
    _check_complete(shape, counts, missing, repeated, strict)
    gatherer = Gatherer(source, infos, cutout, _drift_of(drift, len(source)))
    padded, residual = _check_windows(gatherer, order)
    # frames of a half-cell scan stand for two positions each
    frames = len(source) - source.metadata.get("half_cell", {}).get("frames", 0)
    history = {
        "frames": frames,
        "cutout": {"interpolation": cutout.interpolation, "outside": cutout.outside, "scale": list(cutout.scale)},
        "corrections": source.metadata.get("corrections", {}),
        **(provenance or {}),
    }
    left_out: tuple[LeftOut, ...] = tuple(source.metadata.get("left_out", ()))
    if left_out:
        history["left_out"] = [found._asdict() for found in left_out]
    turned = source.metadata.get("orientation")
    if turned:
        history.setdefault("orientation", turned)
    meta: dict[str, Any] = {"depths": depths, "camera": camera, "anchor": cutout.anchor}
    sink: _Memory | PSFWriter
    if out is None:
        sink = _Memory(shape, cutout.shape, meta, history)
    else:
        sink = PSFWriter(
            out,
            (*shape, *cutout.shape),
            **meta,
            dtype=dtype,
            compression=compression,
            provenance=history,
            workers=workers,
        )
    yield from _gather(gatherer, order, starts, counts, sink, fill, workers)
    matrix = sink.matrix() if isinstance(sink, _Memory) else open_psf(sink.path)
    applied = AS_IS if turned is None else turned["applied"]
    report = AssemblyReport.of(matrix, frames, missing, repeated, padded, residual)
    return replace(report, left_out=left_out, orientation=applied)


def _gather(
    gatherer: Gatherer,
    order: NDArray[np.int64],
    starts: NDArray[np.int64],
    counts: NDArray[np.int64],
    sink: _Sink,
    fill: Fill | None,
    workers: int | None,
) -> Work[None]:
    """Gather every plane by rows in threads and hand it to the sink."""
    clock = Clock("assemble frames", len(order))
    done = 0
    with sink, ThreadPoolExecutor(worker_count(workers)) as pool:
        yield clock.at(0)
        for z, recorded in enumerate(counts):
            plane = _Plane(recorded, gatherer.cutout.shape)
            first = z * recorded.size
            row = partial(plane.fill_row, gatherer, order, starts[first : first + recorded.size + 1])
            results = pool.map(row, range(recorded.shape[0]))
            try:
                for count in results:
                    done += count
                    yield clock.at(done)
            except BaseException:
                pool.shutdown(cancel_futures=True)
                raise
            if recorded.any() and not plane.values.any():
                label = gatherer.infos[int(order[starts[first]])].label
                raise InputError.expected(
                    f"plane {z}",
                    "light in its cutouts",
                    f"only zeros ({label} and others)",
                    "check exposure, anchor and dark frame",
                )
            if fill is None:
                sink.write_plane(z, plane.values, facts=plane.facts())
                continue
            filled = yield from fill(z, plane.values, plane.facts())
            sink.write_plane(z, plane.values, facts=filled.facts, uncertainty=filled.uncertainty)


class _Plane:
    """One plane while it is gathered: ``(ny, nx)`` patterns and their facts."""

    def __init__(self, recorded: NDArray[np.int64], cutout: tuple[int, int]) -> None:
        shape = recorded.shape
        self.recorded, self.cutout = recorded, cutout
        self.values = np.zeros((*shape, *cutout), np.float32)
        self.saturated = np.full(shape, -1, np.int32)
        self.noise = np.full((*shape, 2), np.nan, np.float32)
        self.spread = np.full(shape, np.nan, np.float32)
        self.invalid: dict[tuple[int, int], NDArray[np.bool_]] = {}

    def fill_row(self, gatherer: Gatherer, order: NDArray[np.int64], starts: NDArray[np.int64], y: int) -> int:
        """Gather the positions of one row; return how many frames that took."""
        columns = self.recorded.shape[1]
        row = starts[y * columns : (y + 1) * columns + 1]
        for x in np.flatnonzero(np.diff(row)).tolist():
            found = gatherer.pattern(order[row[x] : row[x + 1]])
            self.values[y, x] = found.values
            self.noise[y, x], self.spread[y, x], self.saturated[y, x] = found.noise, found.spread, found.saturated
            if found.valid is not None:
                self.invalid[y, x] = found.valid
        return int(row[-1] - row[0])

    def facts(self) -> Facts:
        """Return what is known of the positions; what is unknown is left out."""
        valid = None
        if self.invalid:
            masks = np.full((*self.recorded.shape, len(pack_valid(np.ones(self.cutout, bool)))), 255, np.uint8)
            for at, mask in self.invalid.items():
                masks[at] = pack_valid(mask)
            valid = masks
        return Facts.of(
            self.recorded.shape,
            self.cutout,
            recorded=self.recorded,
            saturated=self.saturated if (self.saturated >= 0).any() else None,
            noise=self.noise if np.isfinite(self.noise).any() else None,
            spread=self.spread if np.isfinite(self.spread).any() else None,
            valid=valid,
        )


def assemble(
    source: FrameSource,
    shape: tuple[int, int, int],
    cutout: Cutout,
    out: str | os.PathLike[str] | None = None,
    *,
    depths: ArrayLike | None = None,
    camera: Camera | None = None,
    drift: ArrayLike | None = None,
    strict: bool = False,
    dtype: str = "float32",
    compression: str = "gzip",
    provenance: Mapping[str, Any] | None = None,
    workers: int | None = None,
) -> AssemblyReport:
    """Assemble H at once; see `iter_assemble`."""
    return drain(
        iter_assemble(
            source,
            shape,
            cutout,
            out,
            depths=depths,
            camera=camera,
            drift=drift,
            strict=strict,
            dtype=dtype,
            compression=compression,
            provenance=provenance,
            workers=workers,
        )
    )


class _Memory:
    """The same as `PSFWriter`, in memory."""

    def __init__(
        self, shape: tuple[int, int, int], cutout: tuple[int, int], meta: dict[str, Any], history: dict[str, Any]
    ) -> None:
        self.values = np.zeros((*shape, *cutout), np.float32)
        self.facts: list[Facts] = []
        self.uncertainty: NDArray[np.float32] | None = None
        self.meta, self.history = meta, history

    def __enter__(self) -> None:
        pass

    def __exit__(self, *_: object) -> None:
        pass

    def write_plane(
        self, z: int, plane: NDArray[Any], *, facts: Facts, uncertainty: NDArray[np.float32] | None = None
    ) -> None:
        if not np.isfinite(plane.sum(dtype=np.float64)):
            raise InputError.expected(
                f"plane {z}", "finite values", "NaN or infinity", "find the frame and record it again"
            )
        self.values[z] = plane
        self.facts.append(facts)
        if uncertainty is not None:
            if self.uncertainty is None:
                self.uncertainty = np.zeros_like(self.values)
            self.uncertainty[z] = uncertainty

    def matrix(self) -> PSFMatrix:
        facts = stacked(self.facts)
        return PSFMatrix(self.values, facts=facts, uncertainty=self.uncertainty, provenance=self.history, **self.meta)


def _positions(mask: NDArray[np.bool_]) -> tuple[Position, ...]:
    return tuple(Position(*p) for p in np.argwhere(mask).tolist())


def _drift_of(drift: ArrayLike | None, count: int) -> NDArray[np.float64] | None:
    if drift is None:
        return None
    offsets = np.asarray(drift, np.float64)
    if offsets.shape != (count, 2):
        raise InputError.expected("drift", f"shape ({count}, 2)", offsets.shape, "one row per frame")
    return offsets


def _check_complete(
    shape: tuple[int, int, int],
    counts: NDArray[np.int64],
    missing: tuple[Position, ...],
    repeated: tuple[Position, ...],
    strict: bool,
) -> None:
    if not counts.any():
        raise InputError.expected("frames", f"some of {int(np.prod(shape))}", "none", "check folder and pattern")
    if strict and missing:
        what = f"{len(missing)} missing, first (z, y, x) = {tuple(missing[0])}"
        raise InputError.expected("positions", "a frame at every one", what, "record them or drop strict")
    if strict and repeated:
        what = f"{len(repeated)} given more than once, first (z, y, x) = {tuple(repeated[0])}"
        raise InputError.expected("positions", "one frame at each", what, "remove one or drop strict")


def _check_windows(gatherer: Gatherer, order: NDArray[np.int64]) -> tuple[tuple[Position, ...], tuple[float, float]]:
    """Return padded positions and largest residual; a cutout off the frame is an error before any work."""
    padded: dict[Position, None] = {}
    largest = [0.0, 0.0]
    height, width = gatherer.source.shape
    for index in order.tolist():
        window, _ = gatherer.place(index)
        largest = [max(largest[0], abs(window.row_residual)), max(largest[1], abs(window.column_residual))]
        if not gatherer.outside(index):
            continue
        info = gatherer.infos[index]
        if gatherer.cutout.outside == "error":
            nt, ns = gatherer.cutout.reach
            top, left = info.origin
            raise InputError.expected(
                f"cutout of {gatherer.where(index)}",
                f"rows {top}..{top + height - 1}, columns {left}..{left + width - 1}",
                f"rows {window.row}..{window.row + nt - 1}, columns {window.column}..{window.column + ns - 1}",
                "move the anchor, shrink the cutout, or pad",
            )
        padded[info.position] = None
    return tuple(padded), (largest[0], largest[1])
