"""Super-pixels of any pitch and angle: light fields behind a real lenslet lattice or mask."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfcal.checks import check_choice, check_number, check_tuple
from lfcal.errors import InputError
from lfcal.lattice import MicroImageLattice, ViewGrid, sample_views, view_grid
from lfcal.multiplex.demultiplexing import check_frame
from lfcal.multiplex.modulator import Modulator

__all__ = ["LATTICE_FILTERS", "SuperPixelLattice", "channel_grid", "demultiplex_lattice", "lattice_channels"]

Array = NDArray[np.float64]

LATTICE_FILTERS = ("nearest", "linear", "cubic")


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

    @property
    def pitch_px(self) -> float:
        """Distance of neighbours along a row (pixels)."""
        return math.hypot(*self.along_px)

    @property
    def row_pitch_px(self) -> float:
        """Distance of neighbouring rows (pixels)."""
        (ax, ay), (bx, by) = self.along_px, self.across_px
        # row distance is the cell's area over the pitch: it holds for any angle of the two vectors
        return abs(ax * by - ay * bx) / self.pitch_px

    @property
    def rotation_rad(self) -> float:
        """Angle from the +x axis to a row (rad)."""
        return math.atan2(self.along_px[1], self.along_px[0])

    def basis_px(self) -> Array:
        """Return the lattice vectors as rows (x, y) (pixels)."""
        return np.array([self.along_px, self.across_px])

    def centres_px(self, q: ArrayLike, r: ArrayLike) -> Array:
        """Return centres ``(..., 2)`` as (row, column) of super-pixels q, r."""
        q, r = np.asarray(q, float), np.asarray(r, float)
        (ax, ay), (bx, by) = self.along_px, self.across_px
        centres = np.empty((*np.broadcast_shapes(q.shape, r.shape), 2))
        centres[..., 0] = self.origin_px[0] + q * ay + r * by
        centres[..., 1] = self.origin_px[1] + q * ax + r * bx
        return centres

    def lenslet_at(self, row: ArrayLike, column: ArrayLike) -> Array:
        """Return fractional indices ``(..., 2)`` as (q, r) of image points."""
        points = np.stack(np.broadcast_arrays(np.asarray(row, float), np.asarray(column, float)), axis=-1)
        index: Array = (points - np.array(self.origin_px)) @ np.linalg.inv(self.basis_px()[:, ::-1])
        return index


def lattice_channels(
    frame: ArrayLike,
    lattice: MicroImageLattice,
    size: int | tuple[int, int],
    *,
    spacing_px: float | tuple[float, float] | None = 1.0,
    filter: str = "linear",
    axes: str = "lattice",
    out: NDArray[Any] | None = None,
    workers: int | None = None,
) -> NDArray[Any]:
    """Return ``size`` measurement channels of each super-pixel, ``(size, size, rows, columns)``.

    Parameters
    ----------
    frame
        ``(rows, columns)``, background subtracted.
    lattice
        Where the super-pixels lie: a `SuperPixelLattice`, a `lfcal.lattice.LatticeFit`, or `lfcal.lattice.lattice_of` a
        camera. Neither pitch nor angle need fit the pixels, nor need the lattice be straight.
    size
        Channels down and across, about each centre.
    spacing_px
        Distance of channels (pixels), or down and across; None divides the pitch by ``size``.
    filter
        ``"nearest"``, ``"linear"`` or ``"cubic"`` between pixels; between super-pixels it is linear.
    axes
        ``"lattice"``: rows of super-pixels as they are, in the largest box of the lattice's own axes; ``"frame"``:
        upright in the frame, between super-pixels (`lfcal.lattice.view_grid`).
    out
        float32 or float64 array to write to.
    workers
        Threads.

    Raises
    ------
    InputError
        If no super-pixel lies wholly in the frame, or an option is out of range.
    """
    check_choice("filter", filter, LATTICE_FILTERS)
    image = check_frame(frame, (1, 1))
    grid, count, step = _channel_grid(image.shape, lattice, size, spacing_px, axes)
    result = _output(out, (*count, *grid.shape), image.dtype)
    return sample_views(image, grid, result, step_px=step, filter=filter, workers=workers)


def channel_grid(
    shape: tuple[int, ...],
    lattice: MicroImageLattice,
    size: int | tuple[int, int],
    *,
    spacing_px: float | tuple[float, float] | None = 1.0,
    axes: str = "lattice",
) -> ViewGrid:
    """Return which super-pixels of a frame of ``shape`` `lattice_channels` takes; raises as it does."""
    return _channel_grid(shape, lattice, size, spacing_px, axes)[0]


def _channel_grid(
    shape: tuple[int, ...],
    lattice: MicroImageLattice,
    size: int | tuple[int, int],
    spacing_px: float | tuple[float, float] | None,
    axes: str,
) -> tuple[ViewGrid, tuple[int, ...], tuple[float, float]]:
    """Return the super-pixels, and number and distance of their channels."""
    pair = (size, size) if isinstance(size, int | np.integer) else size
    count = check_tuple("channels of a super-pixel", pair, 2, at_least=1, at_most=512, integer=True)
    step = _spacing(spacing_px, lattice, count)
    half = ((count[0] - 1) / 2 * step[0], (count[1] - 1) / 2 * step[1])
    grid = view_grid(lattice, shape, max(half), axes=axes)
    if not min(grid.shape):
        raise InputError.expected(
            "frame",
            f"a super-pixel of {2 * half[0] + 1:.0f} x {2 * half[1] + 1:.0f} px wholly inside",
            f"{shape} px",
            "give a larger frame or fewer views",
        )
    return grid, count, step


def _output(out: NDArray[Any] | None, shape: tuple[int, ...], dtype: np.dtype[Any]) -> NDArray[Any]:
    """Return ``out``, or an array where it is None: float64 for frames of float64, else float32."""
    if out is None:
        return np.empty(shape, np.float64 if dtype == np.float64 else np.float32)
    if out.shape != shape or out.dtype not in (np.float32, np.float64):
        raise InputError.expected(
            "output array", f"float32 or float64 {shape}", f"{out.dtype} {out.shape}", "allocate it like this"
        )
    return out


def _spacing(
    spacing: float | tuple[float, float] | None, lattice: MicroImageLattice, count: tuple[int, ...]
) -> tuple[float, float]:
    if spacing is None:
        spacing = (lattice.row_pitch_px / count[0], lattice.pitch_px / count[1])
    pair = spacing if isinstance(spacing, tuple) else (spacing, spacing)
    for value in check_tuple("spacing of channels (px)", pair, 2):
        check_number("spacing of channels (px)", value, above=0, at_most=1e3)
    return float(pair[0]), float(pair[1])


def demultiplex_lattice(
    frame: ArrayLike,
    lattice: MicroImageLattice,
    modulator: Modulator,
    *,
    route: str = "spatial",
    filter: str = "linear",
    axes: str = "lattice",
    rcond: float | None = None,
    workers: int | None = None,
) -> NDArray[Any]:
    """Return the views of a light field whose super-pixels are no whole pixels, ``(N, rows, columns)``.

    Parameters
    ----------
    frame, lattice, axes, workers
        As in `lattice_channels`.
    modulator
        One super-pixel of a light field; its values lie at equal steps of the lattice's vectors.
    route
        ``"spatial"`` (theorem 1) or ``"fourier"`` (theorem 2): tiles of the spectrum about the lattice's own
        frequencies, whatever its pitch and angle, which equals the spatial route with a sinc where the frame holds
        nothing between the tiles. It takes a transform of the frame for each pixel of a super-pixel.
    filter
        Of the spatial route: ``"nearest"``, ``"linear"`` or ``"cubic"`` between pixels, the channels of a super-pixel
        counting as taken at its centre; or ``"sinc"`` between super-pixels, each channel at its own place
        (`lfcal.multiplex.heterodyne`).
    rcond
        Singular values up to this share of the largest count as zero.

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
    check_choice("route", route, ("spatial", "fourier"))
    check_choice("filter", filter, (*LATTICE_FILTERS, "sinc"))
    if route == "fourier" or filter == "sinc":
        return _by_waves(check_frame(frame, (1, 1)), lattice, modulator, route, axes, rcond)
    channels = lattice_channels(
        frame, lattice, modulator.side, spacing_px=None, filter=filter, axes=axes, workers=workers
    )
    flat = channels.reshape(modulator.pixels, -1)
    inverse = modulator.inverse(rcond).astype(channels.dtype)
    views: NDArray[Any] = (inverse @ flat).reshape(modulator.count, *channels.shape[2:])
    return views


def _by_waves(
    image: NDArray[Any], lattice: MicroImageLattice, modulator: Modulator, route: str, axes: str, rcond: float | None
) -> NDArray[Any]:
    from lfcal.multiplex.heterodyne import lattice_by_sinc, lattice_by_spectrum, sample_places

    grid = channel_grid(image.shape, lattice, modulator.side, spacing_px=None, axes=axes)
    solve = lattice_by_spectrum if route == "fourier" else lattice_by_sinc
    views = solve(image, lattice, modulator, sample_places(grid), rcond).reshape(modulator.count, *grid.shape)
    return views if image.dtype == np.float64 else views.astype(np.float32)
