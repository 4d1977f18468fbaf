"""Comparison of patterns with the predictions of their camera, the basis for finding faults."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from lfcal.base import Clock, InputError, Work, check_number
from lfcal.camera import ScanPlan
from lfcal.fit import QUICK_PATTERN, Setup, of_quick_pattern, spread_out
from lfcal.judge._modelled import Starts, correlation, depths_seen, modelled, parts, windows_seen
from lfcal.judge._scatter import misfit, noise_of, rounding_of, start_of, variance_of
from lfcal.judge.expected import Behind, behind, plan_of
from lfcal.judge.quality import NOISELESS
from lfcal.psf import PSFMatrix, copied_positions
from lfcal.simulate.engines import EnergyError

__all__ = ["COLUMNS", "PATTERNS", "Evidence", "Unlike", "fitted", "iter_evidence", "iter_fitted", "patterns_of"]

F4 = NDArray[np.float32]
F8 = NDArray[np.float64]
Flags = NDArray[np.bool_]

COLUMNS = ("gain", "background", "source_y", "source_x", "window_y", "window_x", "depth")
"""Fitted parameters of each pattern: fraction of its light, counts, pixels of the source, pixels of the cutout, and the
shift of depth as a fraction of the virtual depth."""

CHANCE = 2
"""Largest number of evenly spread patterns with a rare fault; so few do not determine its frequency."""

CLIP = 4.0
"""Standard deviations above which a sample is not used in the fit of its pattern."""

APART = 0.3
"""Amount by which the correlation of a foreign pattern with its model is below the median correlation."""

APART_ASKED = 0.05
"""Value of `APART` for suspect patterns, whose information about the sensor is also in other patterns."""

ASIDE_PX, SOME = 0.4, 0.25
"""Displacement of single cutouts (pixels) above which their patterns are foreign, and the fraction of all patterns up
to which they count as single ones."""

DIMMEST = 0.25
"""Fraction of the samples, those with the least light, from which the noise of patterns is estimated."""

ROUNDS = 3
"""Number of fits of each pattern; after each, outliers are clipped and the noise is measured again."""


@dataclass(frozen=True, eq=False)
class Unlike:
    """Reason why the patterns of H cannot be compared with a camera.

    Attributes
    ----------
    reason
        Reason, as text.
    stated
        Whether a camera is stated but does not explain the patterns.
    camera
        The stated camera, if its patterns were computed; else None.
    correlation
        Median correlation of the patterns with those of the camera. None: not measured.

    Examples
    --------
    >>> import numpy as np
    >>> from lfcal.judge import Unlike, iter_evidence
    >>> from lfcal.base import drain
    >>> from lfcal.psf import PSFMatrix
    >>> found = drain(iter_evidence(PSFMatrix(np.ones((1, 3, 3, 5, 5)))))
    >>> if isinstance(found, Unlike):
    ...     print(found.reason)
    H has no camera
    """

    reason: str
    stated: bool = False
    camera: Behind | None = None
    correlation: float | None = None


@dataclass(frozen=True, eq=False)
class Evidence:
    """Some patterns of H, compared with the predictions of its camera.

    Attributes
    ----------
    matrix, plan
        H, and the plan of its scan.
    camera
        Camera with which the patterns are predicted.
    index
        Positions (z, y, x) of the n patterns, ``(n, 3)``.
    data, valid
        Values of the patterns, in the unit of H, and a mask that is True at valid values; both ``(n, nt, ns)``.
    model
        Predictions of the camera, as fractions of the light that passes the iris, ``(n, nt, ns)``.
    columns
        Derivatives of ``model`` with respect to the parameters `COLUMNS` after the first two, ``(n, 5, nt, ns)``.
    values, sigmas
        Best-fit parameters of each pattern and their standard deviations, ``(n, 7)`` in the order and the units of
        `COLUMNS`. In the fit, parameters after the first two multiply the product of a derivative and the gain of the
        pattern.
    variance
        Variance of each sample due to noise and the typical error of the model, ``(n, nt, ns)``.
    misfit
        Typical error of the model, as a fraction of the light (relative L2).
    starts
        Parameters at which the model and its derivatives were computed; the displacements in `values` are relative to
        them.
    asked
        Mask ``(n,)``, True for patterns that were included because they are suspect; the others are evenly spread.
    more_suspected
        Number of suspect positions that were not included; those included are the most suspect ones.
    rounding
        Variance of a value due to rounding.

    Examples
    --------
    >>> from lfcal.judge import Evidence, iter_evidence
    >>> from lfcal.base import drain
    >>> from lfcal.psf import open_psf
    >>> with open_psf("H.h5") as H:
    ...     evidence: Evidence = drain(iter_evidence(H, patterns=24))
    >>> print(evidence.data.shape, f"{evidence.unlike.sum()} patterns that do not belong to their positions")
    (24, 55, 55) 0 patterns that do not belong to their positions
    """

    matrix: PSFMatrix
    plan: ScanPlan
    camera: Behind
    index: NDArray[np.intp]
    data: F4
    valid: Flags
    model: F4
    columns: F4
    values: F8
    sigmas: F8
    variance: F4
    misfit: float
    starts: Starts
    asked: Flags
    rounding: float
    more_suspected: int = 0

    def __len__(self) -> int:
        """Return the number of patterns."""
        return len(self.index)

    def extent(self, which: NDArray[np.intp]) -> float:
        """Return the estimated fraction (0 to 1) of recorded positions that are affected like the patterns ``which``.

        ``which`` contains indices of patterns. The estimate uses the evenly spread patterns if more of them are
        affected than is likely by chance. It is at least the number of patterns in ``which`` divided by the number of
        recorded positions.
        """
        even = np.flatnonzero(~self.asked)
        hits = int(np.isin(even, which).sum())
        among = hits / even.size if hits > CHANCE else 0.0
        return max(among, len(which) / max(1, int((self.matrix.recorded > 0).sum())))

    def likely_extent(self, which: NDArray[np.intp]) -> float:
        """Return the result of `extent` for ``which``, corrected for suspect positions that were not compared.

        The fraction affected among them is assumed to equal that among the suspect positions that were compared.
        """
        asked = np.flatnonzero(self.asked)
        others = self.more_suspected * int(np.isin(asked, which).sum()) / max(1, asked.size)
        most = (len(which) + others) / max(1, int((self.matrix.recorded > 0).sum()))
        return max(self.extent(which), min(most, 1.0))

    def column(self, name: str) -> tuple[F8, F8]:
        """Return the values of parameter ``name`` of `COLUMNS`, relative to the plan, and their standard deviations.

        Both are ``(n,)``, in the unit of the parameter.
        """
        k = COLUMNS.index(name)
        return self.values[:, k] + self.starts.column(name, self.index[:, 0]), self.sigmas[:, k]

    @cached_property
    def light(self) -> F4:
        """Predictions of the camera times the gain of each pattern, ``(n, nt, ns)``."""
        return self.model * self.values[:, 0, None, None].astype(np.float32)

    @cached_property
    def left(self) -> F4:
        """Data minus the best fit of each pattern, ``(n, nt, ns)``; 0 at invalid values."""
        values = self.values.astype(np.float32)
        out = self.data - self.light - values[:, 1, None, None]
        for k in range(2, len(COLUMNS)):
            out -= (values[:, 0] * values[:, k])[:, None, None] * self.columns[:, k - 2]
        out[~self.valid] = 0.0
        return out

    @cached_property
    def weight(self) -> F4:
        """Inverse variance of each sample, ``(n, nt, ns)``; 0 at invalid values and in patterns that are `unlike`."""
        found: F4 = np.where(self.valid, 1.0 / self.variance, 0.0).astype(np.float32)
        found[self.unlike] = 0.0
        return found

    @cached_property
    def computed(self) -> bool:
        """Whether the patterns have so little noise that they must have been computed instead of recorded.

        The residuals of such patterns are errors of a model. Neither a sensor nor a codec affected them.
        """
        peak = float(self.light.max())
        inner = self.valid[:, :, 2:] & self.valid[:, :, 1:-1] & self.valid[:, :, :-2]
        inner &= self.light[:, :, 1:-1] <= np.quantile(self.light, DIMMEST)
        # second differences of neighbours, which are almost zero for smooth light
        bend = (self.data[:, :, 2:] - 2 * self.data[:, :, 1:-1] + self.data[:, :, :-2])[inner] / math.sqrt(6)
        noise = 1.4826 * float(np.median(np.abs(bend))) if bend.size else 0.0
        return max(noise, math.sqrt(self.rounding)) * NOISELESS < peak

    @cached_property
    def alike(self) -> F8:
        """Correlation of each pattern with the model at its position, ``(n,)``; 1 if they are proportional."""
        return correlation(np.where(self.valid, self.model, np.float32(0)), self.data)

    @cached_property
    def unlike(self) -> Flags:
        """Mask ``(n,)``, True for patterns that do not belong to their positions; these cannot show sensor faults."""
        seen = self.valid.any((1, 2))
        if not seen.any():
            return np.zeros(len(self), np.bool_)
        limit = np.median(self.alike[seen]) - np.where(self.asked, APART_ASKED, APART)
        return np.asarray((seen & (self.alike < limit)) | self._aside, np.bool_)

    @property
    def _aside(self) -> Flags:
        """Mask ``(n,)`` of the patterns whose cutouts are displaced from those of their plane, if these are few."""
        found = np.zeros(len(self), np.bool_)
        for name in ("window_y", "window_x"):
            values, sigmas = self.column(name)
            for z in np.unique(self.index[:, 0]):
                own = self.index[:, 0] == z
                off = np.abs(values[own] - np.median(values[own]))
                found[own] |= (off > ASIDE_PX) & (off > CLIP * sigmas[own])
        return found if found.mean() < SOME else np.zeros_like(found)

    def beyond(self, column: F4) -> tuple[F8, F8]:
        """Return the best-fit amplitude of ``column`` in the residuals of each pattern, and its standard deviation.

        Both are ``(n,)``; ``column`` is ``(n, nt, ns)``. The component of ``column`` that the fitted parameters explain
        is removed first. If nothing remains, the standard deviation is infinite.
        """
        values, sigmas = np.zeros(len(self)), np.full(len(self), np.inf)
        left, root = self.left, np.sqrt(self.weight)
        for k in range(len(self)):
            own = np.concatenate([self.model[k][None], np.ones_like(self.model[k])[None], self.columns[k]])
            a = (own * root[k]).reshape(len(COLUMNS), -1)
            size = np.sqrt(np.einsum("ij,ij->i", a, a, dtype=np.float64))
            a = a[size > 0] / size[size > 0, None].astype(np.float32)
            b = (column[k] * root[k]).ravel()
            before = float(b @ b)
            inverse = np.linalg.pinv((a @ a.T).astype(np.float64), rcond=1e-6, hermitian=True)
            b = b - (inverse @ (a @ b)).astype(np.float32) @ a
            r = np.clip((left[k] * root[k]).ravel(), -CLIP, CLIP)
            power = float(b @ b)
            if power > 1e-8 * before and power > 0:
                values[k], sigmas[k] = float(b @ r) / power, 1 / math.sqrt(power)
        return values, sigmas

    def with_data(self, data: F4, valid: Flags) -> Evidence:
        """Return new evidence with ``data`` and ``valid`` ``(n, nt, ns)`` at the same positions, fitted again."""
        data = np.where(valid, data, np.float32(0))
        model, columns, starts = self.model, self.columns, self.starts
        found = fitted(
            self.matrix,
            self.camera,
            self.index,
            data,
            valid,
            model=model,
            columns=columns,
            starts=starts,
            rounding=self.rounding,
        )
        return replace(found, asked=self.asked, more_suspected=self.more_suspected)

    def followed(self, values: F8 | None = None) -> Evidence:
        """Return new evidence whose predictions are computed at the apparent positions of the patterns.

        ``values`` ``(n, 7)`` are the parameters that define these positions. None: the parameters of this evidence.
        If the positions are close to those of the current predictions, this evidence is returned unchanged.
        """
        planes = self.index[:, 0]
        moved = self.starts.nearer(self.values if values is None else values, planes)
        again = moved.apart_from(self.starts, planes)
        if not again.any():
            return self
        starts, model, columns = self.starts.only(moved, again), self.model.copy(), self.columns.copy()
        for part in parts(self.index, np.flatnonzero(again)):
            model[part], columns[part] = modelled(self.camera, self.index[part], starts.of(part))
        return replace(self, model=model, columns=columns, starts=starts).with_data(self.data, self.valid)

    def corners(self) -> NDArray[np.intp]:
        """Return the first sensor pixel (row, column) of each cutout, relative to the first cutout of H, ``(n, 2)``."""
        return self.index[:, 1:].copy()


def fitted(
    matrix: PSFMatrix,
    known: Behind,
    index: NDArray[np.intp],
    data: F4,
    valid: Flags,
    *,
    model: F4,
    columns: F4,
    starts: Starts,
    rounding: float,
) -> Evidence:
    """Fit the model of each pattern to ``data`` ``(n, nt, ns)``, with the parameters `COLUMNS`; return the evidence.

    ``known`` is the camera. The other parameters are the attributes of `Evidence` with the same names.
    """
    n = len(index)
    values, sigmas = np.zeros((n, len(COLUMNS))), np.full((n, len(COLUMNS)), np.inf)
    variance = np.maximum(start_of(data, valid), np.float32(rounding))
    light = np.zeros_like(data)
    keep = valid.copy()
    for _ in range(ROUNDS):
        for k in range(n):
            values[k], sigmas[k], light[k] = _fit_one(data[k], keep[k], model[k], columns[k], variance[k])
        bright = np.maximum(model * values[:, 0, None, None], 0).astype(np.float32)
        variance, constant, slope = variance_of(data - light, bright, valid)
        # if noise is smaller than the steps of the values, most residuals are exactly zero
        variance = np.maximum(variance, np.float32(rounding))
        keep = valid & (np.square(data - light) < CLIP**2 * variance)
    noise = noise_of(matrix, index, bright, max(constant, rounding), slope)
    off = misfit(data - light, bright, valid, noise)
    return Evidence(
        matrix,
        known.plan,
        known,
        index,
        data,
        valid,
        model,
        columns,
        values,
        sigmas,
        variance,
        off,
        starts,
        np.zeros(n, np.bool_),
        rounding,
    )


def _fit_one(data: F4, keep: Flags, model: F4, columns: F4, variance: F4) -> tuple[F8, F8, F4]:
    """Return the best-fit parameters of one pattern, their standard deviations, and the fitted pattern."""
    root = np.where(keep, 1.0 / np.sqrt(variance), 0.0).astype(np.float32)
    x = np.concatenate([model[None], np.ones_like(model)[None], columns]).reshape(len(COLUMNS), -1)
    a = x * root.ravel()
    normal = (a @ a.T).astype(np.float64)
    size = np.sqrt(np.maximum(np.diag(normal), 0))
    used = size > 1e-9 * max(size[0], 1e-300)
    values, sigmas = np.zeros(len(COLUMNS)), np.full(len(COLUMNS), np.inf)
    if not used[0]:
        return values, sigmas, np.zeros_like(data)
    scaled = normal[np.ix_(used, used)] / np.outer(size[used], size[used])
    inverse = np.linalg.pinv(scaled, rcond=1e-6, hermitian=True)
    step = inverse @ ((a[used] @ (data * root).ravel()) / size[used]) / size[used]
    values[used] = step
    sigmas[used] = np.sqrt(np.maximum(np.diag(inverse), 0)) / size[used]
    fitted = (step.astype(np.float32) @ x[used]).reshape(data.shape)
    # displacements in pixels, depth as a share: derivatives of the pattern at its brightness
    gain = values[0] if abs(values[0]) > 1e-300 else 1.0
    values[2:] /= gain
    sigmas[2:] /= abs(gain)
    return values, sigmas, fitted


# -- choice of patterns to compare ---------------------------------------------------------------------------
MOST_SAMPLES = 6_000_000
"""Largest number of samples that are compared; each takes about forty bytes."""

PATTERNS = 60
"""Number of compared patterns, fixed so that a file has the same verdict on every machine."""

LEAST_FEW = 4
"""Number of recorded positions needed for a comparison."""

FEWEST = 24
"""Smallest number of patterns that are compared, whatever their size."""

TURNS = 3
"""Number of times that models are computed again at the fitted parameters."""

ALIKE = 0.5
"""Median correlation with the best fit above which patterns belong to the camera."""

LEAST, MOST = 1e-12, 1e15
"""Limits of the largest value of the patterns; beyond them, variances underflow or overflow in single precision."""


def iter_evidence(
    matrix: PSFMatrix,
    *,
    setup: Setup | None = None,
    patterns: int = PATTERNS,
    suspected: NDArray[np.intp] | None = None,
    more_suspected: int = 0,
) -> Work[Evidence | Unlike]:
    """Compare patterns of H with its camera, and return the evidence or the reason why they cannot be compared.

    The choice of patterns depends only on H and the arguments, so that results are reproducible.

    Parameters
    ----------
    matrix
        H.
    setup
        Setup with the camera of a fit. None: the camera stated in H.
    patterns
        Number of evenly spread patterns to compare; fewer if H has fewer, or if they are very large.
    suspected
        Suspect positions (z, y, x) that are also compared, ``(n, 3)``. None: there are none.
    more_suspected
        Number of further suspect positions that are not compared.

    Examples
    --------
    >>> from lfcal.judge import iter_evidence
    >>> from lfcal.base import drain
    >>> from lfcal.psf import open_psf
    >>> with open_psf("H.h5") as H:
    ...     evidence = drain(iter_evidence(H, patterns=24))
    >>> print(f"{len(evidence)} patterns, off by {evidence.misfit:.0%} of the light apart from noise")
    24 patterns, off by 1% of the light apart from noise
    """
    check_number("number of patterns to compare", patterns, at_least=1, integer=True)
    clock = Clock("comparing with the camera", 100)
    yield clock.at(0)
    recorded = np.argwhere((matrix.recorded > 0) & ~copied_positions(matrix))
    if len(recorded) < LEAST_FEW:
        return Unlike(f"only {len(recorded)} positions were recorded")
    if matrix.camera is None:
        return Unlike("H has no camera")
    if not matrix.camera.has_lattice:
        return Unlike("only cameras with a lenslet lattice can be compared; lfcal fit compares this one")
    if of_quick_pattern(matrix):
        return Unlike(QUICK_PATTERN, stated=True)
    if matrix.pixel_scale != (1.0, 1.0):
        return Unlike("H has resampled pixels; assemble it without resampling to compare it")
    try:
        known = _camera_behind(matrix, recorded, setup)
    except (InputError, EnergyError) as error:
        return Unlike(str(error), stated=True)
    if known is None:
        return Unlike("no engine can simulate its camera")
    many = min(patterns, max(FEWEST, MOST_SAMPLES // int(np.prod(matrix.cutout))), len(recorded))
    index = recorded[spread_out(recorded, many, matrix.period)] if many < len(recorded) else recorded
    asked = np.zeros(len(index), np.bool_)
    if suspected is not None and len(suspected):
        chosen = set(map(tuple, index.tolist()))
        odd = set(map(tuple, suspected.tolist())) & set(map(tuple, recorded.tolist()))
        index = np.array(sorted(chosen | odd), np.intp)
        asked = np.array([place not in chosen for place in map(tuple, index.tolist())], np.bool_)
    data, valid = patterns_of(matrix, index)
    largest = float(np.abs(data).max())
    if not data.max(initial=0.0) > 0:
        return Unlike("H shows no light")
    if not LEAST <= largest <= MOST:
        words = f"its largest value is {largest:.0e}, where {LEAST:.0e} to {MOST:.0e} is expected; scale H to counts"
        return Unlike(words, stated=True)
    found = yield from iter_fitted(matrix, known, index, data, valid, clock)
    yield clock.at(100)
    if not np.median(found.values[:, 0]) > 0:
        return Unlike("H has no light where its camera predicts some", stated=True, camera=known)
    alike = float(np.median(_alike(found)))
    if alike < ALIKE:
        words = f"patterns have little in common with those of the camera (correlation {alike:.2f})"
        return Unlike(words, stated=True, camera=known, correlation=alike)
    return replace(found, asked=asked, more_suspected=more_suspected)


def _camera_behind(matrix: PSFMatrix, recorded: NDArray[np.intp], setup: Setup | None) -> Behind | None:
    """Return the camera of H, or None if no engine can compute it; raise an error if it does not match H."""
    first = recorded[spread_out(recorded, LEAST_FEW, matrix.period)]
    plan = plan_of(matrix)  # raises an error if the description is wrong
    assert plan is not None
    known = behind(matrix, first) if setup is None else Behind(setup, plan, 0.0)
    if known is not None:
        modelled(known, first)
    return known


def patterns_of(matrix: PSFMatrix, index: NDArray[np.intp]) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Return the patterns ``(n, nt, ns)`` of H (``matrix``) at ``index`` ``(n, 3)``, and a mask of their valid samples.

    Invalid samples are set to 0.
    """
    data = np.stack([np.asarray(matrix[z, y, x], np.float32) for z, y, x in index.tolist()])
    valid = np.stack([matrix.valid(z, y, x) for z, y, x in index.tolist()]) & np.isfinite(data)
    data[~valid] = 0.0
    return data, valid


