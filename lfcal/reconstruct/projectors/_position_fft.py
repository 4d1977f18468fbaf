"""The reference method of published codes: one FFT convolution per source position."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.base import worker_count
from lfcal.reconstruct.projectors.grid import Grid

__all__ = ["OnePatternFFT", "PositionFFT", "position_fft"]


class PositionFFT:
    """Project with a 'same' FFT convolution for each of the ``ny*nx`` positions (Prevedel et al. 2014).

    Exact and slow: the reference for the other methods. ``phases`` (ny, nx) selects image phases.
    """

    name = "fft"
    any_phases = True

    def __init__(
        self, grid: Grid, dtype: np.dtype[Any], workers: int | None = None, phases: NDArray[np.bool_] | None = None
    ) -> None:
        self.grid = grid
        self.dtype = dtype
        self.workers = worker_count(workers)
        self.rounding = 20 * float(np.finfo(dtype).eps)
        from scipy.fft import next_fast_len  # slow to import, and rarely used

        # the pattern's wrap-around may fall only on the c rows and columns that are cut off.
        self.shape = tuple(next_fast_len(n + c, real=True) for n, c in zip(grid.image_shape, grid.centre, strict=True))
        self.mask = None if phases is None else grid.tiled(phases)

    def prepare(self, plane: NDArray[Any]) -> NDArray[Any]:
        """Return the plane itself: transforms of all positions would not fit into memory."""
        return plane

    def operand_bytes(self, operand: NDArray[Any]) -> int:
        """Return the size of the plane (bytes)."""
        return operand.nbytes

    def forward(self, planes: Iterable[tuple[NDArray[Any], NDArray[Any]]]) -> NDArray[Any]:
        """Return the image of a volume, given as pairs (operand, volume plane)."""
        total: NDArray[Any] | None = None
        for operand, plane in planes:
            for y, x, rows, columns in self._positions():
                # only the voxels at this position in every period, which share one pattern
                comb = np.zeros(self.grid.image_shape, self.dtype)
                comb[rows, columns] = plane[rows, columns]
                product = self._transform(comb) * self._transform(operand[y, x])
                total = product if total is None else np.add(total, product, out=total)
        if total is None:
            return np.zeros(self.grid.image_shape, self.dtype)
        (cy, cx), (height, width) = self.grid.centre, self.grid.image_shape
        image = self._inverse(total)[cy : cy + height, cx : cx + width]
        return image if self.mask is None else image * self.mask

    def adjoint(self, image: NDArray[Any], operands: Iterable[NDArray[Any]]) -> Iterator[NDArray[Any]]:
        """Yield the back projection of ``image`` for each operand."""
        (cy, cx), (height, width) = self.grid.centre, self.grid.image_shape
        shifted = np.zeros(self.shape, self.dtype)
        shifted[cy : cy + height, cx : cx + width] = image if self.mask is None else image * self.mask
        spectrum = self._transform(shifted)
        for operand in operands:
            out = np.zeros(self.grid.image_shape, self.dtype)
            for y, x, rows, columns in self._positions():
                # the conjugate spectrum is that of the flipped pattern: correlation, the transpose of convolution
                full = self._inverse(spectrum * self._transform(operand[y, x]).conj())
                out[rows, columns] = full[:height, :width][rows, columns]
            yield out

    def _positions(self) -> Iterator[tuple[int, int, slice, slice]]:
        (ny, nx), (oy, ox) = self.grid.period, self.grid.origin
        for y in range(ny):
            for x in range(nx):
                yield y, x, slice((y - oy) % ny, None, ny), slice((x - ox) % nx, None, nx)

    def _transform(self, array: NDArray[Any]) -> NDArray[Any]:
        from scipy.fft import rfft2

        spectrum: NDArray[Any] = rfft2(array, self.shape, workers=self.workers)
        return spectrum

    def _inverse(self, spectrum: NDArray[Any]) -> NDArray[Any]:
        from scipy.fft import irfft2

        array: NDArray[Any] = irfft2(spectrum, self.shape, workers=self.workers)
        return array


class OnePatternFFT(PositionFFT):
    """Project with one FFT for each plane, for an H of one position, such as that of a Fourier light-field microscope.

    The transforms of H are kept. Rows that are zero, or not needed, are not transformed.
    """

    def prepare(self, plane: NDArray[Any]) -> NDArray[Any]:
        """Return the transform of the plane's pattern."""
        return self._transform(plane[0, 0])

    def operand_bytes(self, operand: NDArray[Any]) -> int:
        """Return the size of the transform (bytes)."""
        return operand.nbytes

    def forward(self, planes: Iterable[tuple[NDArray[Any], NDArray[Any]]]) -> NDArray[Any]:
        """Return the image of a volume, given as pairs (operand, volume plane)."""
        total: NDArray[Any] | None = None
        for operand, plane in planes:
            product = self._transform(plane)
            product *= operand
            total = product if total is None else np.add(total, product, out=total)
        if total is None:
            return np.zeros(self.grid.image_shape, self.dtype)
        image = self._image(total)
        return image if self.mask is None else image * self.mask

    def adjoint(self, image: NDArray[Any], operands: Iterable[NDArray[Any]]) -> Iterator[NDArray[Any]]:
        """Yield the back projection of ``image`` for each operand."""
        # correlation is the convolution of the reversed image, reversed
        spectrum = self._transform((image if self.mask is None else image * self.mask)[::-1, ::-1])
        for operand in operands:
            yield self._image(spectrum * operand)[::-1, ::-1]

    def _transform(self, array: NDArray[Any]) -> NDArray[Any]:
        from scipy.fft import fft, rfft

        (rows, columns), workers = self.shape, self.workers
        along: NDArray[Any] = rfft(array, columns, axis=1, workers=workers)
        spectrum: NDArray[Any] = fft(along, rows, axis=0, workers=workers, overwrite_x=True)
        return spectrum

    def _image(self, spectrum: NDArray[Any]) -> NDArray[Any]:
        """Return the part of the inverse transform that is the image; the spectrum is overwritten."""
        from scipy.fft import ifft, irfft

        (cy, cx), (height, width) = self.grid.centre, self.grid.image_shape
        along = ifft(spectrum, axis=0, workers=self.workers, overwrite_x=True)[cy : cy + height]
        array: NDArray[Any] = irfft(along, self.shape[1], axis=1, workers=self.workers)
        return array[:, cx : cx + width]


def position_fft(
    grid: Grid, dtype: np.dtype[Any], workers: int | None = None, phases: NDArray[np.bool_] | None = None
) -> PositionFFT:
    """Return the FFT engine for a grid: `OnePatternFFT` if the period is a single position, else `PositionFFT`."""
    return (OnePatternFFT if grid.period == (1, 1) else PositionFFT)(grid, dtype, workers, phases)
