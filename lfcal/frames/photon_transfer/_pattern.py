"""What differs from pixel to pixel: response (PRNU), and pixels that do not measure."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lfcal.frames.cfa import phases
from lfcal.frames.photon_transfer._curve import PhotonTransferCurve
from lfcal.frames.photon_transfer._levels import FlatLevel
from lfcal.frames.photon_transfer.values import MeasuredValue

__all__ = ["find_dead", "measure_prnu"]

BOX = 5
"""Side of the neighbourhood whose mean is taken for the light at a pixel."""

STRUCTURED = 0.15
"""Correlation of neighbours in the residual above which it is no pattern of single pixels."""


def measure_prnu(
    level: FlatLevel, curve: PhotonTransferCurve, dark_variance: float, good: NDArray[np.bool_], cfa: str
) -> tuple[MeasuredValue | None, str]:
    """Return the relative rms of the pixels' responses, and why it cannot be told.

    The light is taken for smooth over `BOX` pixels of one colour; the temporal noise that is left in the mean of the
    flats is taken off (EMVA 1288 release 4, section 8). Micro-images are not smooth: there it is unknown.

    Parameters
    ----------
    level
        Flats near half of saturation.
    curve
        Variance of a sample over its signal.
    dark_variance
        Of a pixel of the mean dark that was subtracted (squared sample values).
    good
        Pixels without defect.
    cfa
        Colour filter pattern.
    """
    squares, noise, count, alike = 0.0, 0.0, 0, [0.0]
    for rows, columns in phases(cfa):
        part, use = level.bright[rows, columns].astype(np.float64), good[rows, columns]
        local = _local(part, use)
        inner = use & (local > 0.2 * float(part[use].mean()))
        residual = np.where(inner, (part - local) / np.where(inner, local, 1), 0.0)
        own = float((residual**2).sum())
        squares, count = squares + own, count + int(inner.sum())
        left = curve.variance(local[inner]) / level.count + dark_variance
        noise += float((left / local[inner] ** 2).sum())
        along = (float((residual[1:] * residual[:-1]).sum()), float((residual[:, 1:] * residual[:, :-1]).sum()))
        alike += [abs(one) / max(own, 1e-300) for one in along]
    if count < 1000:
        return None, "pixel response (PRNU): unknown, for too few pixels are lit"
    if max(alike) > STRUCTURED:
        return None, "pixel response (PRNU): unknown, for the flats have structure; take flats without the lenslets"
    # of the residual of a mean over a box that holds the pixel itself, (1 - 1/box) of the pixel's variance is left
    seen = squares / count / (1 - 1 / BOX**2)
    chance = float(seen * np.sqrt(2 / count)) + 0.02 * noise / count
    found = MeasuredValue(seen - noise / count, chance).root()
    if found.value < 2 * found.sigma:
        return None, f"pixel response (PRNU): below {100 * 2 * found.sigma:.2g} %, lost in noise; average more flats"
    return found, ""


def _local(part: NDArray[np.float64], use: NDArray[np.bool_]) -> NDArray[np.float64]:
    from scipy import ndimage

    weight = ndimage.uniform_filter(use.astype(np.float64), BOX, mode="nearest")
    light = ndimage.uniform_filter(np.where(use, part, 0.0), BOX, mode="nearest")
    return light / np.maximum(weight, 1e-3)


def find_dead(bright: NDArray[np.float32], good: NDArray[np.bool_], noise: float, cfa: str) -> NDArray[np.bool_]:
    """Return the pixels that show less than a quarter of the light of the dimmest third of their neighbours.

    Neighbours are the eight next of the same colour; at the edge of a micro-image most of them are lit too.
    """
    from scipy import ndimage

    dead = np.zeros(bright.shape, np.bool_)
    around = np.ones((3, 3), bool)
    around[1, 1] = False
    for rows, columns in phases(cfa):
        part = bright[rows, columns]
        low = ndimage.rank_filter(part, rank=2, footprint=around, mode="nearest")
        dead[rows, columns] = (part < 0.25 * low) & (low > 20 * max(noise, 0.3)) & good[rows, columns]
    return dead
