"""Comparison of a new frame with the prediction of H: fitted gain, background and source position, and residuals."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from lfcal.base import InputError
from lfcal.fit.locate import LocatedPattern, NewFrame, window_of
from lfcal.fit.model_error import ChiSquare, ModelError

__all__ = ["Compared", "Says", "compared_with"]

F8 = NDArray[np.float64]

STRANGE = 0.2
"""Correlation below which a frame has nothing in common with H."""

ROUNDS = 8
"""Largest number of steps for the position of the source."""

STEP_PX = 0.05
"""Step of the finite differences with respect to the displacement of the source (pixels)."""

LIGHT = 3.0
"""Standard deviations by which a frame must differ from a uniform one."""


@dataclass(frozen=True, eq=False)
class Compared:
    """One frame compared with the prediction of H.

    Attributes
    ----------
    label
        Name of the frame.
    found
        Position in H of the pattern with which the frame was compared, sensor pixel at the middle of its cutout, and
        correlation of frame and pattern.
    displacement_px, displacement_sigma
        Displacement (dy, dx) of the source from the position in H, fitted together with gain and background, and its
        standard deviation (pixels).
    gain, background
        Factor from the light of H to that of the frame, and constant added to the product (counts).
    error
        Relative error (L2) of H beyond the noise.
    chi_square
        Chi-square of the residuals.
    doubt
        Uncertainty of the prediction for a source between positions of H (relative L2).
    beside_px
        Offset (dy, dx) of the source from its known position (pixels); None if the position is not known.
    values, light, noise, weight
        Arrays ``(nt, ns)``: samples minus background, prediction of H times ``gain``, variance of their difference, and
        inverse of its standard deviation (0: sample not used).
    moved
        Derivative of ``light`` with respect to the displacement (dy, dx) of the source, per pixel, ``(2, nt, ns)``.
    """

    label: str
    found: LocatedPattern
    displacement_px: tuple[float, float]
    displacement_sigma: tuple[float, float]
    gain: float
    background: float
    error: ModelError
    chi_square: ChiSquare
    doubt: float
    beside_px: tuple[float, float] | None
    values: F8 = field(repr=False)
    light: F8 = field(repr=False)
    noise: F8 = field(repr=False)
    weight: F8 = field(repr=False)
    moved: F8 = field(repr=False)

    @property
    def strange(self) -> bool:
        """Whether the correlation with the pattern of H is so low that the frame has nothing in common with H."""
        return self.found.correlation < STRANGE


class Says(Protocol):
    """Protocol for the predicted pattern of a source at or near a position."""

    valid: NDArray[np.bool_]
    """Pixels ``(nt, ns)`` for which there is a prediction."""
    noise: F8
    """Variance ``(nt, ns)`` of the prediction's own samples."""
    reach: tuple[float, float]
    """Largest displacement (dy, dx) from the position that can be predicted (px)."""

    def at(self, offset: F8) -> F8:
        """Return the pattern ``(nt, ns)`` of a source displaced from the position by ``offset`` (dy, dx; px)."""

    def doubt(self, offset: F8) -> float:
        """Return the relative uncertainty (L2) of the prediction of `at` for ``offset`` (dy, dx; px)."""


def compared_with(expected: Says, frame: NewFrame, at: LocatedPattern, noise: tuple[float, float]) -> Compared:
    """Compare a frame with its prediction at the best-fit gain, background and position of the source.

    The displacement of the source is limited to ``expected.reach``. ``at`` is the position of H to which ``expected``
    belongs, and ``noise`` the constant and the slope of the variance of a sample, as in `NewFrame`. Raise `InputError`
    if the cutout has fewer than nine usable samples, or no light above its noise.
    """
    raw, there = window_of(frame, at.row, at.column, expected.noise.shape)
    data, good = raw.astype(np.float64), there & expected.valid
    if good.sum() < 9:
        where = f"(z, y, x) = ({at.z}, {at.y}, {at.x})"
        raise InputError.expected(
            f"{frame.label}, samples at {where}", "at least 9 usable samples", int(good.sum()), "reduce the exposure"
        )
    offset, steps = np.zeros(2), np.zeros((2, *data.shape))
    gain, background = _levels(data, expected.at(offset), good, np.ones_like(data))
    reach = np.array(expected.reach)
    sigma = np.zeros(2)
    for turn in range(ROUNDS):
        light = expected.at(offset)
        variance = _variance(noise, gain, light, expected.noise, data if turn == 0 else None)
        gain, background = _levels(data, light, good, variance)
        for axis in np.flatnonzero(reach).tolist():
            by = np.zeros(2)
            by[axis] = STEP_PX
            steps[axis] = (expected.at(offset + by) - expected.at(offset - by)) / (2 * STEP_PX)
        move, sigma = _step(data - gain * light - background, gain, light, steps, good, variance)
        new = np.clip(offset + np.clip(move, -0.4, 0.4), -reach, reach)
        done = float(np.abs(new - offset).max()) < 0.002
        offset = new
        if done:
            break
    light = expected.at(offset)
    variance = _variance(noise, gain, light, expected.noise, None)
    gain, background = _levels(data, light, good, variance)
    _check_light(frame.label, data[good], noise)
    weight = np.where(good, 1.0 / np.sqrt(variance), 0.0)
    shown = gain * light
    residual = data - shown - background
    error = _error(residual, shown, variance, good)
    chi2 = _chi(residual, variance, noise[0], good)
    return Compared(
        frame.label,
        at,
        (float(offset[0]), float(offset[1])),
        (float(sigma[0]), float(sigma[1])),
        gain,
        background,
        error,
        chi2,
        expected.doubt(offset),
        None if frame.place is None else _beside(at, offset, frame.place),
        data - background,
        shown,
        variance,
        weight,
        gain * steps,
    )


