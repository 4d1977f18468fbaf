"""Assemble H from frames: the frames are checked first, then assembled plane by plane.

`iter_assemble_plan` is used by the command line, the window and scripts; `iter_assemble` needs no plan.
"""

from __future__ import annotations

import math
import os
import time
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfcal.base import Clock, InputError, Progress, Work, drained, format_count, plain, worker_count
from lfcal.camera import Camera, ScanPlan
from lfcal.frames import AS_IS, FrameSource, Position, check_stated
from lfcal.psf._pedestal import check_pedestal
from lfcal.psf.assembly_report import AssemblyReport
from lfcal.psf.cutout import Cutout, Gatherer, by_position, find_cutout
from lfcal.psf.facts import Facts, pack_valid
from lfcal.psf.filling import Fill
from lfcal.psf.layout import Header, Plane, Stored
from lfcal.psf.make import PlaneSource, Reopening, Zeros, iter_make
from lfcal.psf.matrix import PSFMatrix
from lfcal.psf.measured_noise import measure_noise
from lfcal.psf.provenance import FrameNoise
from lfcal.records import AssemblySettings

if TYPE_CHECKING:
    from lfcal.work import RunChoice

__all__ = [
    "AssembledPlanes",
    "Assembly",
    "AssemblyProgress",
    "assemble",
    "assemble_plan",
    "find_plan_cutout",
    "forecast_assembly",
    "iter_assemble",
    "iter_assemble_plan",
    "known_of",
    "planes_of_frames",
]

FRAME_FACTS = ("codec", "origin")
"""Metadata of a frame source that H stores besides the number of frames."""

SAMPLED = 24
"""Smallest number of frames from which an automatic cutout is found; all if there are fewer."""

QUICK_S = 2e-3
"""Processor time of a frame (s) below which more threads do not make an assembly faster."""


@dataclass(frozen=True, slots=True)
class AssemblyProgress(Progress):
    """Progress of an assembly, with the total light of every pattern assembled so far.

    Attributes
    ----------
    plane
        Index of the current plane.
    energy
        Sum of each pattern, ``(nz, ny, nx)`` (counts); NaN if it has not been assembled.
    """

    plane: int = field(kw_only=True)
    energy: NDArray[np.float64] = field(kw_only=True, compare=False, repr=False)


