"""Weighted least-squares fit of beads and lines to a frame, with an uncertain background of other objects.

The residual of a frame has the covariance M = V + H G HT: the noise V of its pixels, and the image of what is unknown
about the rest of the volume. G is that of the random objects of error bars (`ObjectModel`): relative fluctuations of
several correlation lengths. The generalised least-squares estimate with M^-1 hence uses the surroundings of a feature
to predict its background. It gives less weight to pixels for which this prediction is uncertain (Aitken 1935; kriging).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lfcal.reconstruct._feature_shapes import Shape
from lfcal.reconstruct._replicates import blurred
from lfcal.reconstruct.projectors import Projector

__all__ = ["DRAWS", "Covariance", "FeatureImages", "FeatureScene", "misfits", "solution"]

F4 = NDArray[np.float32]
F8 = NDArray[np.float64]
Window = tuple[slice, slice]

SCALES = (1.0, 3.0, 10.0)
"""Correlation lengths of the relative fluctuations of the rest (voxels), each with the same variance."""

STEPS = 40
"""Largest number of conjugate-gradient steps."""

RESIDUAL = 3e-3
"""Relative residual at which the conjugate gradients stop."""

LIMIT = 4.0
"""Largest misfit of a correct model, in standard deviations of its logarithm."""

DRAWS = 8
"""Number of random residuals that determine the distribution of the misfit of a correct model."""


class Covariance:
    """Covariance of the residual of a frame.

    Parameters
    ----------
    P
        Projector of H.
    weight
        Inverse variance of the noise of each pixel ``(Y, X)``; 0 at pixels that are not used.
    rest
        Standard deviation of the rest, divided by ``contrast``, ``(nz, Y, X)``.
    contrast
        Relative standard deviation of fluctuations of the rest.
    modes
        Images ``(m, Y, X)``; their outer products are added to the covariance, for errors of H.
    """

    def __init__(self, P: Projector, weight: F8, rest: F4, contrast: float, modes: F8) -> None:
        self._P, self._weight, self._root = P, weight, np.sqrt(weight)
        self._rest, self._contrast, self._modes = rest, contrast, modes

    def solve(self, image: F8) -> F8:
        """Return M^-1 times ``image`` ``(Y, X)``, by conjugate gradients; 0 at pixels that are not used."""
        residual = self._root * image
        found, direction = np.zeros_like(residual), residual.copy()
        power = first = float(np.vdot(residual, residual))
        for _ in range(STEPS):
            if power <= RESIDUAL**2 * first:
                break
            along = direction + self._root * self._spread(self._root * direction)
            size = power / float(np.vdot(direction, along))
            found += size * direction
            residual -= size * along
            now = float(np.vdot(residual, residual))
            direction = residual + now / power * direction
            power = now
        return self._root * found

    def squares(self, image: F8) -> F8:
        """Return the squares of ``image`` ``(Y, X)`` minus the predicted rest, divided by the noise variance."""
        # image - H G HT M^-1 image = V M^-1 image
        return np.divide(self.solve(image) ** 2, self._weight, out=np.zeros_like(image), where=self._weight > 0)

    def draw(self, rng: np.random.Generator) -> F8:
        """Return a random residual ``(Y, X)``; 0 at pixels that are not used."""
        field = np.zeros(self._rest.shape, np.float32)
        for scale in SCALES:
            field += np.float32(_norm(scale)) * blurred(rng.standard_normal(field.shape, np.float32), scale)
        image = self._P.forward(self._rest * field * np.float32(self._strength)).astype(np.float64)
        image += np.tensordot(rng.standard_normal(len(self._modes)), self._modes, 1)
        noise = np.divide(1, self._root, out=np.zeros_like(self._root), where=self._root > 0)
        return np.where(self._root > 0, image + noise * rng.standard_normal(image.shape), 0)

    @property
    def _strength(self) -> float:
        return self._contrast / math.sqrt(len(SCALES))

    def _spread(self, image: F8) -> F8:
        """Return the covariance without noise times ``image``."""
        back = self._rest * self._P.adjoint(image.astype(np.float32))
        # two blurs by a scale are one by sqrt(2) times the scale
        field = sum(np.float32(_norm(one) ** 2) * blurred(back, math.sqrt(2) * one) for one in SCALES)
        found = self._P.forward(self._rest * field * np.float32(self._strength**2)).astype(np.float64)
        for mode in self._modes:
            found += mode * float(np.vdot(mode, image))
        return found


def _norm(scale: float) -> float:
    """Return the factor that gives white noise, blurred by ``scale`` voxels, the variance 1."""
    return math.sqrt(4 * math.pi) * scale


@dataclass(frozen=True, eq=False)
class FeatureImages:
    """Derivatives of the frame with respect to the free parameters of a feature, or M^-1 times these derivatives.

    Attributes
    ----------
    window
        Rows and columns; outside of them, the images are 0 or are neglected.
    images
        Images ``(k, rows, columns)`` within the window.
    """

    window: Window
    images: F8

    def products(self, other: FeatureImages) -> F8:
        """Return the scalar products ``(k, l)`` with the images of ``other``."""
        mine, theirs = [], []
        for a, b in zip(self.window, other.window, strict=True):
            start, stop = max(a.start, b.start), min(a.stop, b.stop)
            if start >= stop:
                return np.zeros((len(self.images), len(other.images)))
            mine.append(slice(start - a.start, stop - a.start))
            theirs.append(slice(start - b.start, stop - b.start))
        here, there = self.images[:, *mine], other.images[:, *theirs]
        return np.tensordot(here, there, ((1, 2), (1, 2)))

    def on(self, image: F8) -> F8:
        """Return the scalar products ``(k,)`` with ``image`` ``(Y, X)``."""
        return np.tensordot(self.images, image[self.window], 2)


@dataclass(frozen=True, eq=False)
class FeatureScene:
    """Features on a frame.

    Attributes
    ----------
    P
        Projector of H.
    shapes
        The features.
    """

    P: Projector
    shapes: tuple[Shape, ...]

    def volume(self) -> F4:
        """Return the light of all features, ``(nz, Y, X)``; between planes, entries may be negative."""
        found = np.zeros(self.P.volume_shape, np.float32)
        for one in self.shapes:
            one.patch(len(found)).add_to(found)
        return found

    def image(self) -> F8:
        """Return the image ``(Y, X)`` of all features."""
        return np.asarray(self.P.forward(self.volume()), np.float64)

    def variance(self) -> F8:
        """Return the variance ``(Y, X)`` that is due to the interpolation of H between planes (counts²)."""
        volume = np.zeros(self.P.volume_shape, np.float32)
        for one in self.shapes:
            one.interpolation_error(len(volume)).add_to(volume)
        return np.asarray(self.P.forward(volume), np.float64) ** 2

    def groups(self, reach: float) -> list[list[int]]:
        """Return groups of features whose windows of ``reach`` do not overlap, so that one projection serves them."""
        windows = [self.window(k, reach) for k in range(len(self.shapes))]
        found: list[list[int]] = []
        for k, own in enumerate(windows):
            for group in found:
                if not any(_overlap(own, windows[other]) for other in group):
                    group.append(k)
                    break
            else:
                found.append([k])
        return found

    def window(self, k: int, reach: float) -> Window:
        """Return the rows and columns that feature ``k`` covers, and ``reach`` cutouts more on each side."""
        patch = self.shapes[k].patch(1)
        found = []
        for axis in range(2):
            more, size = math.ceil(reach * self.P.grid.cutout[axis]), self.P.image_shape[axis]
            start, stop = patch.corner[axis] - more, patch.corner[axis] + patch.values.shape[1 + axis] + more
            found.append(slice(min(max(start, 0), size), min(max(stop, 0), size)))
        return found[0], found[1]

    def iter_columns(self) -> Iterator[list[FeatureImages] | None]:
        """Yield None after each projection, and finally the derivatives of the frame for every feature."""
        images: list[list[F8]] = [[] for _ in self.shapes]
        windows = [self.window(k, 0.5) for k in range(len(self.shapes))]
        for group in self.groups(0.5):
            for free in range(max(len(self.shapes[k].free) for k in group)):
                volume = np.zeros(self.P.volume_shape, np.float32)
                some = [k for k in group if free < len(self.shapes[k].free)]
                for k in some:
                    for patch, factor in self.shapes[k].derivative(self.shapes[k].free[free], len(volume)):
                        patch.add_to(volume, factor)
                image = np.asarray(self.P.forward(volume), np.float64)
                for k in some:
                    images[k].append(image[windows[k]].copy())
                yield None
        yield [FeatureImages(window, np.array(own)) for window, own in zip(windows, images, strict=True)]

    def iter_weighted(
        self, columns: Sequence[FeatureImages], covariance: Covariance
    ) -> Iterator[list[FeatureImages] | None]:
        """Yield None after each solution, and finally the products of ``columns`` with M^-1.

        They are computed on the pixels of `window` with a reach of 1.5 cutouts; these are enough to predict the rest.
        """
        windows = [self.window(k, 1.5) for k in range(len(self.shapes))]
        images: list[list[F8]] = [[] for _ in self.shapes]
        for group in self.groups(1.5):
            for free in range(max(len(columns[k].images) for k in group)):
                image = np.zeros(self.P.image_shape)
                some = [k for k in group if free < len(columns[k].images)]
                for k in some:
                    image[columns[k].window] = columns[k].images[free]
                solved = covariance.solve(image)
                for k in some:
                    images[k].append(solved[windows[k]].copy())
                yield None
        yield [FeatureImages(window, np.array(own)) for window, own in zip(windows, images, strict=True)]

    def moved(self, steps: F8, least: float) -> FeatureScene:
        """Return the scene after ``steps`` of the free parameters, given one feature after another.

        ``least`` is the smallest brightness.
        """
        sizes = np.cumsum([len(one.free) for one in self.shapes])[:-1]
        parts = zip(self.shapes, np.split(steps, sizes), strict=True)
        return FeatureScene(self.P, tuple(one.moved(step, self.P.volume_shape, least) for one, step in parts))

    def determined(self, cov: F8) -> list[bool]:
        """Return for each feature whether the frame determines its free parameters; ``cov`` is their covariance."""
        sizes = np.cumsum([len(one.free) for one in self.shapes])[:-1]
        # a feature that moved far from its initial values has no valid variance
        parts = zip(self.shapes, np.split(np.diag(cov), sizes), strict=True)
        return [bool((own > 0).all()) and not one.at_a_limit(self.P.volume_shape) for one, own in parts]


def _overlap(a: Window, b: Window) -> bool:
    return all(one.start < two.stop and two.start < one.stop for one, two in zip(a, b, strict=True))


def solution(weighted: Sequence[FeatureImages], columns: Sequence[FeatureImages]) -> F8:
    """Return the matrix ``(n, n)`` that maps products of a residual with ``weighted`` to steps of the free parameters.

    If both arguments are for the same values of the parameters, this is the covariance of the parameters.
    """
    matrix = np.block([[one.products(other) for other in columns] for one in weighted])
    scale = 1 / np.sqrt(np.maximum(np.abs(np.diag(matrix)), 1e-300))
    found = np.linalg.pinv(matrix * scale * scale[:, None], rcond=1e-9)
    return np.asarray(found * scale * scale[:, None], np.float64)


def misfits(
    residual: F8,
    columns: Sequence[FeatureImages],
    weighted: Sequence[FeatureImages],
    cov: F8,
    covariance: Covariance,
    *,
    seed: int,
    voting: Sequence[bool],
) -> Iterator[tuple[F8, float] | None]:
    """Yield None after each solution, and finally the relative chi-square of each feature, and the limit for all.

    The residual ``(Y, X)`` without the best step of all features, and without the best prediction of the rest, is
    compared with what `DRAWS` random residuals leave. Pixels are weighted by the light of the feature. The limit
    depends only on the ``voting`` features, if there are any: the others may have hardly any light.
    """

    def left(image: F8) -> F8:
        steps = np.split(cov @ np.concatenate([one.on(image) for one in weighted]), splits)
        rest = image.copy()
        for one, step in zip(columns, steps, strict=True):
            rest[one.window] -= np.tensordot(step, one.images, 1)
        return covariance.squares(rest)

    splits = np.cumsum([len(one.images) for one in columns])[:-1]
    mine = left(residual)
    yield None
    rng, drawn = np.random.default_rng(seed), []
    for _ in range(DRAWS):
        drawn.append(left(covariance.draw(rng)))
        yield None
    values, scatter = [], []
    for one in columns:
        share = np.abs(one.images[0])
        expected = np.array([float((share * image[one.window]).sum()) for image in drawn])
        values.append(float((share * mine[one.window]).sum()) / max(float(expected.mean()), 1e-300))
        scatter.append(np.log(np.maximum(expected, 1e-300)).std(ddof=1))
    votes = np.array(scatter)[np.array(voting)] if any(voting) else np.array(scatter)
    limit = math.exp(LIMIT * float(np.sqrt(np.mean(np.square(votes)))))
    yield np.array(values), limit
