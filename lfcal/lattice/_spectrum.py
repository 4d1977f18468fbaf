"""First estimate of the lenslet lattice from the spectrum of a white image."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from lfcal.base import InputError
from lfcal.lattice._lit_part import LitPart, large_lattices, lit_part
from lfcal.lattice._model import MIN_PITCH

__all__ = ["RoughLattice", "guess_lattice", "overlapping"]

Array = NDArray[np.float64]

MIN_LENSLETS = 5
"""Smallest number of lenslets along the shorter side for an analysis of the spectrum."""

FEW_ACROSS = 8
"""Number of lenslets along the shorter side below which lags of the autocorrelation replace the spectrum."""

PEAK_RATIO = 60.0
"""Smallest ratio of a lattice peak's power to the median at its frequency; 1e6 noise samples stay below 20."""

MAX_PEAKS = 30
ANGLE_TOLERANCE = math.radians(4.0)
LENGTH_TOLERANCE = 0.06
"""Largest relative difference of the two pitches of hexagonal and of square cells."""

MAX_RATIO = 2.2
"""Largest ratio of the two pitches of rectangular cells."""

ORDER_TOLERANCE = 0.08
"""Largest deviation of a peak from a whole order of the lattice."""

NOMINAL_TOLERANCE = 0.10
MIN_CONTRAST_SHARE = 0.2
"""Fraction of the typical contrast above which a lenslet counts as brighter or darker than its gaps."""

HEXAGONAL_ORDERS = (((1, 0), (0, 1), (-1, -1)), ((1, -1), (1, 2), (-2, -1)), ((2, 0), (0, 2), (-2, -2)))
SQUARE_ORDERS = (((1, 0), (0, 1)), ((1, 1), (1, -1)), ((2, 0), (0, 2)))
RECTANGLE_ORDERS = (((1, 0),), ((0, 1),), ((1, 1),), ((1, -1),), ((2, 0),), ((0, 2),))
"""Lowest orders of a cell in sets that rotations by 120, 90 or 180 degrees map to each other, without opposite ones."""

RECTANGLE_EXPLAINED = 0.8
"""Smallest fraction of the peaks that rectangular cells must explain (measured: at least 0.98; textures below 0.73)."""

DIAGONAL = np.array([[1.0, -1.0], [1.0, 1.0]]) / 2
FINER = {
    "hexagonal": ((3, np.array([[2.0, -1.0], [1.0, 1.0]]) / 3), (4, np.eye(2) / 2)),
    "square": ((2, DIAGONAL), (2, np.diag([0.5, 1.0])), (2, np.diag([1.0, 0.5])), (4, np.eye(2) / 2)),
}
"""Lattices that contain a lattice: factor in the number of places, and vectors in units of its basis.

An array of unequal lenslets repeats over a coarser lattice. Three types repeat over √3 pitches, a checkered brightness
over √2, alternate rows over 2 along one axis, and one lenslet of four over 2 along both."""

CELL_SIDE = 9
"""Number of samples along each side of a mean cell."""

MIN_CORRELATION = 0.7
"""Smallest correlation between the mean cells about all places of a lattice. Measured: lenslets of brightness 0.3 to 1
at least 0.99; if some places are gaps, below 0.4."""

SYMMETRY_PITCHES = 8.0
"""Largest distance from the middle for the mean cell."""

MAX_UNEVEN = 0.25
"""Largest variance along circles about a micro-image's centre, relative to the variance of the image, if it exceeds the
variance between circles. Measured: rings, discs and polygons 0.07 at most; places where rings touch 0.47 and above."""

CIRCLES, ANGLES, WITHIN = 8, 24, 0.4
"""Number of circles about a centre, and of samples along each; radius of the largest one over the smaller pitch."""

MIN_BRIGHT = 0.75
"""Smallest fraction of lenslets that must be brighter than the gaps around them."""


@dataclass(frozen=True, slots=True)
class RoughLattice:
    """Lattice vectors as rows (x, y), and one centre (x, y), all in pixels.

    Attributes
    ----------
    kind
        ``"square"`` or ``"hexagonal"``.
    basis
        ``(2, 2)``: along a row, and to the next row.
    centre
        Centre of one micro-image.
    contrast
        Mean brightness of the centres minus the mean of the gaps, in standard deviations of the image.
    """

    kind: str
    basis: Array
    centre: Array
    contrast: float


