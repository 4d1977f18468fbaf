"""Synthetic objects and frames for the error bars of a volume.

A bootstrap that draws frames of the reconstructed volume itself underestimates the errors by a factor of 3 to 9. The
volume is as smooth as its own reconstruction, so what the iterations cannot find does not show. Replicates are
therefore drawn from objects that are rougher than the volume, and each reconstruction is compared with its object.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Protocol, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfcal.base import Clock, Work
from lfcal.reconstruct.margin import widened
from lfcal.reconstruct.projectors import Projector
from lfcal.reconstruct.solvers import NothingMeasured, Reconstruction, SolverChoice, iter_solve

__all__ = ["Imager", "Imaging", "ObjectModel", "Replicates", "SampleNoise", "blurred"]


class Imager(Protocol):
    """Protocol for an H that images volumes, such as a `Projector`."""

    def forward(self, volume: ArrayLike, /) -> NDArray[Any]:
        """Return the image ``(Y, X)`` of ``volume`` ``(nz, Y, X)``."""


Imaging = Callable[[np.random.Generator], Imager]
"""Function that returns an H drawn from its uncertainty."""

CORRELATIONS = (1.0, 3.0, 10.0, 30.0)
"""Correlation lengths of the relative fluctuations of synthetic objects (voxels), each with the same variance.

Without the longest one, the bars of sums over large smooth objects are too short.
"""

FAINTEST = 1e-3
"""Smallest brightness of a synthetic object before its fluctuations, as a fraction of the volume's maximum."""


def blurred(volume: NDArray[Any], width: float) -> NDArray[np.float32]:
    """Return ``volume`` ``(nz, Y, X)``, each plane blurred by a Gaussian of standard deviation ``width`` voxels."""
    from scipy.ndimage import gaussian_filter

    data = np.asarray(volume, np.float32)
    return data if width == 0 else np.asarray(gaussian_filter(data, (0, width, width)), np.float32)


@dataclass(frozen=True)
class ObjectModel:
    """Random objects that resemble a reconstructed volume and contain details that it lacks.

    Attributes
    ----------
    mean
        Expected object ``(nz, Y, X)``.
    contrast
        Standard deviation of the natural logarithm of the brightness relative to ``mean``.
    """

    mean: NDArray[np.float32]
    contrast: float

    @classmethod
    def of(cls, volume: NDArray[Any], contrast: float) -> Self:
        """Return the model of objects like ``volume`` ``(nz, Y, X)``."""
        smooth = blurred(np.maximum(volume, 0), 1.0)
        return cls(smooth + np.float32(FAINTEST * float(np.max(volume, initial=0))), contrast)

    def draw(self, rng: np.random.Generator) -> NDArray[np.float32]:
        """Return an object ``(nz, Y, X)`` with the same total brightness as `mean`."""
        field = np.zeros(self.mean.shape, np.float32)
        for width in CORRELATIONS:
            part = blurred(rng.standard_normal(self.mean.shape, np.float32), width)
            # normalised by the samples, because wide fields have few independent ones
            field += (part - part.mean()) / max(float(part.std()), 1e-9) / np.float32(math.sqrt(len(CORRELATIONS)))
        drawn = self.mean * np.exp(self.contrast * field)
        drawn *= float(self.mean.sum(dtype=np.float64)) / max(float(drawn.sum(dtype=np.float64)), 1e-30)
        return np.asarray(drawn, np.float32)


