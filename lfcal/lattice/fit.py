"""The lenslet lattice, measured from a white image."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfcal.base import InputError, check_choice, check_number
from lfcal.lattice._doubts import check_white, evenness
from lfcal.lattice._forms import (
    FORMS,
    DistortionFrame,
    LatticeForm,
    Selection,
    fit_flexible,
    fit_form,
    flexible_form,
    select_form,
    thinned,
)
from lfcal.lattice._iris_centre import iris_centre
from lfcal.lattice._model import MIN_PITCH, LatticeModel, check_row_pitch
from lfcal.lattice._rounds import FEW, PlacedLenslets, Region, centred, evened, mean_light, place_all, prepare
from lfcal.lattice._smooth_field import determined_degree
from lfcal.lattice._spectrum import guess_lattice, overlapping
from lfcal.lattice.lattice_fit import LatticeErrors, LatticeFit, best_places, outline_of, within_outline

__all__ = ["LatticeFit", "check_cell", "fit_lattice", "fit_outwards", "mean_cell", "start_reach"]

Array = NDArray[np.float64]

MAX_RESIDUAL = 0.08
"""Largest rms residual of an accepted lattice, in pitches."""

CELL_LENSLETS, MIN_CELLS = 400, 9
"""Largest and smallest number of cells whose mean is checked."""

RATIO_TOLERANCE = 0.06
"""Largest relative deviation of the distance of hexagonal rows from 0.87 pitches."""

PARTLY_LIT = 0.75
"""Fraction of the lattice's places within the outline of located micro-images below which a note is added."""

ROUNDS = 4
SETTLED_PX = 2e-3
"""Convergence limit: largest movement of the lenslets between two iterations (rms)."""


def fit_lattice(
    white: ArrayLike,
    *,
    dark: ArrayLike | float = 0.0,
    kind: str | None = None,
    pitch_px: float | None = None,
    workers: int | None = None,
) -> LatticeFit:
    """Fit a lattice of micro-images to a white image, and return the fit.

    An initial lattice is found in the spectrum of the image, and is extended from the middle of the frame outwards.
    Three steps are then repeated. The mean micro-image is computed. Each lenslet is located with it to a fraction of a
    pixel (least squares, Lucas and Kanade 1981). A flexible lattice is fitted robustly to the positions. The form of
    the lattice is then selected: straight, or with a distortion. Finally, the lattice is shifted to the centre of the
    iris. Micro-images of an iris with an odd number of corners are not point-symmetric about that centre.

    Parameters
    ----------
    white
        White image ``(rows, columns)`` of at least 7 uniformly illuminated lenslets, with a pitch above 4 px. A part of
        the frame may be dark; the lattice is fitted to the lit part (`LatticeFit.outline_px`).
    dark
        Dark frame, or dark level (counts), to subtract.
    kind
        Kind of lattice: ``"square"`` (including rectangular cells) or ``"hexagonal"``. None: detected.
    pitch_px
        Nominal pitch along a row (px), accurate to 10 %. None: detected.
    workers
        Number of threads. None: one for each available CPU core.

    Raises
    ------
    InputError
        If no lattice can be fitted, for example because the frame is blank or shows a specimen or a checkerboard; the
        message states the reason.

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
        check_number("nominal pitch (px)", pitch_px, at_least=MIN_PITCH, at_most=min(image.shape) / 2)
    rough = guess_lattice(image, kind, pitch_px)
    model = LatticeModel.of(rough.kind, rough.basis, rough.centre)
    frame = DistortionFrame.of(image.shape)
    # the middle of the frame, or of its lit part
    model = centred(image, model, workers, Region(rough.centre, start_reach(model, frame)))
    model, lenslets = fit_outwards(image, model, rough.centre, workers)
    flat = evened(image, model, lenslets, workers)
    model, lenslets = _settled(flat, model.centred_on(np.array(frame.middle)), frame, workers)
    sound = lenslets.sound
    chosen = select_form(model, lenslets.index[sound], lenslets.places[sound], frame, straight=lenslets.narrow)
    chosen, lenslets = _on_the_iris(flat, chosen, lenslets, workers)
    check_row_pitch(chosen.fitted.model.row_pitch)
    # the light of the uncorrected image: after flattening it would show no vignetting
    light = mean_light(image, chosen.fitted.model, lenslets.index, workers)
    if model.kind == "square":
        between = _surrounded(lenslets)
        if len(between) >= MIN_CELLS:
            check_cell(mean_cell(image, chosen.fitted.model, between))
    elif abs(model.ratio / math.sqrt(0.75) - 1) > RATIO_TOLERANCE:
        got = f"rows {model.ratio:.2f} pitches apart"
        raise InputError.expected("white image", "hexagonal or rectangular cells", got, "record an evenly lit image")
    return _described((image.shape[0], image.shape[1]), lenslets, chosen, light)


def _settled(
    flat: NDArray[np.float32], model: LatticeModel, frame: DistortionFrame, workers: int | None
) -> tuple[LatticeModel, PlacedLenslets]:
    """Return a converged lattice, and the lenslets located relative to it."""
    # a better lattice gives a sharper mean micro-image, which locates the lenslets better
    for _ in range(ROUNDS):
        lenslets = place_all(flat, model, workers)
        sound = lenslets.sound
        sound = sound[thinned(len(sound))]
        before = model
        form = FORMS[1] if lenslets.narrow else flexible_form(len(sound))
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
    """Return lattice and lenslets shifted from the point of best symmetry to the middle of the iris."""
    model, sound = chosen.fitted.model, lenslets.sound
    centres = model.places(lenslets.index[sound])
    light = mean_light(flat, model, lenslets.index[sound], workers)
    middle = iris_centre(flat, model, centres, light, workers)
    if middle is None:
        return chosen, lenslets
    # origin x and y are the first free parameters
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
    # positions at the edge of the lit field are biased, so they must not correct their neighbours
    trusted = np.full_like(measured, np.nan)
    trusted[lenslets.sound] = measured[lenslets.sound]
    rms = _believable(fitted.residual, min(model.pitch, model.row_pitch))
    used = outline_of(measured[~lenslets.dead])
    inside = within_outline(model.places(lenslets.index), used)
    judged = ~lenslets.dead
    if lenslets.narrow:
        judged = np.isin(np.arange(len(judged)), lenslets.sound)
    even = evenness(lenslets.index, light, judged, model.places(lenslets.index)[:, ::-1])
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
        outline_px=used[:, ::-1].copy(),
        notes=(*_extent(inside, lenslets), *check_white(even, rms, lenslets.noise, model.pitch)),
    )


def _extent(inside: NDArray[np.bool_], lenslets: PlacedLenslets) -> tuple[str, ...]:
    """Return notes about a partly lit frame, and about a few lenslets."""
    notes = []
    if inside.mean() < PARTLY_LIT:
        notes.append(
            f"only {100 * inside.mean():.0f} % of the lenslets are lit: the lattice is measured there"
            f"{', without distortion,' if lenslets.narrow else ''} and extrapolated elsewhere"
        )
    count = int((~lenslets.dead).sum())
    if count < FEW:
        notes.append(
            f"only {count} lenslets: distortion is limited to {flexible_form(count).name}, "
            f"fall-off of light to degree {determined_degree(count)}; a full model requires {FEW} or more"
        )
    return tuple(notes)


def _believable(residual: Array, pitch: float) -> float:
    """Return the rms of residuals along one axis (pixels), or raise: any texture has some lattice nearby."""
    rms = math.sqrt(float((residual**2).mean()))
    if rms > MAX_RESIDUAL * pitch:
        raise InputError.expected(
            "white image",
            f"micro-images within {100 * MAX_RESIDUAL:.0f} % of a pitch from a lattice",
            f"{100 * rms / pitch:.0f} % rms",
            "record an evenly lit image of the lenslets",
        )
    return rms


START_PITCHES = 10.0
START_SHARE = 0.33
"""Radius of the first region, as a fraction of half the frame's diagonal."""