def guess_lattice(image: NDArray[np.float32], kind: str | None, pitch_px: float | None) -> RoughLattice:
    """Return the lattice of the micro-images of a white image, ignoring lens types.

    Pairs of spectral peaks at 60 or 90 degrees propose lattices: hexagonal, square, or with rectangular cells. The
    result is the finest one that explains the peaks, or one that contains it (`FINER`). Lenslets of several types, or
    of unequal brightness, add the peaks of a coarser lattice. The image decides between them: a lattice that is too
    fine has centres in the gaps. A stated pitch decides between lattices of different pitch. For a few large lenslets,
    lags of the autocorrelation propose the lattices. In a partly lit frame, the lit part is analysed.

    Raises
    ------
    InputError
        If the image is blank or shows no lattice, or none near ``pitch_px``.
    """
    lit = lit_part(image)
    part = lit.without_holes()
    flat = part.flattened()
    few = _large(part, kind, pitch_px)
    rough, share = few or _fine(flat, kind, pitch_px)
    if share < MIN_BRIGHT or rough.contrast <= 0:
        got = f"only {100 * share:.0f} % that are brighter" if share < MIN_BRIGHT else "gaps as bright as micro-images"
        raise overlapping("micro-images brighter than the gaps between them", got)
    if rough.kind == "square" and few is None and not _alike(flat, rough):
        raise overlapping("micro-images of one shape", "two alternating shapes")
    if rough.kind == "square" and not _round(lit.flattened(), rough):
        raise overlapping("separate round micro-images", "micro-images of another shape, such as touching rings")
    if pitch_px is not None and not _near(rough.basis, pitch_px):
        got = f"{np.linalg.norm(rough.basis[0]):.2f} px"
        raise InputError.expected(
            "white image", f"a pitch within 10 % of {pitch_px:g} px", got, "correct the nominal pitch, or leave it out"
        )
    return RoughLattice(rough.kind, rough.basis, rough.centre + part.origin, rough.contrast)


def overlapping(wanted: str, found: str) -> InputError:
    """Return the error for an image whose micro-images may overlap."""
    remedy = "record an evenly lit image of the lenslets, with the main lens stopped down if micro-images overlap"
    return InputError.expected("white image", wanted, found, remedy)


def _alike(flat: LitPart, rough: RoughLattice) -> bool:
    """Return whether all lattice points of a square lattice have micro-images of the same shape.

    Where discs overlap, the bright lenses between neighbours form a lattice too, but alternate in direction.
    """
    coarse = np.linalg.inv(DIAGONAL) @ rough.basis
    return bool(_cells(flat, coarse, rough.basis, rough.centre)[1].min() > MIN_CORRELATION)


def _round(flat: LitPart, rough: RoughLattice) -> bool:
    """Return whether the mean micro-image is round: where rings touch, bright places lie between their centres."""
    from scipy.ndimage import map_coordinates

    image, far = flat.image, WITHIN * float(np.linalg.norm(rough.basis, axis=1).min())
    radii, angles = far * np.arange(1, CIRCLES + 1) / CIRCLES, 2 * np.pi * np.arange(ANGLES) / ANGLES
    circles = radii[:, None, None] * np.stack([np.cos(angles), np.sin(angles)], -1)
    reach = np.arange(-SYMMETRY_PITCHES, SYMMETRY_PITCHES + 1)
    start = np.rint((flat.middle - rough.centre) @ np.linalg.inv(rough.basis))
    cells = (np.stack(np.meshgrid(reach, reach), -1).reshape(-1, 2) + start) @ rough.basis + rough.centre
    cells = cells[((cells >= far) & (cells < np.array(image.shape[::-1]) - far)).all(1)]
    points = circles[:, :, None] + cells
    values = map_coordinates(image, points[..., ::-1].reshape(-1, 2).T, order=1).reshape(points.shape[:3]).mean(-1)
    means, weights = values.mean(1), radii / radii.sum()
    between = weights @ np.square(means - weights @ means)
    return bool(weights @ values.var(1) <= max(MAX_UNEVEN, between))