class Assembly:
    """The frames of a scan, sorted by position, from which any plane of H can be assembled.

    Parameters
    ----------
    source
        The frames, in any order; their samples are used unchanged.
    shape
        Number of positions ``(nz, ny, nx)`` in the plan.
    cutout
        The cutout, which moves with the source.
    drift
        ``(len(source), 2)`` displacement of each image from its planned position (rows, columns; px). None: the drift
        stated by the source, which may come from its manifest.
    strict
        Whether to treat missing and repeated positions as errors.
    noise
        Noise of the samples, used only if ``measured`` is true. None: unknown.
    measured
        Whether ``noise`` has already been measured; otherwise it is measured here.

    Raises
    ------
    InputError
        If no frame is in the plan, a frame is outside it, or a cutout extends beyond the sensor and is not padded. With
        ``strict``, also if a position is missing or repeated. The message states the position.
    """

    def __init__(
        self,
        source: FrameSource,
        shape: tuple[int, int, int],
        cutout: Cutout,
        *,
        drift: ArrayLike | None = None,
        strict: bool = False,
        noise: FrameNoise | None = None,
        measured: bool = False,
    ) -> None:
        infos = tuple(source.info(k) for k in range(len(source)))
        self.source, self.shape, self.cutout = source, shape, cutout
        self._order, self._starts = by_position(infos, shape)
        self._counts = np.diff(self._starts).reshape(shape)
        self.missing, self.repeated = (_positions(mask) for mask in (self._counts == 0, self._counts > 1))
        _check_complete(shape, self._counts, self.missing, self.repeated, strict)
        self._gatherer = Gatherer(source, infos, cutout, _drift_of(drift, len(source)))
        self._energy = np.full(shape, np.nan)
        self.filled: tuple[int, NDArray[np.float64]] | None = None
        """Index of the current plane, and light of the patterns so far, as in `AssemblyProgress`. None: none so far."""
        self.padded, self.residual_px = _check_windows(self._gatherer, self._order)
        self.noise = noise if measured else measure_noise(self._gatherer, self._order, self._counts)
        """Noise of the samples, None if it could not be measured."""
        if self.noise is not None and self.noise.of_samples is not None:
            self._gatherer = replace(self._gatherer, noise=self.noise.of_samples)

    @property
    def frames(self) -> int:
        """Number of frames to read."""
        return len(self._order)

    def frames_of(self, z: int) -> int:
        """Return the number of frames of plane ``z``."""
        return int(self._counts[z].sum())

    @property
    def recorded(self) -> int:
        """Number of recorded frames, without the copies that complete a half-cell scan."""
        copied = self.source.metadata.half_cell
        return len(self.source) - (0 if copied is None else copied["frames"])

    def history(self, provenance: Mapping[str, Any] | None = None) -> dict[str, Any]:
        """Return the provenance of H, a record of how it was assembled; the entries of ``provenance`` are included."""
        known, cutout = self.source.metadata, self.cutout
        found = {
            "frames": {"count": self.recorded, **known.stated(FRAME_FACTS)},
            "cutout": {"interpolation": cutout.interpolation, "outside": cutout.outside, "scale": list(cutout.scale)},
            "corrections": known.corrections or {},
            **(provenance or {}),
        }
        if self.noise is not None:
            found.setdefault("noise", self.noise.record())
        if known.left_out:
            found["left_out"] = [one._asdict() for one in known.left_out]
        if known.orientation is not None:
            found.setdefault("orientation", {"applied": known.orientation})
        return found

    def header(
        self,
        depths: ArrayLike | None = None,
        camera: Camera | None = None,
        provenance: Mapping[str, Any] | None = None,
    ) -> Header:
        """Return the header of H, with ``depths`` ``(nz,)`` (µm), ``camera``, and the provenance from `history`.

        ``depths`` and ``camera`` are None if unknown. ``provenance`` contains further entries for `history`.
        """
        shape = (*self.shape, *self.cutout.shape)
        return Header(shape, depths, camera, self.cutout.anchor, self.history(provenance))

    def iter_plane(
        self, z: int, clock: Clock, *, values: NDArray[np.float32], before: int = 0, workers: int | None = None
    ) -> Work[Facts]:
        """Assemble plane ``z`` row by row in several threads; yield progress in frames, return facts about positions.

        Parameters
        ----------
        z
            Index of the plane.
        clock, before
            Clock that counts frames, and the number of frames in the planes before this one.
        values
            Array of zeros ``(ny, nx, nt, ns)`` that is filled with the values of the plane.
        workers
            Number of threads. None: one for each available CPU core.

        Raises
        ------
        InputError
            If a frame is not finite, or all values of a plane with frames are 0.
        """
        recorded = self._counts[z]
        plane = _Gathered(recorded, values, self._energy[z])
        first, done = z * recorded.size, before
        row = partial(plane.fill_row, self._gatherer, self._order, self._starts[first : first + recorded.size + 1])
        with ThreadPoolExecutor(worker_count(workers)) as pool:
            results = pool.map(row, range(recorded.shape[0]))
            try:
                for count in results:
                    done += count
                    at = clock.at(done)
                    self.filled = z, self._energy.copy()
                    yield AssemblyProgress(at.done, at.total, at.stage, at.seconds, plane=z, energy=self.filled[1])
            except BaseException:
                pool.shutdown(cancel_futures=True)
                raise
        if recorded.any() and not plane.values.any():
            label = self._gatherer.infos[int(self._order[self._starts[first]])].label
            raise InputError.expected(
                f"plane {z}",
                "light in its cutouts",
                f"only zeros ({label} and others)",
                "check the exposure, the anchor and the dark frame",
            )
        return plane.facts()

    def report(self, matrix: PSFMatrix) -> AssemblyReport:
        """Return the report on the assembled H."""
        known = self.source.metadata
        found = AssemblyReport.of(matrix, self.recorded, self.missing, self.repeated, self.padded, self.residual_px)
        return replace(found, left_out=known.left_out, orientation=known.orientation or AS_IS)


