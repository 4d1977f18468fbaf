"""Convert the planes of H between lfcal's order and size and those of another code."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.base import centre
from lfcal.psf._planes import Planes, TransposedPlanes

__all__ = ["ONE_PER_PLANE", "MirroredPlanes", "PlacedPlanes", "padding_note", "placed"]

ONE_PER_PLANE = "read as one pattern for each plane (a period of 1 x 1), as in a Fourier light-field microscope"
"""Note on a stack of patterns."""

Window = tuple[slice, slice]
"""Rows and columns of a pattern."""


def placed(values: NDArray[Any], window: Window, cutout: tuple[int, int]) -> NDArray[Any]:
    """Return patterns ``(…, t, s)``, cropped to a window, in the middle of a ``cutout`` of zeros, as a new array.

    The middle pixel of the new cutout is pixel ``L // 2`` of a window of L pixels. MATLAB's ``conv2(…, 'same')`` uses
    it as the middle of a kernel, also for even L.
    """
    part = values[(..., *window)]
    out = np.zeros((*values.shape[:-2], *cutout), values.dtype)
    source: list[slice] = []
    target: list[slice] = []
    for have, want in zip(part.shape[-2:], cutout, strict=True):
        first = centre(want) - have // 2
        source.append(slice(max(0, -first), max(0, min(have, want - first))))
        target.append(slice(max(0, first), max(0, min(want, first + have))))
    out[..., target[0], target[1]] = part[..., source[0], source[1]]
    return out


def padding_note(shape: tuple[int, int]) -> str:
    """Return a note on how patterns with an even number of pixels become odd; empty if ``shape`` is odd."""
    rows, columns = (n + 1 - n % 2 for n in shape)
    if (rows, columns) == shape:
        return ""
    words = f"the patterns of {shape[0]} x {shape[1]} px are padded with zeros to {rows} x {columns}"
    return f"{words}; the middle of n pixels is taken as pixel n/2 + 1, as in MATLAB's conv2(…, 'same')"


class PlacedPlanes:
    """Patterns cropped to a separate window for each plane, or padded: see `placed`.

    Parameters
    ----------
    base
        Planes ``(nz, ny, nx, nt, ns)``, of any parity.
    cutout
        Pixels ``(nt, ns)`` of the new patterns, odd.
    windows
        Window of each plane. None: whole patterns.
    swapped
        Whether rows and columns of positions and of pixels are exchanged: ``base`` is then ``(nz, nx, ny, ns, nt)``,
        and ``windows`` refer to its last two axes.
    """

    def __init__(
        self, base: Planes, cutout: tuple[int, int], windows: Sequence[Window] | None = None, *, swapped: bool = False
    ) -> None:
        self.base, self._swapped = base, swapped
        nz, ny, nx, nt, ns = base.shape
        self._windows = list(windows or [(slice(0, nt), slice(0, ns))] * nz)
        self.shape = (nz, *((nx, ny) if swapped else (ny, nx)), *cutout)
        self.dtype = base.dtype

    def plane(self, z: int) -> NDArray[Any]:
        """Return plane ``z`` as a new array."""
        return self._turned(self.base.plane(z), z)

    def cutout(self, z: int, y: int, x: int) -> NDArray[Any]:
        """Return the pattern of one position as a new array."""
        return self._turned(self.base.cutout(z, *((x, y) if self._swapped else (y, x))), z)

    def _turned(self, values: NDArray[Any], z: int) -> NDArray[Any]:
        shape = self.shape[:2:-1] if self._swapped else self.shape[3:]
        whole = placed(values, self._windows[z], (shape[0], shape[1]))
        if not self._swapped:
            return whole
        turned = whole.swapaxes(-1, -2)
        return turned.swapaxes(0, 1) if turned.ndim == 4 else turned

    def transposed(self) -> Planes:
        """Return the planes of the transposed matrix."""
        return TransposedPlanes(self)


class MirroredPlanes:
    """A matrix whose file contains the first half of the positions along each axis; the others are mirror images.

    ``H[z, ny - 1 - y, x, t, s] = H[z, y, x, nt - 1 - t, s]`` and ``H[z, y, nx - 1 - x, t, s] = H[z, y, x, t, ns - 1 -
    s]``, with ``ny = 2 rows - 1`` and ``nx = 2 columns - 1``.
    """

    def __init__(self, base: Planes) -> None:
        self.base = base
        nz, rows, columns, nt, ns = base.shape
        self.shape = (nz, 2 * rows - 1, 2 * columns - 1, nt, ns)
        self.dtype = base.dtype

    def plane(self, z: int) -> NDArray[Any]:
        """Return plane ``z`` as a new array."""
        quarter = self.base.plane(z)
        half = np.concatenate([quarter, quarter[-2::-1, :, ::-1]])
        return np.concatenate([half, half[:, -2::-1, :, ::-1]], axis=1)

    def cutout(self, z: int, y: int, x: int) -> NDArray[Any]:
        """Return the pattern of one position."""
        _, ny, nx, _, _ = self.shape
        pattern = self.base.cutout(z, min(y, ny - 1 - y), min(x, nx - 1 - x))
        return pattern[:: -1 if 2 * y >= ny else 1, :: -1 if 2 * x >= nx else 1]

    def transposed(self) -> Planes:
        """Return the planes of the transposed matrix."""
        return TransposedPlanes(self)
