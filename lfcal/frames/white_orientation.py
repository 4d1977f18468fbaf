"""Orientation of a white image, from a comparison of its lattice and lens types with the camera."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from lfcal.camera import Camera
from lfcal.frames.orientation import AS_IS, ORIENTATIONS, Orientation
from lfcal.lattice import WRONG, CameraCheck, CheckLine, LatticeFit, LensTypes

__all__ = ["TurnedWhite", "compared_orientations", "find_turned_white"]

MAX_LENSLETS = 500
"""Smallest number of lenslets that are compared, if the image has so many; less than twice as many are used."""

CERTAIN_SIGMAS = 5.0
"""Standard errors above which the order of the lens types is certain."""

MIN_ORDERED = 0.8
"""Smallest fraction of lenslets whose type follows one order."""

NEAR_PX, FAR_PX = 0.3, 1.0
"""Distances (px rms) below which a lattice explains the micro-images, and above which it does not."""

MIN_RATIO = 4.0
"""Factor by which another orientation must be nearer."""

EQUAL_PX = 0.3
"""Difference of distances (px rms) below which orientations are equally good."""


@dataclass(frozen=True, slots=True)
class TurnedWhite:
    """Orientations in which a white image matches its camera, although it does not match as delivered.

    Attributes
    ----------
    turns
        Orientations that make the image upright, the best first; several if they are equally good.
    away_px, as_is_px
        Rms distance of the micro-images from those of the camera in the best orientation, and as delivered (px).
    sigmas
        Significance, in standard errors, of the finding that the order of the lens types is reversed. None: no such
        finding.
    """

    turns: tuple[Orientation, ...]
    away_px: float
    as_is_px: float
    sigmas: float | None

    @property
    def words(self) -> str:
        """Description of the orientation and of the evidence for it."""
        ways = " or ".join(turn.words for turn in self.turns)
        places = f"{self.away_px:.2f} px from the camera's lattice when upright, {self.as_is_px:.2f} px as delivered"
        return f"{ways} ({f'{self.sigmas:.0f} σ; ' if self.sigmas is not None else ''}{places})"

    @property
    def options(self) -> str:
        """Command-line option that turns the white image upright; alternatives are joined by "or"."""
        return " or ".join(f"--orientation {turn.option}" for turn in self.turns)


@dataclass(frozen=True, slots=True)
class _Compared:
    turn: Orientation
    away_px: float
    ordered: bool


def find_turned_white(camera: Camera, fit: LatticeFit, types: LensTypes | None) -> TurnedWhite | None:
    """Return the orientations in which a white image matches ``camera``.

    The result is None if the image matches as delivered and no other orientation is clearly better, or if none matches.

    The comparison uses the order of the lens types, the rotation of the lattice, and its offset unless that is only
    assumed.

    Parameters
    ----------
    camera
        Camera description.
    fit
        Lattice of the white image.
    types
        Lens types of the white image, if there are three; else None.
    """
    typed = types is not None and types.sigmas >= CERTAIN_SIGMAS and camera.marks["lattice.type_step"] != "assumed"
    index = fit.index[:: max(1, len(fit.index) // MAX_LENSLETS)]
    seen = fit.centres_px(index[:, 0], index[:, 1])
    kinds = types.type_of(index[:, 0], index[:, 1]) if typed and types is not None else None
    tried = [
        _compare(camera, turn, turn.places(seen, fit.shape), kinds)
        for turn in ORIENTATIONS.values()
        if turn.shape(fit.shape) == fit.shape
    ]
    own = next(one for one in tried if one.turn.name == AS_IS)
    others = sorted((one for one in tried if one.ordered and one is not own), key=lambda one: one.away_px)
    if not others:
        return None
    best = others[0].away_px
    nearer = best <= NEAR_PX and own.away_px > max(FAR_PX, MIN_RATIO * best)
    if own.ordered and not nearer:
        return None
    turns = tuple(one.turn for one in others if one.away_px <= best + EQUAL_PX)
    sigmas = types.sigmas if types is not None and not own.ordered else None
    return TurnedWhite(turns, best, own.away_px, sigmas)


def compared_orientations(check: CameraCheck, camera: Camera) -> tuple[CameraCheck, TurnedWhite | None]:
    """Return ``check`` and the `TurnedWhite` found, which is reported in an additional line of ``check``.

    If the white image is not flipped or turned, or could not be analysed, ``check`` is unchanged, and None is returned
    with it.
    """
    found = None if check.fit is None or check.camera is None else find_turned_white(camera, check.fit, check.types)
    if found is None:
        return check, None
    line = CheckLine("orientation", "upright", found.words, None, WRONG)
    return replace(check, lines=(*check.lines, line)), found


def _compare(
    camera: Camera, turn: Orientation, places: NDArray[np.float64], kinds: NDArray[np.intp] | None
) -> _Compared:
    """Return the rms distance of ``places`` from lenslets of their type, and whether the types are in order.

    ``places`` are positions (row, column) after ``turn``, ``(n, 2)`` (px), and ``kinds`` their lens types. None:
    unknown.
    """
    lattice = camera.lattice
    at = lattice.lenslet_at(camera.sensor_um(places))
    if camera.marks["lattice.offset_um"] == "assumed":
        # the offset of a lattice that was not measured is no evidence: use the best one
        at = at - np.angle(np.exp(2j * np.pi * at).mean(axis=0)) / (2 * np.pi)
    near = np.rint(at).astype(np.intp)
    basis = lattice.basis_um() / camera.sensor.pixel_um
    if kinds is None:
        return _Compared(turn, _rms((at - near) @ basis), True)
    apart = np.mod(kinds - lattice.type_of(near[:, 0], near[:, 1]), 3)
    counts = np.bincount(apart, minlength=3)
    ordered = bool(counts.max() >= MIN_ORDERED * len(apart))
    if not ordered or camera.marks["lattice.offset_um"] == "assumed":
        return _Compared(turn, _rms((at - near) @ basis), ordered)
    return _Compared(turn, _rms(_nearest_of_type(at, near, kinds, camera, basis)), True)


def _nearest_of_type(
    at: NDArray[np.float64],
    near: NDArray[np.intp],
    kinds: NDArray[np.intp],
    camera: Camera,
    basis: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Return, for each position, the vector from the nearest lenslet of its type, ``(n, 2)`` (px)."""
    steps = np.array([(i, j) for i in (-1, 0, 1) for j in (-1, 0, 1)])
    around = near[:, None] + steps
    ways = (at[:, None] - around) @ basis
    length = np.square(ways).sum(axis=-1)
    length[camera.lattice.type_of(around[..., 0], around[..., 1]) != kinds[:, None]] = np.inf
    return np.take_along_axis(ways, length.argmin(axis=1)[:, None, None], axis=1)[:, 0]


def _rms(ways: NDArray[np.float64] | Sequence[float]) -> float:
    return math.sqrt(float(np.square(ways).sum(axis=-1).mean()))
