"""First estimate of the lenslet lattice from the spectrum of a white image."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from lfcal.base import InputError

__all__ = ["RoughLattice", "guess_lattice"]

Array = NDArray[np.float64]

CROP = 1536
"""Side of the central part that is analysed (pixels): fast, with enough lenslets of any camera."""

MIN_PITCH = 4.0
MIN_LENSLETS = 5
"""Smallest number of lenslets along the shorter side."""

PEAK_RATIO = 60.0
"""Smallest ratio of a lattice peak's power to the median at its frequency; 1e6 noise samples stay below 20."""

MAX_PEAKS = 30
ANGLE_TOLERANCE = math.radians(4.0)
LENGTH_TOLERANCE = 0.06
"""Largest relative difference of the two pitches."""

ORDER_TOLERANCE = 0.08
"""Largest deviation of a peak from a whole order of the lattice."""

NOMINAL_TOLERANCE = 0.10
MIN_CONTRAST_SHARE = 0.2
"""Share of the typical contrast above which a lenslet counts as brighter or darker than its gaps."""

HEXAGONAL_ORDERS = (((1, 0), (0, 1), (-1, -1)), ((1, -1), (1, 2), (-2, -1)), ((2, 0), (0, 2), (-2, -2)))
SQUARE_ORDERS = (((1, 0), (0, 1)), ((1, 1), (1, -1)), ((2, 0), (0, 2)))
"""Lowest orders of a cell in sets that rotations by 120 or 90 degrees map to each other, without opposite ones."""

FINER = {
    "hexagonal": ((3, np.array([[2.0, -1.0], [1.0, 1.0]]) / 3), (4, np.eye(2) / 2)),
    "square": ((2, np.array([[1.0, -1.0], [1.0, 1.0]]) / 2), (4, np.eye(2) / 2)),
}
"""Lattices of the same kind that contain a lattice: factor in the number of places, and vectors in units of its basis.

An array of unequal lenslets repeats over a coarser lattice: three types over √3 pitches, a checkered brightness over
√2, one lenslet of four over 2."""

CELL_SIDE = 9
"""Number of samples along each side of a mean cell."""

MIN_CORRELATION = 0.7
"""Smallest correlation between the mean cells about all places of a lattice. Measured: lenslets of brightness 0.3 to 1
at least 0.99; if some places are gaps, below 0.4."""

SYMMETRY_PITCHES = 8.0
"""Largest distance from the middle for the mean cell."""