START_PX = 700.0
"""Largest radius of the first region (pixels): there, the spectrum's lattice is accurate to a fraction of a pitch."""

GROWTH = 1.6
"""Growth factor between regions: a cubic form can extrapolate this far."""

MIN_REGION = 60
"""Smallest number of lenslets of the first region."""

TRACKING_DEGREE = 3
"""Largest order for extrapolation: higher orders diverge outside the measured region."""


def start_reach(model: LatticeModel, frame: DistortionFrame) -> float:
    """Return the radius (px) of the region of ``frame`` that is fitted first.

    If this region would contain too few lenslets of ``model``, the radius is half the diagonal of the frame.
    """
    wanted = max(START_PITCHES * model.pitch, min(START_SHARE * frame.scale, START_PX))
    return wanted if 3 * (wanted / model.pitch) ** 2 >= MIN_REGION else frame.scale


def tracking_form(count: int) -> LatticeForm:
    """Return the form of the lattice for reliable extrapolation from ``count`` lenslets."""
    form = flexible_form(count // 2)
    return form if form.degree <= TRACKING_DEGREE else flexible_form(100)


def fit_outwards(
    image: NDArray[np.float32], model: LatticeModel, start: Array, workers: int | None
) -> tuple[LatticeModel, PlacedLenslets]:
    """Fit the lattice in growing regions about ``start`` (x, y; px); return it, and the lenslets of the last region.

    The initial ``model`` predicts the lenslets of the first region, and each fit predicts those of the next region. The
    last region is the whole frame.
    """
    frame = DistortionFrame.of(image.shape)
    farthest = float(np.hypot(*(frame.outline() - start).T).max())
    reach = start_reach(model, frame)
    # the first region is processed twice, because it starts from the spectrum only
    reaches = [reach]
    while reaches[-1] < farthest:
        reaches.append(min(farthest, GROWTH * reaches[-1]))
    for near in [reaches[0], *reaches]:
        lenslets = place_all(image, model, workers, Region(start, near))
        alive = np.flatnonzero(~lenslets.dead)
        alive = alive[thinned(len(alive))]
        form = tracking_form(len(alive))
        fitted = fit_flexible(model, form, lenslets.index[alive], lenslets.places[alive], frame)
        if fitted is not None:
            model = fitted.model
    return model, lenslets


CELL_SIDE = 12
"""Number of samples along each side of a cell; even, so that half a cell is a whole number of them."""

INVERSE_CORRELATION = -0.99
"""Correlation of a cell with itself half a diagonal away below which light and dark only exchange places. Measured:
checkerboards -0.999 and below; sharp micro-images that fill 50 % to 100 % of the pitch -0.36 to -0.86."""

PLATEAU, LARGEST_PLATEAU, CLOSED = 0.15, 0.25, 0.6
"""Level of a cell (fraction of its contrast) below which a point is dark, largest fraction of dark points if the points
around them are bright, and level above which those points are bright.

Measured dark fractions: between micro-images that touch, 0.2 at most; with discs of 140 % of the pitch, 0.34."""

FLAT, LARGEST_FLAT = 0.03, 0.055
"""Slope (contrast per sample) of a flat part of a cell, and its largest area at a level between light and dark.

Measured: separate micro-images, sharp or blurred, 0.042 at most; overlapping discs 0.07 to 0.45."""

SHARP_EDGES = 0.35
"""Fraction of the cell between a quarter and three quarters of its contrast up to which its edges are sharp.
Unresolved, blurred cells have 0.42 and above, and look alike for any object."""


def mean_cell(image: NDArray[np.float32], model: LatticeModel, index: NDArray[np.intp]) -> Array:
    """Return the mean brightness over one lattice cell, ``(CELL_SIDE, CELL_SIDE)``, averaged over lenslets.

    ``index`` ``(n, 2)`` contains their lattice indices (q, r); of many lenslets, only some are used. The cell starts at
    the centre of a lenslet, and its axes are the lattice vectors.
    """
    from scipy.ndimage import map_coordinates

    chosen = index[:: max(1, len(index) // CELL_LENSLETS)]
    part = np.arange(CELL_SIDE) / CELL_SIDE
    basis = model.basis()
    offsets = (part[:, None, None] * basis[0] + part[None, :, None] * basis[1]).reshape(-1, 1, 2)
    points = (model.places(chosen) + offsets)[..., ::-1]
    values = map_coordinates(image, points.reshape(-1, 2).T, order=1, mode="nearest")
    mean: Array = values.reshape(CELL_SIDE, CELL_SIDE, -1).mean(-1, dtype=np.float64)
    return mean


def _surrounded(lenslets: PlacedLenslets) -> NDArray[np.intp]:
    """Return the evenly lit lenslets (q, r) whose next neighbours along and across the row are evenly lit too."""
    index = lenslets.index[~lenslets.dead & ~lenslets.steep]
    every = {(int(q), int(r)) for q, r in index}
    kept = [all((q + i, r + j) in every for i, j in ((1, 0), (0, 1), (1, 1))) for q, r in index]
    chosen: NDArray[np.intp] = index[np.array(kept, bool)]
    return chosen


def check_cell(cell: Array) -> None:
    """Raise `InputError` if the mean cell shows a checkerboard or overlapping micro-images.

    The light and dark fields of a checkerboard have the same shape: shifted by half a diagonal, each is the negative
    of the other. Micro-images and the gaps between them have different shapes.
    """
    contrast = float(np.ptp(cell))
    if contrast <= 0:
        return
    level = (cell - cell.min()) / contrast
    between = float(((level > 0.25) & (level < 0.75)).mean())
    turned = np.roll(level, (CELL_SIDE // 2, CELL_SIDE // 2), (0, 1))
    alike = float(np.corrcoef(level.ravel(), turned.ravel())[0, 1])
    if alike < INVERSE_CORRELATION and between < SHARP_EDGES:
        raise InputError.expected(
            "white image",
            "micro-images with gaps of a different shape",
            "light and dark fields of the same shape, as in a checkerboard",
            "record an evenly lit image of the lenslets",
        )
    if _overlap(level):
        raise overlapping(
            "separate micro-images with dark gaps", "light between them, as from overlapping micro-images"
        )


def _overlap(level: Array) -> bool:
    """Return whether a mean cell, from 0 to 1, shows overlapping micro-images.

    Their light adds up to several flat levels. Where wide micro-images overlap, the areas between them are the
    brightest, and a large dark area remains at the centre of each.
    """
    half = CELL_SIDE // 2
    centre, sides = level[0, 0], (level[half, 0], level[0, half])
    closed = min(centre, *sides) > CLOSED and float((level < PLATEAU).mean()) > LARGEST_PLATEAU
    down, right = ((np.roll(level, -1, axis) - np.roll(level, 1, axis)) / 2 for axis in (0, 1))
    flat = (np.hypot(down, right) < FLAT) & (level > 0.2) & (level < 0.8)
    return closed or float(flat.mean()) > LARGEST_FLAT or (centre < PLATEAU and max(sides) > 0.5)
