"""Find the centre of a micro-image among the positions of H, and roll H so that it is where other codes expect it.

The codes based on Prevedel et al. 2014 are LFDM, oLaF and their descendants. They rectify an image so that the centre
of a micro-image is on pixel ceil(Nnum/2) of each period, counted from 1. They use position (aa, bb) of H for pixel (aa,
bb) of a period. In lfcal, position (0, 0) is where the scan began.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.base import Position
from lfcal.camera import nearest_lens
from lfcal.psf._planes import Planes, TransposedPlanes
from lfcal.psf.cutout import Cutout
from lfcal.psf.facts import Facts
from lfcal.psf.matrix import PSFMatrix

__all__ = ["TOLERANCE_PX", "LensCentre", "first_pixel", "lens_centre_of", "lens_centred", "sampling"]

TOLERANCE_PX = 0.05
"""Largest distance of a micro-image centre from the expected position at which it counts as being there (pixels)."""

Pair = tuple[float, float]


@dataclass(frozen=True, slots=True)
class LensCentre:
    """A type-0 micro-image centre among the positions of H.

    Attributes
    ----------
    position
        Position ``(row, column)`` of the centre in the period, usually fractional; the first position is 0. A point
        whose image is at the centre has the pattern of this position.
    period
        Number of positions ``(ny, nx)`` in a period.
    """

    position: Pair
    period: tuple[int, int]

    @property
    def expected(self) -> tuple[int, int]:
        """Position at which other software expects the centre, as an index from 0: ceil(n/2) - 1 along each axis."""
        return (self.period[0] + 1) // 2 - 1, (self.period[1] + 1) // 2 - 1

    @property
    def shift(self) -> tuple[int, int]:
        """Number of positions ``(rows, columns)`` by which rolling H brings the centre closest to `expected`."""
        rows, columns = (math.ceil(off - 0.5) for off in self._off())
        return -rows, -columns

    @property
    def rest(self) -> Pair:
        """Offset (rows, columns) of the centre from `expected` after `shift`, in (-0.5, 0.5]; positive: down or right.

        Its unit is a position, that is, a pixel of H.
        """
        rows, columns = (off - math.ceil(off - 0.5) for off in self._off())
        return rows, columns

    @property
    def agrees(self) -> bool:
        """Whether the centre is already at the position that other software expects, to within `TOLERANCE_PX`."""
        return self.shift == (0, 0) and self.is_whole

    @property
    def is_whole(self) -> bool:
        """Whether rolling by whole positions is sufficient, to within `TOLERANCE_PX`."""
        return max(map(abs, self.rest)) <= TOLERANCE_PX

    def _off(self) -> tuple[float, float]:
        """Return the distance of the centre from its expected position, by the shorter way around the period."""
        rows, columns = (
            (at - wanted + n / 2) % n - n / 2
            for at, wanted, n in zip(self.position, self.expected, self.period, strict=True)
        )
        # rounding errors must not become a whole period
        return round(rows, 9), round(columns, 9)


def lens_centre_of(matrix: PSFMatrix) -> LensCentre | None:
    """Return the position of a type-0 micro-image centre in ``matrix``; None if it is unknown.

    The position is computed from the camera and the anchor. For an H from a file of other software, it is determined by
    that file or by the convention of the software (provenance ``lens_centre``). Unless frames were interpolated or
    resampled when H was assembled, the pixels of H are sensor pixels, and pixel 0 is the one nearest to the anchor.
    """
    ny, nx = matrix.period
    if matrix.camera is None:
        stated = _pair(matrix.provenance.get("lens_centre"))
        return None if stated is None else LensCentre((stated[0] % ny, stated[1] % nx), (ny, nx))
    first, scale = first_pixel(matrix), sampling(matrix)[1]
    lens = nearest_lens(matrix.camera, first)
    row, column = ((at - start) * factor for at, start, factor in zip(lens, first, scale, strict=True))
    return LensCentre((row % ny, column % nx), (ny, nx))


def first_pixel(matrix: PSFMatrix) -> Pair:
    """Return the sensor position (row, column) of pixel (0, 0) of the images that H describes.

    This pixel shows the source position (0, 0). Its position is the anchor, rounded to a whole pixel unless the frames
    were interpolated.
    """
    if sampling(matrix)[0]:
        return matrix.anchor
    row, column = matrix.anchor
    return float(math.ceil(row - 0.5)), float(math.ceil(column - 0.5))


def sampling(matrix: PSFMatrix) -> tuple[bool, Pair]:
    """Return whether the frames of H were interpolated, and the number of pixels of H per sensor pixel (rows, columns).

    Without an entry in the provenance, these are False and 1.
    """
    cutout = matrix.provenance.get("cutout")
    if not isinstance(cutout, dict):
        return False, (1.0, 1.0)
    scale = _pair(cutout.get("scale"))
    return cutout.get("interpolation", "nearest") != "nearest", scale if scale and all(scale) else (1.0, 1.0)


def _pair(value: Any) -> Pair | None:
    """Return two finite numbers from a file's provenance, None if it contains anything else."""
    numbers = value if isinstance(value, list | tuple) and len(value) == 2 else ()
    if not numbers or not all(isinstance(v, int | float) and math.isfinite(v) for v in numbers):
        return None
    return float(numbers[0]), float(numbers[1])


