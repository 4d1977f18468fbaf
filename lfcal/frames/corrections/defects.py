"""Defect pixels: where they are on the sensor and how they are repaired."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfcal.base import InputError
from lfcal.frames.cfa import check_cfa, pattern_side, same_colour_offsets
from lfcal.frames.corrections import _kernels
from lfcal.frames.corrections.steps import fingerprint

__all__ = ["Defects", "nearest_good", "repair_nan"]

MAX_SHARE = 0.05
"""More defects than this share of the sensor are refused: the search has failed then."""


@dataclass(frozen=True, eq=False)
class Defects:
    """Repair pixels that do not measure light: each becomes the mean of its nearest good same-colour neighbours.

    They are given in sensor coordinates, where they stay while the spots move. A repair is linear in the frame.
    Pixels that are NaN in a frame of floats (masked by its reader) are repaired as well, where a neighbour within
    one period of the pattern is good; no pixels need be given for that.

    Attributes
    ----------
    pixels
        Rows and columns, shape ``(n, 2)``.
    shape
        Rows and columns of the sensor.
    cfa
        Colour filter pattern by rows, empty for monochrome.
    kinds
        ``"hot"``, ``"dead"`` or ``"stuck"`` for each pixel, or empty where that is not known.
    neighbours, margin
        Neighbours used for each pixel, shape ``(n, m, 2)``, padded with -1, and how far a repair may look (px);
        made from the above.

    Raises
    ------
    InputError
        If a pixel lies off the sensor, has no good neighbour of its colour within two periods of the pattern,
        or more than 5 % of the sensor is defect.

    Examples
    --------
    >>> import numpy as np
    >>> from lfcal.frames import CorrectionChain, Defects
    >>> frame = np.arange(16, dtype=np.uint16).reshape(4, 4)
    >>> frame[1, 1] = 4095
    >>> chain = CorrectionChain((Defects([(1, 1)], shape=(4, 4)),))
    >>> chain.apply(frame)[1].tolist()
    [4.0, 5.0, 6.0, 7.0]
    """

    pixels: ArrayLike = field(repr=False)
    shape: tuple[int, int]
    cfa: str = ""
    kinds: tuple[str, ...] = field(default=(), repr=False)
    neighbours: NDArray[np.int32] = field(init=False, repr=False)
    margin: int = field(init=False)

    def __post_init__(self) -> None:
        """Check and sort the pixels and find their neighbours."""
        check_cfa(self.cfa)
        pixels = np.asarray(self.pixels, np.int64).reshape(-1, 2)
        if self.kinds and len(self.kinds) != len(pixels):
            raise InputError.expected("kinds of defects", len(pixels), len(self.kinds), "give one for each pixel")
        if pixels.size and (pixels.min() < 0 or (pixels >= np.array(self.shape)).any()):
            raise InputError.expected(
                "defect pixels",
                f"on the sensor of {self.shape[0]} x {self.shape[1]} px",
                f"{pixels.min(axis=0).tolist()} … {pixels.max(axis=0).tolist()}",
                "check rows and columns",
            )
        # row-major numbers sort the pixels and drop repeated ones in one go
        flat, first = np.unique(pixels[:, 0] * self.shape[1] + pixels[:, 1], return_index=True)
        # a small sensor may have one defect, even where that is more than the share
        if len(flat) > max(1, MAX_SHARE * self.shape[0] * self.shape[1]):
            raise InputError.expected(
                "defect pixels",
                f"at most {100 * MAX_SHARE:g} % of the sensor",
                f"{100 * len(flat) / (self.shape[0] * self.shape[1]):.3g} %",
                "raise the threshold or give frames between which the spots move",
            )
        chosen = np.ascontiguousarray(pixels[first], np.int32)
        object.__setattr__(self, "pixels", chosen)
        object.__setattr__(self, "kinds", tuple(self.kinds[k] for k in first) if self.kinds else ())
        neighbours = self._find_neighbours(chosen)
        object.__setattr__(self, "neighbours", neighbours)
        reach = np.abs(neighbours - chosen[:, None, :])[neighbours[..., 0] >= 0]
        # the pattern's side in addition: a NaN one period away is repaired as well
        object.__setattr__(self, "margin", int(reach.max(initial=0)) + pattern_side(self.cfa))

    def _find_neighbours(self, pixels: NDArray[np.int32]) -> NDArray[np.int32]:
        bad = np.zeros(self.shape, bool)
        bad[pixels[:, 0], pixels[:, 1]] = True
        found = nearest_good(pixels, bad, self.cfa)
        alone = np.flatnonzero((found[..., 0] < 0).all(axis=1))
        if alone.size:
            r, c = (int(v) for v in pixels[alone[0]])
            raise InputError.expected(
                f"defect pixel ({r}, {c})",
                "a good neighbour of its colour",
                "only defect ones within two periods",
                "such a cluster cannot be repaired; mask it",
            )
        return found

    def __len__(self) -> int:
        """Return the number of defect pixels."""
        return int(self.neighbours.shape[0])

    def mask(self) -> NDArray[np.bool_]:
        """Return a map of the sensor that is true at the defects."""
        mask = np.zeros(self.shape, bool)
        pixels = np.asarray(self.pixels)
        mask[pixels[:, 0], pixels[:, 1]] = True
        return mask

    def describe(self) -> dict[str, Any]:
        """Return a JSON description."""
        return {
            "kind": "defects",
            "count": len(self),
            "cfa": self.cfa,
            **{name: self.kinds.count(name) for name in sorted(set(self.kinds))},
            "crc32": fingerprint(np.asarray(self.pixels)),
        }


def nearest_good(
    pixels: NDArray[np.int32], bad: NDArray[np.bool_], cfa: str, *, origin: tuple[int, int] = (0, 0), reach: int = 2
) -> NDArray[np.int32]:
    """Return for each pixel its nearest ring of same-colour neighbours that holds a good one.

    Parameters
    ----------
    pixels
        Rows and columns in ``bad``, shape ``(n, 2)``.
    bad
        Map of the pixels that may not be used.
    cfa
        Colour filter pattern by rows.
    origin
        Sensor coordinates of the first pixel of ``bad``.
    reach
        Periods of the pattern that a neighbour may be away.

    Returns
    -------
    Rows and columns of the neighbours in ``bad``, shape ``(n, m, 2)``, -1 where there is none.
    """
    side = pattern_side(cfa)
    table = same_colour_offsets(cfa, reach)
    most = max(len(ring) for line in table for rings in line for ring in rings)
    found = np.full((len(pixels), most, 2), -1, np.int32)
    phase = (pixels + np.array(origin)) % side
    # pixels of one phase of the pattern share their rings, so they are looked up together
    for pr, pc in np.ndindex(side, side):
        todo = np.flatnonzero((phase[:, 0] == pr) & (phase[:, 1] == pc))
        for ring in table[pr][pc]:
            if not todo.size:
                break
            near = pixels[todo, None, :] + ring[None]
            good: NDArray[np.bool_] = np.all((near >= 0) & (near < np.array(bad.shape)), axis=2)
            # an index off the map would wrap round; (0, 0) stands in, and stays marked as not good
            inside = np.where(good[..., None], near, 0)
            good &= ~bad[inside[..., 0], inside[..., 1]]
            found[todo, : len(ring)] = np.where(good[..., None], near, -1)
            # pixels whose ring holds a good neighbour are done; the others try the next ring
            todo = todo[~good.any(axis=1)]
    return found


def repair_nan(values: NDArray[np.float32], origin: tuple[int, int], slopes: NDArray[np.float64], cfa: str) -> None:
    """Set NaN in a corrected region to the mean of its nearest same-colour neighbours, one period away at most.

    ``slopes`` is the background subtracted already, ``(level, per row, per column)``. What has no good neighbour
    so near stays NaN.
    """
    bad = np.isnan(values)
    if not bad.any():
        return
    pixels = np.ascontiguousarray(np.argwhere(bad), np.int32)
    neighbours = nearest_good(pixels, bad, cfa, origin=origin, reach=1)
    _kernels.repair_pixels(values, 0, 0, slopes, pixels, neighbours)
