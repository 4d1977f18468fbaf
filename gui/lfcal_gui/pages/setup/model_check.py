"""The camera held against a white image: the work, and what is drawn of it. No Qt."""

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
from lfcal.lattice import FITS, CameraCheck, check_camera
from lfcal_gui.models import typeset
from lfcal_gui.pages.setup.model_lattice_map import DISTORTION, RESIDUALS, LatticeMap, distortion_map, residual_map

__all__ = ["Checked", "iter_check"]

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
    if camera.pitch_px < 2:
        return np.empty((0, 2))
    centres, _ = seen.lattice.lenslets_within(shape[1] / 2 * pixel, shape[0] / 2 * pixel)
    return _thinned(seen.pixels(centres))


def _thinned(centres: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the `MOST_MARKS` centres nearest the frame's first corner, which is looked at first."""
    return centres[np.argsort(centres.sum(axis=1), kind="stable")[:MOST_MARKS]]
