"""Codes for lighting several points together, and when they reduce the error of overlapping patterns.

A frame shows the sum of the patterns of the points that its code lights, ``i_f = sum_m S_fm h_m`` at every pixel. The
patterns are recovered by ``h = S^+ i``: plenoptic multiplexing with the points as samples (theorem 1 without
interpolation). The variance of an entry is ``sum_f (S^+)_mf^2 (additive + i_f)``. An S-matrix of order n reduces
additive noise to 4 n/(n + 1)^2. However, every entry receives 2/(n + 1) of the photon noise of *all* patterns at its
pixel, including bright cores of others (Wuttig 2005; Schechner, Nayar and Belhumeur 2007).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfcal.base import InputError, array_words, check_choice, check_number
from lfcal.multiplex._sensor_noise import SensorNoise

__all__ = [
    "CODES",
    "CodingGain",
    "CodingNumbers",
    "CodingVerdict",
    "code_matrix",
    "coding_gain",
    "coding_pays",
    "measured_coding_gain",
    "overlapping_patterns",
    "random_code",
    "s_matrix",
    "s_matrix_orders",
]

Array = NDArray[np.float64]

CODES = ("S", "random", "single")
"""Kinds of codes: S-matrix, random, and one point at a time."""

MOST_POINTS = 1023


def s_matrix_orders(most: int = MOST_POINTS) -> list[int]:
    """Return the orders of S-matrices from 3 to ``most``: primes of the form 4k - 1, and the numbers 2^m - 1."""
    return [n for n in range(3, most + 1) if _is_paley(n) or (n & (n + 1)) == 0]


def s_matrix(order: int) -> Array:
    """Return an S-matrix ``(order, order)`` of 0 and 1, the best code for additive noise (Harwit and Sloane 1979).

    For the order n, every row and column has (n + 1)/2 ones. With the identity I and the matrix J of ones, the product
    S S^T is (n + 1)/4 (I + J), and the inverse of S is 2/(n + 1) (2 S^T - J). For primes n = 4k - 1, each row is a
    cyclic shift of a sequence that is 1 at 0 and at the quadratic residues modulo n. For other n = 2^m - 1, S is
    derived from Sylvester's Hadamard matrix without its first row and column.

    Raises
    ------
    InputError
        If no S-matrix of this order is available; `s_matrix_orders` lists the orders.

    Examples
    --------
    >>> import numpy as np
    >>> from lfcal.multiplex import s_matrix
    >>> S = s_matrix(7)
    >>> print(S.astype(int)[:2])
    [[1 1 1 0 1 0 0]
     [1 1 0 1 0 0 1]]
    >>> print((np.linalg.inv(S) ** 2).sum(axis=1).round(4))  # variance 4 n/(n + 1)^2 of that of single points
    [0.4375 0.4375 0.4375 0.4375 0.4375 0.4375 0.4375]
    """
    check_number("order of the S-matrix", order, at_least=3, at_most=MOST_POINTS, integer=True)
    if _is_paley(order):
        on = np.zeros(order)
        on[[k * k % order for k in range(order)]] = 1
        places = (np.arange(order)[None, :] + np.arange(order)[:, None]) % order
        return np.asarray(on[places])
    if (order & (order + 1)) == 0:
        number = np.arange(1, order + 1)
        both, odd = number[:, None] & number, np.zeros((order, order), np.intp)
        for bit in range(order.bit_length()):
            odd ^= both >> bit & 1
        return odd.astype(float)
    near = min(s_matrix_orders(), key=lambda n: abs(n - order))
    wanted = "a prime of the form 4k - 1, or a power of two minus 1"
    raise InputError.expected("order of the S-matrix", wanted, order, f"choose {near}, the nearest possible order")


def _is_paley(n: int) -> bool:
    return n % 4 == 3 and all(n % k for k in range(2, math.isqrt(n) + 1))


def random_code(frames: int, points: int, density: float, rng: np.random.Generator) -> Array:
    """Return a random code ``(frames, points)`` of 0 and 1 with full column rank, so that all points can be separated.

    ``density`` is the expected fraction of ones (0 to 1), and ``rng`` the random number generator.

    Raises
    ------
    InputError
        If there are fewer frames than points, or none of a hundred random codes separates all points.

    Examples
    --------
    >>> import numpy as np
    >>> from lfcal.multiplex import random_code
    >>> code = random_code(12, 6, 0.5, np.random.default_rng(0))
    >>> print(code.shape, np.unique(code), np.linalg.matrix_rank(code))
    (12, 6) [0. 1.] 6
    """
    check_number("points", points, at_least=1, at_most=MOST_POINTS, integer=True)
    check_number("number of frames of a random code", frames, at_least=points, at_most=4 * MOST_POINTS, integer=True)
    check_number("fraction of points that are lit", density, above=0, below=1)
    for _ in range(100):
        code = np.asarray(rng.random((frames, points)) < density, float)
        if np.linalg.matrix_rank(code) == points:
            return code
    raise InputError.expected(
        "random code", "a code that separates all points", "none in 100 attempts", "choose more frames"
    )


def code_matrix(
    kind: str, points: int, *, frames: int | None = None, density: float = 0.5, rng: np.random.Generator | None = None
) -> Array:
    """Return a code ``(frames, points)``: 1 where the frame lights the point, otherwise 0.

    Parameters
    ----------
    kind
        ``"S"``: the first columns of the smallest S-matrix whose order is at least ``points``. ``"random"``: a random
        code. ``"single"``: one point at a time.
    points
        Number of points whose patterns overlap.
    frames, density, rng
        Options of random codes: number of frames (None: number of points), expected fraction of points that are lit in
        a frame (0 to 1), and random number generator (None: one with a fixed seed).

    Raises
    ------
    InputError
        If ``kind`` is unknown, ``points`` is not from 1 to 1023, ``frames`` is given for a code that is not random, or
        as in `random_code`.

    Examples
    --------
    >>> from lfcal.multiplex import code_matrix
    >>> code = code_matrix("S", 5)  # the S-matrix of 7 without two columns
    >>> print(code.shape, code.sum(axis=0))  # each point is lit in 4 of 7 frames
    (7, 5) [4. 4. 4. 4. 4.]
    >>> print(code_matrix("single", 3))
    [[1. 0. 0.]
     [0. 1. 0.]
     [0. 0. 1.]]
    """
    check_choice("code", kind, CODES)
    check_number("points", points, at_least=1, at_most=MOST_POINTS, integer=True)
    if frames is not None and kind != "random":
        raise InputError.expected("frames", "no number of frames, except for random codes", frames, "omit the frames")
    if kind == "single":
        return np.eye(points)
    if kind == "random":
        return random_code(points if frames is None else frames, points, density, rng or np.random.default_rng(0))
    order = next(n for n in s_matrix_orders(2 * MOST_POINTS) if n >= points)
    return s_matrix(order)[:, :points]


LIMITS = ("time", "full well")
"""Quantity kept equal in a comparison: the exposure of every frame, or the level of the brightest pixel."""

CORE, DARK = 0.5, 0.01
"""Thresholds for bright entries (at least half of their pattern's peak) and dark ones (at most a hundredth)."""

LEAST_SIGNAL_E = 1e-3


@dataclass(frozen=True, slots=True)
class CodingNumbers:
    """Summary of the gain of a code over lighting one point at a time, in the same number of frames.

    Gains in dB are 10 log10 of the ratio of standard deviations; positive values mean that the code is better.

    Attributes
    ----------
    rms_db
        Gain in the rms error over all entries of the patterns (dB).
    core_db, dark_db
        Gain in the rms error over the bright entries, and over the dark ones (dB); NaN if there are none. Bright
        entries have at least half of the peak of their pattern, dark ones at most a hundredth of it.
    better
        Fraction of the entries whose error is smaller with the code, 0 to 1.
    exposure
        Ratio of the exposure time of coded frames to that of single points; below 1 if the coded frames would otherwise
        saturate.
    peak_e
        Signal of the brightest pixel of the coded frames (electrons).
    """

    rms_db: float
    core_db: float
    dark_db: float
    better: float
    exposure: float
    peak_e: float


@dataclass(frozen=True, eq=False)
class CodingGain:
    """Gain of a code in the precision of the recovered patterns, relative to lighting one point at a time.

    Attributes
    ----------
    frames, points
        Number of frames and number of points of the code.
    signal_e
        Signal of the brightest entry in the frame of a single point (electrons), at equal exposure.
    time_db, full_well_db
        Gain of each entry (dB), ``(points, rows, columns)``, at equal exposure time, and with exposures at which the
        brightest pixel reaches the full well.
    time, full_well
        Summaries of these two arrays.
    """

    frames: int
    points: int
    signal_e: float
    time_db: Array = field(repr=False)
    full_well_db: Array = field(repr=False)
    time: CodingNumbers
    full_well: CodingNumbers


@dataclass(frozen=True, eq=False)
class CodingVerdict:
    """Verdict on whether a code reduces the error of H compared with lighting one point at a time.

    Attributes
    ----------
    pays
        Whether the rms error of H is smaller with the code.
    limit
        Quantity that is equal in the comparison: ``"time"`` or ``"full well"``.
    gain
        Gains of the code for both quantities.
    break_even_e
        Signal of a single point's brightest entry (electrons) up to which coding is better at equal exposure time. It
        is 0 if coding is never better, and infinite if coding is better up to the full well.
    """

    pays: bool
    limit: str
    gain: CodingGain
    break_even_e: float

    @property
    def words(self) -> str:
        """One-line verdict with the gain of the code and, for equal exposure times, its break-even signal."""
        numbers = self.gain.time if self.limit == "time" else self.gain.full_well
        does = "pays" if self.pays else "does not pay"
        reported = f"coding {does} at equal {self.limit}: {numbers.rms_db:+.2f} dB over all entries"
        return reported if self.limit != "time" else f"{reported}; it {self.range_words}"

    @property
    def frames_words(self) -> str:
        """Clause that states whether showing several frames together is better, up to which signal, and why."""
        gain, does = self.gain, "pays" if self.pays else "does not pay"
        return (
            f"showing {gain.points} frames together, coded: {does} at {float(f'{gain.signal_e:.3g}'):g} electrons in a "
            f"point's brightest pixel ({gain.time.rms_db:+.2f} dB); it {self.range_words}"
        )

    @property
    def range_words(self) -> str:
        """Clause that states up to which signal coding is better at equal exposure time, and why."""
        if self.break_even_e == 0:
            return "never pays for this pattern and sensor: photon noise of bright cores is spread over dark entries"
        if math.isinf(self.break_even_e):
            return "pays up to a saturated pixel: the sensor's noise exceeds the photon noise"
        return (
            f"pays up to {float(f'{self.break_even_e:.3g}'):g} electrons in a point's brightest pixel: with "
            "less light, the sensor's noise dominates; with more, the photon noise of bright cores is spread "
            "over dark entries"
        )

    def to_dict(self) -> dict[str, Any]:
        """Return the main values, with gains at equal exposure time, as plain JSON types.

        An infinite `break_even_e` becomes None.
        """
        return {
            "pays": self.pays,
            "together": self.gain.points,
            "signal_e": self.gain.signal_e,
            "gain_db": self.gain.time.rms_db,
            "dark_db": self.gain.time.dark_db,
            "up_to_e": None if math.isinf(self.break_even_e) else self.break_even_e,
        }


def overlapping_patterns(
    plane: ArrayLike, points: int, *, step: int = 1, first: tuple[int, int] = (0, 0)
) -> tuple[Array, NDArray[np.intp]]:
    """Return the patterns of adjacent points on a common area of the sensor, and the positions of the points.

    Parameters
    ----------
    plane
        One depth plane of H, shape ``(ny, nx, nt, ns)``; source positions beyond the period use its periodic
        continuation.
    points
        Number of points, in a block that is as square as possible and in row-major order.
    step
        Distance between adjacent points, in source positions (px in the image).
    first
        Indices (y, x) of the source position of the first point.

    Returns
    -------
    tuple
        Patterns ``(points, rows, columns)`` in the units of ``plane``, NaN outside the cutout of each point, and
        indices (y, x) of the source positions of the points, ``(points, 2)``.

    Raises
    ------
    InputError
        If ``plane`` is not an array of real numbers with four axes, or the patterns contain no light.

    Examples
    --------
    >>> from lfcal.multiplex import overlapping_patterns
    >>> from lfcal.psf import open_psf
    >>> with open_psf("H.h5") as H:
    ...     patterns, places = overlapping_patterns(H.T[0], 4, step=2)
    >>> print(patterns.shape, places.tolist())
    (4, 57, 57) [[0, 0], [0, 2], [2, 0], [2, 2]]
    """
    values = np.asarray(plane)
    check_number("points", points, at_least=1, integer=True)
    check_number("distance of the points (px)", step, at_least=1, at_most=10_000, integer=True)
    if values.ndim != 4 or not values.size or values.dtype.kind not in "uif":
        raise InputError.expected(
            "plane of H", "an array of numbers (ny, nx, nt, ns)", f"shape {values.shape}", "give one plane of H"
        )
    across = math.ceil(math.sqrt(points))
    index = np.arange(points)
    places = np.stack([index // across, index % across], 1) * step
    (ny, nx, nt, ns), (rows, columns) = values.shape, places.max(axis=0)
    found = np.full((points, rows + nt, columns + ns), np.nan)
    for pattern, (y, x) in zip(found, places, strict=True):
        pattern[y : y + nt, x : x + ns] = values[(first[0] + y) % ny, (first[1] + x) % nx]
    _Overlap(found, np.eye(points))  # checks the patterns
    return found, places + np.array(first)


def coding_gain(patterns: ArrayLike, code: ArrayLike, noise: SensorNoise, *, signal_e: float) -> CodingGain:
    """Return the gain of a code for each entry of the patterns, relative to single points in as many frames.

    Each single point is shown in ``frames / points`` frames, so that both methods use the same number of frames.
    Photo-response non-uniformity (PRNU) is the same in all frames; it therefore causes the same error in both methods.

    Parameters
    ----------
    patterns
        Patterns ``(points, rows, columns)`` on a common area of the sensor, in any unit; NaN outside the cutout of a
        point (`overlapping_patterns`).
    code
        Relative brightness of each point in each frame, ``(frames, points)``, 0 to 1 (`code_matrix`).
    noise
        Noise model of the camera (`sensor_noise`).
    signal_e
        Signal of the brightest entry of a single point in one frame (electrons), at most the full well.

    Raises
    ------
    InputError
        If the shapes do not match, the patterns contain no light, the code does not separate the points, or the signal
        exceeds the full well.

    Examples
    --------
    >>> import numpy as np
    >>> from lfcal.multiplex import CodingGain, CodingNumbers, SensorNoise, coding_gain, s_matrix
    >>> noise, spots = SensorNoise(full_e=10_000, additive_e2=100), np.ones((7, 1, 1)) * [0.001, 0.6, 1.0, 0.6]
    >>> found: CodingGain = coding_gain(spots, s_matrix(7), noise, signal_e=1000)
    >>> time: CodingNumbers = found.time
    >>> print(f"bright ones {time.core_db:.2f} dB, dark ones {time.dark_db:.2f} dB, up to {time.peak_e:.0f} electrons")
    bright ones -1.01 dB, dark ones 1.73 dB, up to 4000 electrons
    """
    overlap = _Overlap(patterns, code)
    check_number("electrons of a point's brightest pixel", signal_e, above=0, at_most=noise.full_e)
    maps, numbers = [], []
    for limit in LIMITS:
        signals = overlap.signals(noise, signal_e, limit)
        single, coded = overlap.variances(noise, signals)
        gains = np.where(overlap.entries, 5 * np.log10(single / coded), np.nan)
        maps.append(gains.reshape(overlap.shape))
        numbers.append(overlap.numbers(single, coded, signals))
    frames, points = overlap.code.shape
    return CodingGain(frames, points, signal_e, maps[0], maps[1], numbers[0], numbers[1])


def coding_pays(
    patterns: ArrayLike,
    noise: SensorNoise,
    *,
    code: str | ArrayLike = "S",
    signal_e: float | None = None,
    limit: str = "time",
) -> CodingVerdict:
    """Return a verdict on whether lighting several points together reduces the error of the recovered patterns.

    The rms error over all entries is compared with that of single points in the same number of frames. A code
    reduces this error if additive noise dominates, that is, for weak sources. For strong signals, coding spreads the
    photon noise of bright cores over dark entries.

    Parameters
    ----------
    patterns, noise
        As in `coding_gain`.
    code
        ``"S"``, ``"random"``, or a matrix ``(frames, points)`` as in `coding_gain`.
    signal_e
        Signal of the brightest entry of a single point in one frame (electrons). None: the full well.
    limit
        ``"time"``: equal exposure times; those of coded frames are shortened only if the frames would saturate. ``"full
        well"``: in both cases, the brightest pixel reaches the full well.

    Raises
    ------
    InputError
        As in `coding_gain`.

    Examples
    --------
    >>> from lfcal.camera import preset
    >>> from lfcal.multiplex import CodingVerdict, coding_pays, overlapping_patterns, sensor_noise
    >>> from lfcal.psf import open_psf
    >>> with open_psf("H.h5") as H:
    ...     patterns, _ = overlapping_patterns(H.T[0], 7)
    >>> verdict: CodingVerdict = coding_pays(patterns, sensor_noise(preset("r29").sensor), signal_e=50)
    >>> print(verdict.words)
    coding pays at equal time: +1.78 dB over all entries; it pays up to 15600 electrons in a point's brightest pixel:
    with less light, the sensor's noise dominates; with more, the photon noise of bright cores is spread over dark
    entries
    """
    check_choice("limit", limit, LIMITS)
    lit = code_matrix(code, len(np.asarray(patterns))) if isinstance(code, str) else np.asarray(code, float)
    gain = coding_gain(patterns, lit, noise, signal_e=noise.full_e if signal_e is None else signal_e)
    numbers = gain.time if limit == "time" else gain.full_well
    return CodingVerdict(numbers.rms_db > 0, limit, gain, _break_even(_Overlap(patterns, lit), noise))


def _break_even(overlap: _Overlap, noise: SensorNoise) -> float:
    """Return the signal (electrons) with an rms gain of 0 dB at equal exposure; 0: never better, inf: always better."""

    def pays(signal: float) -> bool:
        single, coded = overlap.variances(noise, overlap.signals(noise, signal, "time"))
        return bool(single[overlap.entries].sum() > coded[overlap.entries].sum())

    low, high = min(LEAST_SIGNAL_E, noise.full_e / 2), noise.full_e
    if not pays(low):
        return 0.0
    if pays(high):
        return math.inf
    for _ in range(60):  # bisection of the logarithm
        middle = math.sqrt(low * high)
        low, high = (middle, high) if pays(middle) else (low, middle)
    return low


def measured_coding_gain(
    patterns: ArrayLike,
    code: ArrayLike,
    noise: SensorNoise,
    *,
    signal_e: float,
    limit: str = "time",
    trials: int = 200,
    rng: np.random.Generator,
) -> float:
    """Return the gain of a code in the rms error over all entries (dB), measured on simulated noisy frames.

    Parameters
    ----------
    patterns, code, noise, signal_e, limit
        As in `coding_gain` and `coding_pays`; the number of frames must be a multiple of the number of points.
    trials
        Number of simulated series of frames, each of which is simulated with and without the code.
    rng
        Random number generator for photon noise, read noise and photo-response non-uniformity.

    Raises
    ------
    InputError
        As in `coding_gain`, or if the number of frames is not a multiple of the number of points.

    Examples
    --------
    >>> import numpy as np
    >>> from lfcal.multiplex import SensorNoise, measured_coding_gain, s_matrix
    >>> noise, rng = SensorNoise(full_e=10_000, additive_e2=100), np.random.default_rng(0)
    >>> gain = measured_coding_gain(np.ones((7, 9, 9)), s_matrix(7), noise, signal_e=0.1, rng=rng)
    >>> print(f"{gain:.1f} dB")  # (n + 1)/(2 sqrt(n)) in near darkness
    1.8 dB
    """
    check_choice("limit", limit, LIMITS)
    check_number("trials", trials, at_least=1, integer=True)
    overlap = _Overlap(patterns, code)
    frames, points = overlap.code.shape
    if frames % points:
        remedy = "choose another code, or show its frames several times"
        raise InputError.expected("frames of the code", f"a multiple of {points}, the number of points", frames, remedy)
    alone = np.vstack([np.eye(points)] * (frames // points))
    signals = overlap.signals(noise, signal_e, limit)
    errors = [
        _error(overlap, shown, noise, signal, trials, rng)
        for shown, signal in zip((alone, overlap.code), signals, strict=True)
    ]
    return 5 * math.log10(errors[0] / errors[1])


def _error(
    overlap: _Overlap, code: Array, noise: SensorNoise, signal_e: float, trials: int, rng: np.random.Generator
) -> float:
    """Return the mean squared error of the entries, measured on simulated series of frames."""
    light, inverse, total = np.maximum(overlap.light, 0), np.linalg.pinv(code) / signal_e, 0.0
    for _ in range(trials):
        response = 1 + noise.prnu * rng.standard_normal(light.shape[1])  # of a pixel, the same in all its frames
        seen = rng.poisson(np.maximum(code @ light * signal_e * response, 0)).astype(float)
        seen += math.sqrt(noise.additive_e2) * rng.standard_normal(seen.shape)
        total += float(((inverse @ seen - light)[overlap.entries] ** 2).mean())
    return total / trials


class _Overlap:
    """Overlapping patterns, the code that lights them, and the resulting noise.

    Attributes
    ----------
    light
        Light ``(points, pixels)`` divided by the brightest entry, 0 where a point has none.
    entries
        Mask of the same shape: true where a point has an entry.
    code
        Code ``(frames, points)``.
    shape
        Shape of the patterns, ``(points, rows, columns)``.
    """

    def __init__(self, patterns: ArrayLike, code: ArrayLike) -> None:
        given, self.code = np.asarray(patterns, float), np.asarray(code, float)
        good = given.ndim == 3 and given.size and not np.isinf(given).any() and np.nanmax(given, initial=-1.0) > 0
        if not good:
            raise InputError.expected(
                "patterns",
                "an array (points, rows, columns) that contains light",
                array_words(given),
                "choose recorded positions",
            )
        points = len(given)
        fits = self.code.ndim == 2 and self.code.shape[1] == points and np.isfinite(self.code).all()
        if not fits or self.code.min() < 0 or self.code.max() > 1:
            raise InputError.expected(
                "code",
                f"values from 0 to 1, shape (frames, {points})",
                array_words(self.code),
                "give one column for each point",
            )
        if np.linalg.matrix_rank(self.code) < points:
            raise InputError.expected(
                "code", "a code that separates all points", "one that does not", "choose more frames"
            )
        self.shape, flat = given.shape, given.reshape(points, -1)
        self.entries: NDArray[np.bool_] = ~np.isnan(flat)
        if not self.entries.any(axis=1).all():
            raise InputError.expected(
                "patterns", "some light for every point", "no entries for one point", "omit this point"
            )
        self.light: Array = np.where(self.entries, flat, 0.0) / np.nanmax(given)

    def signals(self, noise: SensorNoise, signal_e: float, limit: str) -> tuple[float, float]:
        """Return the electrons of the brightest entry in the frame of a single point, and in the coded frames."""
        full = noise.full_e / float((self.code @ self.light).max())
        return (signal_e, min(signal_e, full)) if limit == "time" else (noise.full_e, full)

    def variances(self, noise: SensorNoise, signals: tuple[float, float]) -> tuple[Array, Array]:
        """Return the variance of each entry with single points and with the code, relative to the brightest entry."""
        random, (frames, points) = SensorNoise(noise.full_e, noise.additive_e2), self.code.shape
        # same number of frames: single points are repeated, which does not reduce the fixed pattern
        single = random.variance(self.light * signals[0]) / signals[0] ** 2 * points / frames
        coded = np.linalg.pinv(self.code) ** 2 @ random.variance(self.code @ self.light * signals[1]) / signals[1] ** 2
        fixed = (noise.prnu * self.light) ** 2
        return single + fixed, np.asarray(coded + fixed)

    def numbers(self, single: Array, coded: Array, signals: tuple[float, float]) -> CodingNumbers:
        """Return the gains over all, bright and dark entries."""
        share = self.light / np.maximum(self.light.max(axis=1, keepdims=True), 1e-300)

        def over(chosen: NDArray[np.bool_]) -> float:
            some = chosen & self.entries
            return 5 * math.log10(float(single[some].mean()) / float(coded[some].mean())) if some.any() else math.nan

        return CodingNumbers(
            rms_db=over(self.entries),
            core_db=over(share >= CORE),
            dark_db=over(share <= DARK),
            better=float((single > coded)[self.entries].mean()),
            exposure=signals[1] / signals[0],
            peak_e=float((self.code @ self.light).max()) * signals[1],
        )