class AssembledPlanes(PlaneSource):
    """The planes of an H that is assembled from frames.

    Parameters
    ----------
    assembly
        The frames.
    header
        Description of H without its values.
    fill
        Function that fills missing positions, which stay marked as never recorded. None: their patterns are 0.
    reopening
        How other processes open the same frames. None: the assembly cannot be divided among processes.
    close
        Function that closes the frames if they were opened only for these planes.
    """

    title = "assemble"

    def __init__(
        self,
        assembly: Assembly,
        header: Header,
        fill: Fill | None = None,
        *,
        reopening: Reopening | None = None,
        close: Callable[[], None] = lambda: None,
    ) -> None:
        self.assembly, self.header, self.fill = assembly, header, fill
        self._reopening, self._close = reopening, close
        self._clock = Clock("assemble frames", assembly.frames)

    def iter_plane(self, z: int, zeros: Zeros, workers: int | None, *, alone: bool = False) -> Work[Plane]:
        """Assemble and return plane ``z``; progress counts its frames if ``alone``, otherwise those of all planes.

        ``zeros`` returns the array that is filled.
        """
        assembly = self.assembly
        clock = Clock(f"assemble plane {z}", assembly.frames_of(z)) if alone else self._clock
        if alone or z == 0:
            yield clock.at(0)
        before = 0 if alone else sum(assembly.frames_of(k) for k in range(z))
        values = zeros()
        facts = yield from assembly.iter_plane(z, clock, values=values, before=before, workers=workers)
        if self.fill is None:
            return Plane(values, facts)
        filled = yield from self.fill(z, values, facts)
        return Plane(values, filled.facts, filled.uncertainty)

    def reopening(self, z: int, stored: Stored) -> Reopening:
        """Return how other processes open the frames; each process opens them once for all planes.

        Raises
        ------
        InputError
            If the frames can only be read by this process.
        """
        if self._reopening is None:
            remedy = "state what distinguishes these frames from any others (reopening=)"
            raise InputError.expected("H in units", "a way to open its frames again", "none", remedy)
        return replace(self._reopening, held=True)

    def shown(self, record: Progress) -> Progress:
        """Return ``record`` with the light of all patterns that this process has assembled; unchanged before that."""
        if (at := self.assembly.filled) is None:
            return record
        known = (record.done, record.total, record.stage, record.seconds, record.note, record.per)
        return AssemblyProgress(*known, plane=at[0], energy=at[1])

    def close(self) -> None:
        """Close the frames if they were opened only for these planes."""
        self._close()


class _Gathered:
    """A plane that is being assembled: its patterns ``(ny, nx)`` and their facts."""

    def __init__(self, recorded: NDArray[np.int64], values: NDArray[np.float32], energy: NDArray[np.float64]) -> None:
        shape = recorded.shape
        self.recorded, self.values, self.energy = recorded, values, energy
        self.cutout: tuple[int, int] = (values.shape[2], values.shape[3])
        self.saturated = np.full(shape, -1, np.int32)
        self.noise = np.full((*shape, 2), np.nan, np.float32)
        self.spread = np.full(shape, np.nan, np.float32)
        self.invalid: dict[tuple[int, int], NDArray[np.bool_]] = {}

    def fill_row(self, gatherer: Gatherer, order: NDArray[np.int64], starts: NDArray[np.int64], y: int) -> int:
        """Assemble the positions of one row; return the number of frames read."""
        columns = self.recorded.shape[1]
        row = starts[y * columns : (y + 1) * columns + 1]
        for x in np.flatnonzero(np.diff(row)).tolist():
            found = gatherer.pattern(order[row[x] : row[x + 1]])
            self.values[y, x] = found.values
            self.energy[y, x] = found.values.sum(dtype=np.float64)
            self.noise[y, x], self.spread[y, x], self.saturated[y, x] = found.noise, found.spread, found.saturated
            if found.valid is not None:
                self.invalid[y, x] = found.valid
        return int(row[-1] - row[0])

    def facts(self) -> Facts:
        """Return the known facts about the positions; unknown facts are left out."""
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


def _positions(mask: NDArray[np.bool_]) -> tuple[Position, ...]:
    return tuple(Position(*p) for p in np.argwhere(mask).tolist())


def _drift_of(drift: ArrayLike | None, count: int) -> NDArray[np.float64] | None:
    if drift is None:
        return None
    offsets = np.asarray(drift, np.float64)
    if offsets.shape != (count, 2):
        raise InputError.expected("drift", f"shape ({count}, 2)", offsets.shape, "give one row per frame")
    return offsets


def _check_complete(
    shape: tuple[int, int, int],
    counts: NDArray[np.int64],
    missing: tuple[Position, ...],
    repeated: tuple[Position, ...],
    strict: bool,
) -> None:
    if not counts.any():
        raise InputError.expected(
            "frames of the scan",
            f"frames of at least one of the {int(np.prod(shape))} positions",
            "none",
            "check the folder and the name pattern (--pattern)",
        )
    if strict and missing:
        many = format_count(len(missing), "position", "positions")
        what = f"{many} without a frame, the first at (z, y, x) = {tuple(missing[0])}"
        raise InputError.expected(
            "positions of the scan",
            "a frame at each position",
            what,
            "record the missing positions, or do not require one frame per position (leave --strict out)",
        )
    if strict and repeated:
        many = format_count(len(repeated), "position", "positions")
        what = f"{many} with several frames, the first at (z, y, x) = {tuple(repeated[0])}"
        raise InputError.expected(
            "positions of the scan",
            "one frame at each position",
            what,
            "remove the other frames, or do not require one frame per position (leave --strict out)",
        )


