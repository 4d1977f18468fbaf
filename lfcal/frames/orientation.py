"""The eight flips and turns of a frame: their names, what they do to arrays, places and regions."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfcal.base import InputError
from lfcal.frames.regions import Region

__all__ = ["AS_IS", "AUTO", "CHECK", "ORIENTATIONS", "Orientation", "named_orientation", "nearest_orientation"]


@dataclass(frozen=True, slots=True)
class Orientation:
    """A flip or turn that makes delivered frames upright: first the transposition, then the flips.

    Attributes
    ----------
    name
        What is done to the array, see `ORIENTATIONS`.
    words
        How the frames lie that need it.
    transposed, flip_rows, flip_columns
        Whether rows and columns change places, and whether the order of the new rows or columns is reversed.

    Examples
    --------
    >>> from lfcal.frames import ORIENTATIONS, Orientation
    >>> turn: Orientation = ORIENTATIONS["rot90"]
    >>> print(turn.shape((3000, 4000)), turn.inverse.name, turn.words)
    (4000, 3000) rot270 turned clockwise by 90°
    """

    name: str
    words: str
    transposed: bool = False
    flip_rows: bool = False
    flip_columns: bool = False

    @property
    def option(self) -> str:
        """The name as the command line writes it, without spaces."""
        return self.name.replace(" ", "-")

    @property
    def inverse(self) -> Orientation:
        """The orientation that undoes this one."""
        # all but the quarter turns are their own inverse
        return ORIENTATIONS[{"rot90": "rot270", "rot270": "rot90"}.get(self.name, self.name)]

    def apply(self, array: NDArray[Any]) -> NDArray[Any]:
        """Return the first two axes of ``array`` flipped and turned, a view of it."""
        turned = array.swapaxes(0, 1) if self.transposed else array
        return turned[:: -1 if self.flip_rows else 1, :: -1 if self.flip_columns else 1]

    def shape(self, shape: tuple[int, int]) -> tuple[int, int]:
        """Return rows and columns of what `apply` makes of a frame of ``shape``."""
        return (shape[1], shape[0]) if self.transposed else shape

    def places(self, places: ArrayLike, shape: tuple[int, int]) -> NDArray[np.float64]:
        """Return where pixels ``(..., 2)`` (row, column) of a frame of ``shape`` are after `apply`."""
        at = np.array(places, np.float64)
        if self.transposed:
            at = at[..., ::-1].copy()
        rows, columns = self.shape(shape)
        if self.flip_rows:
            at[..., 0] = rows - 1 - at[..., 0]
        if self.flip_columns:
            at[..., 1] = columns - 1 - at[..., 1]
        return at

    def moves(self) -> NDArray[np.float64]:
        """Return the matrix ``(2, 2)`` that turns moves (down, right) in a frame into those after `apply`."""
        return self.places(np.eye(2), (1, 1)).T

    def region(self, region: Region, shape: tuple[int, int]) -> Region:
        """Return the region of a frame of ``shape`` that `apply` puts at ``region``; bounds must be explicit."""
        rows, columns = self.shape(shape)
        down = _reversed(region[0], rows) if self.flip_rows else region[0]
        right = _reversed(region[1], columns) if self.flip_columns else region[1]
        return (right, down) if self.transposed else (down, right)


def _reversed(part: slice, count: int) -> slice:
    return slice(count - part.stop, count - part.start)


CHECK, AUTO = "check", "auto"
"""Choices besides the names: refuse frames that are certainly turned, or turn them."""

AS_IS = "as is"

ORIENTATIONS: dict[str, Orientation] = {
    one.name: one
    for one in (
        Orientation(AS_IS, "upright"),
        Orientation("rot90", "turned clockwise by 90°", transposed=True, flip_rows=True),
        Orientation("rot180", "turned by 180°", flip_rows=True, flip_columns=True),
        Orientation("rot270", "turned anticlockwise by 90°", transposed=True, flip_columns=True),
        Orientation("mirror x", "mirrored left to right", flip_columns=True),
        Orientation("mirror y", "mirrored top to bottom", flip_rows=True),
        Orientation("transpose", "transposed (rows and columns swapped)", transposed=True),
        Orientation(
            "anti-transpose",
            "transposed and turned by 180°",
            transposed=True,
            flip_rows=True,
            flip_columns=True,
        ),
    )
}
"""What is done to a delivered frame ``f`` to make it upright: ``"as is"`` f; ``"rot90"`` numpy.rot90(f), a quarter turn
anticlockwise; ``"rot180"`` numpy.rot90(f, 2); ``"rot270"`` numpy.rot90(f, 3), a quarter turn clockwise; ``"mirror x"``
f[:, ::-1]; ``"mirror y"`` f[::-1]; ``"transpose"`` f.T; ``"anti-transpose"`` f[::-1, ::-1].T."""


def nearest_orientation(moves: ArrayLike) -> tuple[Orientation, float]:
    """Return the orientation of frames in which the image moves by ``moves``, and how far it really is from that.

    ``moves`` ``(2, 2)`` are (down, right) pixels for each planned pixel down and right: the unit matrix where frames
    are upright. The distance is the root of the sum of squared differences.

    Examples
    --------
    >>> from lfcal.frames import nearest_orientation
    >>> turn, distance = nearest_orientation([[0.98, 0.01], [0.0, -1.0]])
    >>> print(turn.words, round(distance, 3))
    mirrored left to right 0.022
    """
    seen = np.asarray(moves, np.float64)
    away = {name: float(np.linalg.norm(one.inverse.moves() - seen)) for name, one in ORIENTATIONS.items()}
    name = min(away, key=away.__getitem__)
    return ORIENTATIONS[name], away[name]


def named_orientation(name: str) -> Orientation:
    """Return the orientation of a name, written with spaces or hyphens; raises `InputError` for others.

    Examples
    --------
    >>> import numpy as np
    >>> from lfcal.frames import named_orientation
    >>> named_orientation("rot90").apply(np.array([[1, 2, 3], [4, 5, 6]])).tolist()
    [[3, 6], [2, 5], [1, 4]]
    """
    for one in ORIENTATIONS.values():
        if name in (one.name, one.option):
            return one
    known = ", ".join(one.option for one in ORIENTATIONS.values())
    raise InputError.expected("orientation", known, repr(name), "choose one of these")
