"""Modulators for polarisation: response of pixels behind polarisers and retarders to the Stokes parameters."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfcal.base import InputError, array_words, check_number
from lfcal.multiplex.modulator import Modulator, modulator_from_matrix

__all__ = ["STOKES", "degree_of_polarisation", "polarisers"]

STOKES = ("S0", "S1", "S2", "S3")
"""Stokes parameters: all light, horizontal minus vertical, +45° minus -45°, right minus left circular."""

MOST_POLARISERS = 4096
"""Largest number of pixels of a super-pixel."""


def polarisers(
    angles_deg: ArrayLike, *, retardance_deg: ArrayLike | None = None, extinction: float = math.inf
) -> Modulator:
    """Return a super-pixel of linear polarisers, which measures the Stokes parameters S0 to S2.

    With ``retardance_deg``, it also measures S3.

    A polariser at the angle a transmits ``(S0 + e (S1 cos 2a + S2 sin 2a)) / 2`` (Mueller matrix of a diattenuator),
    with e = 1 for an ideal one. It transmits half of unpolarised light, for which only S0 is nonzero.

    Parameters
    ----------
    angles_deg
        Angle of the transmission axis of the polariser at each pixel (degrees), ``(rows, columns)``; NaN: no polariser.
    retardance_deg
        Retardance (degrees) of a wave plate in front of each polariser, with its fast axis at 0°, ``(rows, columns)``;
        90 for a quarter-wave plate. None: no wave plates.
    extinction
        Extinction ratio x: light transmitted with parallel polarisation divided by that with perpendicular
        polarisation; ideally infinite. The transmitted fractions are (1 ± e)/2 with e = (x - 1)/(x + 1).

    Raises
    ------
    InputError
        If the arrays are not two-dimensional and of the same shape, or have invalid values.

    Examples
    --------
    >>> from lfcal.multiplex import polarisers
    >>> array = polarisers([[0, 45], [135, 90]])
    >>> print((array.matrix @ [1, 0.6, 0.8]).round(3))  # S0, S1, S2 of fully polarised light, at 27°
    [0.8 0.9 0.1 0.2]
    >>> print((array.inverse() @ [0.8, 0.9, 0.1, 0.2]).round(3))  # and back
    [1.  0.6 0.8]
    """
    angles = np.asarray(angles_deg, float)
    if angles.size > MOST_POLARISERS:
        raise InputError.expected(
            "angles of polarisers", f"at most {MOST_POLARISERS:,}", f"{angles.size:,}", "give one period of the array"
        )
    if angles.ndim != 2 or not angles.size or np.isinf(angles).any():
        raise InputError.expected(
            "angles of polarisers",
            "rows and columns of angles in degrees",
            array_words(angles),
            "give a two-dimensional array",
        )
    if extinction != math.inf:
        check_number("extinction ratio", extinction, above=1)
    contrast = 1.0 if math.isinf(extinction) else (extinction - 1) / (extinction + 1)
    matrix = _rows(np.radians(angles.ravel()), contrast, _plates(retardance_deg, angles.shape))
    kept = 3 if retardance_deg is None else 4
    named = "/".join("–" if math.isnan(a) else f"{a:g}°" for a in angles.ravel()[:8])
    light = np.eye(kept)[0]  # unpolarised
    side = (angles.shape[0], angles.shape[1])
    return modulator_from_matrix(f"polarisers {named}", side, matrix[:, :kept], colours=STOKES[:kept], light=light)


def _plates(retardance: ArrayLike | None, shape: tuple[int, ...]) -> NDArray[np.float64]:
    plates = np.zeros(shape) if retardance is None else np.asarray(retardance, float)
    if plates.shape != shape or not np.isfinite(plates).all():
        raise InputError.expected(
            "retardance of plates",
            f"degrees, in an array of shape {shape}",
            array_words(plates),
            "write 0 for polarisers without a plate",
        )
    return np.asarray(np.radians(plates.ravel()), float)


def _rows(angles: NDArray[np.float64], contrast: float, plates: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the first rows ``(K, 4)`` of the Mueller matrices of a plate followed by a polariser."""
    bare = np.isnan(angles)
    double = 2 * np.where(bare, 0.0, angles)
    # a plate with its fast axis at 0° turns S2 into S3 and leaves S1
    across = contrast * np.sin(double)
    rows = [np.ones_like(double), contrast * np.cos(double), across * np.cos(plates), across * np.sin(plates)]
    matrix = np.asarray(np.stack(rows, 1) / 2, float)
    matrix[bare] = (1.0, 0.0, 0.0, 0.0)
    return matrix


def degree_of_polarisation(stokes: ArrayLike) -> NDArray[np.float64]:
    """Return the degree of polarisation for Stokes parameters ``(3, ...)`` or ``(4, ...)``; 0 where S0 <= 0.

    It is from 0 to 1 for physical values, but may be larger because of noise.

    Examples
    --------
    >>> from lfcal.multiplex import degree_of_polarisation
    >>> stokes = [[1, 1, 2], [0, 0.6, 1.2], [0, 0.8, 0]]  # S0, S1, S2 of three pixels
    >>> print(degree_of_polarisation(stokes).round(3))
    [0.  1.  0.6]
    """
    values = np.asarray(stokes, float)
    if values.ndim < 1 or len(values) not in (3, 4):
        raise InputError.expected(
            "Stokes parameters", "3 or 4 planes", f"shape {values.shape}", "give S0, S1, S2 (and S3)"
        )
    strength = np.sqrt((values[1:] ** 2).sum(0))
    lit = values[0] > 0
    return np.asarray(np.where(lit, strength / np.where(lit, values[0], 1.0), 0.0), float)
