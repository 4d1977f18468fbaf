"""Measure ringing, error, time and modulation transfer of reconstruction routes and filters."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfcal.base import Clock, InputError, Work, check_choice, drained
from lfcal.multiplex._demosaicing import can_estimate
from lfcal.multiplex.demultiplexing import demultiplex, multiplex
from lfcal.multiplex.filters import COLOUR_FILTERS, SPATIAL_FILTERS
from lfcal.multiplex.modulator import Modulator

__all__ = [
    "WAYS",
    "FilterTrial",
    "Transfer",
    "iter_measure_filters",
    "measure_filters",
    "modulation_transfer",
    "ringing",
]

WAYS = (*(("spatial", name) for name in SPATIAL_FILTERS), ("fourier", "sinc"))
"""All pairs of route and filter that suit every modulator."""


def ways_of(modulator: Modulator) -> tuple[tuple[str, str], ...]:
    """Return the pairs of route and filter that can reconstruct the frames of ``modulator``.

    These are `WAYS`; for colour filter arrays, their special filters are inserted before the Fourier route.
    """
    colour = can_estimate(modulator, modulator.side)
    return (*WAYS[:-1], *(("spatial", name) for name in COLOUR_FILTERS if colour), WAYS[-1])


@dataclass(frozen=True, slots=True)
class Ringing:
    """Oscillation at sharp edges, relative to the range of each sample in the scene.

    Attributes
    ----------
    flat
        Rms error where the scene is uniform within a distance of two super-pixels, averaged over the samples.
    overshoot
        Largest excursion beyond the range of the scene's values, averaged over the samples.
    """

    flat: float
    overshoot: float


def ringing(result: ArrayLike, truth: ArrayLike, side: tuple[int, int]) -> Ringing:
    """Return oscillations and overshoot at edges of reconstructed samples, compared with the scene.

    The border of the image and samples that are constant in the scene are excluded.

    Parameters
    ----------
    result, truth
        Reconstructed samples and true samples of the scene, both ``(N, rows, columns)`` with one value for each pixel.
    side
        Rows and columns of a super-pixel (px).

    Raises
    ------
    InputError
        If the shapes differ, or the scene has no edges or no uniform parts.

    Examples
    --------
    >>> import numpy as np
    >>> from lfcal.multiplex import cfa, demultiplex, multiplex, ringing
    >>> scene, bayer = np.zeros((3, 64, 64)), cfa("Bayer")
    >>> scene[:, :, 32:] = 1  # an edge
    >>> for route, filter in (("fourier", "sinc"), ("spatial", "linear")):
    ...     found = demultiplex(multiplex(scene, bayer), bayer, route=route, filter=filter, samples=(2, 2), workers=1)
    ...     print(f"{filter}: {ringing(found, scene, bayer.side).overshoot:.2f} beyond the scene's range")
    sinc: 0.11 beyond the scene's range
    linear: 0.00 beyond the scene's range
    """
    from scipy.ndimage import maximum_filter, minimum_filter

    seen, scene = np.asarray(result, float), np.asarray(truth, float)
    if seen.shape != scene.shape or seen.ndim != 3:
        raise InputError.expected(
            "reconstruction", f"the scene's shape {scene.shape}", seen.shape, "give arrays of the same shape"
        )
    size = (1, 4 * side[0] + 1, 4 * side[1] + 1)
    span = np.ptp(scene, axis=(1, 2))
    even = (maximum_filter(scene, size) - minimum_filter(scene, size)) <= 1e-9 * max(float(span.max()), 1e-300)
    inner = _inside(scene.shape[1:], side)
    even &= inner
    lit = span > 0
    if not lit.any() or not even[lit].any():
        raise InputError.expected(
            "scene", "edges, and uniform areas between them", "none", "choose a scene with uniform areas"
        )
    flat, over = [], []
    for one, true, here, reach in zip(seen[lit], scene[lit], even[lit], span[lit], strict=True):
        flat.append(np.sqrt(np.mean((one - true)[here] ** 2)) / reach if here.any() else 0.0)
        middle = one[inner]
        over.append(max(middle.max() - true.max(), true.min() - middle.min(), 0.0) / reach)
    return Ringing(float(np.mean(flat)), float(np.mean(over)))


def _inside(shape: tuple[int, ...], side: tuple[int, int]) -> NDArray[np.bool_]:
    """Return a mask of the pixels more than four super-pixels (or a quarter of a small frame) from the border."""
    inside = np.zeros(shape, bool)
    cut = [min(4 * s, n // 4) for n, s in zip(shape, side, strict=True)]
    inside[cut[0] : shape[0] - cut[0], cut[1] : shape[1] - cut[1]] = True
    return inside


@dataclass(frozen=True, slots=True)
class FilterTrial:
    """Error and time of reconstructing a scene by one route and filter.

    Attributes
    ----------
    route, filter
        Route and filter of the reconstruction, as in `demultiplex`.
    seconds
        Shortest elapsed time of all runs (s).
    error
        Rms error of the samples, excluding the border, divided by the range of values of the scene.
    ringing
        Oscillations and overshoot at edges; None if the scene has no uniform parts.
    efficient
        Whether no other combination of route and filter is more accurate and at least as fast.

    Examples
    --------
    >>> import numpy as np
    >>> from lfcal.multiplex import FilterTrial, cfa, measure_filters
    >>> scene = np.tile(np.repeat([0.2, 0.8], 32), (3, 64, 1))  # an edge
    >>> trial: FilterTrial = measure_filters(scene, cfa("Bayer"), ways=[("fourier", "sinc")], rounds=1, workers=1)[0]
    >>> print(f"{trial.name}: error {trial.error:.2f}, overshoot {trial.ringing.overshoot:.2f}")
    Fourier: error 0.08, overshoot 0.11
    """

    route: str
    filter: str
    seconds: float
    error: float
    ringing: Ringing | None
    efficient: bool = False

    @property
    def name(self) -> str:
        """Display name of route and filter."""
        return "Fourier" if self.route == "fourier" else f"spatial, {self.filter}"


def iter_measure_filters(
    scene: ArrayLike,
    modulator: Modulator,
    *,
    ways: Sequence[tuple[str, str]] | None = None,
    noise: NDArray[Any] | float = 0.0,
    rounds: int = 3,
    workers: int | None = None,
) -> Work[list[FilterTrial]]:
    """Return the error and the time of reconstructing a scene at every pixel by several methods (`FilterTrial`).

    Parameters
    ----------
    scene
        Plenoptic samples of the scene at every pixel, ``(N, rows, columns)``.
    modulator
        Modulator that records the scene.
    ways
        Pairs ``(route, filter)``. None: those that suit the modulator (`ways_of`).
    noise
        Noise that is added to the frame, in its units: an array ``(rows, columns)``, or one number for all pixels.
    rounds
        Number of runs for each pair in addition to the first one, which may include compilation; the shortest time is
        returned.
    workers
        Number of threads. None: one for each available CPU core.

    Yields
    ------
    Progress
        Counted in pairs of route and filter.
    """
    truth = np.asarray(scene, float)
    frame = multiplex(truth, modulator) + noise
    inner = _inside(truth.shape[1:], modulator.side)
    span = float(np.ptp(truth)) or 1.0
    ways = ways_of(modulator) if ways is None else ways
    clock, trials = Clock("filters", len(ways)), []
    for k, (route, name) in enumerate(ways):
        yield clock.at(k, f"{route} {name}")
        seconds, result = np.inf, truth
        for _ in range(rounds + 1):  # the first one compiles
            start = time.perf_counter()
            result = demultiplex(frame, modulator, route=route, filter=name, samples=modulator.side, workers=workers)
            seconds = min(seconds, time.perf_counter() - start)
        error = float(np.sqrt(np.mean((result - truth)[:, inner] ** 2))) / span
        try:
            rings: Ringing | None = ringing(result, truth, modulator.side)
        except InputError:
            rings = None
        trials.append(FilterTrial(route, name, seconds, error, rings))
    yield clock.at(len(ways))
    return [_marked(trial, trials) for trial in trials]


measure_filters = drained(
    iter_measure_filters,
    """
    Examples
    --------
    >>> import numpy as np
    >>> from lfcal.multiplex import cfa, measure_filters
    >>> scene = np.tile(np.cos(np.arange(48) / 2), (3, 48, 1))
    >>> ways = [("spatial", "nearest"), ("spatial", "linear"), ("spatial", "cubic")]
    >>> for trial in measure_filters(scene, cfa("Bayer"), ways=ways, rounds=1, workers=1):
    ...     print(f"{trial.name}: error {trial.error:.3f}")
    spatial, nearest: error 0.113
    spatial, linear: error 0.028
    spatial, cubic: error 0.005
    """,
)


def _marked(trial: FilterTrial, trials: list[FilterTrial]) -> FilterTrial:
    beaten = any(t.seconds <= trial.seconds and t.error < trial.error for t in trials if t is not trial)
    return FilterTrial(trial.route, trial.filter, trial.seconds, trial.error, trial.ringing, not beaten)


Array = NDArray[np.float64]

CELLS = 24
"""Number of super-pixels along the wave; frequencies are rounded to whole waves over this length."""


@dataclass(frozen=True, eq=False)
class Transfer:
    """Modulation transfer of a modulator and its reconstruction.

    Attributes
    ----------
    frequencies
        Spatial frequencies of the test waves, ``(n,)`` (cycles/px).
    transfer
        Ratio of the reconstructed to the original amplitude of each of the N samples, ``(N, n)``.
    aliased
        Rms of all spurious components that a wave produces, at other frequencies and in other samples, divided by the
        rms of the wave, ``(N, n)``.

    Examples
    --------
    >>> from lfcal.multiplex import Transfer, cfa, modulation_transfer
    >>> found: Transfer = modulation_transfer(cfa("Bayer"), [0.2], filter="linear")
    >>> print(found.frequencies.round(3))  # 10 waves over 48 pixels
    [0.208]
    >>> print(found.transfer[:, 0].round(2), "aliased", found.aliased[:, 0].round(2))  # red, green, blue
    [0.63 0.63 0.63] aliased [0.37 0.   0.37]
    """

    frequencies: Array = field(repr=False)
    transfer: Array = field(repr=False)
    aliased: Array = field(repr=False)


def modulation_transfer(
    modulator: Modulator,
    frequencies: ArrayLike,
    *,
    route: str = "spatial",
    filter: str | None = None,
    axis: str = "x",
) -> Transfer:
    """Return the modulation transfer of a modulator, measured with sine waves that modulate all samples equally.

    Samples that are 0 in `Modulator.light` contain no wave.

    Parameters
    ----------
    modulator
        Modulator that records the waves; no noise is added.
    frequencies
        Spatial frequencies (cycles/px), 0 to 1/2; they are rounded such that 24 super-pixels contain a whole number of
        periods.
    route, filter
        As in `lfcal.multiplex.demultiplex`.
    axis
        Direction in which the waves vary: ``"x"``, along a row, or ``"y"``, along a column.

    Examples
    --------
    >>> from lfcal.multiplex import cfa, modulation_transfer
    >>> found = modulation_transfer(cfa("Bayer"), [0, 0.125, 0.25], filter="linear")
    >>> print(found.transfer[0].round(3))  # red pixels, two apart: cos^2(pi f)
    [1.    0.854 0.5  ]
    """
    check_choice("axis", axis, ("x", "y"))
    wanted = np.atleast_1d(np.asarray(frequencies, float))
    if wanted.ndim != 1 or not wanted.size or not (wanted.min() >= 0 and wanted.max() <= 0.5):
        raise InputError.expected(
            "frequencies", "values from 0 to 0.5 cycles per pixel", wanted, "give frequencies up to that of Nyquist"
        )
    shape = tuple(s * (CELLS if (k == 0) == (axis == "y") else 8) for k, s in enumerate(modulator.side))
    length = shape[0 if axis == "y" else 1]
    waves = np.rint(wanted * length)
    light = np.abs(modulator.light)
    found = [_answer(modulator, shape, float(k), axis, light, route=route, filter=filter) for k in waves]
    transfer, aliased = (np.array(part).T for part in zip(*found, strict=True))
    return Transfer(waves / length, transfer, aliased)


def _answer(
    modulator: Modulator,
    shape: tuple[int, ...],
    waves: float,
    axis: str,
    light: Array,
    *,
    route: str,
    filter: str | None,
) -> tuple[Array, Array]:
    length = shape[0 if axis == "y" else 1]
    place = np.arange(length)
    results = []
    # a cosine and a sine, whose mean transfer does not depend on the phase of the pattern
    for shift in (0.0, 0.25) if 0 < waves < length / 2 else (0.0,):
        wave = np.cos(2 * np.pi * (waves * place / length + shift))
        field_ = np.broadcast_to(wave[:, None] if axis == "y" else wave, shape)
        frame = multiplex(light[:, None, None] * (1 + 0.5 * field_), modulator)
        samples = demultiplex(frame, modulator, route=route, filter=filter, samples=modulator.side)
        inner = tuple(slice(2 * s, n - 2 * s) for n, s in zip(shape, modulator.side, strict=True))
        seen = (samples / np.where(light > 0, light, 1.0)[:, None, None] - (light > 0)[:, None, None])[:, *inner] / 0.5
        results.append((_projected(seen, field_[inner]), seen, field_[inner]))
    transfer = np.mean([t for t, _, _ in results], axis=0)
    rest = [((s - t[:, None, None] * f) ** 2).mean((1, 2)) / float((f**2).mean()) for t, s, f in results]
    return transfer, np.sqrt(np.mean(rest, axis=0))


def _projected(seen: Array, wave: Array) -> Array:
    return np.asarray((seen * wave).sum((1, 2)) / float((wave**2).sum()))
