"""Super-pixels of any pitch and angle: light fields behind a real lenslet lattice or mask."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfcal.camera import Camera
from lfcal.checks import check_choice, check_number, check_tuple
from lfcal.errors import InputError
from lfcal.multiplex._lattice_kernels import Reading, Sites, lattice_rows
from lfcal.multiplex.demultiplexing import check_frame
from lfcal.multiplex.modulator import Modulator
from lfcal.threads import for_each_chunk

__all__ = ["LATTICE_FILTERS", "SuperPixelLattice", "demultiplex_lattice", "lattice_channels"]

Array = NDArray[np.float64]

LATTICE_FILTERS = {"nearest": 1, "linear": 2, "cubic": 4}


@dataclass(frozen=True, slots=True)
class SuperPixelLattice:
    """Where the super-pixels of a light field lie on the sensor.

    Attributes
    ----------
    kind
        ``"square"`` or ``"hexagonal"``.
    origin_px
        Centre ``(row, column)`` of one of them.
    along_px
        Vector (x, y) to the next one of the row (pixels).
    across_px
        Vector (x, y) to the next row (pixels); half a pitch further along where the lattice is hexagonal.
    """

    kind: str
    origin_px: tuple[float, float]
    along_px: tuple[float, float]
    across_px: tuple[float, float]

    def __post_init__(self) -> None:
        """Check every value."""
        check_choice("lattice", self.kind, ("square", "hexagonal"))
        for name in ("origin_px", "along_px", "across_px"):
            object.__setattr__(self, name, check_tuple(name, getattr(self, name), 2))
        (ax, ay), (bx, by) = self.along_px, self.across_px
        check_number(
            "area of a super-pixel (px^2)", abs(ax * by - ay * bx), at_least=0.999, remedy="a period of 1 px or more"
        )

    @classmethod
    def of_fit(cls, fit: Any) -> SuperPixelLattice:
        """Return the lattice of a `lfcal.frames.LatticeFit`, measured on a white image."""
        return cls(fit.kind, _pair(fit.origin_px), *map(_pair, fit.basis_px()))

    @classmethod
    def of_camera(cls, camera: Camera) -> SuperPixelLattice:
        """Return the lattice a camera states."""
        basis = camera.lattice.basis_um() / camera.sensor.pixel_um
        return cls(camera.lattice.kind, _pair(camera.pixels(camera.lattice.offset_um)), *map(_pair, basis))

    @property
    def pitch_px(self) -> tuple[float, float]:
        """Distance of rows, and of neighbours along a row (pixels)."""
        (ax, ay), (bx, by) = self.along_px, self.across_px
        length = float(np.hypot(ax, ay))
        return abs(ax * by - ay * bx) / length, length

    def sites(self, shape: tuple[int, ...], margin: float) -> tuple[NDArray[np.intp], Array]:
        """Return rows r, and columns in pitches from the origin, of the largest upright box inside a frame.

        All super-pixels of the box have ``margin`` pixels of frame about their centre. Columns of a hexagonal lattice
        are a row pitch apart, so that views have square samples.
        """
        basis = np.array([self.along_px, self.across_px])
        far = np.array(shape, float) - 1
        corners = np.array([(x, y) for x in (0.0, far[1]) for y in (0.0, far[0])]) - np.array(self.origin_px)[::-1]
        index = corners @ np.linalg.inv(basis)
        low, high = np.floor(index.min(0)).astype(int), np.ceil(index.max(0)).astype(int)
        q, r = np.meshgrid(np.arange(low[0], high[0] + 1), np.arange(low[1], high[1] + 1))
        centres = np.stack([q, r], -1) @ basis + np.array(self.origin_px)[::-1]
        good = ((centres >= margin) & (centres <= far[::-1] - margin)).all(-1)
        along = q + self.lean * r
        rows = np.flatnonzero(good.any(1))
        empty = np.zeros(0)
        if not len(rows):
            return empty.astype(np.intp), empty
        left = max(float(along[k][good[k]].min()) for k in rows)
        right = min(float(along[k][good[k]].max()) for k in rows)
        step = self.pitch_px[0] / self.pitch_px[1] if self.kind == "hexagonal" else 1.0
        columns = left + step * np.arange(max(0, int((right - left) / step + 1e-9) + 1))
        return np.asarray(r[rows, 0], np.intp), np.asarray(columns, float)

    @property
    def lean(self) -> float:
        """By how much each row is shifted along against the one before, in pitches."""
        return 0.5 if self.kind == "hexagonal" else 0.0


def _pair(values: Any) -> tuple[float, float]:
    first, second = values
    return float(first), float(second)


def lattice_channels(
    frame: ArrayLike,
    lattice: SuperPixelLattice,
    size: int | tuple[int, int],
    *,
    spacing_px: float | tuple[float, float] | None = 1.0,
    filter: str = "linear",
    out: NDArray[Any] | None = None,
    workers: int | None = None,
) -> NDArray[Any]:
    """Return ``size`` measurement channels of each super-pixel, ``(size, size, rows, columns)``.

    Parameters
    ----------
    frame
        ``(rows, columns)``, background subtracted.
    lattice
        Where the super-pixels lie; neither pitch nor angle need fit the pixels.
    size
        Channels down and across, about each centre.
    spacing_px
        Distance of channels (pixels), or down and across; None divides the pitch by ``size``.
    filter
        ``"nearest"``, ``"linear"`` or ``"cubic"`` between pixels; columns between the lenslets of a hexagonal row are
        linear.
    out
        float32 or float64 array to write to.
    workers
        Threads.

    Raises
    ------
    InputError
        If no super-pixel lies wholly in the frame, or an option is out of range.
    """
    check_choice("filter", filter, tuple(LATTICE_FILTERS))
    image = check_frame(frame, (1, 1))
    pair = (size, size) if isinstance(size, int | np.integer) else size
    count = check_tuple("channels of a super-pixel", pair, 2, at_least=1, at_most=512, integer=True)
    step = _spacing(spacing_px, lattice, count)
    half = [(n - 1) / 2 * s for n, s in zip(count, step, strict=True)]
    rows, columns = lattice.sites(image.shape, max(half))
    if not len(rows) or not len(columns):
        raise InputError.expected(
            "frame",
            f"a super-pixel of {2 * half[0] + 1:.0f} x {2 * half[1] + 1:.0f} px wholly inside",
            f"{image.shape} px",
            "give a larger frame or fewer views",
        )
    place = columns[None, :] - lattice.lean * rows[:, None]
    # for each row of the lattice its own lenslets, from the first that is needed
    base = np.floor(place[:, 0] + 1e-9).astype(np.intp)
    left = np.floor(place + 1e-9).astype(np.intp)
    share = place - left
    share[np.abs(share) < 1e-6] = 0.0
    lenses = int((left - base[:, None]).max()) + 2
    q = base[:, None] + np.arange(lenses)
    points = np.stack([q, np.broadcast_to(rows[:, None], q.shape)], -1) @ np.array(
        [lattice.along_px, lattice.across_px]
    )
    shape = (*count, *place.shape)
    result = np.empty(shape, np.float64 if image.dtype == np.float64 else np.float32) if out is None else out
    if result.shape != shape or result.dtype not in (np.float32, np.float64):
        raise InputError.expected(
            "output array", f"float32 or float64 {shape}", f"{result.dtype} {result.shape}", "allocate it like this"
        )
    corner_y = np.ascontiguousarray(points[..., 1] + lattice.origin_px[0] - half[0])
    corner_x = np.ascontiguousarray(points[..., 0] + lattice.origin_px[1] - half[1])
    shares = share.astype(result.dtype)
    sites = Sites(corner_y, corner_x, np.ascontiguousarray(left - base[:, None]), shares)
    reading = Reading(*step, LATTICE_FILTERS[filter])
    for_each_chunk(lambda a, b: lattice_rows(image, sites, reading, result, a, b), len(rows), workers)
    return result


def _spacing(
    spacing: float | tuple[float, float] | None, lattice: SuperPixelLattice, count: tuple[int, ...]
) -> tuple[float, float]:
    if spacing is None:
        spacing = (lattice.pitch_px[0] / count[0], lattice.pitch_px[1] / count[1])
    pair = spacing if isinstance(spacing, tuple) else (spacing, spacing)
    for value in check_tuple("spacing of channels (px)", pair, 2):
        check_number("spacing of channels (px)", value, above=0, at_most=1e3)
    return float(pair[0]), float(pair[1])


def demultiplex_lattice(
    frame: ArrayLike,
    lattice: SuperPixelLattice,
    modulator: Modulator,
    *,
    filter: str = "linear",
    rcond: float | None = None,
    workers: int | None = None,
) -> NDArray[Any]:
    """Return the views of a light field whose super-pixels are no whole pixels, ``(N, rows, columns)``.

    Each super-pixel is resampled to the modulator's pixels and decorrelated (theorem 1); its channels count as taken
    at one place, its centre.

    Raises
    ------
    InputError
        If the modulator is no single light-field super-pixel, or the frame holds none.
    """
    if modulator.side != modulator.cell:
        raise InputError.expected(
            "modulator on a lattice",
            "one super-pixel of a light field",
            modulator.name,
            "part the colours first (lfcal.frames.channel_source)",
        )
    channels = lattice_channels(frame, lattice, modulator.side, spacing_px=None, filter=filter, workers=workers)
    flat = channels.reshape(modulator.pixels, -1)
    inverse = modulator.inverse(rcond).astype(channels.dtype)
    views: NDArray[Any] = (inverse @ flat).reshape(modulator.count, *channels.shape[2:])
    return views
