"""The eight orientations of a frame: their names, their effect on arrays, positions and regions, and turned frames."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfcal.base import InputError, Region, check_region, format_pixels
from lfcal.frames.source import FrameInfo, FrameMetadata, Frames, FrameSource, Samples
from lfcal.frames.view import SourceView

__all__ = [
    "AS_IS",
    "AUTO",
    "CHECK",
    "ORIENTATIONS",
    "Orientation",
    "OrientedSource",
    "named_orientation",
    "nearest_orientation",
    "oriented",
]


@dataclass(frozen=True, slots=True)
class Orientation:
    """Flip or rotation that makes delivered frames upright: a transposition, followed by flips.

    Attributes
    ----------
    name
        Name of the operation that is applied to the array, one of `ORIENTATIONS`.
    words
        Description of the frames that need the operation, such as "turned by 180°".
    transposed, flip_rows, flip_columns
        Whether rows and columns are exchanged, and whether the order of rows or of columns is reversed after that.

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
        """The name as written on the command line, with hyphens instead of spaces."""
        return self.name.replace(" ", "-")

    @property
    def inverse(self) -> Orientation:
        """Orientation that reverses this one."""
        # all except the quarter turns are their own inverse
        return ORIENTATIONS[{"rot90": "rot270", "rot270": "rot90"}.get(self.name, self.name)]

    def apply(self, array: NDArray[Any]) -> NDArray[Any]:
        """Return a view of ``array`` whose first two axes are flipped or rotated by this orientation."""
        turned = array.swapaxes(0, 1) if self.transposed else array
        return turned[:: -1 if self.flip_rows else 1, :: -1 if self.flip_columns else 1]

    def shape(self, shape: tuple[int, int]) -> tuple[int, int]:
        """Return the shape ``(rows, columns)`` of a frame of ``shape`` after `apply` (px)."""
        return (shape[1], shape[0]) if self.transposed else shape

    def places(self, places: ArrayLike, shape: tuple[int, int]) -> NDArray[np.float64]:
        """Return the positions after `apply` of the positions ``places`` in a frame of ``shape`` (px).

        Positions are (row, column), ``(..., 2)``.
        """
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
        """Return the matrix ``(2, 2)`` that converts displacements (down, right) in a frame to those after `apply`."""
        return self.places(np.eye(2), (1, 1)).T

    def region(self, region: Region, shape: tuple[int, int]) -> Region:
        """Return the region of a frame of ``shape`` that `apply` maps to ``region``; all slices need start and stop."""
        rows, columns = self.shape(shape)
        down = _reversed(region[0], rows) if self.flip_rows else region[0]
        right = _reversed(region[1], columns) if self.flip_columns else region[1]
        return (right, down) if self.transposed else (down, right)


def _reversed(part: slice, count: int) -> slice:
    return slice(count - part.stop, count - part.start)


CHECK = "check"
AUTO = "auto"
"""Choices in addition to the names: refuse frames that are certainly turned (check), or turn them (auto)."""

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
"""Operations that make a delivered frame ``f`` upright, by name. ``"as is"``: f; ``"rot90"``: numpy.rot90(f), a quarter
turn anticlockwise; ``"rot180"``: numpy.rot90(f, 2); ``"rot270"``: numpy.rot90(f, 3), a quarter turn clockwise;
``"mirror x"``: f[:, ::-1]; ``"mirror y"``: f[::-1]; ``"transpose"``: f.T; ``"anti-transpose"``: f[::-1, ::-1].T."""


def nearest_orientation(moves: ArrayLike) -> tuple[Orientation, float]:
    """Return the orientation of frames whose image motion is closest to ``moves``, and the residual.

    The columns of ``moves`` ``(2, 2)`` are observed motions (down, right; px) of the image. The first is for a planned
    motion of one pixel down, the second for one pixel right. For upright frames, ``moves`` is the unit matrix. The
    residual is the Frobenius norm of the difference between ``moves`` and the motions in frames that exactly need the
    returned orientation.

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
    """Return the orientation ``name``, written with spaces or hyphens; raise `InputError` if there is none.

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