def _large(part: LitPart, kind: str | None, pitch_px: float | None) -> tuple[RoughLattice, float] | None:
    """Return the lattice of a few large lenslets, and its fraction of bright points; None if there is none."""
    part = part.scaled()
    for lags in large_lattices(part):
        for name in ("hexagonal", "square") if kind is None else (kind,):
            basis = _of_kind(lags, name)
            if basis is None or (pitch_px is not None and not _near(basis, pitch_px)):
                continue
            rough, share = _judge(part, name, basis, _most_symmetric(part, name, basis))
            if share >= MIN_BRIGHT and rough.contrast > 0:
                across = min(part.image.shape) / float(np.linalg.norm(basis, axis=1).max())
                return (rough, share) if across < FEW_ACROSS else None
    return None


def _of_kind(vectors: Array, kind: str) -> Array | None:
    """Return the basis of a lattice of ``kind`` with these two vectors; None if they form another one."""
    lengths = np.linalg.norm(vectors, axis=1)
    ratio = float(lengths.max() / lengths.min())
    angle = math.acos(float(np.clip(abs(vectors[0] @ vectors[1]) / lengths.prod(), -1, 1)))
    wanted, largest = (math.radians(60), 1 + LENGTH_TOLERANCE) if kind == "hexagonal" else (math.radians(90), MAX_RATIO)
    if ratio > largest or abs(angle - wanted) > ANGLE_TOLERANCE:
        return None
    return upright(vectors, kind)


def _fine(flat: LitPart, kind: str | None, pitch_px: float | None) -> tuple[RoughLattice, float]:
    """Return the lattice of many lenslets, and its fraction of bright points."""
    frequencies, amplitudes = _peaks(flat.image)
    candidates = _candidates(frequencies, kind)
    if not candidates:
        found = "no regular pattern" if len(frequencies) < 2 else "peaks that form no lattice"
        wanted = f"a {kind} lattice of micro-images" if kind else "a square or hexagonal lattice of micro-images"
        raise InputError.expected("white image", wanted, found, "record an evenly lit, sharp image of the lenslets")
    rough, share = _finest(flat, *_explaining(candidates, frequencies, amplitudes), kind)
    if pitch_px is not None and not _near(rough.basis, pitch_px):
        stated = [(name, basis) for name, basis in _contained(candidates, kind) if _near(basis, pitch_px)]
        if stated:
            name, basis = _explaining(stated, frequencies, amplitudes)
            rough, share = _judge(flat, name, basis, _most_symmetric(flat, name, basis))
    return rough, share


def _near(basis: Array, pitch_px: float) -> bool:
    return bool(abs(np.linalg.norm(basis[0]) / pitch_px - 1) <= NOMINAL_TOLERANCE)


def _contained(candidates: list[tuple[str, Array]], kind: str | None) -> list[tuple[str, Array]]:
    """Return the candidates, and the finer lattices that contain each of them."""
    return [*candidates, *((n, b) for name, basis in candidates for _, n, b in _finer(name, basis, kind))]


def _finer(name: str, basis: Array, kind: str | None) -> list[tuple[int, str, Array]]:
    """Return finer lattices that contain one: factor in the number of points, kind, basis."""
    found = []
    for order, step in FINER[name]:
        finer = step @ basis
        for other in ("square", "hexagonal") if step is DIAGONAL else (name,):
            made = _of_kind(finer, other)
            if made is not None and kind in (None, other):
                found.append((order, other, made))
    return found


def _finest(flat: LitPart, name: str, basis: Array, kind: str | None) -> tuple[RoughLattice, float]:
    """Return the finest lattice that contains the lattice ``basis`` and has a micro-image at every point."""
    found = _judge(flat, name, basis, _most_symmetric(flat, name, basis))
    for order, finer_name, finer in _finer(name, basis, kind):
        if np.linalg.norm(finer, axis=1).min() < MIN_PITCH:
            continue
        if order == 3:
            centre = _most_symmetric(flat, name, basis, types=3)
            gains, alike = _cells(flat, basis, finer, centre)
            # types differ in focus, so their cells need not be equal; but a gap is empty
            filled = (np.abs(gains) > MIN_CONTRAST_SHARE * np.abs(alike)).all()
            other, share = _judge(flat, name, finer, centre)
        else:
            gains, alike = _cells(flat, basis, finer, _most_symmetric(flat, finer_name, finer))
            filled = (gains > MIN_CONTRAST_SHARE).all() and (alike > MIN_CORRELATION).all()
            other, share = _finest(flat, finer_name, finer, kind) if filled else found
        finest = abs(np.linalg.det(other.basis)) < 0.9 * abs(np.linalg.det(found[0].basis))
        if filled and finest and share >= MIN_BRIGHT and other.contrast > 0:
            found = other, share
    return found