def _check_windows(gatherer: Gatherer, order: NDArray[np.int64]) -> tuple[tuple[Position, ...], tuple[float, float]]:
    """Return padded positions and the largest residual; raise an error if a cutout extends beyond its frame."""
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
                "move the anchor, choose a smaller cutout, or allow padding",
            )
        padded[info.position] = None
    return tuple(padded), (largest[0], largest[1])


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
    store_tolerance: float | None = None,
    run: RunChoice | None = None,
    reopening: Reopening | None = None,
) -> Work[AssemblyReport]:
    """Assemble H from frames with one plane in memory at a time, and return a report that contains H.

    Parameters
    ----------
    source
        Source of corrected frames, in any order; their pixel values are used unchanged.
    shape
        Number of planes and of source positions, ``(nz, ny, nx)``, in the plan.
    cutout
        Cutout around the image of the source, which moves with the source.
    out
        H file to write; it never exists in an incomplete state. None: H is kept in memory as float32.
    depths, camera, provenance
        Depths of the planes (µm), camera, and provenance (plain JSON types) to store with H. None: unknown.
    drift
        Displacement (rows, columns; px) of the image in each frame from its planned position, ``(len(source), 2)``.
        None: the drift stated by the source, for example in its manifest.
    strict
        Whether missing and repeated positions are errors; otherwise, they are marked in H and listed in the report.
    fill
        Function that fills in the patterns of missing positions, which remain marked as never recorded. None: their
        patterns are 0.
    dtype, compression, workers, store_tolerance
        As in `PSFWriter`.
    run
        Only for a file. Settings for processing the planes as separate work units: the executor, and what to do with
        units left by an earlier run. If the run is stopped, finished units are kept. None: no units.
    reopening
        Only with a ``run``: values that identify these frames, and the function with which other processes open them.
        Without such a function, H is assembled only by threads of this process.

    Raises
    ------
    InputError
        If a frame is outside the plan or not finite, or its cutout extends beyond the sensor and is not padded. With
        ``strict``, also if a position is missing or repeated. The message states the position.

    Examples
    --------
    >>> import numpy as np
    >>> from lfcal.frames import ArraySource
    >>> from lfcal.base import drain
    >>> from lfcal.psf import Cutout, iter_assemble
    >>> frames = ArraySource(np.ones((3, 16, 16), np.uint16), [(0, 0, 0), (0, 0, 1), (0, 1, 0)])
    >>> report = drain(iter_assemble(frames, (1, 2, 2), Cutout((5, 5), anchor=(7, 8))))
    >>> print(report.frames, "frames,", report.missing)
    3 frames, (Position(z=0, y=1, x=1),)
    """
    assembly = Assembly(source, shape, cutout, drift=drift, strict=strict)
    planes = AssembledPlanes(assembly, assembly.header(depths, camera, provenance), fill, reopening=reopening)
    stored = Stored(dtype, compression, store_tolerance)
    return assembly.report((yield from iter_make(planes, out, stored, run=run, workers=workers)))


assemble = drained(
    iter_assemble,
    """
    Examples
    --------
    >>> import numpy as np
    >>> from lfcal.frames import ArraySource
    >>> from lfcal.psf import Cutout, assemble
    >>> frames = np.zeros((1, 2, 3, 16, 16), np.uint16)
    >>> for y, x in np.ndindex(2, 3):
    ...     frames[0, y, x, 7 + y, 8 + x] = 1000  # the image of position (y, x)
    >>> H = assemble(ArraySource(frames), (1, 2, 3), Cutout((5, 5), anchor=(7, 8))).matrix
    >>> print(H.shape, H[0, :, :, 2, 2].tolist())
    (1, 2, 3, 5, 5) [[1000.0, 1000.0, 1000.0], [1000.0, 1000.0, 1000.0]]
    """,
)


