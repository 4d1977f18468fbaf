"""Modulators for exposure, time and cameras: assorted pixels, coded shutters, arrays of cameras."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfcal.base import InputError, array_words, check_tuple
from lfcal.multiplex.modulator import Modulator, modulator_from_matrix

__all__ = ["camera_array", "coded_shutter", "interleave", "neutral_density"]

Array = NDArray[np.float64]


def neutral_density(transmissions: ArrayLike, *, name: str = "") -> Modulator:
    """Return a modulator whose pixels have different exposures; its single sample is the radiance.

    Such assorted pixels extend the dynamic range (Nayar and Mitsunaga 2000, Narasimhan and Nayar 2005). The exposures
    are determined by the transmissions of neutral-density filters, or by the exposure times relative to the longest. To
    exclude saturated pixels, pass the weights of `pixel_weights` to `demultiplex`.

    Parameters
    ----------
    transmissions
        Fraction of the light that each pixel of a super-pixel receives, ``(rows, columns)``, 0 to 1.
    name
        Name in tables and plots.

    Examples
    --------
    >>> import numpy as np
    >>> from lfcal.multiplex import demultiplex, neutral_density
    >>> frame = np.tile([255.0, 100.0], (4, 4))  # the clear pixels are saturated
    >>> radiance = demultiplex(frame, neutral_density([(1, 0.25)]), weights=frame < 255)
    >>> print(radiance[0, 0].round(3))
    [400. 400. 400. 400. 400. 400. 400. 400.]
    """
    shares = _shares("exposures of the super-pixel", transmissions)
    found = name or "ND " + "/".join(f"{share:.3g}" for share in shares.ravel()[:6])
    return modulator_from_matrix(found, shares.shape, shares.reshape(-1, 1))


def coded_shutter(open_shares: ArrayLike, *, name: str = "coded shutter") -> Modulator:
    """Return a modulator whose pixels are open in different intervals of an exposure; each interval is a sample.

    Parameters
    ----------
    open_shares
        Fraction of each time interval during which a pixel of the super-pixel is open, ``(rows, columns, intervals)``,
        0 to 1.
    name
        Name in tables and plots.

    Examples
    --------
    >>> import numpy as np
    >>> from lfcal.multiplex import coded_shutter, demultiplex
    >>> shutter = coded_shutter([[(1, 0), (1, 1)]])  # one pixel closes after the first interval
    >>> print(shutter.sample_names, demultiplex(np.tile([3.0, 5.0], (4, 4)), shutter)[:, 0, 0].round(3))
    ('t0', 't1') [3. 2.]
    """
    array = np.asarray(open_shares, float)
    if array.ndim != 3:
        raise InputError.expected(
            name,
            "fractions of the exposure, with shape (rows, columns, moments)",
            array.shape,
            "give an array of this shape",
        )
    shares = _shares(name, array.reshape(-1, array.shape[2])).reshape(array.shape)
    moments = tuple(f"t{k}" for k in range(array.shape[2]))
    side = (array.shape[0], array.shape[1])
    return modulator_from_matrix(name, side, shares.reshape(-1, len(moments)), colours=moments)


def camera_array(rows: int, columns: int) -> Modulator:
    """Return an array of ``rows`` x ``columns`` cameras, each of which records one view, as a modulator.

    `interleave` combines the frames of the cameras.

    If the cameras have different filters, shutters or polarisers, multiply the result by a modulator with the same
    super-pixel, such as ``camera_array(2, 2) * cfa("Bayer")``. Its samples are all views in all colours, of which each
    camera measures only one. If all cameras see the same view, as for a distant scene, use only the modulator of the
    colours.

    Examples
    --------
    >>> import numpy as np
    >>> from lfcal.multiplex import camera_array, demultiplex, interleave
    >>> cameras = camera_array(1, 2)
    >>> frame = interleave([np.full((3, 4), 10.0), np.full((3, 4), 20.0)], (1, 2))
    >>> print(demultiplex(frame, cameras)[:, 0, 0].round(3))  # fractions of the light of both
    [ 5. 10.]
    >>> print(cameras.sample_names)
    ('view 0,0', 'view 0,1')
    """
    side = check_tuple("cameras (rows, columns)", (rows, columns), 2, at_least=1, at_most=64, integer=True)
    identity = math.prod(side) * np.eye(math.prod(side))  # a camera collects all its light, like a lenslet
    return modulator_from_matrix(
        f"cameras {rows} x {columns}",
        (rows, columns),
        identity,
        views=(rows, columns),
        cell=(rows, columns),
        lenslets=True,
    )


def interleave(frames: Sequence[ArrayLike], side: tuple[int, int]) -> NDArray[np.float32] | Array:
    """Combine the frames of several cameras (or exposures) into one mosaic ``(rows * side[0], columns * side[1])``.

    Frame k provides pixel k (in row-major order) of every super-pixel of ``side`` (rows, columns) pixels. An array of
    cameras can thus be demultiplexed like a single sensor. The mosaic is float64 if a frame is, else float32.

    Raises
    ------
    InputError
        If the number of frames differs from the number of pixels of the super-pixel, or the frames are not
        two-dimensional arrays of the same shape.

    Examples
    --------
    >>> from lfcal.multiplex import interleave
    >>> print(interleave([[[1, 2]], [[3, 4]], [[5, 6]], [[7, 8]]], (2, 2)))
    [[1. 3. 2. 4.]
     [5. 7. 6. 8.]]
    """
    rows, columns = check_tuple("super-pixel (rows, columns)", side, 2, at_least=1, integer=True)
    arrays = [np.asarray(frame) for frame in frames]
    shapes = {a.shape for a in arrays}
    if len(arrays) != rows * columns or len(shapes) != 1 or arrays[0].ndim != 2:
        wanted = f"{rows * columns} frames (rows, columns) of the same shape"
        raise InputError.expected(
            "frames to interleave",
            wanted,
            f"{len(arrays)} of shape {' and '.join(map(str, sorted(shapes)))}" if arrays else "none",
            "give one frame for each pixel of a super-pixel",
        )
    h, w = arrays[0].shape
    kind = np.float64 if any(a.dtype == np.float64 for a in arrays) else np.float32
    mosaic = np.empty((h * rows, w * columns), kind)
    for k, array in enumerate(arrays):
        mosaic[k // columns :: rows, k % columns :: columns] = array
    return mosaic


def _shares(what: str, values: ArrayLike) -> Array:
    shares = np.asarray(values, float)
    good = shares.ndim == 2 and shares.size and np.isfinite(shares).all() and shares.min() >= 0 and shares.max() <= 1
    if not good or not shares.any():
        raise InputError.expected(
            what,
            "rows and columns of fractions from 0 to 1, not all 0",
            array_words(shares),
            "correct these fractions",
        )
    return shares