def _cells(flat: LitPart, basis: Array, finer: Array, centre: Array) -> tuple[Array, Array]:
    """Compare the mean cells about the points of a finer lattice within one cell of the lattice of ``basis``.

    Cells near the middle are averaged, as in `_most_symmetric`. Returns the gain of each mean cell relative to the one
    with the highest contrast, and its correlation with it; both are 1 for that cell.
    """
    from scipy.ndimage import map_coordinates

    image = flat.image
    steps = np.stack(np.meshgrid(np.arange(4), np.arange(4)), -1).reshape(-1, 2) @ finer @ np.linalg.inv(basis)
    inside = np.unique(np.mod(np.round(np.mod(steps + 1e-6, 1), 4), 1), axis=0) @ basis
    side = (np.arange(CELL_SIDE) - (CELL_SIDE - 1) / 2) / CELL_SIDE
    window = np.stack(np.meshgrid(side, side), -1).reshape(-1, 2) @ finer
    window = window[np.hypot(*window.T) < 0.5 * np.linalg.norm(finer, axis=1).min()]
    reach = np.arange(-SYMMETRY_PITCHES, SYMMETRY_PITCHES + 1)
    cells = np.stack(np.meshgrid(reach, reach), -1).reshape(-1, 2) @ basis + centre
    cells = cells[((cells >= 0) & (cells < np.array(image.shape[::-1]))).all(1)]
    points = inside[:, None, None] + window[:, None] + cells
    values = map_coordinates(image, points[..., ::-1].reshape(-1, 2).T, order=1, mode="nearest")
    means: Array = values.reshape(points.shape[:3]).mean(-1, dtype=np.float64)
    means -= means.mean(1, keepdims=True)
    size = np.maximum(np.linalg.norm(means, axis=1), 1e-12)
    best = int(np.argmax(size))
    product = means @ means[best]
    return product / size[best] ** 2, product / (size * size[best])


def _even(basis: Array) -> bool:
    lengths = np.linalg.norm(basis, axis=1)
    return bool(lengths.max() < (1 + LENGTH_TOLERANCE) * lengths.min())


def _explaining(candidates: list[tuple[str, Array]], frequencies: Array, amplitudes: Array) -> tuple[str, Array]:
    """Return the finest lattice to which the peaks belong."""

    def explained(basis: Array) -> float:
        order = frequencies @ basis.T
        return float(amplitudes[np.abs(order - np.rint(order)).max(1) < ORDER_TOLERANCE].sum() / amplitudes.sum())

    shares = [explained(basis) for _, basis in candidates]
    shares = [
        0.0 if share < RECTANGLE_EXPLAINED and name == "square" and not _even(basis) else share
        for share, (name, basis) in zip(shares, candidates, strict=True)
    ]
    enough = [c for c, share in zip(candidates, shares, strict=True) if share > 0.9 * max(shares)]
    return min(enough, key=lambda c: abs(np.linalg.det(c[1])))


def _peaks(flat: NDArray[np.float32]) -> tuple[Array, Array]:
    """Return peaks of the spectrum: frequencies ``(n, 2)`` as (x, y) in cycles per pixel, and amplitudes."""
    from scipy import fft, ndimage

    rows, columns = flat.shape
    window = np.outer(np.hanning(rows), np.hanning(columns)).astype(np.float32)
    power = np.abs(fft.fftshift(fft.fft2(flat * window, workers=1))) ** 2
    fy, fx = fft.fftshift(fft.fftfreq(rows)), fft.fftshift(fft.fftfreq(columns))
    radius = np.hypot(fx[None, :], fy[:, None])
    ratio = _whiten(power, radius, min(rows, columns))
    lowest = MIN_LENSLETS / min(rows, columns) / 1.2
    inside = (radius > lowest) & (radius < 1.3 / MIN_PITCH)
    # the spectrum of a real image is symmetric: half of it contains every peak once
    inside &= (fy[:, None] > 0) | ((fy[:, None] == 0) & (fx[None, :] > 0))
    j, i = np.nonzero((ratio == ndimage.maximum_filter(ratio, 5)) & inside & (ratio > PEAK_RATIO))
    order = np.argsort(-power[j, i])[:MAX_PEAKS]
    found = [
        (
            fx[column] + _parabola(power[row, column - 1 : column + 2]) / columns,
            fy[row] + _parabola(power[row - 1 : row + 2, column]) / rows,
        )
        for row, column in zip(j[order], i[order], strict=True)
    ]
    return np.array(found, float).reshape(-1, 2), np.sqrt(power[j[order], i[order]].astype(float))


