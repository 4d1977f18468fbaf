"""The lenslet lattice, measured from a white image."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfcal.base import InputError, check_choice, check_number
from lfcal.lattice._checkered import check_cell, mean_cell
from lfcal.lattice._doubts import check_white, evenness
from lfcal.lattice._forms import DistortionFrame, fit_form
from lfcal.lattice._growth import followed, start_reach
from lfcal.lattice._iris_centre import iris_centre
from lfcal.lattice._local_means import best_places
from lfcal.lattice._model import LatticeModel
from lfcal.lattice._rounds import PlacedLenslets, centred, evened, mean_light, place_all, prepare
from lfcal.lattice._selection import Selection, flexible_form, select_form, thinned
from lfcal.lattice._spectrum import MIN_LENSLETS, MIN_PITCH, guess_lattice
from lfcal.lattice.lattice_fit import LatticeErrors, LatticeFit

__all__ = ["LatticeFit", "fit_lattice"]

Array = NDArray[np.float64]

MAX_RESIDUAL = 0.08
"""Largest residual rms of an accepted lattice, in pitches."""

ROUNDS = 4
SETTLED_PX = 2e-3
"""The lattice is settled when the lenslets move less than this from one round to the next (rms)."""


def fit_lattice(
    white: ArrayLike,
    *,
    dark: ArrayLike | float = 0.0,
    kind: str | None = None,
    pitch_px: float | None = None,
    workers: int | None = None,
) -> LatticeFit:
    """Fit the lattice of micro-images to a white image.

    The spectrum gives a first lattice (`guess_lattice`), which is followed from the middle of the frame outwards
    (`followed`). Then, in turns, the mean micro-image is made, each lenslet is placed by it to a fraction of a pixel
    (least squares, Lucas and Kanade 1981), and a flexible lattice is fitted to the places with outliers weighed
    down. The form is chosen that the places call for (`select_form`): straight, or with a distortion. At last the
    lattice is moved to the middle of the iris, which micro-images of odd corners are not symmetric about
    (`iris_centre`).

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
        If the frame is blank, textured, shows no such lattice, a checkerboard or a specimen; with the reason.

    Examples
    --------
    >>> from lfcal.frames import read_image
    >>> from lfcal.lattice import LatticeFit, fit_lattice
    >>> fit: LatticeFit = fit_lattice(read_image("session/white/white_0.png"), dark=64.0)
    >>> print(fit.kind, f"{fit.pitch_px:.1f} px, rows {fit.row_pitch_px:.1f} px apart, {len(fit.index)} lenslets")
    hexagonal 11.0 px, rows 9.5 px apart, 53 lenslets
    """
    image = prepare(white, dark)
    if kind is not None:
        check_choice("lattice", kind, ("square", "hexagonal"))
    if pitch_px is not None:
        check_number("nominal pitch (px)", pitch_px, at_least=MIN_PITCH, at_most=min(image.shape) / MIN_LENSLETS)
    rough = guess_lattice(image, kind, pitch_px)
    model = LatticeModel.of(rough.kind, rough.basis, rough.centre)
    model = model.centred_on((np.array(image.shape[::-1]) - 1) / 2)
    frame = DistortionFrame.of(image.shape)
    model = centred(image, model, workers, start_reach(model, frame))
    model = followed(image, model, workers)
    flat = evened(image, model, workers)
    model, lenslets = _settled(flat, model, frame, workers)
    sound = lenslets.sound
    chosen = select_form(model, lenslets.index[sound], lenslets.places[sound], frame)
    chosen, lenslets = _on_the_iris(flat, chosen, lenslets, workers)
    # the light is that of the image as taken: evened out, it would show no vignetting
    light = mean_light(image, chosen.fitted.model, lenslets.index, workers)
    if model.kind == "square":
        check_cell(mean_cell(image, chosen.fitted.model, lenslets.index[sound]))
    return _described((image.shape[0], image.shape[1]), lenslets, chosen, light)


def _settled(
    flat: NDArray[np.float32], model: LatticeModel, frame: DistortionFrame, workers: int | None
) -> tuple[LatticeModel, PlacedLenslets]:
    """Return the lenslets placed about a lattice that does not move any more."""
    # a better lattice makes a sharper mean micro-image, which places the lenslets better
    for _ in range(ROUNDS):
        lenslets = place_all(flat, model, workers)
        sound = lenslets.sound
        sound = sound[thinned(len(sound))]
        before = model
        form = flexible_form(len(sound))
        fitted = fit_form(model, form, lenslets.index[sound], lenslets.places[sound], frame)
        if fitted is None:
            break
        model = fitted.model
        moved = model.places(lenslets.index[sound]) - before.places(lenslets.index[sound])
        if math.sqrt(float((moved**2).mean())) < SETTLED_PX:
            break
    return model, lenslets


def _on_the_iris(
    flat: NDArray[np.float32], chosen: Selection, lenslets: PlacedLenslets, workers: int | None
) -> tuple[Selection, PlacedLenslets]:
    """Return lattice and lenslets moved from where the micro-images are most symmetric to the middle of the iris."""
    model, sound = chosen.fitted.model, lenslets.sound
    centres = model.places(lenslets.index[sound])
    light = mean_light(flat, model, lenslets.index[sound], workers)
    middle = iris_centre(flat, model, centres, light, workers)
    if middle is None:
        return chosen, lenslets
    # origin x and y are the first of the free numbers
    covariance = chosen.covariance.copy()
    covariance[:2, :2] += middle.covariance
    fitted = replace(chosen.fitted, model=model.moved(middle.shift))
    moved = replace(lenslets, places=lenslets.places + middle.shift)
    return replace(chosen, fitted=fitted, covariance=covariance), moved


def _described(shape: tuple[int, int], lenslets: PlacedLenslets, chosen: Selection, light: Array) -> LatticeFit:
    fitted = chosen.fitted
    model, frame = fitted.model, DistortionFrame.of(shape)
    errors = LatticeErrors.of(fitted, chosen.covariance, frame)
    x, y = model.places(np.zeros((1, 2), np.intp))[0]
    measured = np.where(lenslets.dead[:, None], np.nan, lenslets.places)
    # places on the rim of the lit field are off: they tell nothing of their neighbours either
    trusted = np.full_like(measured, np.nan)
    trusted[lenslets.sound] = measured[lenslets.sound]
    rms = _believable(fitted.residual, model.pitch)
    even = evenness(lenslets.index, light, ~lenslets.dead, model.places(lenslets.index)[:, ::-1])
    return LatticeFit(
        kind=model.kind,
        shape=shape,
        pitch_px=model.pitch,
        row_pitch_px=model.row_pitch,
        rotation_rad=model.rotation,
        origin_px=(float(y), float(x)),
        pitch_error_px=errors.pitch_px,
        shear_rad=math.atan(model.shear),
        residual_rms_px=rms,
        index=lenslets.index,
        measured_px=measured[:, ::-1].copy(),
        light=light,
        dead=lenslets.dead,
        distortion=model.distortion,
        errors=errors,
        form=fitted.form.name,
        reason=chosen.reason,
        places_px=best_places(lenslets.index, model.places(lenslets.index), trusted)[:, ::-1].copy(),
        notes=check_white(even, rms, lenslets.noise, model.pitch),
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
