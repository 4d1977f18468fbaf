"""Other projectors for comparison: pyolaf 0.2.1, if it is installed, and a minimal loop of FFTs."""

from __future__ import annotations

import contextlib
import io
from typing import Any

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from lfcal.psf import transpose

__all__ = ["LeanFFT", "PyolafPair", "pyolaf_version"]


def pyolaf_version() -> str:
    """Return the version of pyolaf that can be imported, or an empty string."""
    try:
        import pyolaf
        import pyolaf.project
    except ImportError:
        return ""
    return str(pyolaf.__version__)


class LeanFFT:
    """The method of published codes in a few lines of scipy: one 'same' convolution per source position.

    Transforms are as short as possible, in single precision, and use all processors. As in published codes, the back
    projection uses HT in the same way.
    """

    def __init__(self, H: NDArray[Any], workers: int) -> None:
        self.H, self.HT, self.workers = H, transpose(H), workers

    def forward(self, volume: NDArray[Any]) -> NDArray[Any]:
        """Return the image of a volume ``(nz, Y, X)``; position (0, 0) of H is at pixel (0, 0)."""
        images = [self._same(self.H[z], volume[z]) for z in range(len(volume))]
        return np.sum(images, axis=0) if len(images) > 1 else images[0]

    def adjoint(self, image: NDArray[Any]) -> NDArray[Any]:
        """Return the back projection."""
        return np.stack([self._same(self.HT[z], image) for z in range(len(self.H))])

    def _same(self, patterns: NDArray[Any], plane: NDArray[Any]) -> NDArray[Any]:
        ny, nx, nt, ns = patterns.shape
        shape = [
            scipy.fft.next_fast_len(n + (k - 1) // 2, real=True) for n, k in zip(plane.shape, (nt, ns), strict=True)
        ]
        total: Any = 0
        for y in range(ny):
            for x in range(nx):
                comb = np.zeros_like(plane)
                comb[y::ny, x::nx] = plane[y::ny, x::nx]
                spectrum = scipy.fft.rfft2(comb, shape, workers=self.workers)
                spectrum *= scipy.fft.rfft2(patterns[y, x], shape, workers=self.workers)
                total = total + spectrum
        full: NDArray[Any] = scipy.fft.irfft2(total, shape, workers=self.workers)
        return full[(nt - 1) // 2 :, (ns - 1) // 2 :][: plane.shape[0], : plane.shape[1]]


class _Dense:
    """A pattern with the interface that pyolaf expects of sparse patterns."""

    def __init__(self, pattern: NDArray[Any]) -> None:
        self.pattern = pattern
        self.shape = pattern.shape

    def todense(self) -> NDArray[Any]:
        """Return the pattern."""
        return self.pattern


class PyolafPair:
    """pyolaf's projectors (numpy) on the same H, which must have an odd square period.

    Its positions are relative to the middle of the image (`anchor`). Its image is displaced by a pixel relative to its
    volume, so its two projections are not transposes of each other.
    """

    def __init__(self, H: NDArray[Any], image_shape: tuple[int, int]) -> None:
        n = H.shape[1]
        self.size = np.array(image_shape)
        self.H, self.HT = self._patterns(H), self._patterns(transpose(H))
        number, half = np.array([n, n]), np.array([(n + 1) // 2, (n + 1) // 2])
        mask = np.ones((n, n), np.int32)
        entries = {
            "TexNnum": number,
            "TexNnum_half": half,
            "texMask": mask,
            "texScaleFactor": np.array([1.0, 1.0]),
            "Nnum": number,
            "Nnum_half": half,
            "sensMask": mask,
        }
        self.resolution = {name: np.array(value) for name, value in entries.items()}
        reach = [int(s) // n // 2 + 1 for s in image_shape]
        rows, columns = np.meshgrid(*(n * np.arange(-r, r + 1.0) for r in reach), indexing="ij")
        centres = np.stack([rows, columns], axis=-1)
        self.centres = {"vox": centres, "px": centres}

    @property
    def anchor(self) -> tuple[int, int]:
        """Pixel of position (0, 0) of its back projection."""
        n = self.H.shape[0]
        row, column = (int(-(-s // 2)) - (n + 1) // 2 for s in self.size)
        return row, column

    @staticmethod
    def _patterns(H: NDArray[Any]) -> NDArray[Any]:
        nz, ny, nx = H.shape[:3]
        out = np.empty((ny, nx, nz), object)
        for z, y, x in np.ndindex(nz, ny, nx):
            out[y, x, z] = _Dense(H[z, y, x])
        return out

    def forward(self, volume: NDArray[Any]) -> NDArray[Any]:
        """Return pyolaf's image of a volume ``(nz, Y, X)``."""
        from pyolaf.project import LFM_forwardProject

        with contextlib.redirect_stderr(io.StringIO()):
            image: NDArray[Any] = LFM_forwardProject(
                self.H, np.moveaxis(volume, 0, -1), self.centres, self.resolution, self.size, "full"
            )
        return image

    def adjoint(self, image: NDArray[Any]) -> NDArray[Any]:
        """Return pyolaf's back projection ``(nz, Y, X)``."""
        from pyolaf.project import LFM_backwardProject

        with contextlib.redirect_stderr(io.StringIO()):
            volume: NDArray[Any] = LFM_backwardProject(self.HT, image, self.centres, self.resolution, self.size, "full")
        return np.moveaxis(volume, -1, 0)
