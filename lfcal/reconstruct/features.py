"""Beads and lines, fitted on a frame with their uncertainties.

A reconstructed volume is smoother than its object, and its errors are those of an inverse problem. Positions and
brightness of a few features with a known shape are therefore measured on the frame itself, several times more
precisely. All other light is the *rest*: it is reconstructed with the features as background, and its error is a part
of the uncertainty of the features.
"""

from __future__ import annotations

import math
from collections.abc import Generator, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfcal.base import Clock, InputError, Progress, Work, check_number, drained
from lfcal.reconstruct._feature_fit import DRAWS, Covariance, FeatureImages, FeatureScene, misfits, solution
from lfcal.reconstruct._feature_shapes import BEAD, BEYOND, NARROWEST, WIDEST, Shape
from lfcal.reconstruct._replicates import FAINTEST, Imaging, ObjectModel, Replicates, SampleNoise, blurred
from lfcal.reconstruct._uncertain_h import UncertainH
from lfcal.reconstruct.error_bars import USUAL, ErrorBars, ErrorSums, check_bars
from lfcal.reconstruct.margin import cropped
from lfcal.reconstruct.projectors import Projector
from lfcal.reconstruct.solvers import Reconstruction, SolverChoice, SolverProgress, iter_solve

__all__ = ["Feature", "FeatureFit", "FittedFeature", "find_beads", "fit_features", "iter_fit_features"]

F4 = NDArray[np.float32]
F8 = NDArray[np.float64]
T = TypeVar("T")

USUAL_WIDTH = 1.0
"""Initial standard deviation of a profile (voxels)."""

MOST_STEPS = 12
"""Largest number of steps with the same weights."""

SMALL = 0.1
"""Steps smaller than this, in standard uncertainties, end the fit."""

CARVED = 2.5
"""Radius around a feature within which the expected rest is interpolated, in standard deviations of its profile."""

CARVED_MORE = 2.0
"""Addition to this radius for the blur of a reconstruction (voxels)."""

FILLING = 4.0
"""Standard deviation of the Gaussian that averages the surroundings of a feature (voxels)."""

SMOOTH = 2.0
"""Standard deviation of the Gaussian that smooths the expected rest (voxels).

A reconstructed rest contains the noise of the frame, except where it is interpolated. Without smoothing, this noise
would cause residuals that the covariance of the rest does not include.
"""

ERROR_DRAWS = 8
"""Number of random H by which errors of H are represented."""

APART = 1.0
"""Smallest distance of the initial positions of two beads (voxels)."""

MOST = 1000
"""Largest number of features; their covariance matrix is dense."""


@dataclass(frozen=True, slots=True)
class Feature:
    """A bead or a straight line with a Gaussian profile.

    Attributes
    ----------
    row, column
        Position of the bead, or of one end of the line, in the volume (voxels; 0 is the centre of the first).
    plane
        Index of the depth plane, from 0; fractions are between planes. None: unknown; the fit starts in the plane
        with the most light near the position.
    brightness
        Sum over the voxels. None: unknown; the fit starts from that in the reconstructed volume.
    width
        Standard deviation of the profile (voxels); a given value remains fixed. None: unknown; it is fitted.
    end
        Row and column of the other end of a line. None: a bead.
    """

    row: float
    column: float
    plane: float | None = None
    brightness: float | None = None
    width: float | None = None
    end: tuple[float, float] | None = None


@dataclass(frozen=True, slots=True)
class FittedFeature:
    """A fitted bead or line.

    Attributes
    ----------
    feature
        Fitted values.
    depth_um
        Depth (µm); the index of the plane if H states no depths.
    sigmas
        Standard uncertainty of each fitted value by name: ``brightness``, ``row``, ``column``, ``plane``, ``width``,
        ``end_row``, ``end_column``, and ``depth_um`` with the unit of `depth_um`. It is 0 for fixed values, and NaN if
        the feature does not fit (`fits`).
    chi2
        Misfit of the frame near the feature relative to that of a correct model.
    limit
        Largest `chi2` of a correct model.
    """

    feature: Feature
    depth_um: float
    sigmas: dict[str, float]
    chi2: float
    limit: float

    @property
    def fits(self) -> bool:
        """Whether the frame agrees with the feature, and determines all its values."""
        return not math.isnan(self.sigmas["brightness"])