@dataclass(frozen=True)
class SampleNoise:
    """Noise of the samples of a frame: below saturation, the variance is ``floor + slope * light``.

    Attributes
    ----------
    floor
        Variance of a sample without light from the volume (counts²).
    slope
        Increase of the variance per count of light (counts).
    background
        Expected value of a sample without light from the volume (counts).
    saturation
        Largest sample value (counts). None: no limit.
    """

    floor: float
    slope: float
    background: float
    saturation: float | None = None

    @classmethod
    def of(cls, choice: SolverChoice) -> SampleNoise | None:
        """Return the noise that ``choice`` states; None if it states neither a gain nor a noise model."""
        if choice.gain is not None:
            floor, slope = choice.gain * choice.background + choice.read_noise**2, choice.gain
        elif choice.noise is not None:
            floor, slope = choice.noise
        else:
            return None
        return cls(floor, slope, choice.background, choice.saturation)

    @classmethod
    def measured(
        cls, choice: SolverChoice, image: NDArray[Any], model: NDArray[Any], weights: NDArray[Any]
    ) -> SampleNoise:
        """Return the noise from the residual of ``image`` ``(Y, X)`` to its ``model``, both including the background.

        A model that does not fit has a larger residual, and error bars increase. ``weights`` contains pixel weights.
        """
        valid = np.isfinite(image) & (weights > 0)
        if choice.saturation is not None:
            valid &= image < choice.saturation
        light = np.maximum(model[valid].astype(np.float64), 0)
        square = (image[valid] - light) ** 2 - choice.read_noise**2
        slope = max(float(square.sum()) / max(float(light.sum()), 1e-30), 1e-6)
        return cls(slope * choice.background + choice.read_noise**2, slope, choice.background, choice.saturation)

    def sampled(self, light: NDArray[Any], rng: np.random.Generator) -> NDArray[np.float32]:
        """Return a random frame ``(Y, X)`` for the expected ``light`` (counts, at least 0, without background)."""
        # the part of the background that has photon noise; the rest of the variance is that of the camera
        glow = min(self.background, self.floor / self.slope)
        expected = light.astype(np.float64) + glow
        frame = self.slope * rng.poisson(expected / self.slope) + (self.background - glow)
        rest = self.floor - self.slope * glow
        if rest > 0:
            frame += math.sqrt(rest) * rng.standard_normal(frame.shape)
        return self.limited(frame - self.background)

    def limited(self, light: NDArray[Any]) -> NDArray[np.float32]:
        """Return ``light`` ``(Y, X)`` plus the background, limited to the saturation (counts)."""
        frame = np.asarray(light + self.background, np.float32)
        return frame if self.saturation is None else np.minimum(frame, np.float32(self.saturation))