def iter_assemble_plan(
    source: FrameSource,
    plan: ScanPlan,
    out: str | os.PathLike[str] | None = None,
    settings: AssemblySettings | None = None,
    *,
    provenance: Mapping[str, Any] | None = None,
    fill: Fill | None = None,
    run: RunChoice | None = None,
    reopening: Reopening | None = None,
    workers: int | None = None,
) -> Work[AssemblyReport]:
    """Assemble H of ``plan`` from corrected frames, and return a report that contains H.

    Parameters
    ----------
    source
        Corrected frames, as returned by `lfcal.frames.corrected_view`; no further corrections are applied.
    plan
        Scan plan with the positions, depths, anchor and cutout.
    out
        H file to write. None: H is kept in memory as float32.
    settings
        Settings of the assembly. None: the defaults.
    provenance
        Provenance to store with H, as plain JSON types, in addition to plan, corrections and settings.
    fill, run, reopening, workers
        As in `iter_assemble`.

    Raises
    ------
    InputError
        As in `iter_assemble`; also if a pedestal would remain in H because the black level was not subtracted
        correctly, unless ``settings.keep_pedestal`` is true.

    Examples
    --------
    >>> from pathlib import Path
    >>> from lfcal.camera import ScanPlan
    >>> from lfcal.frames import CorrectionRecipe, corrected_view, open_frames
    >>> from lfcal.psf import iter_assemble_plan
    >>> plan = ScanPlan.from_json(Path("session/plan.json").read_text())
    >>> with open_frames("session/frames", plan=plan) as frames:
    ...     view = corrected_view(frames, CorrectionRecipe(dark="session/dark"), plan)
    ...     work = iter_assemble_plan(view, plan, "new.h5")
    ...     step = next(work)
    ...     work.close()  # cancelled: no file is left
    >>> print(step.stage, step.count, Path("new.h5").exists())
    assemble frames 0 of 1254 False
    """
    settings = settings or AssemblySettings()
    cutout = find_plan_cutout(source, plan, settings)
    assembly = Assembly(source, plan.shape[:3], cutout, strict=settings.strict)
    header = assembly.header(plan.depths_um, plan.camera, known_of(source, plan, provenance))
    if reopening is not None:
        # facts found from many frames are passed on, so that other processes do not search for them again
        found = replace(settings, cutout=cutout.shape, keep_pedestal=True)
        noise = None if assembly.noise is None else list(assembly.noise)
        reopening = replace(reopening, values={**reopening.values, "settings": plain(found), "noise": noise})
    planes = AssembledPlanes(assembly, header, fill, reopening=reopening)
    stored = Stored(settings.dtype, settings.compression, settings.store_tolerance)
    return assembly.report((yield from iter_make(planes, out, stored, run=run, workers=workers)))


assemble_plan = drained(
    iter_assemble_plan,
    """
    Examples
    --------
    >>> from pathlib import Path
    >>> from lfcal.camera import ScanPlan
    >>> from lfcal.frames import CorrectionRecipe, corrected_view, open_frames
    >>> from lfcal.psf import assemble_plan
    >>> plan = ScanPlan.from_json(Path("session/plan.json").read_text())
    >>> recipe = CorrectionRecipe(dark="session/dark", white="session/white")
    >>> with open_frames("session/frames", plan=plan) as frames:
    ...     report = assemble_plan(corrected_view(frames, recipe, plan), plan)
    >>> print(report.frames, "frames:", report.matrix)
    1254 frames: <PSFMatrix (z, y, x, t, s) = (2, 19, 33, 55, 55), float32, camera 'bench (sample session)'>
    """,
)


def forecast_assembly(source: FrameSource, plan: ScanPlan, *, count: int = 12, workers: int | None = None) -> float:
    """Return the expected elapsed time for assembling H (s), extrapolated from reading and cropping a few frames.

    Parameters
    ----------
    source
        Corrected frames, as returned by `lfcal.frames.corrected_view`.
    plan
        Scan plan with the positions, anchor and cutout.
    count
        Number of frames that are timed, spread over the scan; the median of their CPU times is used.
    workers
        Number of threads with which H will be assembled. None: one for each available CPU core.

    Raises
    ------
    InputError, FileFormatError, StorageError
        If a frame cannot be read.

    Examples
    --------
    >>> from pathlib import Path
    >>> from lfcal.camera import ScanPlan
    >>> from lfcal.frames import CorrectionRecipe, corrected_view, open_frames
    >>> from lfcal.psf import forecast_assembly
    >>> plan = ScanPlan.from_json(Path("session/plan.json").read_text())
    >>> with open_frames("session/frames", plan=plan) as frames:
    ...     seconds = forecast_assembly(corrected_view(frames, CorrectionRecipe(), plan), plan)
    >>> print(0 < seconds < 600)
    True
    """
    infos = tuple(source.info(k) for k in range(len(source)))
    gatherer = Gatherer(source, infos, Cutout.for_plan(plan, outside="zero"))
    times = []
    # the first frame includes the time for loading and compiling
    for index in (0, *np.linspace(0, len(source) - 1, min(count, len(source)), dtype=int).tolist()):
        start = time.thread_time()
        gatherer.pattern(np.array([index]))
        times.append(time.thread_time() - start)
    each = float(np.median(times[1:]))
    # threads block each other if a frame takes less time than the interpreter needs for it
    return each * len(source) / (worker_count(workers) if each > QUICK_S else 1)


