"""Predict the frame of a known object with the H of a fit, or with the H of each region of the field."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lfcal.base import InputError
from lfcal.fit import MODEL, Compared, NewFrame, StoredFit, predicted_frame
from lfcal.psf import open_psf
from lfcal.reconstruct import Projector

__all__ = ["ObjectPlace", "nearest", "object_error"]


@dataclass(frozen=True, eq=False)
class ObjectPlace:
    """A region of the sensor where an H is valid.

    Attributes
    ----------
    H
        File of H.
    middle_px
        Middle (row, column) of the scan on the sensor (pixels).
    gains
        Gain of each plane, because regions may have been recorded with different light.
    """

    H: Path
    middle_px: tuple[float, float]
    gains: tuple[float, ...]

    @classmethod
    def of(cls, fit: StoredFit) -> ObjectPlace:
        """Return the region of the H in the folder of a fit.

        Raises
        ------
        InputError
            If the fit was made without H.
        """
        H = fit.folder / MODEL
        if not H.is_file():
            raise InputError.expected(
                str(H), "H of the fit", "none", "fit again and write H (lfcal fit without --no-h)"
            )
        row, column = (a + (n - 1) / 2 for a, n in zip(fit.anchor, fit.period, strict=True))
        return cls(H, (row, column), tuple(map(float, fit.gains)))


def nearest(places: Sequence[ObjectPlace], shape: tuple[int, int], origin: tuple[float, float]) -> NDArray[np.intp]:
    """Return the index in ``places`` of the region nearest to each pixel of a frame, ``(rows, columns)``.

    The frame has the ``shape`` (rows, columns), and its first pixel is at ``origin`` (row, column) on the sensor.
    """
    rows, columns = (np.arange(n) + o for n, o in zip(shape, origin, strict=True))
    away = [np.add.outer((rows - r) ** 2, (columns - c) ** 2) for r, c in (one.middle_px for one in places)]
    found: NDArray[np.intp] = np.argmin(away, axis=0)
    return found


def object_error(
    places: Sequence[ObjectPlace],
    shot: NewFrame,
    volume: NDArray[np.float32],
    given: tuple[float, float] | None,
    workers: int | None,
) -> Compared:
    """Compare the frame of a known object with a prediction that uses the H of the region nearest to each object point.

    Patterns are thus assumed to be periodic only between a point and the nearest region.

    Parameters
    ----------
    places
        Regions of the sensor with their H.
    shot
        Frame of the object with the dark level subtracted.
    volume
        The object, ``(nz, rows, columns)``, in any unit; rows and columns are as in the frame.
    given
        Constant and slope of the variance of a sample, as in `NewFrame`. None: as stated by the frame.
    workers
        Number of threads. None: all processors.

    Raises
    ------
    InputError
        If neither ``given`` nor the frame states the variance.
    """
    noise = given or shot.noise
    if noise is None:
        raise InputError.expected(f"{shot.label}, noise", "a variance of its samples", "none", "state it (--noise)")
    rows, columns = shot.values.shape
    near = nearest(places, (rows, columns), shot.origin)
    common = np.mean([one.gains for one in places], axis=0)
    light, cutout = np.zeros((rows, columns)), (1, 1)
    for k, one in enumerate(places):
        # at equal light, because the light of a region's recording is not a property of the camera
        scale = (common / np.array(one.gains)).astype(np.float32)
        own = np.where(near == k, volume, np.float32(0)) * scale[:, None, None]
        with open_psf(one.H) as matrix:
            cutout = matrix.cutout
            if own.any():
                row, column = (a - o for a, o in zip(matrix.anchor, shot.origin, strict=True))
                light += Projector(matrix, (rows, columns), (row, column), workers=workers).forward(own)
    return predicted_frame(light, shot, noise, cutout)
