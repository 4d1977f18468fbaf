"""Depth-dependent filters of volumes that reduce artefacts of uneven sampling (Stefanoiu et al. 2019)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfcal.base import InputError, check_number, for_each_chunk
from lfcal.reconstruct.solvers.planes import separable

__all__ = ["SIEVE", "DepthSmoothing", "Sieve", "coarseness", "lanczos_kernel", "smoothing_widths"]


SIEVE = 0.27
"""Standard deviation of a sieve in the native plane, in units of the lenslets' pitch. With this value, the width of
beads is within a tenth of that with Richardson-Lucy, and 0.23 of a repeating pattern is transmitted."""


FINE = 0.5
"""Smallest standard deviation of a sieve in any plane (voxels); details finer than the grid are noise."""


def coarseness(camera: Any, depths: ArrayLike) -> tuple[float, ...]:
    """Return how coarsely the lenslets of ``camera`` sample each plane at ``depths`` (µm).

    The value is 1 for absolute virtual depths up to 1, and 0 from 2 on; it decreases linearly in between. All values
    are 0 for lenslets in a pupil plane, which sample every plane with all pixels.
    """
    if not camera.has_lattice:
        return (0.0,) * np.size(depths)
    found = [abs(camera.virtual_depth(float(z))) for z in np.atleast_1d(np.asarray(depths, float))]
    return tuple(float(min(1.0, max(0.0, 2.0 - v))) for v in found)


def smoothing_widths(camera: Any, depths: ArrayLike) -> NDArray[np.float64]:
    """Return the distance between independent samples in each plane at ``depths`` (µm), in voxels (image pixels).

    ``camera`` is a `lfcal.camera.Camera`, as in `PSFMatrix.camera`. At virtual depth v, corresponding pixels under
    neighbouring lenslets image points that are ``p/|v|`` apart, where p is the pitch. A lenslet that is in focus at
    virtual depth vf has the blur ``p/2 |1/vf - 1/v|``. The result is twice the absolute difference of the two, at most
    p (Stefanoiu et al. 2019, equations 8-10, written with v). If |v| < 1, it is p. Of several lens types, the one with
    the smallest blur is used. For lenslets in a pupil plane, the result is 1.
    """
    if not camera.has_lattice:  # every pixel is a sample
        return np.ones(np.size(depths))
    pitch = camera.pitch_px
    gap = camera.lattice.gap_um
    inverse_focus = [1.0 / lens.focus_depth(gap) for lens in camera.lattice.types]
    widths = []
    for z in np.atleast_1d(np.asarray(depths, float)):
        v = camera.virtual_depth(float(z))
        if abs(v) < 1:
            widths.append(pitch)
            continue
        # with several lens types, the one in focus determines the resolution.
        blur = min(abs(f - 1.0 / v) for f in inverse_focus) / 2
        widths.append(2 * pitch * min(0.5, abs(1.0 / abs(v) - blur)))
    return np.array(widths)


def lanczos_kernel(width: float, lobes: int = 4) -> NDArray[np.float64]:
    """Return a 1-D low-pass kernel that preserves periods above ``2 * width`` pixels: a sinc with a Lanczos window.

    ``lobes`` is the number of zeros of the sinc on each side; the window ends at the last of them. For a width of 1 or
    less, the kernel is ``[1.0]``.
    """
    # 1 pixel or less: nothing to filter, and np.sinc(x / width) would divide by zero
    if width <= 1:
        return np.ones(1)
    half = int(np.ceil(lobes * width)) - 1
    x = np.arange(-half, half + 1)
    # a plain sinc rings far out; the Lanczos window ends it after `lobes` zeros
    kernel = np.sinc(x / width) * np.sinc(x / (lobes * width))
    normalised: NDArray[np.float64] = kernel / kernel.sum()
    return normalised


@dataclass(frozen=True)
class DepthSmoothing:
    """Low-pass filter that band-limits each plane to its sampling by the lenslets.

    It is the smoothing step of the estimate-maximise-smooth (EMS) algorithm (Stefanoiu et al. 2019).

    Attributes
    ----------
    widths
        Distance between independent samples in each plane (voxels), ``nz`` values; planes with values up to 1 are not
        changed.
    lobes
        Number of lobes of the Lanczos window; fewer lobes cause less ringing and more blur.

    Examples
    --------
    >>> import numpy as np
    >>> from lfcal.reconstruct import DepthSmoothing
    >>> stripes = np.tile([3.0, 0.0, 0.0], (2, 30, 10))
    >>> DepthSmoothing([1, 4]).apply(stripes)[:, 15, 12:15].round(2).tolist()  # samples at every voxel, every 4 voxels
    [[3.0, 0.0, 0.0], [1.0, 1.0, 1.0]]
    """

    widths: Sequence[float]
    lobes: int = 4

    def __post_init__(self) -> None:
        """Check every value."""
        object.__setattr__(self, "widths", tuple(float(w) for w in self.widths))
        for width in self.widths:
            check_number("smoothing width (voxels)", width, at_least=0, below=10_000)
        check_number("lobes of the smoothing", self.lobes, at_least=1, integer=True)

    @classmethod
    def for_camera(cls, camera: Any, depths: ArrayLike, lobes: int = 4) -> DepthSmoothing:
        """Return the smoothing for planes at ``depths`` (µm, ``(nz,)``) of ``camera``, a `lfcal.camera.Camera`.

        ``lobes`` is the number of lobes of the Lanczos window.
        """
        return cls(tuple(smoothing_widths(camera, depths)), lobes)

    def apply(self, volume: NDArray[Any]) -> NDArray[Any]:
        """Return a smoothed copy of ``volume`` ``(nz, Y, X)``, without negative values.

        Near the border, the kernel is normalised to its part inside the volume. Raise `InputError` unless `widths` has
        one value for each plane.
        """
        if len(self.widths) != len(volume):
            raise InputError.expected(
                "smoothing widths", f"one per plane ({len(volume)})", len(self.widths), "give one width per plane"
            )
        out = np.empty_like(volume)

        def work(start: int, stop: int) -> None:
            for z in range(start, stop):
                out[z] = _smooth(volume[z], lanczos_kernel(self.widths[z], self.lobes))

        for_each_chunk(work, len(volume))
        # the kernel's negative lobes may cause negative values, which multiplicative solvers cannot use
        np.maximum(out, 0, out=out)
        return out


@dataclass(frozen=True)
class Sieve:
    """Gaussian filter with a separate width for each plane; it removes finer details (Snyder & Miller 1985).

    Attributes
    ----------
    sigmas
        Standard deviation for each plane (voxels); planes for which it is below 1/3 are not changed.
    """

    sigmas: tuple[float, ...]

    @classmethod
    def for_camera(cls, camera: Any, depths: ArrayLike) -> Sieve:
        """Return the sieve for planes at ``depths`` (µm) of ``camera``.

        Up to an absolute virtual depth of 1, lenslets cannot distinguish points closer together than the pitch. There,
        the Gaussian has a standard deviation of `SIEVE` times the pitch. It decreases towards virtual depth 2, where
        several lenslets image every point, but is at least `FINE`.
        """
        wide = SIEVE * camera.pitch_px if camera.has_lattice else FINE
        return cls(tuple(max(FINE, wide * share) for share in coarseness(camera, depths)))

    def apply(self, volume: NDArray[Any]) -> NDArray[Any]:
        """Return ``volume`` ``(nz, Y, X)`` filtered, with zeros beyond the border; the filter is its own transpose."""
        out = np.empty_like(volume)

        def work(start: int, stop: int) -> None:
            for z in range(start, stop):
                out[z] = _blurred(volume[z], self.sigmas[z])

        for_each_chunk(work, len(volume))
        return out


def _blurred(plane: NDArray[Any], sigma: float) -> NDArray[Any]:
    if sigma < 1 / 3:
        return plane
    x = np.arange(-math.ceil(4 * sigma), math.ceil(4 * sigma) + 1)
    kernel = np.exp(-(x**2) / (2 * sigma**2))
    kernel /= kernel.sum()
    return separable(plane, kernel)


def _smooth(plane: NDArray[Any], kernel: NDArray[np.float64]) -> NDArray[Any]:
    if kernel.size == 1:
        return plane
    plane = separable(plane, kernel)
    for axis in (0, 1):
        norm = np.convolve(np.ones(plane.shape[axis]), kernel)[kernel.size // 2 :][: plane.shape[axis]]
        # a window cut by the border has a small sum, but at least a quarter of the kernel is inside.
        plane /= np.expand_dims(np.maximum(norm, 0.25), 1 - axis)
    return plane