def find_plan_cutout(source: FrameSource, plan: ScanPlan, settings: AssemblySettings) -> Cutout:
    """Return the cutout that ``settings`` request for ``plan``.

    Raises
    ------
    InputError
        If the frames do not match the plan, or H would contain a pedestal, unless ``settings.keep_pedestal`` is true.
    """
    check_stated(source, plan.camera)
    outside = "zero" if settings.pad else "error"
    cutout = Cutout.for_plan(plan, interpolation=settings.interpolation, outside=outside)
    if settings.cutout is not None:
        cutout = replace(cutout, shape=_cutout_shape(source, cutout, settings))
    _check_filter(source, plan)
    keeps_level = source.metadata.keeps_level
    # nothing is known about frames that were not corrected
    if keeps_level is not None and not settings.keep_pedestal:
        infos = tuple(source.info(k) for k in range(len(source)))
        check_pedestal(Gatherer(source, infos, cutout), plan.shape[0], subtracted=not keeps_level)
    return cutout


def _check_filter(source: FrameSource, plan: ScanPlan) -> None:
    """Raise `InputError` if the period of a scan is not a multiple of the colour filter's period."""
    cfa = source.metadata.cfa
    if not cfa or source.metadata.channel:
        return
    step = math.isqrt(len(cfa))  # letters by rows of a square
    if any(n % step for n in plan.period):
        period = " x ".join(str(math.lcm(n, step)) for n in plan.period)
        raise InputError.expected(
            "period of a scan through a colour filter",
            f"a multiple of {step} pixels, which is the period of the filter",
            f"{plan.period[0]} x {plan.period[1]} pixels, after which the same point of a lenslet has another colour",
            f"scan {period} positions, or describe the sensor without its filter if it has none",
        )


def known_of(source: FrameSource, plan: ScanPlan, provenance: Mapping[str, Any] | None) -> dict[str, Any]:
    """Return the facts about the scan that are stored with H, the plan, and the entries of ``provenance``."""
    reported = ("session", "devices", "simulated", "optics", "suspect", "half_cell", "kept_aside", "earlier_tasks")
    return {**source.metadata.stated(reported), "plan": plan.to_dict(), **(provenance or {})}


def planes_of_frames(
    source: FrameSource, plan: ScanPlan, values: Mapping[str, Any], fill: Fill | None, close: Callable[[], None]
) -> AssembledPlanes:
    """Return the planes of ``plan`` for a process that assembles units of a run.

    ``values`` is `Reopening.values`, with the entries ``settings`` and ``noise``. ``fill`` is as in
    `AssembledPlanes`. ``close`` is called to close the frames when the planes are finished.
    """
    given = values["settings"]
    settings = AssemblySettings(**{**given, "cutout": tuple(given["cutout"])})
    cutout = find_plan_cutout(source, plan, settings)
    noise = None if values["noise"] is None else FrameNoise(*values["noise"])
    assembly = Assembly(source, plan.shape[:3], cutout, strict=settings.strict, noise=noise, measured=True)
    return AssembledPlanes(assembly, assembly.header(plan.depths_um), fill, close=close)


def _cutout_shape(source: FrameSource, cutout: Cutout, settings: AssemblySettings) -> tuple[int, int]:
    if not isinstance(settings.cutout, str):
        assert settings.cutout is not None
        return settings.cutout
    sample = range(0, len(source), max(1, len(source) // SAMPLED))
    images = (source.read(k) for k in sample)

    def centre(k: int) -> tuple[float, float]:
        info = source.info(k)
        row, column = (
            cutout.anchor[axis] + step / cutout.scale[axis] - info.origin[axis]
            for axis, step in enumerate((info.position.y, info.position.x))
        )
        return row, column

    return find_cutout(images, (centre(k) for k in sample), lost=settings.lost)
