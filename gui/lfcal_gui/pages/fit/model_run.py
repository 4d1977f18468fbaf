"""A fit as work for the window: what is asked, what is kept of it, and what comes out. No Qt."""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lfcal.base import InputError, Progress, Work
from lfcal.camera import Camera, ScanPlan
from lfcal.fit import Fineness, Fit, FitProgress, Measured, iter_fit_camera, leftover_of, measured_of, predict
from lfcal.psf import PSFMatrix, light_shares
from lfcal_gui.models import ProjectState
from lfcal_gui.pages.fit.model import FitSettings, Stamp, lacking_of, offer_of, stamp_of

__all__ = ["FitRequest", "FitRun", "FoundFit", "Place", "asked_of", "iter_fit", "iter_taken"]

F4 = NDArray[np.float32]
Place = tuple[int, int, int]
"""A position (z, y, x)."""


@dataclass(frozen=True, eq=False)
class FitRequest:
    """What is fitted to what.

    Attributes
    ----------
    psf, stamp
        File of H, and as it was when the fit was asked for.
    settings, window, plan
        What the user chose; camera and plan of the window.
    """

    psf: str
    stamp: Stamp
    settings: FitSettings
    window: Camera
    plan: ScanPlan | None

    @property
    def name(self) -> str:
        """Name of the file."""
        return Path(self.psf).name


@dataclass(frozen=True, eq=False)
class FoundFit:
    """What a fit found, with pictures of every pattern that it was given.

    Attributes
    ----------
    question
        What was asked.
    fit, measured
        As of `lfcal.fit`.
    unit
        What the values of H are.
    places
        Positions of all patterns, outliers among them, plane by plane and row by row.
    aside
        Those that were never fitted.
    patterns, valid, model, residual, chi2
        Of each place: what was measured, and which pixels are a measurement; what is predicted, with gain and
        background; measured minus predicted in sigmas ``(nt, ns)``; mean square of the residuals, weighted by the
        light.
    by_plane, by_type
        chi² of each plane, and of the pixels behind each lens type; NaN where nothing was measured.
    """

    question: FitRequest
    fit: Fit
    measured: Measured
    unit: str
    places: tuple[Place, ...]
    aside: frozenset[Place]
    patterns: dict[Place, F4] = field(repr=False)
    valid: dict[Place, NDArray[np.bool_]] = field(repr=False)
    model: dict[Place, F4] = field(repr=False)
    residual: dict[Place, F4] = field(repr=False)
    chi2: dict[Place, float] = field(repr=False)
    by_plane: NDArray[np.float64]
    by_type: NDArray[np.float64]

    def fate(self, place: Place) -> str:
        """Return whether a pattern was fitted, kept aside, or left out as unlike the others."""
        if place not in self.fit.residuals:
            return "left out"
        return "kept aside" if place in self.aside else "fitted"

    def worst(self) -> Place:
        """Return the pattern that is explained worst."""
        return max(self.places, key=lambda place: self.chi2[place])


@dataclass
class FitRun:
    """What a fit at work in a thread has told so far, and at its end what it found.

    The window reads it at any time: rounds are only added.
    """

    rounds: list[FitProgress] = field(default_factory=list)
    found: FoundFit | None = None


def asked_of(project: ProjectState, settings: FitSettings) -> FitRequest:
    """Return what is to be fitted in a project.

    Raises
    ------
    InputError
        Where something is missing that is known without reading H.
    """
    stamp = stamp_of(project)
    if stamp is None:
        raise InputError.expected("fit", "an H file", "none", "open one on the PSF page")
    _ = settings.noise  # raises where it is none
    if not settings.unknowns:
        raise InputError.expected("unknowns", "one group or more", "none", "choose some, or automatic")
    return FitRequest(project.psf, stamp, settings, project.camera, project.plan)


def iter_fit(asked: FitRequest, kept: FitRun) -> Work[None]:
    """Fit the recorded positions of H; what comes out is in ``kept``, as jobs are remembered long after they ended."""
    start = time.perf_counter()
    measured, unit = _read(asked)
    work = iter_fit_camera(measured, unknowns=_unknowns(asked, measured))
    try:
        while True:
            try:
                record: Progress = next(work)
            except StopIteration as end:
                fit: Fit = end.value
                break
            if isinstance(record, FitProgress):
                kept.rounds.append(record)
            yield record
    finally:
        work.close()
    yield Progress(0, 1, "what is left of each pattern", time.perf_counter() - start)
    kept.found = _found(asked, fit, measured, unit)
    yield Progress(1, 1, "what is left of each pattern", time.perf_counter() - start)


def iter_taken(asked: FitRequest, fit: Fit, kept: FitRun) -> Work[None]:
    """Take over a ``fit`` of these patterns that was made elsewhere: they are read and compared with it."""
    start = time.perf_counter()
    yield Progress(0, 1, "patterns of the fit", 0.0)
    places = sorted({*fit.residuals, *((one.z, one.y, one.x) for one in fit.outliers)})
    measured, unit = _read(asked, places)
    if measured.plan.shape != fit.planned.shape:
        got, want = measured.plan.shape, fit.planned.shape
        raise InputError.expected(f"{asked.name}, patterns", f"those of the fit, {want}", got, "press Fit")
    kept.found = _found(asked, fit, measured, unit)
    yield Progress(1, 1, "patterns of the fit", time.perf_counter() - start)


