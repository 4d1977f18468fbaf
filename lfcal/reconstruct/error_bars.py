"""Error bars of a reconstructed volume, by a parametric bootstrap.

Random objects that resemble the volume, but contain finer details (`ObjectModel`), are imaged with noise and
reconstructed with the same settings. The differences between these reconstructions and their objects are samples of
the error of the volume. They include noise, what the iterations have not yet found, and what H cannot image. The same
samples show which parts of a volume are unknown: there, the error is as large as the details of the objects.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfcal.base import Clock, InputError, Work, check_number, drained
from lfcal.reconstruct._replicates import Imaging, ObjectModel, Replicates, SampleNoise, blurred
from lfcal.reconstruct.margin import cropped
from lfcal.reconstruct.projectors import Projector
from lfcal.reconstruct.solvers import SolverChoice
from lfcal.records import BootstrapSettings

__all__ = [
    "BLURS",
    "KNOWN",
    "UNKNOWN",
    "ErrorBars",
    "ErrorSums",
    "RegionSum",
    "check_bars",
    "error_bars",
    "iter_error_bars",
]

BLURS = (0.0, 1.0, 2.0, 4.0)
"""Standard deviations of the Gaussians that blur details and errors, to compare them at several scales (voxels)."""

KNOWN = 0.3
"""Relative error of details (kappa) below which they are resolved."""

UNKNOWN = 0.9
"""Relative error of details (kappa) above which a volume contains no information about them."""

AVERAGING = 3.0
"""Standard deviation of the Gaussian over which kappa is averaged (voxels)."""

NEAR = 1.5
"""Standard deviation of the Gaussian over which the variance of neighbours is averaged (voxels)."""

NEAR_WEIGHT = 4.0
"""Weight of the neighbours' variance, as a number of replicates.

