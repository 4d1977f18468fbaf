"""How large what recorded patterns show beyond a model is, pixel by pixel: variance beyond that of the noise."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

__all__ = ["PlaneResiduals", "amplitudes", "sized"]

F4 = NDArray[np.float32]
F8 = NDArray[np.float64]
Flags = NDArray[np.bool_]

SURE = 5.0
"""Standard deviations by which a variance beyond the noise must lie above none to be taken for one."""

KNOTS = np.log(np.array([0.001, 0.003, 0.01, 0.03, 0.1, 0.3, 1.0]))
"""Brightness over the plane's brightest, as logarithm, at which the size of residuals is found."""


@dataclass(frozen=True, eq=False)
class PlaneResiduals:
    """A plane's model and what was measured of it.

    Attributes
    ----------
    model
        Light as predicted ``(ny, nx, nt, ns)``.
    residual
        Measured minus predicted, 0 where nothing was measured.
    precision
        1 over the noise's variance; 0 where nothing was measured.
    recorded
        Positions ``(ny, nx)`` that count.
    around
        Whether positions are a whole period, whose last neighbours the first.
    sizes
        Standard deviations of what spots and stray light lack, beyond noise; empty before they are known.
    """

    model: F4
    residual: F4
    precision: F4
    recorded: Flags
    around: bool
    sizes: tuple[F4, ...] = ()

    @property
    def period(self) -> tuple[int, int]:
        """Positions ``(ny, nx)``."""
        return self.model.shape[0], self.model.shape[1]

    def window(self, rows: slice, columns: slice) -> PlaneResiduals:
        """Return the plane in some of the cutout's pixels."""
        model, residual, precision, *sizes = (
            np.ascontiguousarray(one[:, :, rows, columns])
            for one in (self.model, self.residual, self.precision, *self.sizes)
        )
        return PlaneResiduals(model, residual, precision, self.recorded, self.around, tuple(sizes))

    def without(self, aside: Flags) -> PlaneResiduals:
        """Return the plane with the positions ``aside`` not measured."""
        keep = ~aside
        return replace(self, precision=self.precision * keep[:, :, None, None], recorded=self.recorded & keep)


def amplitudes(model: F4) -> tuple[F4, F4]:
    """Return where residuals of spots, and stray light, are to be expected: each as large as the light near by.

    Of spots the light of a pixel and of those about it, by half each: what is dim beside what is bright errs by more
    than its own light. Of stray light the mean of all positions, for it comes from any lenslet.
    """
    from scipy.ndimage import gaussian_filter  # slow to load

    near, far = (gaussian_filter(np.square(model), (0, 0, width, width)).clip(min=0) for width in (0.6, 4.0))
    mean = gaussian_filter(model.mean((0, 1)), 3).clip(min=0)
    return ((near * far) ** 0.25).astype(np.float32), np.broadcast_to(mean.astype(np.float32), model.shape)


def sized(data: PlaneResiduals) -> PlaneResiduals:
    """Return the plane with the standard deviations of what spots and stray light lack; without where noise is all.

    Residuals have E[R² - V] = s² A² + c² B² with the amplitudes A and B, and s by brightness. Weights lie between those
    of chi², by which dark pixels alone would count, and of the light's squares.
    """
    own = data.recorded
    near, mean = amplitudes(data.model)
    good = data.precision[own] > 0
    noise = (1.0 / data.precision[own][good]).astype(np.float64)
    square = np.square(data.residual[own][good], dtype=np.float64) - noise
    x = np.stack([np.square(one[own][good], dtype=np.float64) for one in (near, mean)])
    found = np.zeros(2)
    for _ in range(6):
        weight = 1.0 / (noise + found @ x)
        found = _not_negative((x * weight) @ x.T, (x * weight) @ square)
    sure = [_deviation(x[k], noise) * SURE < found[k] for k in (0, 1)]
    if not any(sure):
        return data
    found = np.where(sure, found, 0.0)
    brightness = np.log(np.maximum(data.model / max(float(data.model.max()), 1e-30), 1e-6))
    grown = _by_brightness(found @ x, square, noise, brightness[own][good])
    grown = np.interp(brightness, KNOTS, grown)
    # in bright pixels, of which chi² tells little, there may be more: then all is as large
    stated = (found @ x) * grown[own][good]
    whole, error = (float(v) / float(stated.sum()) for v in (square.sum(), math.sqrt(2.0 * float((noise**2).sum()))))
    if whole > 1.0 + 2.0 * error:
        grown *= min(4.0, whole)
    grown = np.sqrt(grown).astype(np.float32)
    spots, stray = (np.float32(math.sqrt(size)) * one * grown for size, one in zip(found, (near, mean), strict=True))
    return replace(data, sizes=(spots, stray))


def _not_negative(matrix: F8, gradient: F8) -> F8:
    """Return the solution of normal equations of two unknowns that are not negative."""
    out = np.zeros(2)
    used = [k for k in (0, 1) if matrix[k, k] > 0]
    while used:
        part = np.linalg.lstsq(matrix[np.ix_(used, used)], gradient[used], rcond=1e-10)[0]
        if (part > 0).all():
            out[used] = part
            break
        used.remove(used[int(np.argmin(part))])
    return out


def _deviation(x: F8, noise: F8) -> float:
    """Return the standard deviation of a share of ``x`` where there is noise alone: its squares have 2 V²."""
    total = float((x * x / noise).sum())
    return math.sqrt(2.0 * float((x * x).sum())) / total if total > 0 else math.inf


def _by_brightness(stated: F8, square: F8, noise: F8, brightness: F8) -> F8:
    """Return what residuals scatter beyond noise over what is stated (squares), at each of `KNOTS`.

    Where few pixels tell it stays near 1.
    """
    nearest = np.abs(brightness[:, None] - KNOTS).argmin(1)
    out = np.ones(len(KNOTS))
    for k in range(len(KNOTS)):
        part, other, size = (one[nearest == k] for one in (stated, noise, square))
        told = np.square(part / (other + part))
        if told.sum() > 0:
            weight = 0.5 * float(told.sum())
            value = float((told * size / np.maximum(part, 1e-30)).sum()) / float(told.sum())
            out[k] = min(25.0, max(0.04, (value * weight + 1.0) / (weight + 1.0)))
    return out