MIN_BRIGHT = 0.75
"""Smallest share of lenslets that must be brighter than the gaps around them."""


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
        Mean brightness of the centres less that of the gaps, in standard deviations of the image.
    """

    kind: str
    basis: Array
    centre: Array
    contrast: float


def guess_lattice(image: NDArray[np.float32], kind: str | None, pitch_px: float | None) -> RoughLattice:
    """Return the lattice of the micro-images of a white image, ignoring lens types.

    Pairs of spectral peaks of equal length at 60 or 90 degrees propose lattices. The result is the finest one that
    explains the peaks, or one that contains it (`FINER`), because lenslets of several types, or of unequal brightness,
    add the peaks of a coarser lattice. The image decides between them: a lattice that is too fine has centres in the
    gaps. A stated pitch decides between lattices of different pitch.

    Raises
    ------
    InputError
        If the image is blank or shows no lattice, or none near ``pitch_px``.
    """
    crop, origin = _central(image)
    flat = _flatten(crop)
    frequencies, amplitudes = _peaks(flat)
    candidates = _candidates(frequencies, kind)
    if not candidates:
        found = "no regular pattern" if len(frequencies) < 2 else "peaks that form none"
        wanted = f"a {kind} lattice of micro-images" if kind else "a square or hexagonal lattice of micro-images"
        raise InputError.expected("white image", wanted, found, "take an evenly lit, sharp image of the lenslets")
    rough, share = _finest(flat, *_explaining(candidates, frequencies, amplitudes))
    if pitch_px is not None and not _near(rough.basis, pitch_px):
        stated = [(name, basis) for name, basis in _contained(candidates) if _near(basis, pitch_px)]
        if stated:
            name, basis = _explaining(stated, frequencies, amplitudes)
            rough, share = _judge(flat, name, basis, _most_symmetric(flat, name, basis))
    if share < MIN_BRIGHT or rough.contrast <= 0:
        got = f"{100 * share:.0f} % of the places"
        raise InputError.expected(
            "white image",
            "micro-images brighter than the gaps between them",
            got,
            "take an evenly lit image of the lenslets",
        )
    if pitch_px is not None and not _near(rough.basis, pitch_px):
        got = f"{np.linalg.norm(rough.basis[0]):.2f} px"
        raise InputError.expected(
            "white image", f"a pitch within 10 % of {pitch_px:g} px", got, "correct the nominal pitch or leave it out"
        )
    return RoughLattice(rough.kind, rough.basis, rough.centre + origin, rough.contrast)


def _near(basis: Array, pitch_px: float) -> bool:
    return bool(abs(np.linalg.norm(basis[0]) / pitch_px - 1) <= NOMINAL_TOLERANCE)


def _contained(candidates: list[tuple[str, Array]]) -> list[tuple[str, Array]]:
    """Return the candidates, and the finer lattices that contain each of them."""
    return [
        *candidates,
        *((name, upright(step @ basis, name)) for name, basis in candidates for _, step in FINER[name]),
    ]


def _finest(flat: NDArray[np.float32], name: str, basis: Array) -> tuple[RoughLattice, float]:
    """Return the finest lattice that contains that of ``basis`` and has a micro-image at every place."""
    found = _judge(flat, name, basis, _most_symmetric(flat, name, basis))
    for order, step in FINER[name]:
        finer = upright(step @ basis, name)
        if np.linalg.norm(finer[0]) < MIN_PITCH:
            continue
        if order == 3:
            centre = _most_symmetric(flat, name, basis, types=3)
            gains, alike = _cells(flat, basis, finer, centre)
            # types differ in focus, so their cells need not be equal; but a gap is empty
            filled = (np.abs(gains) > MIN_CONTRAST_SHARE * np.abs(alike)).all()
            other, share = _judge(flat, name, finer, centre)
        else:
            gains, alike = _cells(flat, basis, finer, _most_symmetric(flat, name, finer))
            filled = (gains > MIN_CONTRAST_SHARE).all() and (alike > MIN_CORRELATION).all()
            other, share = _finest(flat, name, finer) if filled else found
        finest = np.linalg.norm(other.basis[0]) < np.linalg.norm(found[0].basis[0])
        if filled and finest and share >= MIN_BRIGHT and other.contrast > 0:
            found = other, share
    return found


def _cells(flat: NDArray[np.float32], basis: Array, finer: Array, centre: Array) -> tuple[Array, Array]:
    """Compare the mean cells about the places of a finer lattice within one cell of the lattice of ``basis``.

    Cells near the middle are averaged, as in `_most_symmetric`. Returns the gain of each mean cell relative to the one
    with the highest contrast, and its correlation with it; both are 1 for that cell.
    """
    from scipy.ndimage import map_coordinates

    steps = np.stack(np.meshgrid(np.arange(4), np.arange(4)), -1).reshape(-1, 2) @ finer @ np.linalg.inv(basis)
    inside = np.unique(np.round(np.mod(steps + 1e-6, 1), 4), axis=0) @ basis
    side = (np.arange(CELL_SIDE) - (CELL_SIDE - 1) / 2) / CELL_SIDE
    window = np.stack(np.meshgrid(side, side), -1).reshape(-1, 2) @ finer
    window = window[np.hypot(*window.T) < 0.5 * np.linalg.norm(finer[0])]
    reach = np.arange(-SYMMETRY_PITCHES, SYMMETRY_PITCHES + 1)
    cells = np.stack(np.meshgrid(reach, reach), -1).reshape(-1, 2) @ basis + centre
    cells = cells[((cells >= 0) & (cells < np.array(flat.shape[::-1]))).all(1)]
    points = inside[:, None, None] + window[:, None] + cells
    values = map_coordinates(flat, points[..., ::-1].reshape(-1, 2).T, order=1, mode="nearest")
    means: Array = values.reshape(points.shape[:3]).mean(-1, dtype=np.float64)
    means -= means.mean(1, keepdims=True)
    size = np.maximum(np.linalg.norm(means, axis=1), 1e-12)
    best = int(np.argmax(size))
    product = means @ means[best]
    return product / size[best] ** 2, product / (size * size[best])


def _explaining(candidates: list[tuple[str, Array]], frequencies: Array, amplitudes: Array) -> tuple[str, Array]:
    """Return the finest lattice to which the peaks belong."""

    def explained(basis: Array) -> float:
        order = frequencies @ basis.T
        return float(amplitudes[np.abs(order - np.rint(order)).max(1) < ORDER_TOLERANCE].sum() / amplitudes.sum())

    shares = [explained(basis) for _, basis in candidates]
    enough = [c for c, share in zip(candidates, shares, strict=True) if share > 0.9 * max(shares)]
    return min(enough, key=lambda c: abs(np.linalg.det(c[1])))


def _central(image: NDArray[np.float32]) -> tuple[NDArray[np.float32], Array]:
    rows, columns = image.shape
    height, width = min(rows, CROP), min(columns, CROP)
    top, left = (rows - height) // 2, (columns - width) // 2
    return image[top : top + height, left : left + width], np.array([left, top], float)


def _flatten(crop: NDArray[np.float32]) -> NDArray[np.float32]:
    """Remove variations slower than the coarsest lattice, in brightness and in contrast."""
    sigma = min(crop.shape) / MIN_LENSLETS / 2
    # uneven light would put power near zero frequency, and bright corners would dominate
    flat = crop - blurred(crop, sigma)
    spread = np.sqrt(blurred(flat * flat, sigma))
    top = float(spread.max())
    if not top > 1e-6 * float(np.abs(crop).max()):
        raise InputError.expected("white image", "micro-images", "a blank image", "switch the light on")
    return (flat / np.maximum(spread, 0.05 * top)).astype(np.float32)


def blurred(image: NDArray[np.float32], sigma: float) -> NDArray[np.float32]:
    """Return ``image`` after a wide Gaussian of ``sigma`` pixels, computed on a coarser grid."""
    import cv2

    rows, columns = image.shape
    factor = max(1, int(sigma / 6))
    small = cv2.resize(image, (-(-columns // factor), -(-rows // factor)), interpolation=cv2.INTER_AREA)
    small = cv2.GaussianBlur(small, (0, 0), sigma / factor, borderType=cv2.BORDER_REFLECT)
    result: NDArray[np.float32] = cv2.resize(small, (columns, rows), interpolation=cv2.INTER_LINEAR)
    return result


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
    """Return lattices (kind, basis) for every pair of peaks of equal length at 60 or 90 degrees."""
    every = np.concatenate([peaks, -peaks])
    found: list[tuple[str, Array]] = []
    for one, two in combinations(range(len(every)), 2):
        if two == one + len(peaks):
            continue
        k = np.stack([every[one], every[two]])
        lengths = np.linalg.norm(k, axis=1)
        if abs(lengths[0] / lengths[1] - 1) > LENGTH_TOLERANCE:
            continue
        angle = math.acos(float(np.clip(k[0] @ k[1] / lengths.prod(), -1, 1)))
        # the angle of the lattice is the supplement of that of its spectrum
        for name, wanted in (("hexagonal", math.radians(60)), ("square", math.radians(90))):
            if kind in (None, name) and abs(angle - wanted) < ANGLE_TOLERANCE:
                basis = upright(np.linalg.inv(k).T, name)
                if not any(
                    n == name and np.allclose(basis, other, rtol=0, atol=0.02 * np.linalg.norm(basis[0]))
                    for n, other in found
                ):
                    found.append((name, basis))
    return found


def upright(basis: Array, kind: str) -> Array:
    """Return an equivalent basis whose first vector is nearest a sensor axis, and whose second turns from x to y.

    The angle between them is 60 degrees for a hexagonal lattice, and 90 for a square one.
    """
    combos = [np.array(pair) @ basis for pair in ((1, 0), (0, 1), (-1, 0), (0, -1), (1, 1), (-1, -1), (1, -1), (-1, 1))]
    shortest = min(float(np.linalg.norm(v)) for v in combos)
    short = [v for v in combos if np.linalg.norm(v) < 1.25 * shortest]

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


def _judge(flat: NDArray[np.float32], kind: str, basis: Array, centre: Array) -> tuple[RoughLattice, float]:
    """Return the lattice with its centre, and the share of centres brighter than the gaps."""
    import cv2

    pitch = float(np.linalg.norm(basis, axis=1).mean())
    smooth = cv2.GaussianBlur(flat, (0, 0), 0.15 * pitch)
    inverse = np.linalg.inv(basis)
    corners = np.array([(x, y) for x in (0, flat.shape[1]) for y in (0, flat.shape[0])]) - centre
    limit = np.ceil(np.abs(corners @ inverse).max(0)).astype(int)
    q, r = np.meshgrid(np.arange(-limit[0], limit[0] + 1), np.arange(-limit[1], limit[1] + 1))
    places = np.stack([q.ravel(), r.ravel()], axis=-1) @ basis + centre
    margin = pitch
    inside = ((places > margin) & (places < np.array(flat.shape[::-1]) - 1 - margin)).all(1)
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


def _most_symmetric(flat: NDArray[np.float32], kind: str, basis: Array, types: int = 1) -> Array:
    """Return the place in the cell, near the middle, about which the mean cell has the best rotational symmetry.

    The rotation is 60 degrees for a hexagonal lattice. It is 120 for that of one of three ``types``, whose three
    centres of this symmetry are one lenslet of each type. It is 90 for a square lattice, whose gaps are as symmetric
    as its lenslets: there, the brighter place is taken. Brightness alone does not suffice, because overlapping
    micro-images are brightest at their edges.
    """
    n = 48
    middle = (np.array(flat.shape[::-1]) - 1) / 2
    # near the middle, the spectrum's lattice is in phase with that of the image
    reach = SYMMETRY_PITCHES * float(np.linalg.norm(basis[0]))
    low = np.maximum(np.ceil(middle - reach), 0).astype(int)
    high = np.minimum(middle + reach + 1, flat.shape[::-1]).astype(int)
    x, y = (np.arange(a, b) - c for a, b, c in zip(low, high, middle, strict=True))
    part = flat[low[1] : high[1], low[0] : high[0]].astype(float)
    window = np.outer(np.hanning(len(y) + 2)[1:-1], np.hanning(len(x) + 2)[1:-1])
    part = (part - (part * window).sum() / window.sum()) * window
    shifts = np.stack([v.ravel() for v in np.meshgrid(np.arange(n) / n, np.arange(n) / n)], axis=-1)
    alike, bright = np.zeros(n * n), np.zeros(n * n)
    for orders in HEXAGONAL_ORDERS if kind == "hexagonal" else SQUARE_ORDERS:
        fx, fy = np.linalg.solve(basis, np.array(orders, float).T)
        phase = -2 * np.pi * np.outer(x, fx)
        along = part @ np.cos(phase) + 1j * (part @ np.sin(phase))
        amplitude = (np.exp(-2j * np.pi * np.outer(y, fy)) * along).sum(0)
        mean = np.exp(2j * np.pi * shifts @ np.array(orders).T) @ amplitude / len(orders)
        alike += mean.real**2 if types == 1 else abs(mean) ** 2
        bright += len(orders) * mean.real
    if kind == "square":
        between = np.roll(bright.reshape(n, n), (n // 2, n // 2), (0, 1)).ravel()
        alike[(bright <= 0) | (bright < between)] = 0
    result: Array = middle + shifts[int(np.argmax(alike))] @ basis
    return result


def _sample(image: NDArray[np.float32], places: Array) -> NDArray[np.float32]:
    index = np.rint(places).astype(np.intp)
    x = np.clip(index[:, 0], 0, image.shape[1] - 1)
    y = np.clip(index[:, 1], 0, image.shape[0] - 1)
    result: NDArray[np.float32] = image[y, x]
    return result