def lens_centred(matrix: PSFMatrix, lens: LensCentre, interpolation: str = "nearest") -> PSFMatrix:
    """Return a view of ``matrix`` in which the micro-image centre ``lens`` is where other software expects it.

    Positions are rolled within the period by `LensCentre.shift`, a whole number along each axis. Rolling does not
    change their patterns, because each cutout is centred on the image of its source. In the image
    ``f[p] = sum_v g[v] H[v mod n][p - v + c]`` of a volume g, n is the period and c the middle of the cutout. The
    origins of p and v, and with them the anchor, move by ``-shift`` pixels of H.

    Parameters
    ----------
    matrix
        H or HT.
    lens
        Result of `lens_centre_of`.
    interpolation
        ``"nearest"`` ignores the remaining fraction of a position (`LensCentre.rest`). Any other of
        `lfcal.psf.cutout.INTERPOLATIONS` shifts each pattern by this fraction, as rectification shifts the image.
    """
    planes = _Centred(matrix, lens.shift, lens.rest, interpolation)
    facts = {} if matrix.is_transposed else _rolled(matrix.facts, lens.shift)
    if planes.moves:  # a pixel of a moved pattern combines several pixels, measured or not
        facts.pop("valid", None)
    steps = zip(matrix.anchor, lens.shift, sampling(matrix)[1], strict=True)
    row, column = (at - step / factor for at, step, factor in steps)
    moved = {"lens_centred": {"shift": list(lens.shift), "rest": list(lens.rest), "interpolation": interpolation}}
    return PSFMatrix(
        planes,
        depths=matrix.known_depths,
        camera=matrix.camera,
        anchor=(row, column),
        facts=Facts(**facts),
        region=matrix.region,
        transposed=matrix.is_transposed,
        provenance={**matrix.provenance, **moved},
    )


def _rolled(facts: Facts, shift: tuple[int, int]) -> dict[str, NDArray[Any]]:
    """Return the known facts; those of positions ``(nz, ny, nx, …)`` are rolled like the positions."""
    known = facts.known()
    return {name: np.roll(v, shift, (1, 2)) if v.ndim > 1 else v for name, v in known.items()}


class _Centred:
    """Planes of H with positions rolled by ``shift`` and patterns shifted by ``rest`` pixels."""

    def __init__(self, matrix: PSFMatrix, shift: tuple[int, int], rest: Pair, interpolation: str) -> None:
        self.base, self._shift = matrix.planes, shift
        self.moves = interpolation != "nearest" and rest != (0.0, 0.0)
        self._cutout = Cutout(matrix.cutout, rest, interpolation)
        self.shape = matrix.shape
        self.dtype = np.dtype(np.float32) if self.moves else matrix.dtype

    def plane(self, z: int) -> NDArray[Any]:
        """Return plane ``z``."""
        plane = np.roll(self.base.plane(z), self._shift, (0, 1))
        if not self.moves:
            return plane
        moved = np.empty(plane.shape, np.float32)
        for at in np.ndindex(*plane.shape[:2]):
            moved[at] = self._moved(plane[at])
        return moved

    def cutout(self, z: int, y: int, x: int) -> NDArray[Any]:
        """Return the pattern of one position."""
        _, ny, nx, _, _ = self.shape
        pattern = self.base.cutout(z, (y - self._shift[0]) % ny, (x - self._shift[1]) % nx)
        return self._moved(pattern) if self.moves else pattern

    def transposed(self) -> Planes:
        """Return the planes of the transposed matrix."""
        return TransposedPlanes(self)

    def _moved(self, pattern: NDArray[Any]) -> NDArray[np.float32]:
        window = self._cutout.window(Position(0, 0, 0))
        # there is no light beyond the cutout: it was chosen that way
        margin = window.row - self._cutout.region(window)[0].start
        return self._cutout.resample(np.pad(pattern, margin), window)
