"""Prepare the image for a solver: weights, background and noise, without invalid values."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from lfcal.base import MAX_SAMPLE, InputError, check_number, format_count, in_order

__all__ = ["GoodnessOfFit", "Measurement", "NothingMeasured", "check_counts", "held_out_fit", "no_light"]


BAND = 1 << 17
"""Number of pixels that are compared with the model at a time."""

LARGE = 1 << 20
"""Number of pixels above which threads are faster."""

NOTHING = np.zeros(0)

FAINTEST = 1e-31
"""Counts of the brightest pixel below which single precision has too few digits."""

TINY = float(np.finfo(np.float64).tiny)

HALF_MEDIAN = 0.22747
"""Median of half of chi squared with one degree of freedom."""


class NothingMeasured(InputError):
    """Error for an image without information on a volume: no pixel is valid, or no valid pixel has light."""


def check_counts(read_noise: float, saturation: float | None) -> None:
    """Raise `InputError` unless ``read_noise`` and ``saturation`` (counts; None: no saturation) are in range.

    The read noise must be from 0 to the square root of `MAX_SAMPLE`, and the saturation above 0 and at most
    `MAX_SAMPLE`.
    """
    check_number("read noise (counts)", read_noise, at_least=0, at_most=math.sqrt(MAX_SAMPLE))
    if saturation is not None:
        check_number("saturation (counts)", saturation, above=0, at_most=MAX_SAMPLE)


@dataclass(frozen=True, slots=True)
class GoodnessOfFit:
    """Residual and likelihood of a model image, and likelihood of the held-out pixels with its standard deviation.

    The fields are those of `SolverProgress`.
    """

    residual: float
    likelihood: float
    held_out: float = float("nan")
    held_out_error: float = float("nan")


@dataclass(frozen=True, slots=True)
class Measurement:
    """Image to reconstruct, with weights and background; create one with `Measurement.of`.

    Attributes
    ----------
    image
        Image (counts), ``(Y, X)``, plus the square of the read noise; finite, and not negative unless created with
        ``signed``.
    weights
        Weight of each pixel, ``(Y, X)``. None: 1 everywhere.
    background
        Expected image without light (counts), plus the square of the read noise; a number or ``(Y, X)``.
    notes
        Notes on how the image was changed.
    held
        Weight of each held-out pixel, ``(Y, X)``, 0 for all others. None: no held-out pixels.
    """

    image: NDArray[Any]
    weights: NDArray[Any] | None
    background: Any
    notes: tuple[str, ...] = ()
    held: NDArray[Any] | None = None

    @classmethod
    def of(
        cls,
        image: ArrayLike,
        *,
        dtype: DTypeLike,
        weights: ArrayLike | None = None,
        saturation: float | None = None,
        background: ArrayLike = 0.0,
        read_noise: float = 0.0,
        signed: bool = False,
        held_out: ArrayLike | None = None,
    ) -> Measurement:
        """Check ``image``, and return it as a measurement.

        Parameters
        ----------
        image
            Image ``(Y, X)`` in counts. Pixels that are NaN or infinite get weight 0.
        dtype
            Floating-point type of the arrays of the result.
        weights
            Weight of each pixel, ``(Y, X)``, not negative. None: 1.
        saturation
            Sample value at which pixels saturate (counts, above 0); pixels at or above it get weight 0. None: no
            saturation.
        background
            Expected image without light (counts), not negative; a number or ``(Y, X)``.
        read_noise
            Rms of the Gaussian read noise (counts). Its square is added to image and background (the shifted Poisson
            approximation of Snyder et al. 1995).
        signed
            Whether to keep negative values, for least squares; otherwise they are set to 0, and a note states how many.
        held_out
            Mask ``(Y, X)``, True at held-out pixels, which get weight 0 and test the prediction. None: no held-out
            pixels.

        Raises
        ------
        InputError
            If shapes differ, or pixels, weights, background, read noise or saturation are invalid.
        NothingMeasured
            If no pixel has both weight and light, so that there is no volume.
        """
        check_counts(read_noise, saturation)
        data = np.array(image, dtype)
        if data.ndim != 2:
            raise InputError.expected("image", "two axes (y, x)", f"{data.ndim} axes", "give one frame")
        trust = None if weights is None else _fitting("weights", weights, data.shape, dtype)
        floor = _fitting("background", background, data.shape, dtype)
        bad = ~np.isfinite(data)
        # pixels without weight, such as the margin around a frame, are already excluded
        counted = np.broadcast_to(True, data.shape) if trust is None else trust > 0
        notes = []
        if lost := int(np.count_nonzero(bad & counted)):
            notes.append(f"{format_count(lost, 'non-finite pixel was', 'non-finite pixels were')} left out")
        if saturation is not None:
            full = np.greater_equal(data, saturation, where=~bad, out=np.zeros(data.shape, bool))
            if lost := int(np.count_nonzero(full & counted)):
                notes.append(f"{format_count(lost, 'saturated pixel was', 'saturated pixels were')} left out")
            bad |= full
        if bad.any():
            trust = np.where(bad, 0, 1 if trust is None else trust).astype(dtype)
            data[bad] = 0
        _check_light(data, counted & ~bad, notes)
        if read_noise > 0:
            data += np.asarray(read_noise**2, dtype)
            floor = floor + np.asarray(read_noise**2, dtype)
        # counted after the read noise is added: its square lifts most of them above zero.
        below = int(np.count_nonzero(data < 0))
        if below and not signed:
            notes.append(
                f"{format_count(below, 'negative pixel was', 'negative pixels were')} set to 0, because this solver "
                "needs values of 0 or more; to keep most of them, state the read noise"
            )
            np.maximum(data, 0, out=data)
        held = None
        if held_out is not None:
            mask = _fitting("held-out pixels", held_out, data.shape, dtype)
            held = mask if trust is None else mask * trust
            trust = (1 - mask) if trust is None else (1 - mask) * trust
        return cls(data, trust, floor, tuple(notes), held)

    def weighted(self, image: NDArray[Any]) -> NDArray[Any]:
        """Return ``image`` ``(Y, X)`` multiplied by the weights."""
        return image if self.weights is None else image * self.weights

    def ones(self) -> NDArray[Any]:
        """Return the weights ``(Y, X)``, ones if there are none; their back projection is the sensitivity."""
        return np.ones_like(self.image) if self.weights is None else self.weights

    def fit(self, model: NDArray[Any], mask: NDArray[Any] | None = None, floor: float = 0.0) -> GoodnessOfFit:
        """Return how well ``model``, an image with background, fits the measurement where ``mask`` is True.

        Both arrays are ``(Y, X)``; without a mask, all pixels are used. The likelihood is
        ``-sum w (f log(f/m) - f + m)``, computed in float64. Here f is the measured image, w its weights, and m the
        model, at least ``floor``.
        """
        rows, columns = model.shape
        step = max(1, BAND // columns)
        work = partial(self._band, model, mask, max(floor, TINY))
        bands = [slice(k, min(k + step, rows)) for k in range(0, rows, step)]
        # bands are the same for any number of threads, and summed in order
        found = list(in_order(work, bands, None if model.size >= LARGE else 1))
        square, miss, deviance = (math.fsum(one[k] for one in found) for k in (0, 1, 2))
        residual = math.sqrt(miss / square) if square > 0 else float(miss > 0)
        if self.held is None:
            return GoodnessOfFit(residual, -deviance)
        terms, weights = (np.concatenate([one[k] for one in found]) for k in (3, 4))
        return GoodnessOfFit(residual, -deviance, *held_out_fit(terms, weights))

    def _band(
        self, model: NDArray[Any], mask: NDArray[Any] | None, least: float, band: slice
    ) -> tuple[float, float, float, NDArray[np.float64], NDArray[np.float64]]:
        """Return sums over some rows: of the squared data, of the squared residuals, and of half the deviance.

        The last two results are half the deviance and the weight of each held-out pixel.
        """
        data, m = self.image[band].astype(np.float64), model[band].astype(np.float64)
        trust = None if mask is None else mask[band].astype(np.float64)
        if self.weights is not None:
            trust = self.weights[band] * (1.0 if trust is None else trust)

        def total(values: NDArray[np.float64]) -> float:
            return float(values.sum() if trust is None else np.vdot(values, trust))

        square, miss = total(data**2), total((data - m) ** 2)
        # a model of 0 under a lit pixel would make the likelihood minus infinity
        np.maximum(m, least, out=m)
        # terms of dark pixels contain only the model, so any finite logarithm is allowed
        terms = np.log(np.maximum(data, TINY))
        terms -= np.log(m)
        terms *= data
        terms += m
        terms -= data
        if self.held is None:
            return square, miss, total(terms), NOTHING, NOTHING
        held = self.held[band] if mask is None else self.held[band] * mask[band]
        chosen = held > 0
        return square, miss, total(terms), terms[chosen], held[chosen].astype(np.float64)


def held_out_fit(terms: NDArray[np.float64], held: NDArray[Any]) -> tuple[float, float]:
    """Return the score of the prediction of held-out pixels, and its standard deviation due to noise.

    ``terms`` contains half the deviance of each pixel. ``held``, of the same shape, contains the weight of each
    held-out pixel, and 0 for all others. The score is minus the weighted sum of these terms. For a correct model, the
    terms are distributed like half of chi-square times a scale that depends on the gain. The scale is estimated from
    the median, so that errors of the model in a few pixels do not count as noise.
    """
    chosen = held > 0
    weights, values = held[chosen].astype(np.float64), terms[chosen]
    scale = float(np.median(values)) / HALF_MEDIAN if values.size else 0.0
    return -float((weights * values).sum()), scale * float(np.sqrt((weights**2).sum() / 2))


def _check_light(data: NDArray[Any], counted: NDArray[np.bool_], notes: list[str]) -> None:
    """Raise `NothingMeasured` unless a ``counted`` pixel has light; ``notes`` explain the exclusion of the others."""
    brightest = float(np.max(data, where=counted, initial=0))
    largest = max(brightest, -float(np.min(data, where=counted, initial=0)))
    if largest > MAX_SAMPLE:
        raise InputError.expected("image", f"counts up to {MAX_SAMPLE:g}", f"{largest:g}", "scale the frame")
    if brightest >= FAINTEST:
        return
    if brightest > 0:
        least = f"a pixel of at least {FAINTEST:g}"
        raise NothingMeasured.expected("image", least, f"no pixel above {brightest:.2g}", "give the frame in counts")
    said = "".join(f"; {note}" for note in notes)
    remedy = "check the frame, its saturation and the weights"
    if not counted.any():
        raise NothingMeasured.expected("image", "pixels to fit", f"none{said}", remedy)
    raise NothingMeasured.expected(
        "image", "light", f"no pixel above 0{said}", remedy if notes else "check the light and the background"
    )


def no_light() -> InputError:
    """Return the error for a PSF matrix whose entries are all zero or have a negative sum."""
    return InputError.expected(
        "PSF matrix",
        "light from the volume on the image",
        "none: the entries of H are zero, or their sum is negative",
        "check how H was assembled",
    )


def _fitting(what: str, value: ArrayLike, shape: tuple[int, ...], dtype: DTypeLike) -> NDArray[Any]:
    array = np.asarray(value, dtype)
    if array.ndim and array.shape != shape:
        raise InputError.expected(what, f"a number or shape {shape}", array.shape, "crop it like the image")
    if not np.isfinite(array).all() or (array < 0).any():
        raise InputError.expected(
            what, "finite values of 0 or more", "negative values, NaN or infinity", "replace these values"
        )
    return np.broadcast_to(array, shape) if what == "weights" else array
