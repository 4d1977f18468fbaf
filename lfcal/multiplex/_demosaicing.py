"""Demosaic any colour filter array: linear estimates with a prior for images, optionally blended by direction.

Neighbouring pixels receive almost the same light, and colours differ from each other much less than they vary together.
If these two facts are expressed as a prior covariance, the best linear estimate can be computed for any filter array
(Trussell and Hartwell 2002, "Mathematics for demosaicking", IEEE Trans. Image Processing 11:485). The two greens of a
Bayer pattern are one colour, and a pixel behind any filter contains information about all samples.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.base import InputError, for_each_chunk
from lfcal.multiplex._demosaic_kernels import Mosaic, blend_rows, estimate_rows
from lfcal.multiplex.filters import COLOUR_FILTERS
from lfcal.multiplex.modulator import Modulator

__all__ = [
    "ALONG_COLUMNS",
    "ALONG_ROWS",
    "EVEN",
    "Prior",
    "can_estimate",
    "estimation_weights",
    "reach_of",
    "reconstruct_by_estimation",
    "thinned",
]

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Prior:
    """Covariance exp(-d/length) of the light at two positions with the elliptical distance d.

    Attributes
    ----------
    length_px
        Correlation length of the light (pixels).
    elongation
        Factor by which this length is longer along the rows and shorter along the columns, for edges along the rows.
    chroma
        Ratio of the variance of differences between samples to that of their mean.
    noise
        Ratio of the variance of a pixel's noise to that of the mean of its samples.
    """

    length_px: float = 20.0
    elongation: float = 1.0
    chroma: float = 0.07
    noise: float = 1e-9

    def alike(self, dy: NDArray[Any], dx: NDArray[Any]) -> Array:
        """Return the correlation of the light at two positions that are ``(dy, dx)`` apart (pixels)."""
        correlation: Array = np.exp(-np.hypot(dy * self.elongation, dx / self.elongation) / self.length_px)
        return correlation


EVEN = Prior()
ALONG_ROWS = Prior(elongation=1.8)
ALONG_COLUMNS = Prior(elongation=1 / 1.8)

MOST_PIXELS = 1_000_000

LEAST_LEVEL = 0.05
"""Smallest assumed variation of a colour, relative to that of the strongest."""

LEAST_WEIGHT = 0.004
"""Smaller weights (in magnitude) are omitted: for a Bayer pattern two fifths, with a loss below 0.01 dB."""

LEAST_REACH = (3, 4)
"""Smallest reach (pixels) of one estimate, and of two that are compared; wider windows gain nothing."""


def reach_of(modulator: Modulator, estimates: int) -> int:
    """Return the reach of an estimate's window on each side (pixels); the window contains a whole super-pixel."""
    return max(LEAST_REACH[estimates - 1], -(-max(modulator.side) // 2))


def sample_levels(frame: NDArray[Any], modulator: Modulator) -> Array:
    """Return the variation of each sample in a frame, ``(N,)``, relative to the mean of all samples.

    The variation is the rms of differences between neighbouring super-pixels. At edges, all colours are assumed to
    change equally, independent of the colour of the light (grey-edge assumption: van de Weijer, Gevers and Gijsenij
    2007, IEEE Trans. Image Processing 16:2207). Without this scale, a sensor twice as sensitive to green as to red
    would look like a green scene.

    Parameters
    ----------
    frame
        Frame ``(rows, columns)``, a whole number of super-pixels.
    modulator
        Filter array.
    """
    py, px = modulator.side
    # a million pixels are enough for the levels of a frame of any size
    step = py * max(1, frame.size // MOST_PIXELS)
    rms = np.zeros(py * px)
    for k in range(py * px):
        a, b = divmod(k, px)
        here, below = frame[a::step, b::px].astype(float), frame[a + py :: step, b::px].astype(float)
        changes = np.concatenate([(below - here[: len(below)]).ravel(), np.diff(here, axis=1).ravel()])
        rms[k] = math.sqrt(float(np.mean(changes**2))) if changes.size else 0.0
    levels = modulator.inverse() @ rms
    if not levels.max() > 0:
        return np.ones(modulator.count)
    levels = np.maximum(levels, LEAST_LEVEL * levels.max())
    balanced: Array = levels / levels.mean()
    return balanced


def estimation_weights(modulator: Modulator, prior: Prior, reach: int, levels: NDArray[Any] | None = None) -> Array:
    """Return the weights ``(K, N, 2 reach + 1, 2 reach + 1)`` of the pixels around each pixel of a super-pixel.

    The weights reproduce uniform light exactly (if the window measures it). Among all such weights, they have the
    smallest mean squared error under ``prior``. If samples cannot be separated, the result for uniform light is the
    least-norm solution.

    Parameters
    ----------
    modulator
        Colour filter array, in which every pixel samples the light at its own position.
    prior
        Prior covariance of the light.
    reach
        Distance from the middle of the window to its edge (pixels).
    levels
        Scale of each sample ``(N,)``; ``prior`` describes the samples after division by these scales.
    """
    scale = np.ones(modulator.count) if levels is None else np.asarray(levels, float)
    n, (dy, dx), windows = modulator.count, _offsets(reach), _windows(modulator, reach)
    shared = np.full((n, n), 1 / n)
    differing = prior.chroma * (np.eye(n) - shared)
    within = prior.alike(np.subtract.outer(dy, dy), np.subtract.outer(dx, dx))
    here = prior.alike(dy, dx)
    weights = np.empty((len(windows), n, len(dy)))
    for k, filters in enumerate(windows):
        seen = filters * scale
        joint = shared + differing
        covariance = seen @ joint @ seen.T * within
        # noise is relative to the light of a pixel: behind a dark filter it is not larger than behind a clear one
        covariance[np.diag_indices_from(covariance)] += prior.noise
        weights[k] = scale[:, None] * _unbiased(covariance, joint @ seen.T * here, seen)
    return weights.reshape(len(windows), n, 2 * reach + 1, 2 * reach + 1)


def thinned(weights: Array, modulator: Modulator) -> Array:
    """Return `estimation_weights` without the smallest ones, for speed; the result for uniform light does not change.

    The other weights are changed as little as possible.
    """
    flat = weights.reshape(*weights.shape[:2], -1).copy()
    for rows, seen in zip(flat, _windows(modulator, weights.shape[2] // 2), strict=True):
        for row in rows:
            wanted, kept = row @ seen, np.abs(row) >= LEAST_WEIGHT
            row[~kept] = 0.0
            row[kept] += (wanted - row @ seen) @ np.linalg.pinv(seen[kept])
    return flat.reshape(weights.shape)


def _offsets(reach: int) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return rows and columns of a window's pixels relative to its middle."""
    along = np.arange(-reach, reach + 1)
    dy, dx = np.meshgrid(along, along, indexing="ij")
    return dy.ravel(), dx.ravel()


def _windows(modulator: Modulator, reach: int) -> Array:
    """Return the response of the pixels in the window about each pixel, ``(K, pixels of the window, N)``."""
    (py, px), (dy, dx) = modulator.side, _offsets(reach)
    a, b = np.divmod(np.arange(py * px), px)
    places = (a[:, None] + dy) % py * px + (b[:, None] + dx) % px
    windows: Array = modulator.matrix[places]
    return windows


def _unbiased(covariance: Array, cross: Array, seen: Array) -> Array:
    """Return the matrix W of least error with W seen = identity, as far as the rank of ``seen`` allows."""
    n = seen.shape[1]
    solved = np.linalg.solve(covariance, np.hstack([cross.T, seen]))
    free, by_seen = solved[:, :n].T, solved[:, n:]
    information = np.linalg.pinv(seen.T @ by_seen, rcond=1e-10)
    # samples that the window cannot separate have no estimate: project onto the measured part
    measured = information @ (seen.T @ by_seen)
    weights: Array = measured @ free + (measured - measured @ free @ seen) @ information @ by_seen.T
    return weights


Image = NDArray[Any]

ROWS_AT_ONCE = 64
"""Number of rows of two estimates that are stored until they are blended."""

HALF_WINDOW = 3
"""Half width of the 7 x 7 pixels over which changes of colour are compared."""


def can_estimate(modulator: Modulator, samples: tuple[int, int]) -> bool:
    """Return whether the modulator is a colour filter array and its colours are requested at every pixel."""
    return bool(modulator.colours) and modulator.views == (1, 1) and samples == modulator.side


def reconstruct_by_estimation(
    frame: Image, modulator: Modulator, filter: str, out: Image, *, workers: int | None = None
) -> Image:
    """Write the colours of a frame to ``out`` ``(N, rows, columns)`` and return it.

    Parameters
    ----------
    frame
        Frame ``(rows, columns)``, a whole number of super-pixels.
    modulator
        Colour filter array.
    filter
        ``"lmmse"``: the linear estimate for isotropic surroundings. ``"directional"``: two estimates, for edges along
        the rows and along the columns, blended according to how little colours change in these directions. As in Menon,
        Andriani and Calvagno 2007 ("Demosaicing with directional filtering and a posteriori decision", IEEE Trans.
        Image Processing 16:132), the change is measured on the estimates themselves.
    out
        Output array; its float type is also used for the calculation.
    workers
        Number of threads. None: one for each available CPU core.

    Raises
    ------
    InputError
        If the modulator is not a colour filter array, or the output does not have one sample per pixel.
    """
    if not can_estimate(modulator, modulator.side) or out.shape[1:] != frame.shape:
        raise InputError.expected(
            f"filter for {modulator.name}",
            f"a filter that needs no colour filter array, not {' or '.join(COLOUR_FILTERS)}",
            repr(filter),
            "choose another filter: these need a colour filter array and one sample per pixel",
        )
    priors = (EVEN,) if filter == "lmmse" else (ALONG_ROWS, ALONG_COLUMNS)
    reach = reach_of(modulator, len(priors))
    levels = sample_levels(frame, modulator)
    full = (estimation_weights(modulator, prior, reach, levels) for prior in priors)
    tables = [np.ascontiguousarray(thinned(weights, modulator), out.dtype) for weights in full]
    mosaic = _mosaic(frame, modulator.side, reach)

    def linear(start: int, stop: int) -> None:
        estimate_rows(mosaic, tables[0], out[:, start:stop], start)

    def blended(start: int, stop: int) -> None:
        for top in range(start, stop, ROWS_AT_ONCE):
            _blend(mosaic, tables, out, top, min(top + ROWS_AT_ONCE, stop))

    for_each_chunk(linear if filter == "lmmse" else blended, len(frame), workers)
    return out


def _blend(mosaic: Mosaic, tables: list[Image], out: Image, start: int, stop: int) -> None:
    """Write rows ``start … stop``, computed from the estimates of these and the neighbouring rows."""
    low, high = max(start - HALF_WINDOW - 1, 0), min(stop + HALF_WINDOW + 1, out.shape[1])
    estimates = np.empty((2, len(out), high - low, out.shape[2]), out.dtype)
    for estimate, table in zip(estimates, tables, strict=True):
        estimate_rows(mosaic, table, estimate, low)
    blend_rows(estimates[0], estimates[1], HALF_WINDOW, out[:, start:stop], start - low)


def _mosaic(frame: Image, side: tuple[int, int], reach: int) -> Mosaic:
    cells = -(-reach // side[1])
    columns = _continued(frame.shape[1], cells * side[1], side[1])
    rows = _continued(frame.shape[0], reach, side[0])
    return Mosaic(frame, rows, np.ascontiguousarray(columns.reshape(-1, side[1]).T), side[0], cells)


def _continued(length: int, margin: int, period: int) -> NDArray[np.intp]:
    """Return the pixel indices ``-margin … length + margin``, mirrored at the ends to the same phase of the period."""
    place = np.arange(-margin, length + margin)
    mirrored = np.where(place < 0, -place, np.where(place >= length, 2 * (length - 1) - place, place))
    # the nearest pixel with the same position in its super-pixel
    away = (place - mirrored + period // 2) % period - period // 2
    found = mirrored + away
    # a small frame may be mirrored at both ends
    found = np.where(found < 0, found % period, found)
    last = length - period + (found - length) % period
    return np.asarray(np.where(found >= length, last, found), np.intp)