The variance of a few replicates scatters, and bars of 95 % are then too short for the voxels where it happens to be
small. A larger weight makes the bars of isolated bright voxels too long.
"""


def student(level: float, count: int) -> float:
    """Return half the width of an interval of probability ``level``, in units of sigma.

    It is the quantile of Student's t distribution with ``count`` degrees of freedom, for a sigma that is estimated from
    ``count`` replicates.

    Raises
    ------
    InputError
        If the level is not between 0 and 1.
    """
    from scipy.special import stdtrit

    check_number("probability of an interval", level, above=0, below=1)
    return float(stdtrit(count, 0.5 + level / 2))


@dataclass(frozen=True, slots=True)
class RegionSum:
    """Sum of a volume over a region, with its uncertainty.

    Attributes
    ----------
    label
        Label of the region, a positive integer.
    planes
        First and last plane of the region, from 0.
    voxels
        Number of voxels.
    total
        Sum over the region (the units of the volume).
    sigma
        Standard uncertainty of the sum, from all causes.
    noise, h, object
        Parts of `sigma` that add up to it in quadrature: due to the noise of the frame, to errors of H, and to the
        object. The last is caused by the limited number of iterations, and by what H cannot image.
    replicates
        Number of replicates that `sigma` is estimated from.
    """

    label: int
    planes: tuple[int, int]
    voxels: int
    total: float
    sigma: float
    noise: float
    h: float
    object: float
    replicates: int

    def interval(self, level: float = 0.95) -> tuple[float, float]:
        """Return the ends of the interval that contains the true sum with probability ``level``; both at least 0."""
        half = student(level, self.replicates) * self.sigma
        return max(0.0, self.total - half), max(0.0, self.total + half)


@dataclass(frozen=True, eq=False)
class ErrorBars:
    """Reconstructed volume with the uncertainty of every voxel.

    Attributes
    ----------
    volume
        Volume ``(nz, Y, X)``.
    sigma
        Standard uncertainty of every voxel, ``(nz, Y, X)``, in the units of the volume.
    kappa
        Rms error of details of a voxel's size, relative to the rms of these details, averaged over neighbours,
        ``(nz, Y, X)``. It is 0 if they are known exactly, and about 1 if nothing is known about them.
    resolution
        Standard deviation (voxels) of the narrowest Gaussian of `BLURS`, ``(nz, Y, X)``, that leaves a relative error
        below `KNOWN` when error and details are blurred with it. It is NaN if there is none.
    regions
        Sum over each labelled region, in ascending order of labels.
    replicates
        Number of replicates.
    notes
        Remarks on the frame and its noise.

    Examples
    --------
    >>> import numpy as np
    >>> from lfcal.reconstruct import ErrorBars, Projector, error_bars
    >>> P = Projector(np.array([1, 2, 1]).reshape(1, 1, 1, 1, 3) / 4, (1, 40))
    >>> frame = P.forward(np.where(np.arange(40) // 10 == 1, 400.0, 20.0).reshape(1, 1, 40))
    >>> bars: ErrorBars = error_bars(P, frame)
    >>> low, high = bars.interval(0.95)
    >>> print(bars.sigma.shape, bool((low <= bars.volume).all()), len(bars.regions))
    (1, 1, 40) True 0
    """

    volume: NDArray[np.float32]
    sigma: NDArray[np.float32]
    kappa: NDArray[np.float32]
    resolution: NDArray[np.float32]
    regions: tuple[RegionSum, ...]
    replicates: int
    notes: tuple[str, ...] = ()

    def interval(self, level: float = 0.95) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Return lower and upper ends ``(nz, Y, X)`` of the intervals of probability ``level`` (0 to 1), at least 0."""
        half = np.float32(student(level, self.replicates)) * self.sigma
        return np.maximum(self.volume - half, 0), np.maximum(self.volume + half, 0)

    @property
    def unknown(self) -> NDArray[np.bool_]:
        """Mask ``(nz, Y, X)``, True at voxels whose `kappa` exceeds `UNKNOWN`: nothing is known about their details."""
        return self.kappa > UNKNOWN

    @property
    def unknown_share(self) -> float:
        """Fraction of the voxels with a known `kappa` that are `unknown`."""
        return float(np.mean(self.unknown, where=np.isfinite(self.kappa)))


def check_bars(choice: SolverChoice, what: str = "a reconstruction with error bars") -> None:
    """Raise `InputError` unless ``choice`` fixes the number of iterations; ``what`` names the run in the message."""
    if choice.auto or choice.tolerance > 0:
        setting, given = ("iterations", "auto") if choice.auto else ("tolerance", str(choice.tolerance))
        raise InputError.expected(
            f"{setting} of {what}",
            "a fixed number of iterations, so that all reconstructions are alike",
            given,
            "give a number of iterations, such as 60",
        )


USUAL = SolverChoice("rl-nesterov", iterations=60)
"""Default solver: with fewer iterations, the bars depend more on the assumed contrast of the objects."""


def check_labels(labels: ArrayLike | None, shape: tuple[int, int, int]) -> NDArray[np.int64] | None:
    """Return ``labels`` for every voxel of a volume of ``shape`` ``(nz, Y, X)``; labels ``(Y, X)`` apply to all planes.

    None if ``labels`` is None.

    Raises
    ------
    InputError
        If the labels are not integers of at least 0, have another shape, or label no voxel.
    """
    if labels is None:
        return None
    found = np.asarray(labels)
    if found.shape not in (shape, shape[1:], (1, *shape[1:])):
        raise InputError.expected(
            "labels of regions", f"shape {shape} or {shape[1:]}", found.shape, "label the voxels of this volume"
        )
    if found.dtype.kind not in "iub" and not (np.isfinite(found).all() and (found == np.round(found)).all()):
        raise InputError.expected(
            "labels of regions", "integers", "fractions, NaN or infinity", "give an image of integer labels"
        )
    whole = np.broadcast_to(found.astype(np.int64), shape)
    wanted = "0 outside of regions, and positive integers inside"
    if whole.min() < 0:
        raise InputError.expected("labels of regions", wanted, whole.min(), "replace the negative labels")
    if whole.max() < 1:
        raise InputError.expected("labels of regions", wanted, "only zeros", "label at least one region")
    return whole


def is_split(k: int, *, regions: bool, uncertain: bool) -> bool:
    """Return whether the errors of sums in replicate ``k`` (from 0) are split into noise, H and object.

    A split takes one more reconstruction, or two more if H is ``uncertain``. Without ``regions``, nothing is split.
    """
    return regions and k % (4 if uncertain else 3) == 0


def runs_of(choice: SolverChoice, settings: BootstrapSettings, *, regions: bool, uncertain: bool) -> int:
    """Return the number of reconstructions for error bars.

    It is one for the frame, one for each replicate, and one more if ``choice`` does not state the noise.
    ``choice`` and ``settings`` are as in `iter_error_bars`, and the other arguments as in `is_split`.
    """
    split = sum(is_split(k, regions=regions, uncertain=uncertain) for k in range(settings.replicates))
    return (1 if SampleNoise.of(choice) else 2) + settings.replicates + (1 + uncertain) * split


class ErrorSums:
    """Sums over replicates, from which `ErrorBars` are computed.

    Parameters
    ----------
    volume
        Reconstructed volume ``(nz, Y, X)``, without margin.
    mean
        Expected object of the replicates ``(nz, Y, X)``, as in `ObjectModel`, without margin.
    labels
        Label of every voxel, ``(nz, Y, X)``; 0 outside of regions. None: no regions.
    """

    def __init__(self, volume: NDArray[Any], mean: NDArray[Any], labels: NDArray[np.int64] | None) -> None:
        self._volume, self._mean = volume, mean
        # numbered without gaps, because labels may be as large as 32 bits allow
        self._names, found = np.unique(np.zeros(1) if labels is None else labels, return_inverse=True)
        self._labels = None if labels is None else found.reshape(volume.shape)
        self._errors = [np.zeros(volume.shape, np.float32) for _ in BLURS]
        self._details = [np.zeros(volume.shape, np.float32) for _ in BLURS]
        self._regions: list[NDArray[np.float64]] = []
        self._parts: list[NDArray[np.float64]] = []

    @property
    def count(self) -> int:
        """Number of replicates so far."""
        return len(self._regions)

    def add(
        self,
        made: NDArray[Any],
        drawn: NDArray[Any],
        quiet: NDArray[Any] | None = None,
        exact: NDArray[Any] | None = None,
    ) -> None:
        """Add a replicate.

        Parameters
        ----------
        made, drawn
            Reconstruction and object of the replicate, ``(nz, Y, X)``.
        quiet
            Reconstruction of the same object from a frame without noise. None: not computed.
        exact
            Reconstruction of the same object with the exact H, also without noise. None: H has no errors, and
            ``quiet`` is used.
        """
        error = np.asarray(made, np.float32) - drawn
        detail = drawn - self._mean
        for k, width in enumerate(BLURS):
            self._errors[k] += blurred(error, width) ** 2
            self._details[k] += blurred(detail, width) ** 2
        self._regions.append(self._sums(error))
        if quiet is not None:
            steps = (np.asarray(made, np.float32), quiet, quiet if exact is None else exact, drawn)
            self._parts.append(np.array([self._sums(a - b) for a, b in itertools.pairwise(steps)]))

    def _sums(self, volume: NDArray[Any]) -> NDArray[np.float64]:
        """Return the sums of ``volume`` over the regions, in the order of their labels."""
        if self._labels is None:
            return np.zeros(0)
        return np.bincount(self._labels.ravel(), volume.ravel()).astype(np.float64)

    def result(self, notes: Sequence[str] = ()) -> ErrorBars:
        """Return the error bars from all replicates so far, with the remarks ``notes``."""
        kappas = [self._kappa(k) for k in range(len(BLURS))]
        resolution = np.full(self._volume.shape, np.nan, np.float32)
        for width, kappa in reversed(list(zip(BLURS, kappas, strict=True))):
            resolution[kappa < KNOWN] = width
        return ErrorBars(
            np.asarray(self._volume, np.float32),
            self._sigma(),
            kappas[0],
            resolution,
            self._region_sums(),
            self.count,
            tuple(notes),
        )

    def _kappa(self, k: int) -> NDArray[np.float32]:
        error, detail = blurred(self._errors[k], AVERAGING), blurred(self._details[k], AVERAGING)
        return np.sqrt(error / np.maximum(detail, np.finfo(np.float32).tiny))

    def _sigma(self) -> NDArray[np.float32]:
        """Return the standard uncertainty of every voxel; its variance is shrunk towards that of its neighbours."""
        from scipy.special import digamma

        n = self.count
        # relative to the expected object, neighbours have similar variances
        variance = self._errors[0] / n / np.maximum(self._mean, np.finfo(np.float32).tiny) ** 2
        # the mean logarithm of the variance of n samples is too low by this
        bias = float(digamma(n / 2)) - math.log(n / 2)
        near = np.exp(blurred(np.log(np.maximum(variance, 1e-12)), NEAR) - bias)
        return np.asarray(self._mean * np.sqrt((n * variance + NEAR_WEIGHT * near) / (n + NEAR_WEIGHT)), np.float32)

    def _region_sums(self) -> tuple[RegionSum, ...]:
        if self._labels is None:
            return ()
        totals, counts = self._sums(self._volume), np.bincount(self._labels.ravel())
        sigmas = np.sqrt(np.mean(np.square(self._regions), axis=0))
        parts = self._shares() * sigmas
        found = []
        for k, label in enumerate(self._names):
            if label:
                planes = np.flatnonzero((self._labels == k).any(axis=(1, 2)))
                ends = int(planes[0]), int(planes[-1])
                noise, h, own = (float(one) for one in parts[:, k])
                total, sigma = float(totals[k]), float(sigmas[k])
                found.append(RegionSum(int(label), ends, int(counts[k]), total, sigma, noise, h, own, self.count))
        return tuple(found)

    def _shares(self) -> NDArray[np.float64]:
        """Return the parts of the uncertainty of each region relative to the whole, ``(3, regions)``; NaN: unknown."""
        if not self._parts:
            return np.full((3, len(self._names)), np.nan)
        squares = np.mean(np.square(self._parts), axis=0)
        found: NDArray[np.float64] = np.sqrt(squares / np.maximum(squares.sum(axis=0), np.finfo(np.float64).tiny))
        return found


def iter_error_bars(
    P: Projector,
    image: ArrayLike,
    choice: SolverChoice = USUAL,
    settings: BootstrapSettings | None = None,
    *,
    weights: ArrayLike | None = None,
    labels: ArrayLike | None = None,
    imaging: Imaging | None = None,
) -> Work[ErrorBars]:
    """Reconstruct ``image``; return `ErrorBars` for every voxel and for the sums over labelled regions.

    The number of reconstructions is one for the volume, one for each replicate, and one more if the noise is unknown.
    With ``labels``, some replicates are also reconstructed without noise to find the contributions of noise, H and
    object. If H has errors, they are also reconstructed with the exact H.

    Parameters
    ----------
    P
        Projector of H for the shape of the image, extended by the margin of ``choice`` on each side. If the noise of H
        is known, each replicate is reconstructed with an H to which different random noise is added.
    image
        Image ``(Y, X)`` in counts.
    choice
        Solver and its settings, with a fixed number of iterations. If it states neither the gain nor the noise, the
        noise is estimated from the residual of the volume.
    settings
        Number, contrast and seed of the replicates. None: the defaults.
    weights
        Weight of each pixel, ``(Y, X)``, not negative. None: 1.
    labels
        Label of every voxel, ``(nz, Y, X)`` or ``(Y, X)`` for all planes: positive integers inside regions, else 0.
    imaging
        Function that draws an H from its uncertainty with a random generator, and returns a projector of it, of which
        only ``forward`` is used. It is called for each replicate, and the drawn H images this replicate. None: ``P``
        images all replicates.

    Raises
    ------
    InputError
        If the image, the weights or the labels do not fit the projector, the number of iterations is not fixed, or the
        image has no light above the background.

    Examples
    --------
    >>> import numpy as np
    >>> from lfcal.reconstruct import BootstrapSettings, Projector, SolverChoice, iter_error_bars
    >>> P = Projector(np.array([1, 2, 1]).reshape(1, 1, 1, 1, 3) / 4, (1, 20))
    >>> choice, settings = SolverChoice("rl", iterations=3, gain=1), BootstrapSettings(replicates=3)
    >>> print([step.note for step in iter_error_bars(P, np.full((1, 20), 50.0), choice, settings)][::3])
    ['volume', 'replicate 1', 'replicate 2', 'replicate 3']
    """
    own = BootstrapSettings() if settings is None else settings
    check_bars(choice)
    runs = Replicates.of(P, image, choice, weights, imaging)
    nz, rows, columns = P.volume_shape
    regions = check_labels(labels, (nz, rows - 2 * choice.margin, columns - 2 * choice.margin))
    kind = {"regions": regions is not None, "uncertain": runs.uncertain}
    clock = Clock("error bars", choice.iterations * runs_of(choice, own, **kind))
    result = yield from runs.iter_volume(clock, "volume")
    volume = result.volume
    model = ObjectModel.of(volume, own.contrast)
    noise, notes = yield from runs.iter_noise(clock, choice.iterations, volume)
    sums = ErrorSums(cropped(volume, choice.margin), cropped(model.mean, choice.margin), regions)
    done = choice.iterations * (1 if SampleNoise.of(choice) else 2)
    for k in range(own.replicates):
        split = is_split(k, **kind)
        found = yield from runs.iter_replicate(clock, done, model, noise, (own.seed, k), split=split)
        sums.add(*(cropped(one, choice.margin) for one in found))
        done += (1 + (1 + runs.uncertain) * split) * choice.iterations
    return sums.result((*result.notes, *notes))


error_bars = drained(
    iter_error_bars,
    """
    Examples
    --------
    >>> import numpy as np
    >>> from lfcal.reconstruct import BootstrapSettings, Projector, RegionSum, SolverChoice, error_bars
    >>> P = Projector(np.array([1, 2, 1]).reshape(1, 1, 1, 1, 3) / 4, (1, 40))
    >>> truth = np.where(np.arange(40) // 10 == 1, 900.0, 100.0).reshape(1, 1, 40)
    >>> frame = np.random.default_rng(1).poisson(P.forward(truth))
    >>> bars = error_bars(P, frame, SolverChoice("rl", iterations=20, gain=1), labels=truth > 500)
    >>> region: RegionSum = bars.regions[0]
    >>> low, high = region.interval(0.95)
    >>> print(region.voxels, low < 9000 < high, region.noise < region.sigma)
    10 True True
    """,
)