@dataclass(frozen=True, eq=False)
class FeatureFit:
    """Features of a frame, and the rest of its volume.

    Attributes
    ----------
    features
        The features in the given order.
    rest
        Volume ``(nz, Y, X)`` of all other light.
    notes
        Remarks on the frame and its noise.
    bars
        The rest with its uncertainty, including the part due to errors of the features. None: not computed.
    """

    features: tuple[FittedFeature, ...]
    rest: F4
    notes: tuple[str, ...]
    bars: ErrorBars | None = None


def find_beads(volume: ArrayLike, most: int = 200) -> tuple[Feature, ...]:
    """Return the beads that are visible in a reconstructed volume, the brightest first.

    A bead is the maximum of the smoothed volume within 7 x 7 voxels and over all planes. It must be clearly brighter
    than the median of its surroundings (15 x 15 voxels).

    Parameters
    ----------
    volume
        Volume ``(nz, Y, X)``.
    most
        Largest number of beads.

    Examples
    --------
    >>> import numpy as np
    >>> from lfcal.reconstruct import find_beads
    >>> y, x = np.indices((60, 60))
    >>> volume = np.exp(-((y - 20) ** 2 + (x - 40) ** 2) / 2)[None] + 0.01
    >>> print(find_beads(volume))
    (Feature(row=20.0, column=40.0, plane=0.0, brightness=None, width=None, end=None),)
    """
    # slow to import
    from scipy.ndimage import maximum_filter, median_filter

    data = blurred(np.maximum(np.asarray(volume, np.float32), 0), 1.0)
    peak = data.max(axis=0)
    around = median_filter(peak, 15, mode="nearest")
    excess = peak - around
    spread = 1.4826 * float(np.median(np.abs(excess - np.median(excess))))
    at = (peak == maximum_filter(peak, 7)) & (excess > np.maximum(5 * spread, 0.5 * around))
    rows, columns = np.nonzero(at & (excess > 0.05 * excess.max(initial=0.0)))
    order = np.argsort(-excess[rows, columns], kind="stable")[:most]
    return tuple(
        Feature(float(row), float(column), float(data[:, row, column].argmax()))
        for row, column in zip(rows[order], columns[order], strict=True)
    )


def iter_fit_features(
    P: Projector,
    image: ArrayLike,
    features: Sequence[Feature] | None = None,
    choice: SolverChoice | None = None,
    *,
    contrast: float = 0.9,
    weights: ArrayLike | None = None,
    imaging: Imaging | None = None,
    seed: int = 0,
    replicates: int = 0,
) -> Work[FeatureFit]:
    """Fit beads and lines to a frame, and reconstruct the rest: all light that does not belong to them.

    Parameters
    ----------
    P
        Projector of H for the shape of the image, extended by the margin of ``choice`` on each side. Between planes, H
        is interpolated (cubically between four planes).
    image
        Image ``(Y, X)`` in counts.
    features
        Initial values. None: the beads that `find_beads` finds in the reconstructed volume.
    choice
        Solver, with a fixed number of iterations (the rest takes a third of them), and noise of the frame as in
        `iter_error_bars`. None: 60 iterations of ``rl-nesterov``.
    contrast
        Standard deviation of the relative brightness of details of the rest that its reconstruction does not show.
    weights
        Weight of each pixel, ``(Y, X)``, not negative. None: 1.
    imaging
        Function that returns the projector of an H drawn from its uncertainty, as in `iter_error_bars`. Its
        deviations are included in the uncertainties. None: H is exact, apart from its stated noise.
    seed
        Seed of the random numbers for expected misfits, errors of H, and replicates.
    replicates
        Number of random objects from which the uncertainty of the rest is estimated. 0: it is not estimated.

    Raises
    ------
    InputError
        If the image, the weights or the features do not fit the projector, no bead is found, or the number of
        iterations is not fixed.

    Examples
    --------
    >>> import numpy as np
    >>> from lfcal.reconstruct import Feature, Projector, iter_fit_features
    >>> P = Projector(np.array([1, 2, 1]).reshape(1, 1, 1, 1, 3) / 4, (30, 40))
    >>> frame = np.full((30, 40), 5.0)
    >>> frame[15, 20] = 900
    >>> steps = list(iter_fit_features(P, frame, [Feature(15, 20)]))
    >>> print(steps[-1].done == steps[-1].total)
    True
    """
    own = USUAL if choice is None else choice
    check_bars(own, "a fit of features")
    runs = Replicates.of(P, image, own, weights, imaging)
    return _Fit(runs, own, contrast, seed).iter_result(features, replicates)