def iter_fitted(
    matrix: PSFMatrix,
    known: Behind,
    index: NDArray[np.intp],
    data: NDArray[np.float32],
    valid: NDArray[np.bool_],
    clock: Clock,
    *,
    elsewhere: bool = True,
) -> Work[Evidence]:
    """Fit models of the camera ``known`` to patterns of H (``matrix``), and return the evidence.

    The models are computed at the apparent source position, cutout and depth of each pattern. ``index``, ``data`` and
    ``valid`` are as in `Evidence`. ``clock`` counts hundredths of the work. If ``elsewhere``, the depths of the planes
    are also searched for far from their stated values.
    """
    model, columns = (np.empty((len(index), *shape), np.float32) for shape in (matrix.cutout, (5, *matrix.cutout)))
    starts = Starts.none(len(index), len(matrix))
    if elsewhere:
        starts = replace(starts, depth=depths_seen(known, index, data))
    for part in parts(index, np.arange(len(index))):
        model[part], columns[part] = modelled(known, index[part], starts.of(part))
        yield clock.at(int(80 * (part[-1] + 1) / len(index)))
    starts = replace(starts, window=windows_seen(index, data, model))
    again = starts.window.any(1)
    rounding = rounding_of(data, model, valid)
    for turn in range(TURNS):
        for part in parts(index, np.flatnonzero(again)):
            model[part], columns[part] = modelled(known, index[part], starts.of(part))
            yield clock.at(80 + 5 * turn)
        found = fitted(
            matrix, known, index, data, valid, model=model, columns=columns, starts=starts, rounding=rounding
        )
        moved = starts.nearer(found.values, index[:, 0])
        again = moved.apart_from(starts, index[:, 0])
        if not again.any():
            break
        starts = starts.only(moved, again)
    return found


def _alike(found: Evidence) -> F8:
    """Return the correlation ``(n,)`` of each pattern with its best fit."""
    return correlation(np.where(found.valid, found.data - found.left, np.float32(0)), found.data)