def _beside(at: LocatedPattern, offset: F8, place: tuple[float, float]) -> tuple[float, float]:
    """Return the offset (dy, dx) of a source from the position that its frame states (pixels)."""
    return float(at.row + offset[0] - place[0]), float(at.column + offset[1] - place[1])


def _check_light(label: str, data: F8, noise: tuple[float, float]) -> None:
    """Raise `InputError` if a frame shows no light above its noise."""
    off = data - np.median(data)
    variance = noise[0] + noise[1] * np.maximum(off, 0.0)
    if float((off**2 - variance).sum()) <= LIGHT * math.sqrt(2.0 * float(np.square(variance).sum())):
        raise InputError.expected(
            f"{label}, light",
            "more light than noise",
            "no light above the noise",
            "increase the exposure, or check the lamp",
        )


def _variance(noise: tuple[float, float], gain: float, light: F8, own: F8, data: F8 | None) -> F8:
    """Return the variance of samples minus ``gain * light``: that of the frame plus that of the samples of H."""
    shown = np.maximum(gain * light, 0.0)
    if data is not None:
        shown = np.maximum(shown, data)
    found: F8 = noise[0] + noise[1] * shown + gain**2 * own
    return found + 1e-12 * float(np.square(shown).max()) + 1e-300


def _levels(data: F8, light: F8, good: NDArray[np.bool_], variance: F8) -> tuple[float, float]:
    weight = 1.0 / np.sqrt(variance[good])
    a = np.stack([light[good] * weight, weight], axis=1)
    gain, background = np.linalg.lstsq(a, data[good] * weight, rcond=None)[0]
    return float(gain), float(background)


def _step(residual: F8, gain: float, light: F8, steps: F8, good: NDArray[np.bool_], variance: F8) -> tuple[F8, F8]:
    """Return the step of the displacement (px), fitted with gain and background, and its standard deviation."""
    weight = 1.0 / np.sqrt(variance[good])
    a = np.stack([gain * steps[0][good], gain * steps[1][good], light[good], np.ones(int(good.sum()))]) * weight
    inverse = np.linalg.pinv(a @ a.T, rcond=1e-12, hermitian=True)
    found = inverse @ (a @ (residual[good] * weight))
    return found[:2], np.sqrt(np.maximum(np.diag(inverse)[:2], 0.0))


def _error(residual: F8, light: F8, variance: F8, good: NDArray[np.bool_]) -> ModelError:
    power = float(np.square(light[good]).sum())
    if power <= 0:
        return ModelError(math.inf, 0.0, 0.0, 1)
    squares = float((np.square(residual[good]) - variance[good]).sum())
    return ModelError(squares / power, math.sqrt(2.0 * float(np.square(variance[good]).sum())) / power, 0.0, 1)


def _chi(residual: F8, variance: F8, constant: float, good: NDArray[np.bool_]) -> ChiSquare:
    size = np.square(residual[good]) / variance[good]
    bright = np.clip(1.0 - constant / variance[good], 0.0, 1.0)
    total = float(bright.sum())
    if total <= 0:
        return ChiSquare(float(size.mean()), float(size.mean()), math.sqrt(2.0 / size.size))
    spread = math.sqrt(2.0 * float(np.square(bright).sum())) / total
    return ChiSquare(float(size.mean()), float((bright * size).sum()) / total, spread)