@dataclass(frozen=True)
class Replicates:
    """Runs of a solver on a frame, and on the frames of random objects like its volume.

    Attributes
    ----------
    P
        Projector of H with the margin of the volume.
    choice
        Solver and its settings, without margin.
    image
        The frame ``(Y, X)``, extended by the margin.
    weights
        Weight of each pixel, ``(Y, X)``. None: 1.
    imaging
        Function that draws an H from its uncertainty, to image a replicate. None: `P` images all replicates.
    """

    P: Projector
    choice: SolverChoice
    image: NDArray[np.float32]
    weights: NDArray[np.float32] | None
    imaging: Imaging | None

    @property
    def uncertain(self) -> bool:
        """Whether H has errors, from its recorded noise or from the uncertainty of a fit."""
        return self.imaging is not None or self.P.noise is not None

    @classmethod
    def of(
        cls,
        P: Projector,
        image: ArrayLike,
        choice: SolverChoice,
        weights: ArrayLike | None = None,
        imaging: Imaging | None = None,
    ) -> Replicates:
        """Return the runs for an ``image`` ``(Y, X)`` with pixel ``weights``, and a ``choice`` that states a margin."""
        frame, margin = np.asarray(image, np.float32), choice.margin
        trust = None if weights is None else np.broadcast_to(np.asarray(weights, np.float32), frame.shape)
        if margin:
            trust = np.ones_like(frame) if trust is None else trust
            frame, trust = widened(frame, margin), widened(trust, margin)
        quiet = P.denoised() if choice.denoise else P
        return cls(quiet, replace(choice, margin=0), frame, trust, imaging)

    def iter_run(
        self, clock: Clock, done: int, note: str, image: ArrayLike | None = None, P: Projector | None = None
    ) -> Work[Reconstruction]:
        """Reconstruct an ``image`` (None: the frame) with ``P`` (None: the projector of the frame).

        The returned volume includes the margin. ``done`` is the number of iterations of earlier runs, for the records
        of ``clock``.
        """
        data = self.image if image is None else image
        work = iter_solve(self.P if P is None else P, data, self.choice, weights=self.weights)
        while True:
            try:
                record = next(work)
            except StopIteration as stop:
                result: Reconstruction = stop.value
                return result
            yield clock.at(done + record.done, note)

    def iter_volume(self, clock: Clock, note: str) -> Work[Reconstruction]:
        """Reconstruct the frame as in `iter_run`; raise `NothingMeasured` if its volume has no light."""
        made = yield from self.iter_run(clock, 0, note)
        if not np.max(made.volume, initial=0) > 0:
            raise NothingMeasured.expected(
                "frame",
                f"light above the background of {self.choice.background:g}",
                "a volume without light",
                "correct the background, or choose another frame",
            )
        return made

    def iter_noise(self, clock: Clock, done: int, volume: NDArray[Any]) -> Work[tuple[SampleNoise, tuple[str, ...]]]:
        """Return the noise of the frame, and notes.

        If the noise is unknown, it is estimated from the residual of the ``volume``. Iterations also fit a part of the
        noise, so the residual is too small. The volume itself is therefore imaged with the estimated noise and
        reconstructed, and the new residual shows by which factor.
        """
        known = SampleNoise.of(self.choice)
        if known is not None:
            return known, ()
        first = self._measured(self.image, volume)
        rng = np.random.default_rng(0)
        frame = first.sampled(np.maximum(self.P.forward(volume), 0), rng)
        frame[~np.isfinite(self.image)] = np.nan
        fitted = yield from self.iter_run(clock, done, "noise of the frame", frame)
        factor = first.slope / self._measured(frame, fitted.volume).slope
        background = self.choice.background
        slope = first.slope * factor
        floor = slope * background + self.choice.read_noise**2
        words = f"the noise is unknown; the residual of the volume agrees with {slope:.3g} counts per photoelectron"
        return replace(first, slope=slope, floor=floor), (words,)

    def _measured(self, image: NDArray[Any], volume: NDArray[Any]) -> SampleNoise:
        """Return the noise from the residual of ``image`` to the projection of ``volume``."""
        trust = np.ones_like(image) if self.weights is None else self.weights
        return SampleNoise.measured(self.choice, image, self.P.forward(volume) + self.choice.background, trust)

    def iter_replicate(
        self, clock: Clock, done: int, model: ObjectModel, noise: SampleNoise, key: tuple[int, int], *, split: bool
    ) -> Work[list[NDArray[Any]]]:
        """Reconstruct the frame of a random object.

        Parameters
        ----------
        clock, done
            As in `iter_run`.
        model
            Model of the objects.
        noise
            Noise of the frame.
        key
            Seed, and number of the replicate from 0.
        split
            Whether the frame is also reconstructed without noise and, if H is `uncertain`, without noise and with the
            exact H.

        Returns
        -------
        list
            The reconstruction and the object, each ``(nz, Y, X)`` with margin. With ``split``, they are followed by
            the reconstruction without noise and, if H is `uncertain`, by the one with the exact H.
        """
        rng = np.random.default_rng(key)
        drawn = model.draw(rng)
        imaging = self.P if self.imaging is None else self.imaging(rng)
        # an H whose noise was not reduced has negative entries
        light = np.maximum(imaging.forward(drawn), 0)
        # the error due to the noise of H, and to its reduction, is that of an H recorded again
        P = self.P.with_new_noise(int(rng.integers(1 << 31)))
        name = f"replicate {key[1] + 1}"
        runs = [(noise.sampled(light, rng), P, name)]
        if split:
            runs.append((noise.limited(light), P, f"{name} without noise"))
        if split and self.uncertain:
            exact = np.maximum(self.P.forward(drawn), 0)
            runs.append((noise.limited(exact), self.P, f"{name} without noise, with the exact H"))
        bad = ~np.isfinite(self.image)
        found: list[NDArray[Any]] = []
        for k, (frame, projector, note) in enumerate(runs):
            frame[bad] = np.nan
            made = yield from self.iter_run(clock, done + k * self.choice.iterations, note, frame, projector)
            found.append(made.volume)
        return [found[0], drawn, *found[1:]]
