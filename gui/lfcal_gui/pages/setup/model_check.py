"""Comparison of the camera with a white image: the work, its drawing, and maps of the lattice. No Qt."""

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
from lfcal.lattice import DIFFERS, FITS, CameraCheck, LatticeFit, check_camera
from lfcal_gui.models import typeset

DISTORTION, RESIDUALS = "distortion", "residuals"
CELLS = 24
"""Number of cells of a map along the longer side."""
REACH = 0.9
"""Length of the longest arrow, in cells."""
HEAD = 0.3
"""Length of an arrow head relative to the arrow."""


@dataclass(frozen=True, eq=False)
class LatticeMap:
    """Map of displacements on a grid over the frame.

    Attributes
    ----------
    size
        Displacement (pixels) ``(rows, columns)``; NaN if the cell contains no lenslet.
    arrows
        ``(2 n, 2)``: ends (row, column) of line segments, pair after pair, in pixels of the frame.
    cell
        Side of a cell (pixels).
    gain
        Magnification of the arrows.
    """

    size: NDArray[np.float64]
    arrows: NDArray[np.float64]
    cell: float
    gain: float

    @property
    def largest(self) -> float:
        """Largest displacement (pixels); 0 if there is none."""
        return float(np.nanmax(self.size)) if np.isfinite(self.size).any() else 0.0


def residual_map(fit: LatticeFit) -> LatticeMap:
    """Return the map of the mean displacement of the micro-images from the fitted lattice in each cell."""
    return _map(fit.residual_map(CELLS), max(fit.shape) / CELLS)


def distortion_map(fit: LatticeFit) -> LatticeMap | None:
    """Return the map of the distortion relative to a straight lattice; None if the lattice is straight."""
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
    """Return the chosen lattice with the reason, and doubts about the frame, one line each."""
    dead = int(fit.dead.sum())
    count = f"{len(fit.index)} lenslets{f', {dead} of them dead' if dead else ''}"
    lines = [f"Lattice {fit.reason or fit.form}. {count}, residual {fit.residual_rms_px:.3f} px rms."]
    return "\n".join([*lines, *(f"Doubtful: {note}" for note in fit.notes)])


MOST_PIXELS = 1400
"""Largest number of rows or columns of the image; larger frames are subsampled."""
MOST_MARKS = 4000
"""Largest number of lenslets drawn; of more, only those near the first corner."""


@dataclass(frozen=True)
class Checked:
    """A comparison with its image.

    Attributes
    ----------
    name
        Name of the white image's file.
    check
        The comparison.
    camera
        Camera that was compared.
    picture, step
        White image subsampled to every ``step``-th pixel, and this step.
    centres, described
        Fitted and described centres (row, column) of micro-images ``(n, 2)``, in pixels of the frame.
    maps
        Maps of the deviation of the micro-images from straight rows (`DISTORTION`, if any) and from the lattice
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
        """Whether the white image covers the full sensor, so that a scan can be drawn in it."""
        return self.picture.shape == tuple(-(-n // self.step) for n in self.camera.sensor.shape)

    @property
    def role(self) -> str:
        """Merit of the result, which determines its colour: ``"good"``, ``"fair"`` or ``"bad"``."""
        return {FITS: "good", DIFFERS: "fair"}.get(self.check.verdict, "bad")

    @property
    def words(self) -> str:
        """Result of the comparison in a sentence."""
        wrong = [one for one in self.check.lines if one.verdict == self.check.verdict]
        if self.check.verdict != FITS and wrong:
            more = f" ({len(wrong) - 1} more)" if len(wrong) > 1 else ""
            return typeset(f"{wrong[0].label}: {wrong[0].measured}, described as {wrong[0].expected}{more}.")
        fit = self.check.fit
        return "" if fit is None else f"Pitch {fit.pitch_px:.3f} px, residual {fit.residual_rms_px:.2f} px rms."


def iter_check(camera: Camera, white: Path, dark: Path | None) -> Work[Checked]:
    """Compare ``camera`` with a white image; yield progress and return the comparison."""
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
    """Return the `MOST_MARKS` centres nearest to the first corner of the frame, which is shown first."""
    return centres[np.argsort(centres.sum(axis=1), kind="stable")[:MOST_MARKS]]