class OrientedSource(SourceView):
    """View of ``source`` whose frames are turned upright; reading a region reads only that region.

    Apply this view last. The frames, dark frames and white images of a camera have the same orientation and are
    combined as delivered; only the corrected result is turned. The positions of cutouts are turned together with the
    sensor.

    Parameters
    ----------
    source
        Corrected frames in the orientation as delivered.
    turn
        The orientation that makes them upright.
    sensor
        Shape ``(rows, columns)`` of the sensor as delivered (px). None: the frames show the whole sensor.
    """

    def __init__(self, source: FrameSource, turn: Orientation, sensor: tuple[int, int] | None = None) -> None:
        super().__init__(source)
        self.turn = turn
        self.sensor = sensor or source.shape

    @property
    def shape(self) -> tuple[int, int]:
        """Shape ``(rows, columns)`` of every frame after turning (px)."""
        return self.turn.shape(self.source.shape)

    def derived(self, known: FrameMetadata) -> FrameMetadata:
        """Return the metadata ``known`` of the source, changed for the turned frames.

        The origin is turned. Colour filter pattern, channel phase and dark frames are omitted, because they refer to
        pixels as delivered.
        """
        origin = self.info(0).origin if known.origin is not None and len(self.source) else known.origin
        return replace(known, cfa="", channel_phase=None, darks={}, origin=origin, orientation=self.turn.name)

    def info(self, index: int) -> FrameInfo:
        """Return the metadata of frame ``index``, with its origin and mask turned.

        The drift stays unchanged, because it refers to the plan's upright image.

        Raises
        ------
        InputError
            If the frame extends beyond the sensor.
        """
        info = self.source.info(index)
        # the pixel that becomes the first is at the corner nearest to that of the turned sensor
        first = np.array(info.origin)
        last = first + self.source.shape - 1
        if (last >= self.sensor).any():
            raise InputError.expected(
                f"{info.label}, frame to turn",
                f"a frame on the sensor of {format_pixels(self.sensor)}",
                f"one from row {first[0]}, column {first[1]} to row {last[0]}, column {last[1]}",
                "give the size of the whole sensor together with the orientation",
            )
        row, column = self.turn.places([first, last], self.sensor).min(axis=0).astype(int).tolist()
        mask = None if info.mask is None else self.turn.apply(info.mask)
        return replace(info, origin=(row, column), mask=mask)

    def read(self, index: int, region: Region | None = None) -> NDArray[Any]:
        """Return the turned frame ``index``, or the part of it in ``region`` (rows and columns after turning)."""
        return self._turned(self.source.read(index, self._behind(region)))

    def samples(self, index: int, region: Region | None = None) -> Samples:
        """Return the turned samples of frame ``index``, with their validity and noise.

        ``region`` is the part of the turned frame to return, as rows and columns. None: the whole frame.
        """
        found = self.source.samples(index, self._behind(region))
        return found._replace(
            values=self._turned(found.values),
            valid=None if found.valid is None else self._turned(found.valid),
            noise=None if found.noise is None else found.noise.moved(self._turned),
        )

    def repeats(self) -> FrameSource | None:
        """Return the source's repeated frames of one position, turned upright; None if there are none."""
        found = self.source.repeats() if isinstance(self.source, Frames) else None
        return None if found is None else OrientedSource(found, self.turn, self.sensor)

    def _turned(self, array: NDArray[Any]) -> NDArray[Any]:
        return np.ascontiguousarray(self.turn.apply(array))

    def _behind(self, region: Region | None) -> Region | None:
        if region is None:
            return None
        return self.turn.region(check_region(region, self.shape), self.source.shape)


def oriented(source: FrameSource, turn: Orientation, sensor: tuple[int, int]) -> FrameSource:
    """Return a view of ``source`` whose frames are turned upright, or ``source`` itself if they are upright.

    Parameters
    ----------
    source
        Corrected frames in the orientation as delivered.
    turn
        The orientation that makes them upright.
    sensor
        Shape ``(rows, columns)`` of the upright sensor (px); the positions of cutouts are turned together with it.

    Examples
    --------
    >>> import numpy as np
    >>> from lfcal.frames import ArraySource, OrientedSource, named_orientation, oriented
    >>> source = ArraySource(np.array([[[1, 2, 3], [4, 5, 6]]]), [(0, 0, 0)])
    >>> upright: OrientedSource = oriented(source, named_orientation("mirror-x"), sensor=(2, 3))
    >>> upright.read(0).tolist()
    [[3, 2, 1], [6, 5, 4]]
    """
    if turn.name == AS_IS:
        return source
    whole = all(source.info(k).origin == (0, 0) for k in range(len(source)))
    return OrientedSource(source, turn, None if whole else turn.inverse.shape(sensor))