def _whiten(power: NDArray[np.float32], radius: Array, n: int) -> NDArray[np.float32]:
    """Divide by the median over rings of equal frequency, so that the slow fall-off of a texture is not a peak."""
    from scipy import ndimage

    ring = np.minimum((radius * n / 4).astype(np.intp), n // 4)
    # the spectrum of a real image is symmetric: half of it has the same medians
    half = slice(len(power) // 2, None)
    medians = np.asarray(ndimage.median(power[half], ring[half], np.arange(ring.max() + 1)))
    medians = np.maximum(medians, 1e-12 * float(power.max()))
    result: NDArray[np.float32] = (power / medians[ring]).astype(np.float32)
    return result


def _parabola(power: NDArray[np.float32]) -> float:
    """Return the sub-sample offset of the middle one of three: a parabola through logarithms, exact for a Gaussian."""
    if len(power) != 3:
        return 0.0
    left, middle, right = np.log(np.maximum(power.astype(float), 1e-30))
    curvature = left - 2 * middle + right
    return float(0.5 * (left - right) / curvature) if curvature < 0 else 0.0


def _candidates(peaks: Array, kind: str | None) -> list[tuple[str, Array]]:
    """Return lattices (kind, basis) for every pair of peaks that spans one of a known kind."""
    every = np.concatenate([peaks, -peaks])
    lengths = np.linalg.norm(every, axis=1)
    found: list[tuple[str, Array]] = []
    for one, two in combinations(range(len(every)), 2):
        if two == one + len(peaks) or max(lengths[one], lengths[two]) > MAX_RATIO * min(lengths[one], lengths[two]):
            continue
        pair = np.stack([every[one], every[two]])
        for name in ("hexagonal", "square"):
            # the angle of the lattice is the supplement of that of its spectrum
            if kind not in (None, name) or _of_kind(pair, name) is None:
                continue
            basis = upright(np.linalg.inv(pair).T, name)
            if not any(
                n == name and np.abs(basis - other).max() <= 0.02 * np.linalg.norm(basis[0]) for n, other in found
            ):
                found.append((name, basis))
    return found


def upright(basis: Array, kind: str) -> Array:
    """Return an equivalent basis whose first vector is closest in direction to a sensor axis.

    The second vector is rotated from the first in the direction from x to y. The angle is about 60 degrees for a
    hexagonal lattice and 90 for a square one.
    """
    pairs = [(1, 0), (0, 1), (-1, 0), (0, -1)]
    if kind == "hexagonal":
        pairs += [(1, 1), (-1, -1), (1, -1), (-1, 1)]
    short = [np.array(pair) @ basis for pair in pairs]
    if kind == "hexagonal":
        shortest = min(float(np.linalg.norm(v)) for v in short)
        short = [v for v in short if np.linalg.norm(v) < 1.25 * shortest]

    def tilt(vector: Array) -> float:
        return abs(math.remainder(math.atan2(vector[1], vector[0]), math.pi / 2))

    least = min(map(tilt, short))
    upright_ones = [v for v in short if tilt(v) < least + 0.05]
    first = min(upright_ones, key=lambda v: (round(abs(math.atan2(v[1], v[0])), 3), -v[1]))
    wanted = math.radians(60 if kind == "hexagonal" else 90)
    start = math.atan2(first[1], first[0])

    def turn(vector: Array) -> float:
        away = math.atan2(vector[1], vector[0]) - start - wanted
        return abs(math.remainder(away, 2 * math.pi))

    return np.stack([first, min(short, key=turn)])


def _judge(flat: LitPart, kind: str, basis: Array, centre: Array) -> tuple[RoughLattice, float]:
    """Return the lattice with its centre, and the fraction of centres brighter than the gaps."""
    from lfcal.base import cv2

    image = flat.image
    lengths = np.linalg.norm(basis, axis=1)
    smooth = cv2.GaussianBlur(image, (0, 0), 0.15 * float(lengths.min()))
    inverse = np.linalg.inv(basis)
    corners = np.array([(x, y) for x in (0, image.shape[1]) for y in (0, image.shape[0])]) - centre
    limit = np.ceil(np.abs(corners @ inverse).max(0)).astype(int)
    q, r = np.meshgrid(np.arange(-limit[0], limit[0] + 1), np.arange(-limit[1], limit[1] + 1))
    places = np.stack([q.ravel(), r.ravel()], axis=-1) @ basis + centre
    margin = float(lengths.max())
    if min(image.shape) < FEW_ACROSS * margin:
        margin /= 2
    inside = ((places > margin) & (places < np.array(image.shape[::-1]) - 1 - margin)).all(1)
    places = places[inside]
    if kind == "hexagonal":
        gaps = np.array([(1 / 3, 1 / 3), (2 / 3, -1 / 3), (1 / 3, -2 / 3)])
    else:
        gaps = np.array([(0.5, 0.5), (0.5, -0.5)])
    gaps = np.concatenate([gaps, -gaps]) @ basis
    around = np.mean([_sample(smooth, places + gap) for gap in gaps], axis=0)
    difference = _sample(smooth, places) - around
    if not len(difference):
        return RoughLattice(kind, basis, centre, 0.0), 0.0
    # without light there is only noise
    sure = np.abs(difference) > MIN_CONTRAST_SHARE * np.percentile(np.abs(difference), 90)
    return RoughLattice(kind, basis, centre, float(difference.mean())), float((difference[sure] > 0).mean())


def _most_symmetric(flat: LitPart, kind: str, basis: Array, types: int = 1) -> Array:
    """Return the point in the cell, near the middle, about which the mean cell has the best rotational symmetry.

    The rotation is 60 degrees for a hexagonal lattice. It is 120 for the lattice of one of three ``types``, whose three
    centres of this symmetry are one lenslet of each type. It is 90 for a square lattice and 180 for rectangular cells,
    whose gaps are as symmetric as their lenslets: in this case, the brightest point is returned. Brightness alone does
    not suffice, because overlapping micro-images are brightest at their edges.
    """
    n = 48
    image, middle = flat.image, flat.middle
    lengths = np.linalg.norm(basis, axis=1)
    # near the middle, the spectrum's lattice is in phase with that of the image
    reach = SYMMETRY_PITCHES * float(lengths.max())
    low = np.maximum(np.ceil(middle - reach), 0).astype(int)
    high = np.minimum(middle + reach + 1, image.shape[::-1]).astype(int)
    x, y = (np.arange(a, b) - c for a, b, c in zip(low, high, middle, strict=True))
    part = image[low[1] : high[1], low[0] : high[0]].astype(float)
    window = np.outer(np.hanning(len(y) + 2)[1:-1], np.hanning(len(x) + 2)[1:-1])
    part = (part - (part * window).sum() / window.sum()) * window
    shifts = np.stack([v.ravel() for v in np.meshgrid(np.arange(n) / n, np.arange(n) / n)], axis=-1)
    alike, bright = np.zeros(n * n), np.zeros(n * n)
    even = _even(basis)
    for orders in HEXAGONAL_ORDERS if kind == "hexagonal" else SQUARE_ORDERS if even else RECTANGLE_ORDERS:
        fx, fy = np.linalg.solve(basis, np.array(orders, float).T)
        phase = -2 * np.pi * np.outer(x, fx)
        along = part @ np.cos(phase) + 1j * (part @ np.sin(phase))
        amplitude = (np.exp(-2j * np.pi * np.outer(y, fy)) * along).sum(0)
        mean = np.exp(2j * np.pi * shifts @ np.array(orders).T) @ amplitude / len(orders)
        alike += mean.real**2 if types == 1 else abs(mean) ** 2
        bright += len(orders) * mean.real
    if kind == "square":
        for halves in ((1, 1),) if even else ((1, 1), (0, 1), (1, 0)):
            by = (halves[0] * n // 2, halves[1] * n // 2)
            alike[(bright <= 0) | (bright < np.roll(bright.reshape(n, n), by, (0, 1)).ravel())] = 0
    result: Array = middle + shifts[int(np.argmax(alike))] @ basis
    return result


def _sample(image: NDArray[np.float32], places: Array) -> NDArray[np.float32]:
    index = np.rint(places).astype(np.intp)
    x = np.clip(index[:, 0], 0, image.shape[1] - 1)
    y = np.clip(index[:, 1], 0, image.shape[0] - 1)
    result: NDArray[np.float32] = image[y, x]
    return result
