"""The lenslet lattice, measured from a white image."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfcal.camera import Camera, LensletLattice
from lfcal.checks import check_choice, check_number
from lfcal.errors import InputError
from lfcal.lattice.model import LatticeModel, fit_model, free_shear
from lfcal.lattice.rounds import centred, evened, mean_light, place_all, prepare
from lfcal.lattice.spectrum import MIN_LENSLETS, MIN_PITCH, guess_lattice

__all__ = ["LatticeFit", "fit_lattice"]

Array = NDArray[np.float64]

MAX_RESIDUAL = 0.08
"""Largest residual rms of an accepted lattice, in pitches."""

ROUNDS = 4
SETTLED_PX = 2e-3
"""The lattice is settled when no lenslet moves farther from one round to the next."""


@dataclass(frozen=True, eq=False)
class LatticeFit:
    """A lattice of micro-images and how well it fits.

    Image coordinates count rows downwards from the centre of the first pixel.

    Attributes
    ----------
    kind
        ``"square"`` or ``"hexagonal"``.
    shape
        Rows and columns of the frame.
    pitch_px, row_pitch_px
        Distance of neighbours along a row, and of neighbouring rows (pixels).
    rotation_rad
        Angle from the +x (column) axis to a row, positive towards +y (down) (rad).
    origin_px
        Centre ``(row, column)`` of the lenslet q = r = 0, the one nearest the frame's centre.
    pitch_error_px
        Standard error of the pitch (pixels).
    shear_rad
        By how much rows and columns depart from the ideal angle, fitted freely (rad).
    residual_rms_px
        Distance of the placed micro-images from the lattice, rms along one axis (pixels).
    index
        ``(n, 2)``: q along a row and r across, of every lenslet wholly in the frame.
    measured_px
        ``(n, 2)``: placed centres (row, column); NaN for dead ones.
    light
        ``(n,)``: mean sample value within half a pitch.
    dead
        ``(n,)``: lenslets that give too little light or cannot be placed.
    """

    kind: str
    shape: tuple[int, int]
    pitch_px: float
    row_pitch_px: float
    rotation_rad: float
    origin_px: tuple[float, float]
    pitch_error_px: float
    shear_rad: float
    residual_rms_px: float
    index: NDArray[np.intp] = field(repr=False)
    measured_px: Array = field(repr=False)
    light: Array = field(repr=False)
    dead: NDArray[np.bool_] = field(repr=False)

    def basis_px(self) -> Array:
        """Return the lattice vectors as rows (x, y): along a row, and to the next row (pixels)."""
        return self._model().basis()

    def _model(self) -> LatticeModel:
        along = self.pitch_px * np.array([math.cos(self.rotation_rad), math.sin(self.rotation_rad)])
        return LatticeModel(self.kind, np.array(self.origin_px[::-1]), along, self.row_pitch_px / self.pitch_px)

    def centres_px(self, q: ArrayLike, r: ArrayLike) -> Array:
        """Return the lattice's centres ``(..., 2)`` as (row, column) of lenslets q, r."""
        index = np.stack(np.broadcast_arrays(np.asarray(q, float), np.asarray(r, float)), axis=-1)
        centres: Array = (index @ self.basis_px())[..., ::-1] + np.array(self.origin_px)
        return centres

    def lenslet_at(self, row: ArrayLike, column: ArrayLike) -> Array:
        """Return fractional lattice indices ``(..., 2)`` as (q, r) of image points."""
        points = np.stack(np.broadcast_arrays(np.asarray(column, float), np.asarray(row, float)), axis=-1)
        index: Array = (points - np.array(self.origin_px)[::-1]) @ np.linalg.inv(self.basis_px())
        return index

    @property
    def dead_lenslets(self) -> list[tuple[int, int]]:
        """Lattice indices (q, r) of the dead lenslets."""
        return [(int(q), int(r)) for q, r in self.index[self.dead]]

    def to_lattice(
        self, camera: Camera, *, origin: tuple[int, int] | None = None, type_step: int | None = None
    ) -> LensletLattice:
        """Return ``camera``'s lattice with what was measured: pitch, row pitch, rotation and offset.

        Parameters
        ----------
        camera
            The camera that took the frame; lens types and gap are kept.
        origin
            Lenslet (q, r) at the lattice's offset, of type 0 where there are three types; by default the one
            nearest to the offset stated so far.
        type_step
            Sense of the lens types along a row; by default as stated so far.

        Raises
        ------
        InputError
            If the kind of lattice or the frame's shape is not the camera's.
        """
        if camera.sensor.shape != self.shape:
            raise InputError.expected(
                "white image",
                f"the camera's {camera.sensor.shape} pixels",
                self.shape,
                "choose the camera it was taken with",
            )
        stated = camera.lattice
        if stated.kind != self.kind:
            raise InputError.expected("lattice of the white image", stated.kind, self.kind, "correct the camera")
        pixel = camera.sensor.pixel_um
        if origin is None:
            row, column = camera.pixels(stated.offset_um)
            q, r = np.rint(self.lenslet_at(row, column)).astype(int)
            origin = (int(q), int(r))
        offset = camera.sensor_um(self.centres_px(*origin))
        return replace(
            stated,
            pitch_um=self.pitch_px * pixel,
            row_pitch_um=self.row_pitch_px * pixel,
            rotation_rad=self.rotation_rad,
            offset_um=(float(offset[0]), float(offset[1])),
            clear_um=None if stated.clear_um is None else min(stated.clear_um, 1.5 * self.pitch_px * pixel),
            type_step=stated.type_step if type_step is None else type_step,
        )