fit_features = drained(
    iter_fit_features,
    """
    Examples
    --------
    >>> import numpy as np
    >>> from lfcal.reconstruct import Feature, FeatureFit, FittedFeature, Projector, SolverChoice, fit_features
    >>> P = Projector(np.outer([1, 2, 1], [1, 2, 1])[None, None, None] / 16, (40, 40))
    >>> y, x = np.indices((40, 40))
    >>> bead = 5000 * np.exp(-((y - 19.7) ** 2 + (x - 21.2) ** 2) / 2) / (2 * np.pi)
    >>> frame = np.random.default_rng(1).poisson(P.forward(bead[None]) + 10)
    >>> choice = SolverChoice("rl-nesterov", iterations=20, background=10, gain=1)
    >>> fit: FeatureFit = fit_features(P, frame, [Feature(20, 21, width=1.0)], choice)
    >>> found: FittedFeature = fit.features[0]
    >>> print(found.fits, abs(found.feature.row - 19.7) < 3 * found.sigmas["row"] < 0.2)
    True True
    """,
)


def check_features(features: Sequence[Feature], planes: int, shape: tuple[int, ...]) -> None:
    """Raise `InputError` unless ``features`` are possible in a volume of ``planes`` planes of ``shape`` ``(Y, X)``.

    There must be 1 to `MOST` features, and beads must be at least `APART` voxels apart.
    """
    if not 0 < len(features) <= MOST:
        got = f"{len(features)} features" if features else "no bead that is visible in the volume"
        raise InputError.expected(
            "features to fit", f"1 to {MOST} beads or lines", got, "give a table with their positions"
        )
    for number, one in enumerate(features, 1):
        what = f"of feature {number}"
        for row, column in [(one.row, one.column), *([one.end] if one.end else [])]:
            if not (-0.5 <= row <= shape[0] - 0.5 and -0.5 <= column <= shape[1] - 0.5):
                raise InputError.expected(
                    f"position {what}",
                    f"a row and a column inside of the frame of {shape[0]} x {shape[1]} pixels",
                    f"({row:g}, {column:g})",
                    "correct it, or leave this feature out",
                )
        if one.plane is not None:
            check_number(f"plane {what}", one.plane, at_least=-BEYOND, at_most=planes - 1 + BEYOND)
        if one.brightness is not None:
            check_number(f"brightness {what}", one.brightness, above=0)
        if one.width is not None:
            check_number(f"width {what} (voxels)", one.width, at_least=NARROWEST, at_most=WIDEST)
        if one.end is not None:
            check_number(f"length {what} (voxels)", math.dist((one.row, one.column), one.end), at_least=2)
        for before, other in enumerate(features[: number - 1], 1):
            away = math.hypot(one.row - other.row, one.column - other.column)
            if one.end is None and other.end is None and away < APART:
                raise InputError.expected(
                    f"positions of features {before} and {number}",
                    f"at least {APART:g} voxel apart",
                    f"{away:.2g} voxels",
                    "leave one of them out",
                )


@dataclass(frozen=True, eq=False)
class _Response:
    """First-order response of a fit to other frames.

    ``scene`` and ``rest`` are the fitted features and the expected rest. ``columns`` and ``weighted`` are as in
    `solution`, and ``cov`` is the covariance of the free parameters.
    """

    scene: FeatureScene
    rest: F4
    columns: Sequence[FeatureImages]
    weighted: Sequence[FeatureImages]
    cov: F8

    def change(self, residual: F8) -> F8:
        """Return the change ``(Y, X)`` of the image of the features that fits a ``residual`` best."""
        steps = self.cov @ np.concatenate([one.on(residual) for one in self.weighted])
        found, k = np.zeros_like(residual), 0
        for one in self.columns:
            found[one.window] += np.tensordot(steps[k : k + len(one.images)], one.images, 1)
            k += len(one.images)
        return found


