"""Compare two H by plane and lens type: unchanged, at the best scale, and at the best shift."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfcal.base import Clock, Work, drained, for_each_chunk, worker_count
from lfcal.judge._shifting import best_shift, shifted
from lfcal.judge.pairing import Pair, pair
from lfcal.psf import PSFMatrix

__all__ = ["Comparison", "Figures", "PlaneFigures", "compare", "iter_compare"]

F8 = NDArray[np.float64]

STARTED = 48
"""Number of positions of a plane from which its shift is first estimated."""

ALIKE = 12
"""Number of positions at which every plane is compared with every other."""

MOST_PLANES = 40
"""Number of planes up to which each is compared with every other."""

LIKER = 1.5
"""Factor by which another plane must match better than the plane of the same depth to be reported."""

FLOOR = 0.05
"""Fraction of a pattern's peak that is subtracted before its centroid is computed, to exclude distant noise."""

A, B = 0, 1
MODEL = slice(2, 5)
"""Columns of the sums: a, b, and the shifted b with its derivatives with respect to row and column."""


@dataclass(frozen=True, slots=True)
class Figures:
    """Differences between patterns ``a`` of one H and patterns ``b`` of the other; NaN if nothing could be compared.

    ``|x|`` is the L2 norm of all values.

    Attributes
    ----------
    nrmse
        ``|a - b| / |b|``, without scaling.
    scale
        Number g that minimises ``|a - g b|``.
    scaled
        ``|a - g b| / |a|`` at this scale: 0 if both are proportional, 1 if they have nothing in common.
    shift_px
        Best-fit shift (row, column) of ``a`` relative to ``b``, with sub-pixel precision (pixels).
    left
        ``|a - g b| / |a|``, with ``b`` shifted by ``shift_px`` and the best-fit scale g.
    correlation
        ``sum(a b) / sqrt(sum(a²) sum(b²))``.
    """

    nrmse: float
    scale: float
    scaled: float
    shift_px: tuple[float, float]
    left: float
    correlation: float


@dataclass(frozen=True, slots=True)
class PlaneFigures:
    """Differences in one plane.

    Attributes
    ----------
    planes, depths_um
        Index and depth of the plane in each H.
    positions
        Number of compared positions.
    all
        Differences over all pixels.
    types
        Differences over the pixels behind the lenslets of each type; empty without a camera to identify the types.
    like
        Index of another plane of the second H that matches this plane of the first better. None: the same plane matches
        best.
    """

    planes: tuple[int, int]
    depths_um: tuple[float, float]
    positions: int
    all: Figures
    types: tuple[Figures, ...]
    like: int | None


