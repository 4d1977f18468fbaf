"""Noise reduction for recorded patterns whose noise is known.

At a fixed pixel of the sensor, the signal is a smooth function of the position of the source. From one position to the
next, a spot moves by a fraction of a pixel under its lenslet. The entries of neighbouring positions for that pixel
therefore measure nearly the same value. An entry is moved towards their mean as far as noise explains their scatter
(the adaptive filter of Lee 1980, IEEE Trans. Pattern Anal. Mach. Intell. 2, 165-168, over positions). Where the signal
itself changes between them, the entry is kept. Light is not negative, and neither are the results.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.base import for_each_chunk
from lfcal.psf._noise_kernels import NoiseRule, reduce_noise
from lfcal.psf.facts import Origin, unpack_valid
from lfcal.psf.matrix import PSFMatrix

__all__ = ["denoised", "mean_noise", "noise_of_positions", "with_new_noise"]

RULE = NoiseRule(reach=3, certain=2.0)
"""Noise reduction by means of 7 x 7 positions; a mean below two standard errors becomes zero."""


def noise_of_positions(H: Any, z: int) -> NDArray[np.float64] | None:
    """Return the variance without light and the variance per unit of signal of each position in plane ``z``.

    The shape is ``(ny, nx, 2)``, with NaN where the noise is unknown or the pattern is not measured. The result is None
    for arrays and HT, and if no position has a noise above 0.
    """
    if not isinstance(H, PSFMatrix) or H.is_transposed or (stored := H.facts.noise) is None:
        return None
    known = H.facts
    noise = np.array(stored[z], np.float64)
    bad = ~np.isfinite(noise).all(axis=-1) | (noise < 0).any(axis=-1)
    if known.recorded is not None:
        bad |= known.recorded[z] == 0
    if known.origin is not None:
        bad |= known.origin[z] != Origin.MEASURED
    noise[bad] = np.nan
    # without noise, there is nothing to reduce
    return noise if np.nansum(noise) > 0 else None


def mean_noise(H: Any) -> NDArray[np.float64] | None:
    """Return the mean of `noise_of_positions` in each plane, ``(nz, 2)``.

    It is 0 for planes of unknown noise. The result is None if the noise of all planes is unknown.
    """
    planes = [noise_of_positions(H, z) for z in range(H.shape[0])]
    if all(noise is None for noise in planes):
        return None
    return np.stack([np.zeros(2) if noise is None else np.nanmean(noise, axis=(0, 1)) for noise in planes])


def denoised(H: Any, z: int, plane: NDArray[Any]) -> NDArray[Any]:
    """Return a copy of ``plane``, plane ``z`` of ``H`` with the shape ``(ny, nx, nt, ns)``, with reduced noise.

    Each entry is moved towards the mean of the entries of nearby source positions at the same sensor pixel, as far as
    the known noise explains their scatter. If `noise_of_positions` returns None, ``plane`` itself is returned.

    Examples
    --------
    >>> import numpy as np
    >>> from lfcal.psf import Facts, PSFMatrix
    >>> from lfcal.psf import denoised
    >>> t = np.arange(-10, 11)
    >>> true = 400 * np.exp(-(t[:, None] ** 2 + t**2) / 500) * np.ones((1, 9, 9, 1, 1))
    >>> frames = np.random.default_rng(0).poisson(true).astype(float)
    >>> noise = np.tile([0.0, 1.0], (1, 9, 9, 1))  # photons alone
    >>> H = PSFMatrix(frames, facts=Facts.of((1, 9, 9), (21, 21), noise=noise))
    >>> for plane in (H.plane(0), denoised(H, 0, H.plane(0))):
    ...     print(f"{np.linalg.norm(plane - true[0]) / np.linalg.norm(true):.2f}")
    0.05
    0.03
    """
    noise = noise_of_positions(H, z)
    if noise is None:
        return plane
    valid = H.facts.valid
    used = np.ones((1, 1, 1, 1), np.bool_) if valid is None else unpack_valid(valid[z], plane.shape[2:])
    out = np.empty_like(plane)

    def reduce(start: int, stop: int) -> None:
        sums = np.empty((5, *plane.shape[2:]))
        reduce_noise(plane, used, noise, RULE._replace(start=start, stop=stop), out, sums)

    for_each_chunk(reduce, len(plane))
    return out


def with_new_noise(H: Any, z: int, plane: NDArray[Any], seed: int) -> NDArray[Any]:
    """Return a copy of ``plane``, plane ``z`` of ``H`` ``(ny, nx, nt, ns)``, with additional Gaussian noise.

    The added noise of an entry has the known variance of its position for its value; positions of unknown noise are
    unchanged. ``seed`` selects the random numbers. If `noise_of_positions` returns None, ``plane`` itself is returned.

    Examples
    --------
    >>> import numpy as np
    >>> from lfcal.psf import Facts, PSFMatrix
    >>> from lfcal.psf import with_new_noise
    >>> noise = np.tile([9.0, 1.0], (1, 4, 4, 1))  # read noise of 3 counts, and photons
    >>> H = PSFMatrix(np.full((1, 4, 4, 9, 9), 16.0), facts=Facts.of((1, 4, 4), (9, 9), noise=noise))
    >>> print(f"{with_new_noise(H, 0, H.plane(0), seed=1).std():.1f}")
    5.0
    """
    noise = noise_of_positions(H, z)
    if noise is None:
        return plane
    out = np.array(plane, copy=True)
    rng = np.random.default_rng([seed, z])
    for y, row in enumerate(out):
        floor, slope = (np.nan_to_num(noise[y, :, k])[:, None, None] for k in range(2))
        drawn = rng.standard_normal(row.shape, np.float32)
        row += drawn * np.sqrt(floor + slope * np.maximum(row, 0)).astype(row.dtype)
    return out
