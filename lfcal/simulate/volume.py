"""Simulate light fields of extended objects (points, a vesicle, a plume) with the same H as for a point."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from lfcal.base import Clock, InputError, Work, array_words, centre, check_number, drained, worker_count
from lfcal.camera import ScanPlan
from lfcal.psf import PSFMatrix
from lfcal.simulate._scatter import Row, scatter
from lfcal.simulate.engines import Sampling
from lfcal.simulate.plane_task import EffectsLike, budgeted
from lfcal.simulate.response import PlaneResponse

__all__ = ["iter_light_field", "light_field", "plume", "points", "vesicle"]


class ResponseSource(Protocol):
    """Protocol for a source of responses, read a few positions at a time."""

    @property
    def shape(self) -> tuple[int, int, int, int, int]:
        """Shape ``(nz, ny, nx, nt, ns)``."""
        ...

    def responses_at(self, z: int, y: int, xs: NDArray[np.intp]) -> NDArray[np.float32]:
        """Return the responses ``(len(xs), nt, ns)`` of the positions (z, y, x) for x in ``xs``."""
        ...


class _Stored:
    """Responses of an existing H."""

    def __init__(self, matrix: PSFMatrix) -> None:
        self.matrix = matrix
        self.shape = matrix.shape

    shape: tuple[int, int, int, int, int]

    def responses_at(self, z: int, y: int, xs: NDArray[np.intp]) -> NDArray[np.float32]:
        return np.ascontiguousarray(self.matrix.plane(z)[y, xs], np.float32)


class _Simulated:
    """Responses computed when needed; the tables of one plane are kept."""

    def __init__(
        self, plan: ScanPlan, effects: EffectsLike, level: str, tolerance: float | None, sampling: Sampling | None
    ):
        self.plan = plan
        self.budget = budgeted(effects, plan, tolerance)
        self.options: dict[str, Any] = {"level": level, "sampling": sampling}
        self.shape = plan.shape
        self._cached: tuple[int, PlaneResponse] | None = None

    def responses_at(self, z: int, y: int, xs: NDArray[np.intp]) -> NDArray[np.float32]:
        if self._cached is None or self._cached[0] != z:
            effects, share = self.budget.at(self.plan.depths_um[z])
            self._cached = (z, PlaneResponse(self.plan, z, effects, tolerance=share, **self.options))
        row: NDArray[np.float32] = self._cached[1].rows([y], xs)[0]
        return row


def iter_light_field(
    volume: NDArray[np.float32],
    through: PSFMatrix | ScanPlan,
    *,
    effects: EffectsLike = "auto",
    level: str = "auto",
    tolerance: float | None = None,
    sampling: Sampling | None = None,
    workers: int | None = None,
) -> Work[NDArray[np.float32]]:
    """Simulate and return the light-field image of a luminous volume, ``f[p] = sum_v g[v] H[v mod n][p - v + c]``.

    Parameters
    ----------
    volume
        Luminous volume g, shape ``(nz, rows, columns)``: one plane for each depth, and one voxel for each sensor pixel.
        Voxel (0, 0) of a plane is at source position (0, 0). In the formula, v is a voxel, p a pixel of the image, n
        the period of H, and c the middle pixel of its cutout. Voxels outside the volume are dark.
    through
        A PSF matrix H, or a scan plan whose camera is simulated; in the latter case, only the responses of luminous
        voxels are computed.
    effects, level, tolerance, sampling, workers
        As in `simulate_psf`; all but ``workers`` are used only with a scan plan.

    Returns
    -------
    ndarray
        Image f, shape ``(rows, columns)``, float32, in the unit of ``volume`` times H, before effects of the sensor;
        `lfcal.simulate.expose` converts photoelectrons to a frame.

    Yields
    ------
    Progress
        Counted in source rows of the period.

    Raises
    ------
    InputError
        If the volume does not have one plane of finite values for each depth.

    Examples
    --------
    >>> import numpy as np
    >>> from lfcal.psf import open_psf
    >>> from lfcal.simulate import iter_light_field
    >>> volume = np.zeros((2, 80, 80), np.float32)
    >>> volume[1, 40, 40] = 2.0
    >>> with open_psf("H.h5") as H:
    ...     steps = [step.count for step in iter_light_field(volume, H)]
    ...     print(steps[0], steps[-1], sep=" … ")  # of 2 planes of 19 rows
    1 of 38 … 38 of 38
    """
    source: ResponseSource = (
        _Stored(through) if isinstance(through, PSFMatrix) else _Simulated(through, effects, level, tolerance, sampling)
    )
    nz, ny, nx, nt, ns = source.shape
    if volume.ndim != 3 or volume.shape[0] != nz or not np.isfinite(volume).all():
        raise InputError.expected(
            "volume", f"finite values of shape ({nz}, rows, columns)", array_words(volume), "give one image per plane"
        )
    rows, columns = volume.shape[1:]
    half_t, half_s = centre(nt), centre(ns)
    image = np.zeros((rows + nt - 1, columns + ns - 1))
    clock = Clock("project the volume", nz * ny)
    for z in range(nz):
        for y in range(min(ny, rows)):
            lit = volume[z, y::ny]
            xs = np.unique(np.flatnonzero(lit.any(axis=0)) % nx)
            if xs.size:
                responses = source.responses_at(z, y, xs)
                slot = np.full(nx, -1, np.intp)
                slot[xs] = np.arange(xs.size)
                scatter(image, lit, Row(responses, slot, y, ny), worker_count(workers))
            yield clock.at(z * ny + y + 1)
    return image[half_t : half_t + rows, half_s : half_s + columns].astype(np.float32)


light_field = drained(
    iter_light_field,
    """
    Examples
    --------
    >>> import numpy as np
    >>> from lfcal.psf import open_psf
    >>> from lfcal.simulate import light_field
    >>> volume = np.zeros((2, 80, 80), np.float32)
    >>> volume[1, 40, 40] = 2.0
    >>> with open_psf("H.h5") as H:
    ...     image = light_field(volume, H)
    ...     print(image.shape, round(float(image.sum() / H.plane(1)[40 % 19, 40 % 33].sum()), 3))  # twice the response
    (80, 80) 2.0
    """,
)


# -- objects ---------------------------------------------------------------------------------------------


def points(shape: tuple[int, int, int], count: int, rng: np.random.Generator, margin: int = 0) -> NDArray[np.float32]:
    """Return a float32 volume of ``shape`` ``(nz, rows, columns)``: 1 at ``count`` random voxels, and 0 elsewhere.

    The border of each plane, ``margin`` voxels wide, remains 0.

    Examples
    --------
    >>> import numpy as np
    >>> from lfcal.simulate import points
    >>> beads = points((3, 64, 64), count=20, rng=np.random.default_rng(1), margin=8)
    >>> int(beads.sum()), int(beads[:, 8:-8, 8:-8].sum())  # none in the border
    (20, 20)
    """
    nz, rows, columns = _checked_shape(shape)
    check_number("margin (voxels)", margin, at_least=0, below=min(rows, columns) / 2, integer=True)
    inner = (nz, rows - 2 * margin, columns - 2 * margin)
    check_number("points", count, at_least=1, at_most=int(np.prod(inner)), integer=True)
    volume = np.zeros(shape, np.float32)
    z, y, x = np.unravel_index(rng.choice(int(np.prod(inner)), count, replace=False), inner)
    volume[z, y + margin, x + margin] = 1.0
    return volume


def vesicle(
    shape: tuple[int, int, int], radius: float, wall: float = 1.5, plane_step: float | None = None
) -> NDArray[np.float32]:
    """Return a float32 volume with a hollow sphere in its middle; the profile of the wall is a Gaussian with peak 1.

    Parameters
    ----------
    shape
        Shape ``(nz, rows, columns)`` of the returned volume.
    radius, wall
        Radius of the sphere, and rms width of its wall, in units of the lateral voxel pitch.
    plane_step
        Distance between adjacent planes, in units of the lateral voxel pitch. None: chosen so that the sphere with its
        wall just fits between the first and the last plane.

    Examples
    --------
    >>> from lfcal.simulate import vesicle
    >>> shell = vesicle((1, 41, 41), radius=12.0)
    >>> [round(float(shell[0, 20, 20 + r]), 2) for r in (0, 9, 12, 15)]  # hollow, and bright at 12 voxels
    [0.0, 0.14, 1.0, 0.14]
    """
    nz, rows, columns = _checked_shape(shape)
    check_number("radius (voxels)", radius, above=0)
    check_number("wall (voxels)", wall, above=0)
    step = 2.0 * (radius + wall) / max(1, nz - 1) if plane_step is None else plane_step
    z, y, x = _from_middle((nz, rows, columns))
    distance = np.sqrt((z * step) ** 2 + y**2 + x**2)
    return np.exp(-0.5 * ((distance - radius) / wall) ** 2).astype(np.float32)


def plume(
    shape: tuple[int, int, int], rng: np.random.Generator, width: float = 0.08, spread: float = 0.25
) -> NDArray[np.float32]:
    """Return a float32 volume with a plasma-like plume that rises from the bottom edge; values are from 0 to 1.

    Parameters
    ----------
    shape
        Shape ``(nz, rows, columns)`` of the returned volume.
    rng
        Random number generator, which determines the filaments.
    width, spread
        Rms width of the plume at the bottom, as a fraction of the number of rows. Increase of this width per row of
        height (voxels per voxel).

    Examples
    --------
    >>> import numpy as np
    >>> from lfcal.simulate import plume
    >>> smoke = plume((3, 60, 40), np.random.default_rng(0))
    >>> [round(float(smoke[:, rows].max()), 1) for rows in (slice(50, 60), slice(0, 10))]  # at its foot, at the top
    [1.0, 0.1]
    """
    from scipy.ndimage import gaussian_filter

    nz, rows, columns = _checked_shape(shape)
    check_number("width of the plume", width, above=0)
    check_number("spread of the plume", spread, at_least=0)
    z, y, x = _from_middle((nz, rows, columns))
    height = (rows - 1) / 2 - y  # above the bottom edge
    rms = width * rows + spread * height
    across = x**2 + (z * rows / max(1, nz)) ** 2
    smooth = np.exp(-0.5 * across / rms**2) * (width * rows / rms) ** 2
    grain = gaussian_filter(rng.standard_normal((nz, rows, columns)), (0.7, rows / 24, rows / 48), mode="wrap")
    volume = smooth * np.exp(0.6 * grain / max(float(grain.std()), 1e-12))
    result: NDArray[np.float32] = (volume / volume.max()).astype(np.float32)
    return result


def _from_middle(shape: Sequence[int]) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    z, y, x = (np.arange(n, dtype=np.float64) - (n - 1) / 2 for n in shape)
    return z[:, None, None], y[None, :, None], x[None, None, :]


def _checked_shape(shape: tuple[int, int, int]) -> tuple[int, int, int]:
    if len(shape) != 3:
        raise InputError.expected("shape of a volume", "(planes, rows, columns)", shape, "give three numbers")
    for n in shape:
        check_number("size of the volume (voxels)", n, at_least=1, integer=True)
    return shape