class _Fit:
    """One run of `iter_fit_features`."""

    def __init__(self, runs: Replicates, choice: SolverChoice, contrast: float, seed: int) -> None:
        self._runs, self._choice, self._contrast, self._seed = runs, choice, contrast, seed
        self._margin, self._P = choice.margin, runs.P
        self._noise = SampleNoise(0, 1, 0)
        self._least = 0.0
        self._extra: F8 | float = 0.0
        self._clock, self._done = Clock("features", 1), 0

    def iter_result(self, features: Sequence[Feature] | None, replicates: int) -> Work[FeatureFit]:
        """Fit the ``features``; None: the beads of the reconstructed volume."""
        its, (planes, *sides) = self._choice.iterations, self._P.volume_shape
        shape = (sides[0] - 2 * self._margin, sides[1] - 2 * self._margin)
        if features is not None:
            check_features(features, planes, shape)
        clock = Clock("volume", its * (1 if SampleNoise.of(self._choice) else 2))
        first = yield from self._runs.iter_volume(clock, "")
        self._noise, notes = yield from self._runs.iter_noise(clock, its, first.volume)
        starts = find_beads(cropped(first.volume, self._margin)) if features is None else features
        check_features(starts, planes, shape)
        rest, scene = self._start(first.volume, starts)
        self._least = 1e-6 * float(np.maximum(first.volume, 0).sum(dtype=np.float64))
        size = sum(len(one.free) for one in scene.shapes)
        steps = 2 * (MOST_STEPS + 2) * size + self._rest_iterations + DRAWS + 1
        self._clock = Clock("features", steps)
        found, rest, response = yield from self._iter_fit(scene, rest)
        yield self._clock.at(steps)
        bars = None if replicates == 0 else (yield from self._iter_bars(rest, response, replicates))
        return FeatureFit(found, cropped(rest, self._margin), (*first.notes, *notes), bars)

    @property
    def _rest_iterations(self) -> int:
        return max(1, self._choice.iterations // 3)

    def _start(self, volume: F4, features: Sequence[Feature]) -> tuple[F4, FeatureScene]:
        """Return the rest of a reconstructed ``volume``, and the features with initial values."""
        masks = [_around(one, volume.shape[1:], self._margin) for one in features]
        rest = _expected_rest(volume, masks)
        light = np.maximum(volume, 0) - rest
        shapes = tuple(
            _initial(one, light[:, mask], len(volume), self._margin) for one, mask in zip(features, masks, strict=True)
        )
        return rest, FeatureScene(self._P, shapes)

    def _iter_fit(self, scene: FeatureScene, rest: F4) -> Work[tuple[tuple[FittedFeature, ...], F4, _Response]]:
        """Fit the features of ``scene``; return them, the rest, and the response of the fit to other frames."""
        light = rest
        for last in (False, True):
            if last:
                light = yield from self._iter_rest(scene)
                # a rest below a feature would contain its light
                near = [_around(one, light.shape[1:], self._margin) for one in self._features(scene)]
                rest = _expected_rest(light, near)
                self._extra = self._variance_of_h(rest + scene.volume())
            residual, weight = self._residual(scene, rest)
            covariance = self._covariance(scene, rest, weight, exact=not last)
            columns = yield from self._counted(scene.iter_columns())
            weighted = yield from self._counted(scene.iter_weighted(columns, covariance))
            for _ in range(MOST_STEPS):
                cov = solution(weighted, columns)
                step = cov @ np.concatenate([one.on(residual) for one in weighted])
                scene = scene.moved(step, self._least)
                residual, _ = self._residual(scene, rest)
                if (np.abs(step) < SMALL * np.sqrt(np.abs(np.diag(cov)))).all():
                    break
                columns = yield from self._counted(scene.iter_columns())
        cov = solution(weighted, columns)
        voting = scene.determined(cov)
        judged = misfits(residual, columns, weighted, cov, covariance, seed=self._seed, voting=voting)
        chi2, limit = yield from self._counted(judged)
        return self._fitted(scene, cov, chi2, limit), light, _Response(scene, rest, columns, weighted, cov)

    def _counted(self, steps: Iterator[T | None]) -> Generator[Progress, None, T]:
        """Yield a progress record for each None of ``steps``, and return the other value."""
        for step in steps:
            if step is not None:
                return step
            self._done += 1
            yield self._clock.at(min(self._done, self._clock.total))
        raise AssertionError("the last step is the result")

    def _iter_rest(self, scene: FeatureScene) -> Work[F4]:
        """Reconstruct the rest with the features as background."""
        made = yield from self._each(self._solved(self._P, self._runs.image, scene.image()))
        return made.volume

    def _solved(self, P: Projector, image: F4, light: F8) -> Generator[SolverProgress, None, Reconstruction]:
        """Return the work that reconstructs the rest of an ``image``, given the ``light`` of the features."""
        background = np.maximum(light, 0).astype(np.float32) + np.float32(self._choice.background)
        short = replace(self._choice, iterations=self._rest_iterations, margin=0)
        return iter_solve(P, image, short, weights=self._runs.weights, background=background)

    def _iter_bars(self, rest: F4, response: _Response, replicates: int) -> Work[ErrorBars]:
        """Return the uncertainty of the ``rest`` from reconstructions of random objects with the fitted features.

        Each frame is fitted again, to first order, so that errors of the features cause errors of the rest.
        """
        runs, by = self._runs, self._margin
        model = ObjectModel.of(rest, self._contrast)
        sums = ErrorSums(cropped(rest, by), cropped(model.mean, by), None)
        image, volume = response.scene.image(), response.scene.volume()
        self._clock, self._done = Clock("error bars of the rest", replicates * self._rest_iterations), 0
        for k in range(replicates):
            rng = np.random.default_rng((self._seed, k))
            drawn = model.draw(rng)
            imaging = self._P if runs.imaging is None else runs.imaging(rng)
            frame = self._noise.sampled(np.maximum(imaging.forward(drawn + volume), 0), rng)
            frame[~np.isfinite(runs.image)] = np.nan
            residual, _ = self._residual(response.scene, response.rest, frame)
            P = self._P.with_new_noise(int(rng.integers(1 << 31)))
            made = yield from self._each(self._solved(P, frame, image + response.change(residual)))
            sums.add(cropped(made.volume, by), cropped(drawn, by))
        return sums.result()

    def _each(self, work: Generator[SolverProgress, None, Reconstruction]) -> Work[Reconstruction]:
        while True:
            try:
                next(work)
            except StopIteration as stop:
                result: Reconstruction = stop.value
                return result
            self._done += 1
            yield self._clock.at(min(self._done, self._clock.total))

    def _residual(self, scene: FeatureScene, rest: F4, image: F4 | None = None) -> tuple[F8, F8]:
        """Return frame minus expected frame, and the weight (inverse variance) of each pixel, ``(Y, X)`` each.

        Both are 0 at pixels that are not used. ``image`` is the frame (None: that of the run).
        """
        light = np.maximum(np.asarray(self._P.forward(rest + scene.volume()), np.float64), 0)
        variance = self._noise.floor + self._noise.slope * light + scene.variance() + self._extra
        frame, noise = np.asarray(self._runs.image if image is None else image, np.float64), self._noise
        valid = np.isfinite(frame)
        if noise.saturation is not None:
            valid &= frame < noise.saturation
        trust = np.ones_like(frame) if self._runs.weights is None else self._runs.weights
        weight = np.where(valid, trust / np.maximum(variance, 1e-12), 0)
        return np.where(weight > 0, frame - noise.background - light, 0), weight

    def _variance_of_h(self, volume: F4) -> F8 | float:
        """Return the variance ``(Y, X)`` of the image of ``volume`` due to the noise of H; 0 if the noise is unknown.

        It is computed for the recorded H, because reducing the noise causes a bias as large as the noise that it
        removes.
        """
        noise = self._P.noise
        if noise is None:
            return 0.0
        # slow to import
        from scipy.ndimage import uniform_filter

        square, (rows, columns) = volume.astype(np.float64) ** 2, self._P.grid.cutout
        constant = uniform_filter(np.tensordot(noise[:, 0], square, 1), (rows, columns), mode="constant")
        rising = self._P.forward((noise[:, 1, None, None] * square).astype(np.float32))
        return np.asarray(rows * columns * constant + np.maximum(rising, 0), np.float64)

    def _covariance(self, scene: FeatureScene, rest: F4, weight: F8, *, exact: bool) -> Covariance:
        """Return the covariance of residuals; ``exact`` neglects errors of H."""
        spread = rest + np.float32(FAINTEST * float(rest.max(initial=0.0)))
        modes = np.zeros((0, *weight.shape))
        imaging = self._runs.imaging
        if imaging is not None and not exact:
            modes = self._modes(imaging, rest + scene.volume())
        return Covariance(self._P, weight, spread, self._contrast, modes)

    def _modes(self, imaging: Imaging, volume: F4) -> F8:
        """Return images ``(m, Y, X)``; the sum of their outer products is the covariance that errors of H cause."""
        if isinstance(imaging, UncertainH):
            return imaging.modes(volume)
        rng, expected = np.random.default_rng(self._seed), self._P.forward(volume)
        drawn = [imaging(rng).forward(volume) - expected for _ in range(ERROR_DRAWS)]
        return np.array(drawn, np.float64) / math.sqrt(ERROR_DRAWS)

    def _features(self, scene: FeatureScene) -> list[Feature]:
        """Return the current values of the features, in voxels of the volume without margin."""
        found, by = [], self._margin
        for one in scene.shapes:
            light, row, column, plane, width, *end = one.values
            ends = (end[0] - by, end[1] - by) if end else None
            found.append(Feature(row - by, column - by, plane, light, width, ends))
        return found

    def _fitted(self, scene: FeatureScene, cov: F8, chi2: F8, limit: float) -> tuple[FittedFeature, ...]:
        depths, found, k = self._P.depths, [], 0
        variances = np.diag(cov)
        each = zip(scene.shapes, self._features(scene), chi2, scene.determined(cov), strict=True)
        for one, feature, misfit, determined in each:
            errors = dict.fromkeys(one.names, 0.0)
            own = variances[k : k + len(one.free)]
            known = determined and misfit <= limit
            for free, variance in zip(one.free, own, strict=True):
                errors[one.names[free]] = math.sqrt(variance) if known else math.nan
            k += len(one.free)
            depth, slope = depth_at(one.values[BEAD.index("plane")], depths)
            errors["depth_um"] = abs(slope) * errors["plane"]
            found.append(FittedFeature(feature, depth, errors, float(misfit), limit))
        return tuple(found)


def depth_at(plane: float, depths: F8) -> tuple[float, float]:
    """Return the depth at a fractional plane index, also beyond the planes, and the increase of the depth per plane."""
    if len(depths) == 1:
        return float(depths[0]), 0.0
    k = min(max(math.floor(plane), 0), len(depths) - 2)
    slope = float(depths[k + 1] - depths[k])
    return float(depths[k]) + (plane - k) * slope, slope


def _around(one: Feature, shape: tuple[int, ...], margin: int) -> NDArray[np.bool_]:
    """Return a mask ``(Y, X)``, True at the voxels near a feature."""
    y, x = np.indices(shape) - margin
    down, across = (0.0, 0.0) if one.end is None else (one.end[0] - one.row, one.end[1] - one.column)
    length = down**2 + across**2
    along = ((y - one.row) * down + (x - one.column) * across) / length if length else np.zeros(shape)
    along = np.clip(along, 0, 1)
    away = np.hypot(y - one.row - along * down, x - one.column - along * across)
    return np.asarray(away < CARVED_MORE + CARVED * (one.width or USUAL_WIDTH))


def _expected_rest(volume: F4, masks: Sequence[NDArray[np.bool_]]) -> F4:
    """Return ``volume`` ``(nz, Y, X)`` smoothed, and interpolated over ``masks`` ``(Y, X)`` from their surroundings."""
    near = np.any(masks, axis=0)
    far = blurred(np.where(near, 0, 1)[None], FILLING)
    light = np.maximum(volume, 0)
    smooth = blurred(np.where(near, 0, light), FILLING) / np.maximum(far, 1e-6)
    return blurred(np.where(near, smooth, light), SMOOTH)


def _initial(one: Feature, light: F4, planes: int, margin: int) -> Shape:
    """Return a feature with initial values; ``light`` ``(nz, n)`` is the light of the voxels near the feature."""
    plane = float(light.sum(axis=1).argmax()) if one.plane is None else one.plane
    brightness = float(light.sum()) if one.brightness is None else one.brightness
    width = USUAL_WIDTH if one.width is None else one.width
    values = [max(brightness, 1e-9), one.row + margin, one.column + margin, plane, width]
    if one.end is not None:
        values += [one.end[0] + margin, one.end[1] + margin]
    fixed = ({BEAD.index("plane")} if planes == 1 else set()) | ({BEAD.index("width")} if one.width else set())
    return Shape(tuple(values), tuple(k for k in range(len(values)) if k not in fixed))
