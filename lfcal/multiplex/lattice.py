"""Super-pixels of any pitch and angle: light fields behind a real lenslet lattice or mask."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfcal.camera import Camera
from lfcal.checks import check_choice, check_number, check_tuple
from lfcal.errors import InputError
from lfcal.lattice import LatticeFit, ViewGrid, view_grid
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
    def of_fit(cls, fit: LatticeFit) -> SuperPixelLattice:
        """Return the lattice of a `lfcal.lattice.LatticeFit`, measured on a white image."""
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
        # row distance is the cell's area over the pitch: it holds for any angle of the two vectors
        return abs(ax * by - ay * bx) / length, length

    def view_grid(self, shape: tuple[int, ...], margin: float) -> ViewGrid:
        """Return the largest box of super-pixels with ``margin`` pixels of frame about their centres."""
        return view_grid(self.kind, (self.along_px, self.across_px), self.origin_px, shape, margin)


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
    half = ((count[0] - 1) / 2 * step[0], (count[1] - 1) / 2 * step[1])
    grid = lattice.view_grid(image.shape, max(half))
    if not min(grid.shape):
        raise InputError.expected(
            "frame",
            f"a super-pixel of {2 * half[0] + 1:.0f} x {2 * half[1] + 1:.0f} px wholly inside",
            f"{image.shape} px",
            "give a larger frame or fewer views",
        )
    result = _output(out, (*count, *grid.shape), image.dtype)
    near, share, centres = _lenslets(lattice, grid)
    corner_y = np.ascontiguousarray(centres[..., 1] - half[0])
    corner_x = np.ascontiguousarray(centres[..., 0] - half[1])
    sites = Sites(corner_y, corner_x, near, share.astype(result.dtype))
    reading = Reading(*step, LATTICE_FILTERS[filter])
    for_each_chunk(lambda a, b: lattice_rows(image, sites, reading, result, a, b), len(grid.rows), workers)
    return result


def _output(out: NDArray[Any] | None, shape: tuple[int, ...], dtype: np.dtype[Any]) -> NDArray[Any]:
    """Return ``out``, or an array where it is None: float64 for frames of float64, else float32."""
    if out is None:
        return np.empty(shape, np.float64 if dtype == np.float64 else np.float32)
    if out.shape != shape or out.dtype not in (np.float32, np.float64):
        raise InputError.expected(
            "output array", f"float32 or float64 {shape}", f"{out.dtype} {out.shape}", "allocate it like this"
        )
    return out


def _lenslets(lattice: SuperPixelLattice, grid: ViewGrid) -> tuple[NDArray[np.intp], Array, Array]:
    """Return the lenslets of each row of the grid, as the kernel counts them.

    Returns
    -------
    tuple
        Number of the lenslet left of each view pixel, counted from the first one its row needs; share of the one to
        its right; and the centres of those lenslets ``(rows, lenslets, 2)`` as (x, y) (pixels).
    """
    left, share = grid.neighbours()
    # relative to the leftmost lenslet of its row, so that the kernel's tables stay short
    base = left[:, :1]
    q = base + np.arange(int((left - base).max()) + 2)
    index = np.stack([q, np.broadcast_to(grid.rows[:, None], q.shape)], -1)
    # lattices count (x, y), pixels (row, column)
    centres: Array = index @ np.array([lattice.along_px, lattice.across_px]) + np.array(lattice.origin_px)[::-1]
    return np.ascontiguousarray(left - base), share, centres


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
