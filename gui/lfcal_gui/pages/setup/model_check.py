"""The camera compared with a white image: the work, what is drawn of it, and maps of the lattice. No Qt."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.base import Clock, Work
from lfcal.camera import Camera
from lfcal.frames import compared_orientations, read_image
from lfcal.frames.corrections import read_average
from lfcal.lattice import FITS, CameraCheck, LatticeFit, check_camera
from lfcal_gui.models import typeset

DISTORTION, RESIDUALS = "distortion", "residuals"
CELLS = 24
"""Cells along the longer side."""
REACH = 0.9
"""Length of the longest arrow, in cells."""
HEAD = 0.3
"""Length of an arrow's head over that of the arrow."""


@dataclass(frozen=True, eq=False)
class LatticeMap:
    """Displacements on a grid over the frame.

    Attributes
    ----------
    size
        ``(rows, columns)``: how far (pixels); NaN where no lenslet was placed.
    arrows
        ``(2 n, 2)``: ends (row, column) of line segments, pair after pair, in pixels of the frame.
    cell
        Side of a cell (pixels).
    gain
        By how much the arrows are drawn too long.
    """

    size: NDArray[np.float64]
    arrows: NDArray[np.float64]
    cell: float
    gain: float

    @property
    def largest(self) -> float:
        """Largest displacement (pixels); 0 where there is none."""
        return float(np.nanmax(self.size)) if np.isfinite(self.size).any() else 0.0


def residual_map(fit: LatticeFit) -> LatticeMap:
    """Return the mean displacement of the micro-images of each cell from the fitted lattice."""
    return _map(fit.residual_map(CELLS), max(fit.shape) / CELLS)


def distortion_map(fit: LatticeFit) -> LatticeMap | None:
    """Return how far from the straight lattice micro-images are seen; None where the lattice is straight."""
    if fit.distortion is None:
        return None
    cell = max(fit.shape) / CELLS
    rows, columns = (np.arange(max(1, -(-n // cell))) for n in fit.shape)
    seen = np.stack(np.meshgrid((columns + 0.5) * cell, (rows + 0.5) * cell), axis=-1)
    bent = fit.distortion.displacement(fit.distortion.invert(seen))
    return _map(np.stack([bent[..., 1], bent[..., 0]]), cell)


def _map(shift: NDArray[np.float64], cell: float) -> LatticeMap:
    """Return the map of displacements ``(2, rows, columns)`` (row, column)."""
    size = np.hypot(*shift)
    known = np.isfinite(size)
    longest = float(size[known].max()) if known.any() else 0.0
    gain = REACH * cell / longest if longest > 0 else 1.0
    place = (np.argwhere(known) + 0.5) * cell
    step = gain * shift[:, known].T
    start, end = place - step / 2, place + step / 2
    side = np.stack([-step[:, 1], step[:, 0]], axis=-1)
    barbs = [end - HEAD * (step + sign * side / 2) for sign in (-1, 1)]
    arrows = np.stack([start, end, end, barbs[0], end, barbs[1]], axis=1).reshape(-1, 2)
    return LatticeMap(size, arrows, cell, gain)


def lattice_words(fit: LatticeFit) -> str:
    """Return which lattice was chosen and why, and what is doubtful of the frame, a line each."""
    dead = int(fit.dead.sum())
    count = f"{len(fit.index)} lenslets{f', {dead} of them dead' if dead else ''}"
    lines = [f"Lattice {fit.reason or fit.form}. {count}, {fit.residual_rms_px:.3f} px rms off it."]
    return "\n".join([*lines, *(f"Doubtful: {note}" for note in fit.notes)])


MOST_PIXELS = 1400
"""Rows or columns of the picture; larger frames are shown coarser."""
MOST_MARKS = 4000
"""Lenslets drawn over it; of more, those near the first corner."""


@dataclass(frozen=True)
class Checked:
    """A comparison with its picture.

    Attributes
    ----------
    name
        Name of the white image's file.
    check
        The comparison.
    camera
        The camera that was compared.
    picture, step
        The white image, every ``step``-th pixel.
    centres, described
        ``(n, 2)``: centres (row, column) of micro-images as fitted and as the camera says, in pixels of the frame.
    maps
        How the micro-images depart from straight rows (`DISTORTION`, where they do) and from the lattice
        (`RESIDUALS`).
    """

    name: str
    check: CameraCheck
    camera: Camera
    picture: NDArray[Any]
    step: int
    centres: NDArray[np.float64]
    described: NDArray[np.float64]
    maps: Mapping[str, LatticeMap] = field(default_factory=dict)

    @property
    def whole(self) -> bool:
        """Whether the white image is of the whole sensor, so that a scan can be drawn in it."""
        return self.picture.shape == tuple(-(-n // self.step) for n in self.camera.sensor.shape)

    @property
    def words(self) -> str:
        """What the comparison shows, in a sentence."""
        wrong = [one for one in self.check.lines if one.verdict == self.check.verdict]
        if self.check.verdict != FITS and wrong:
            more = f" ({len(wrong) - 1} more)" if len(wrong) > 1 else ""
            return typeset(f"{wrong[0].label}: {wrong[0].measured}, described as {wrong[0].expected}{more}.")
        fit = self.check.fit
        return "" if fit is None else f"Pitch {fit.pitch_px:.3f} px, off by {fit.residual_rms_px:.2f} px."


def iter_check(camera: Camera, white: Path, dark: Path | None) -> Work[Checked]:
    """Yield progress and return the comparison of ``camera`` with a white image."""
    clock = Clock("fitting the lattice of the white image", 2)
    yield clock.at(0)
    frame = read_image(white)
    level = read_average(dark) if dark is not None else 0.0
    yield clock.at(1)
    check, _ = compared_orientations(check_camera(camera, frame, dark=level), camera)
    yield clock.at(2)
    step = max(1, -(-max(frame.shape) // MOST_PIXELS))
    picture = frame[::step, ::step]
    described = _described(camera, frame.shape)
    return Checked(white.name, check, camera, picture, step, _fitted(check), described, _maps(check))


def _maps(check: CameraCheck) -> dict[str, LatticeMap]:
    if check.fit is None:
        return {}
    bent = distortion_map(check.fit)
    return {RESIDUALS: residual_map(check.fit), **({} if bent is None else {DISTORTION: bent})}


def _fitted(check: CameraCheck) -> NDArray[np.float64]:
    if check.fit is None:
        return np.empty((0, 2))
    index = check.fit.index
    return _thinned(np.asarray(check.fit.centres_px(index[:, 0], index[:, 1])))


def _described(camera: Camera, shape: tuple[int, ...]) -> NDArray[np.float64]:
    seen = replace(camera, sensor=replace(camera.sensor, shape=(shape[0], shape[1])))
    pixel = camera.sensor.pixel_um
    # what is described in another unit would fill the frame with millions
    if camera.has_lattice and camera.pitch_px < 2:
        return np.empty((0, 2))
    centres, _ = seen.lattice.lenslets_within(shape[1] / 2 * pixel, shape[0] / 2 * pixel)
    return _thinned(seen.pixels(centres))


def _thinned(centres: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the `MOST_MARKS` centres nearest the frame's first corner, which is looked at first."""
    return centres[np.argsort(centres.sum(axis=1), kind="stable")[:MOST_MARKS]]