@dataclass(frozen=True, eq=False)
class Comparison:
    """Differences between two H, such as a recorded and a simulated one, or two recordings with the same camera.

    Positions that are missing, dark or NaN in either H are left out. In formulas, a and b are patterns of the first and
    the second H.

    Attributes
    ----------
    pair
        The compared parts of both H, and notes on what was left out.
    all, types
        Differences over all planes: over all pixels, and over the pixels behind the lenslets of each type. The shift is
        the mean over the planes; in ``left``, each plane has its own shift.
    planes
        Differences in each compared plane.
    error
        ``|a / s - b| / |b|`` of each pattern, ``(planes, ny, nx)``, where s makes the sums of both patterns equal; NaN
        where nothing was compared.
    shift_px
        Centroid (row, column) of each pattern of the first H minus that of the second (px), ``(planes, ny, nx, 2)``.

    Examples
    --------
    >>> import numpy as np
    >>> from lfcal.judge import Comparison, compare
    >>> reference = np.zeros((1, 2, 2, 7, 7))
    >>> reference[..., 3, 3] = 1
    >>> found: Comparison = compare(np.roll(reference, (1, 2), axis=(3, 4)), reference)
    >>> print(found.compared, "positions, moved by", round(found.rms_shift_px, 3), "px")  # the root of 1² + 2²
    4 positions, moved by 2.236 px
    """

    pair: Pair
    all: Figures
    types: tuple[Figures, ...]
    planes: tuple[PlaneFigures, ...]
    error: NDArray[np.float32]
    shift_px: NDArray[np.float32]

    @property
    def compared(self) -> int:
        """Number of compared positions over all planes."""
        return int(np.isfinite(self.error).sum())

    @property
    def max_shift_px(self) -> float:
        """Largest length of a centroid shift (px); NaN if nothing was compared."""
        shifts = self._shifts()
        return float(shifts.max()) if shifts.size else math.nan

    @property
    def rms_shift_px(self) -> float:
        """Root mean square of the lengths of the centroid shifts (px); NaN if nothing was compared."""
        shifts = self._shifts()
        return float(np.sqrt(np.mean(shifts**2))) if shifts.size else math.nan

    @property
    def rms_error(self) -> float:
        """Root mean square of ``error``; NaN if nothing was compared."""
        known = self.error[np.isfinite(self.error)].astype(np.float64)
        return float(np.sqrt(np.mean(known**2))) if known.size else math.nan

    def _shifts(self) -> NDArray[np.float64]:
        size = np.hypot(self.shift_px[..., 0], self.shift_px[..., 1]).astype(np.float64)
        return size[np.isfinite(size)]

    @property
    def correlation(self) -> float:
        """Correlation ``sum(a b) / sqrt(sum(a²) sum(b²))`` over all compared values; 1 if both H are proportional."""
        return self.all.correlation

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes on what was left out, and on differences between the two H."""
        swapped = [
            f"plane {one.planes[0]} of the first H matches plane {one.like} of the second better: check "
            "whether depths are swapped"
            for one in self.planes
            if one.like is not None
        ]
        empty = [f"{one.planes[0]}" for one in self.planes if not one.positions]
        if empty and len(empty) < len(self.planes):
            planes = f"plane{'s' * (len(empty) > 1)} {', '.join(empty)} of the first H"
            swapped.append(f"{planes}: not compared, because no position has light in both")
        return (*self.pair.notes, *swapped)

    def worst(self, count: int = 6) -> list[tuple[int, int, int]]:
        """Return up to ``count`` positions (k, y, x) with the largest ``error``, worst first.

        k is the index of the compared plane.
        """
        known = np.where(np.isfinite(self.error), self.error, -np.inf)
        order = np.argsort(known, axis=None, kind="stable")[::-1][:count]
        found = [tuple(int(v) for v in np.unravel_index(at, known.shape)) for at in order]
        return [(k, y, x) for k, y, x in found if known[k, y, x] > -np.inf]

    def to_dict(self) -> dict[str, object]:
        """Return everything except the maps ``error`` and ``shift_px`` as a dictionary.

        Differences are `Figures` and `PlaneFigures`; all other values are plain JSON types.
        """
        return {
            "format": "lfcal-comparison",
            "version": 1,
            "shapes": [list(self.pair.a.shape), list(self.pair.b.shape)],
            "compared": list(self.pair.shape),
            "positions": self.compared,
            "correlation": self.correlation,
            "rms_error": self.rms_error,
            "rms_shift_px": self.rms_shift_px,
            "max_shift_px": self.max_shift_px,
            "notes": list(self.notes),
            "all": self.all,
            "types": list(self.types),
            "planes": list(self.planes),
            "worst": [
                {"planes": list(self.pair.planes[k]), "position": [y, x], "error": float(self.error[k, y, x])}
                for k, y, x in self.worst()
            ],
        }


def iter_compare(
    a: PSFMatrix | ArrayLike,
    b: PSFMatrix | ArrayLike,
    *,
    by_number: bool = False,
    by_index: bool = False,
    workers: int | None = None,
) -> Work[Comparison]:
    """Compare two H, with only a few rows of positions in memory at a time, and return the `Comparison`.

    The shift of a plane is estimated from the cross-spectrum of some of its patterns, and refined with all of them. For
    the refinement, ``b`` is shifted with its Fourier series. Then ``a`` is fitted by least squares with the shifted
    ``b`` and its derivatives with respect to row and column.

    Parameters
    ----------
    a, b, by_number, by_index
        As in `pair`, which selects the parts to compare.
    workers
        Number of threads. None: all processors.

    Raises
    ------
    InputError
        As in `pair`.

    Examples
    --------
    >>> import numpy as np
    >>> from lfcal.judge import iter_compare
    >>> H = np.ones((2, 2, 1, 5, 5))
    >>> [step.count for step in iter_compare(H, H, workers=1)]
    ['0 of 4', '1 of 4', '2 of 4', '3 of 4', '4 of 4']
    """
    both = pair(a, b, by_number=by_number, by_index=by_index)
    n, ny, nx = both.shape[:3]
    threads = worker_count(workers)
    clock = Clock("comparing two H", n * ny)
    yield clock.at(0)
    types = _sensor_types(both)
    kinds = 0 if types is None else int(types.max()) + 1
    sums = np.zeros((n, 1 + kinds, 5, 5))
    starts = np.zeros((n, 2))
    counts = np.zeros(n, np.intp)
    error = np.full((n, ny, nx), np.nan, np.float32)
    shift = np.full((n, ny, nx, 2), np.nan, np.float32)
    for k in range(n):
        there = both.there(k)
        starts[k] = _start(both, k, there)
        for first in range(0, ny, threads):
            rows = range(first, min(ny, first + threads))
            given = [both.row(k, y) for y in rows]

            def one(start: int, stop: int) -> list[F8]:
                return [
                    _row_sums(*given[i], there[rows[i]], starts[k], types, rows[i], error=error[k], shift=shift[k])  # noqa: B023
                    for i in range(start, stop)
                ]

            for part in for_each_chunk(one, len(given), threads):
                for found in part:
                    sums[k] += found
            yield clock.at(k * ny + rows[-1] + 1)
        counts[k] = np.isfinite(error[k]).sum()
    like = _more_like(both)
    planes = tuple(
        PlaneFigures(
            both.planes[k],
            (float(both.a.known_depths[both.planes[k][0]]), float(both.b.known_depths[both.planes[k][1]])),
            int(counts[k]),
            _figures(sums[k, 0], starts[k]),
            tuple(_figures(one, starts[k]) for one in sums[k, 1:]),
            like[k],
        )
        for k in range(n)
    )
    together = [_together(sums[:, t], [p.all if t == 0 else p.types[t - 1] for p in planes]) for t in range(1 + kinds)]
    return Comparison(both, together[0], tuple(together[1:]), planes, error, shift)


compare = drained(
    iter_compare,
    """
    Examples
    --------
    >>> import numpy as np
    >>> from lfcal.judge import compare
    >>> reference = np.zeros((1, 1, 1, 7, 7))
    >>> reference[..., 3, 2:5] = 1  # three pixels in a row
    >>> found = compare(2 * np.roll(reference, 1, axis=-1), reference)
    >>> print(f"{found.max_shift_px:.2f} px off, correlation {found.correlation:.3f}")
    1.00 px off, correlation 0.667
    """,
)


def _sensor_types(both: Pair) -> NDArray[np.intp] | None:
    """Return the lens type of sensor pixels ``(ny + nt - 1, nx + ns - 1)``, from the corner of the first cutout."""
    matrix = both.a if both.a.camera is not None else both.b
    camera = matrix.camera
    if camera is None or matrix.pixel_scale != (1.0, 1.0) or len(camera.lattice.types) < 2:
        return None
    _, ny, nx, nt, ns = both.shape
    # a has the numbers of positions; without a camera they are equal to those of b
    rows = round(matrix.anchor[0]) - (nt - 1) // 2 + np.arange(ny + nt - 1)
    columns = round(matrix.anchor[1]) - (ns - 1) // 2 + np.arange(nx + ns - 1)
    return camera.lattice.type_at(camera.sensor_um(np.stack(np.meshgrid(rows, columns, indexing="ij"), axis=-1)))


def _some(there: NDArray[np.bool_], count: int) -> NDArray[np.intp]:
    """Return about ``count`` of the existing positions (y, x), spread evenly in storage order."""
    places = np.argwhere(there)
    chosen = np.unique(np.linspace(0, len(places) - 1, min(count, len(places))).round().astype(int))
    return places[chosen] if len(places) else places


def _start(both: Pair, k: int, there: NDArray[np.bool_]) -> F8:
    """Return the shift (row, column) of a plane, estimated from some of its patterns."""
    given = [both.patterns(k, y, x) for y, x in _some(there, STARTED).tolist()]
    good = [(p, q) for p, q in given if np.isfinite(p).all() and np.isfinite(q).all()]
    if not good:
        return np.zeros(2)
    return best_shift(np.stack([p for p, _ in good]), np.stack([q for _, q in good]))


def _row_sums(
    p: F8,
    q: F8,
    there: NDArray[np.bool_],
    start: F8,
    types: NDArray[np.intp] | None,
    y: int,
    *,
    error: NDArray[np.float32],
    shift: NDArray[np.float32],
) -> F8:
    """Return the sums ``(1 + types, 5, 5)`` of a row of positions, and fill in its errors and centroid shifts."""
    nt, ns = p.shape[1:]
    kinds = 0 if types is None else int(types.max()) + 1
    sums = np.zeros((1 + kinds, 5, 5))
    ours, theirs = p.sum((1, 2)), q.sum((1, 2))
    used = np.flatnonzero(there & np.isfinite(ours + theirs) & (ours > 0) & (theirs > 0))
    if not len(used):
        return sums
    p, q = p[used], q[used]
    flat, other = p.reshape(len(used), -1), q.reshape(len(used), -1)
    at_equal = flat * (theirs[used] / ours[used])[:, None] - other
    error[y, used] = np.linalg.norm(at_equal, axis=1) / np.linalg.norm(other, axis=1)
    shift[y, used] = centroids(flat, (nt, ns)) - centroids(other, (nt, ns))
    there_px = np.stack([p, q, *shifted(q, start)], 1).reshape(len(used), 5, -1)
    for x, columns in zip(used.tolist(), there_px, strict=True):
        if types is None:
            sums[0] += columns @ columns.T
            continue
        own = types[y : y + nt, x : x + ns].ravel()
        for t in range(kinds):
            part = columns[:, own == t]
            sums[1 + t] += part @ part.T
    if types is not None:
        sums[0] = sums[1:].sum(0)
    return sums


def _figures(sums: F8, start: F8) -> Figures:
    """Return the differences that follow from sums of products ``(5, 5)``, computed at the shift ``start``."""
    aa, ab, bb = float(sums[A, A]), float(sums[A, B]), float(sums[B, B])
    if not (aa > 0 and bb > 0):
        return Figures(*(math.nan,) * 3, (math.nan, math.nan), math.nan, math.nan)
    nrmse = math.sqrt(max(0.0, aa - 2 * ab + bb) / bb)
    scale, correlation = ab / bb, ab / math.sqrt(aa * bb)
    scaled = math.sqrt(max(0.0, 1.0 - correlation * correlation))
    found = np.linalg.lstsq(sums[MODEL, MODEL], sums[MODEL, A], rcond=1e-12)[0]
    gain = float(found[0])
    shift = (math.nan, math.nan)
    if gain:
        shift = (float(start[0] - found[1] / gain), float(start[1] - found[2] / gain))
    left = math.sqrt(max(0.0, 1.0 - float(found @ sums[MODEL, A]) / aa))
    return Figures(nrmse, scale, scaled, shift, min(left, scaled), correlation)


def _together(sums: F8, planes: list[Figures]) -> Figures:
    """Return the differences over all planes, each with a separate scale and shift in the residual."""
    whole = _figures(sums.sum(0), np.zeros(2))
    known = [k for k, one in enumerate(planes) if math.isfinite(one.left)]
    if not known:
        return whole
    weights = np.array([sums[k, A, A] for k in known])
    shift = np.average([planes[k].shift_px for k in known], axis=0, weights=weights)
    left = math.sqrt(float(np.average([planes[k].left ** 2 for k in known], weights=weights)))
    place = (float(shift[0]), float(shift[1]))
    return Figures(whole.nrmse, whole.scale, whole.scaled, place, left, whole.correlation)


def _more_like(both: Pair) -> list[int | None]:
    """Return, for each pair of planes, another plane of ``b`` that matches the plane of ``a`` better, or None."""
    n, planes = len(both.planes), len(both.b)
    if planes < 2 or planes > MOST_PLANES:
        return [None] * n
    common = np.all([both.there(k) for k in range(n)], axis=0) & np.all(
        [np.roll(np.asarray(both.b.recorded[z]) > 0, tuple(-v for v in both.moved), (0, 1)) for z in range(planes)],
        axis=0,
    )
    places = _some(common, ALIKE).tolist()
    if not places:
        return [None] * n

    def reported(patterns: list[F8]) -> F8:
        flat = np.nan_to_num(np.stack(patterns)).ravel()
        size = float(np.linalg.norm(flat))
        return flat / size if size > 0 else flat

    theirs = np.stack(
        [reported([both.crop(both.b[(z, *both.place_in_b(y, x))]) for y, x in places]) for z in range(planes)]
    )
    found: list[int | None] = []
    for k in range(n):
        ours = reported([both.patterns(k, y, x)[0] for y, x in places])
        unlike = 1.0 - theirs @ ours
        own, best = both.planes[k][1], int(unlike.argmin())
        if not theirs[own].any():  # a plane without light matches none
            found.append(None)
            continue
        found.append(best if best != own and unlike[own] > LIKER * unlike[best] + 1e-3 else None)
    return found


def centroids(patterns: NDArray[np.float64], shape: tuple[int, ...]) -> NDArray[np.float64]:
    """Return the centroids ``(n, 2)`` (row, column; px) of patterns ``(n, nt ns)`` of ``shape`` ``(nt, ns)``.

    First, the fraction `FLOOR` of its peak is subtracted from each pattern, and negative values are set to 0.
    """
    above = np.maximum(patterns - FLOOR * patterns.max(1, keepdims=True), 0).reshape(-1, *shape)
    total = above.sum((1, 2))
    rows = above.sum(2) @ np.arange(shape[0])
    columns = above.sum(1) @ np.arange(shape[1])
    places: NDArray[np.float64] = np.stack([rows / total, columns / total], -1)
    return places