def _unknowns(asked: FitRequest, measured: Measured) -> str | tuple[str, ...]:
    """Return what is found; groups that the page greys out, which were chosen for another camera, are not."""
    chosen = asked.settings.unknowns
    if isinstance(chosen, str):
        return chosen
    without = lacking_of(measured.plan)
    own = tuple(name for name in chosen if name not in without)
    if not own:
        got = f"{chosen[0]}, which needs {without[chosen[0]]}"
        raise InputError.expected("unknowns", "one group or more that the camera has", got, "choose others")
    return own


def _read(asked: FitRequest, places: list[Place] | None = None) -> tuple[Measured, str]:
    """Return the patterns to fit, or those of ``places``; the file is closed again: others may want to replace it."""
    from lfcal.psf import open_psf

    settings = asked.settings
    with open_psf(asked.psf) as opened:
        matrix = _owned(opened.T if opened.is_transposed else opened, asked)
        offer = offer_of(matrix)
        if settings.noise is None and offer.noise is None:
            raise InputError(f"{asked.name}: {offer.noise_words(settings)[0]}")
        camera = matrix.camera if settings.camera == "psf" else asked.window
        if places is None:
            measured = measured_of(matrix, camera, noise=settings.noise, most=settings.positions or None)
        else:
            aside = _kept_aside(matrix, places)
            measured = measured_of(matrix, camera, positions=places, held_out=aside, noise=settings.noise)
        unit = "share of the light" if light_shares(matrix.provenance) else "counts"
        return measured, unit


def _kept_aside(matrix: PSFMatrix, places: list[Place]) -> list[Place]:
    """Return which of the places the session kept from its fits, as H says."""
    said = matrix.provenance.get("kept_aside")
    every = {tuple(at) for at in said if isinstance(at, list)} if isinstance(said, list) else set()
    return [place for place in places if place in every]


def _owned(matrix: PSFMatrix, asked: FitRequest) -> PSFMatrix:
    """Return H with a camera: where it has none, its depths and anchor are of no meaning either, but a plan's are."""
    if matrix.camera is not None:
        return matrix
    plan = asked.plan
    if plan is None or plan.shape != matrix.shape:
        wanted, got = f"its own, or a plan of its shape {matrix.shape}", "none" if plan is None else f"{plan.shape}"
        raise InputError.expected(f"{asked.name}, camera", wanted, got, "make the plan on the Plan page")
    return PSFMatrix(matrix.planes, depths=plan.depths_um, camera=plan.camera, anchor=plan.anchor, facts=matrix.facts)


def _found(asked: FitRequest, fit: Fit, measured: Measured, unit: str) -> FoundFit:
    left = leftover_of(fit, measured)
    model, residual, chi2 = _outliers(fit, measured)
    fitted = [_place(at) for at in left.index]
    model |= dict(zip(fitted, left.model, strict=True))
    residual |= dict(zip(fitted, left.residual, strict=True))
    chi2 |= dict(zip(fitted, left.chi2.tolist(), strict=True))
    patterns = {_place(at): pattern for at, pattern in zip(measured.index, measured.patterns, strict=True)}
    return FoundFit(
        asked,
        fit,
        measured,
        unit,
        tuple(sorted(patterns)),
        frozenset(_place(at) for at in measured.index[measured.held_out]),
        patterns,
        {_place(at): good for at, good in zip(measured.index, measured.valid, strict=True)},
        model,
        residual,
        chi2,
        left.by_plane,
        left.by_type,
    )


def _place(at: NDArray[np.intp]) -> Place:
    z, y, x = (int(v) for v in at)
    return z, y, x


def _outliers(fit: Fit, measured: Measured) -> tuple[dict[Place, F4], dict[Place, F4], dict[Place, float]]:
    """Return what the fit predicts where patterns were left out as unlike the others, and how far off they are."""
    rows = [k for k, at in enumerate(measured.index) if _place(at) not in fit.residuals]
    if not rows:
        return {}, {}, {}
    index = measured.index[rows]
    places = [_place(at) for at in index]
    gains, backgrounds = (values[index[:, 0]][:, None, None] for values in (fit.levels.gains, fit.levels.backgrounds))
    light = predict(fit.setup, measured.plan, index, measured.places_px[rows], Fineness.finest) * gains
    constant, slope = (measured.noise[rows, k][:, None, None] for k in (0, 1))
    bright = slope * np.maximum(light, 0)
    model = (light + backgrounds).astype(np.float32)
    off = (measured.patterns[rows] - model) / np.sqrt(constant + bright)
    residual = np.where(measured.valid[rows], off, 0.0).astype(np.float32)
    weight = np.where(measured.valid[rows], bright / (constant + bright), 0.0)
    total = np.maximum(weight.sum((1, 2)), 1e-300)
    chi2 = (weight * np.square(residual, dtype=np.float64)).sum((1, 2)) / total
    return (
        dict(zip(places, model, strict=True)),
        dict(zip(places, residual, strict=True)),
        dict(zip(places, chi2.tolist(), strict=True)),
    )