def fit_lattice(
    white: ArrayLike,
    *,
    dark: ArrayLike | float = 0.0,
    kind: str | None = None,
    pitch_px: float | None = None,
    workers: int | None = None,
) -> LatticeFit:
    """Fit the lattice of micro-images to a white image.

    The spectrum gives a first lattice (`guess_lattice`); then, in turns, the mean micro-image is made, each
    lenslet is placed by it to a fraction of a pixel (least squares, Lucas and Kanade 1981), and the lattice is
    fitted to the places with outliers weighed down.

    Parameters
    ----------
    white
        Frame ``(rows, columns)`` of evenly lit lenslets, at least 5 along its shorter side, pitch above 4 px.
    dark
        Dark frame or level to subtract.
    kind
        ``"square"`` or ``"hexagonal"``; None finds out.
    pitch_px
        Nominal pitch along a row, right within 10 %; None finds out.
    workers
        Threads; None takes every processor.

    Raises
    ------
    InputError
        If the frame is blank, textured, or shows no such lattice; with the reason.
    """
    image = prepare(white, dark)
    if kind is not None:
        check_choice("lattice", kind, ("square", "hexagonal"))
    if pitch_px is not None:
        check_number("nominal pitch (px)", pitch_px, at_least=MIN_PITCH, at_most=min(image.shape) / MIN_LENSLETS)
    rough = guess_lattice(image, kind, pitch_px)
    model = LatticeModel.of(rough.kind, rough.basis, rough.centre)
    model = model.centred_on((np.array(image.shape[::-1]) - 1) / 2)
    model = centred(image, model, workers)
    flat = evened(image, model, workers)
    # a better lattice makes a sharper mean micro-image, which places the lenslets better
    for _ in range(ROUNDS):
        lenslets = place_all(flat, model, workers)
        alive = ~lenslets.dead
        before = model.places(lenslets.index)
        model, residual, error = fit_model(model, lenslets.index[alive], lenslets.places[alive])
        if np.abs(model.places(lenslets.index) - before).max() < SETTLED_PX:
            break
    shear = free_shear(model, lenslets.index[alive], lenslets.places[alive])
    # the light is that of the image as taken: evened out, it would show no vignetting
    light = mean_light(image, model, lenslets.index, workers)
    rms = _believable(residual, model.pitch)
    x, y = model.origin
    return LatticeFit(
        kind=model.kind,
        shape=(image.shape[0], image.shape[1]),
        pitch_px=model.pitch,
        row_pitch_px=model.row_pitch,
        rotation_rad=model.rotation,
        origin_px=(float(y), float(x)),
        pitch_error_px=error,
        shear_rad=shear,
        residual_rms_px=rms,
        index=lenslets.index,
        measured_px=np.where(alive[:, None], lenslets.places, np.nan)[:, ::-1].copy(),
        light=light,
        dead=lenslets.dead,
    )


def _believable(residual: Array, pitch: float) -> float:
    """Return the rms of residuals along one axis (pixels), or refuse: any texture has some lattice nearby."""
    rms = math.sqrt(float((residual**2).mean()))
    if rms > MAX_RESIDUAL * pitch:
        raise InputError.expected(
            "white image",
            f"micro-images within {100 * MAX_RESIDUAL:.0f} % of a pitch from a lattice",
            f"{100 * rms / pitch:.0f} % rms",
            "take an evenly lit image of the lenslets",
        )
    return rms
