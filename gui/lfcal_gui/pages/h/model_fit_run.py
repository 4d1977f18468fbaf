"""A fit in the window: its request, progress and results, as text and as a map. No Qt."""

from __future__ import annotations

import math
import re
import tempfile
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.base import InputError, Progress, Work, format_length, format_share
from lfcal.fit import (
    GROUPS,
    Fineness,
    Fit,
    FitProgress,
    Measured,
    Outlier,
    Parameter,
    iter_write_fit,
    iter_write_model,
    kept_aside,
    leftover_of,
    measured_of,
    predict,
)
from lfcal.psf import light_shares, open_psf
from lfcal.tasks import FitMatrix, FittedPatterns
from lfcal_gui.models import ProjectState, typeset
from lfcal_gui.pages.h.model import PositionMap
from lfcal_gui.pages.h.model_fit import FitSettings, Offer, Stamp, offer_of, stamp_of, task_files, task_of

F4 = NDArray[np.float32]
Place = tuple[int, int, int]
"""A position (z, y, x)."""


@dataclass(frozen=True, eq=False)
class FitRequest:
    """Request for a fit: H, settings, camera and plan.

    Attributes
    ----------
    project, stamp
        The project, and the stamp of its H at the time of the request.
    settings
        Settings of the fit.
    offer
        Data that H offers; None until it is read.
    """

    project: ProjectState
    stamp: Stamp
    settings: FitSettings
    offer: Offer | None = None

    @property
    def name(self) -> str:
        """Name of the file."""
        return Path(self.project.psf).name

    def task_in(self, folder: Path) -> FitMatrix:
        """Write the input files of the fit into a folder and return the task, which also writes there."""
        folder.mkdir(parents=True, exist_ok=True)
        for name, text in task_files(self.settings, self.project, self.offer):
            (folder / name).write_text(text, encoding="utf-8")
        return task_of(self.settings, self.project, self.offer, folder, folder)

    def check(self) -> None:
        """Raise `InputError`, in the terms of the page, if H lacks something that a fit needs."""
        assert self.offer is not None
        project = self.project
        for words, role in (
            self.offer.camera_words(self.settings, project.camera, project.plan),
            self.offer.noise_words(self.settings),
        ):
            if role == "error":
                raise InputError(f"{self.name}: {words}")


@dataclass(frozen=True, eq=False)
class FoundFit:
    """Result of a fit, with images of every pattern that it used.

    Attributes
    ----------
    question
        The request.
    fit, measured
        As in `lfcal.fit`.
    known
        Provenance of H, and numbers on the fit.
    unit
        Unit of the values of H.
    places
        Positions of all patterns, including outliers, plane by plane and row by row.
    aside
        Held-out positions, which were never fitted.
    patterns, valid
        For each position: the measured pattern ``(nt, ns)``, and its pixels with a measurement.
    model, residual
        For each position: the prediction with gain and background, and measured minus predicted in sigmas
        ``(nt, ns)``.
    chi2
        For each position: the mean square of the residuals, weighted by the light.
    by_plane, by_type
        chi² of each plane, and of the pixels behind each lens type; NaN where nothing was measured.
    """

    question: FitRequest
    fit: Fit
    measured: Measured
    known: Mapping[str, Any]
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

    @property
    def is_taken(self) -> bool:
        """Whether the fit was made elsewhere, such as during a recording, instead of on this page."""
        return self.question.offer is None

    def iter_saved(self, folder: Path) -> Work[list[Path]]:
        """Write all files of the fit into a folder, as the task does."""
        if self.is_taken:
            files, _ = yield from iter_write_fit(self.fit, self.measured, folder, self.known)
            return files
        made = FittedPatterns(self.measured, self.known, self.fit)
        outcome = yield from self.question.task_in(folder).iter_write(made)
        return list(outcome.files)

    def iter_model(self, path: Path) -> Work[Path]:
        """Write H of the fitted camera, with the task of the fit in its provenance."""
        stated = {} if self.is_taken else self.question.task_in(path.parent).provenance
        return (yield from iter_write_model(self.fit, path, provenance={**self.known, **stated}))

    def fate(self, place: Place) -> str:
        """Return whether a pattern was fitted, held out, or left out as an outlier."""
        if place not in self.fit.residuals:
            return "left out"
        return "held out" if place in self.aside else "fitted"

    def worst(self) -> Place:
        """Return the position of the pattern with the largest χ²."""
        return max(self.places, key=lambda place: self.chi2[place])


@dataclass
class FitRun:
    """Progress of a fit that runs in a thread, and its result when it has ended.

    The window may read it at any time, because rounds are only appended.
    """

    rounds: list[FitProgress] = field(default_factory=list)
    found: FoundFit | None = None


def asked_of(project: ProjectState, settings: FitSettings) -> FitRequest:
    """Return the request for the fit of a project's H.

    Raises
    ------
    InputError
        If something is missing that is known without reading H.
    """
    stamp = stamp_of(project)
    if stamp is None:
        raise InputError.expected("fit", "an H file", "none", "open one")
    task_of(settings, project, None)
    return FitRequest(project, stamp, settings)


def iter_fit(asked: FitRequest, kept: FitRun) -> Work[None]:
    """Fit the recorded positions of H as the task does; the result is stored in ``kept``."""
    start = time.perf_counter()
    # H is closed again: others may want to replace it
    with open_psf(asked.project.psf) as matrix:
        asked, unit = replace(asked, offer=offer_of(matrix)), _unit(matrix.provenance)
    asked.check()
    with tempfile.TemporaryDirectory(prefix="lfcal-fit-") as scratch:
        work = asked.task_in(Path(scratch)).iter_fit()
        try:
            while True:
                try:
                    record: Progress = next(work)
                except StopIteration as end:
                    made: FittedPatterns = end.value
                    break
                if isinstance(record, FitProgress):
                    kept.rounds.append(record)
                yield record
        finally:
            work.close()
    yield Progress(0, 1, "residual of each pattern", time.perf_counter() - start)
    kept.found = _found(asked, made, unit)
    yield Progress(1, 1, "residual of each pattern", time.perf_counter() - start)


def iter_taken(asked: FitRequest, fit: Fit, kept: FitRun) -> Work[None]:
    """Take over a ``fit`` of these patterns that was made elsewhere: read the patterns and compare them with it."""
    start = time.perf_counter()
    yield Progress(0, 1, "patterns of the fit", 0.0)
    places = sorted({*fit.residuals, *((one.z, one.y, one.x) for one in fit.outliers)})
    with open_psf(asked.project.psf) as opened:
        matrix = opened.T if opened.is_transposed else opened
        aside = [at for at in kept_aside(matrix) if tuple(at) in places]
        measured = measured_of(matrix, positions=places, held_out=aside)
        unit = _unit(matrix.provenance)
    if measured.plan.shape != fit.planned.shape:
        got, want = measured.plan.shape, fit.planned.shape
        raise InputError.expected(
            f"{asked.name}, shape of the patterns", f"the fitted shape {want}", got, "press Fit to fit this H"
        )
    kept.found = _found(asked, FittedPatterns(measured, {"source": asked.name}, fit), unit)
    yield Progress(1, 1, "patterns of the fit", time.perf_counter() - start)


def _unit(provenance: Mapping[str, Any]) -> str:
    return "fraction of the light" if light_shares(provenance) else "counts"


def _found(asked: FitRequest, made: FittedPatterns, unit: str) -> FoundFit:
    measured, known, fit = made
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
        known,
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
    """Return, for patterns left out as outliers, the predictions, the residuals in sigmas, and χ²."""
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


COLUMNS = ("Parameter", "Found", "± σ", "Stated", "Unit", "Offset (σ)", "Group")
NUMBERS = (1, 2, 3, 5)
"""Columns that are sorted by their numbers."""

SPARE = (2, 3, 4, 6)
"""Columns hidden in a narrow table."""


MOST = 6
"""Largest number of planes that are listed one by one."""

LEAST_CHI2 = (0.8, 1.5)
"""Smallest range of χ² of the colour scale, so that pure noise does not look like a pattern."""


@dataclass(frozen=True)
class ParameterRow:
    """One parameter as a table row: displayed texts, and the sort keys of its columns (NaN if none).

    ``far`` states whether the found value is 3 σ or more from the stated one.
    """

    texts: tuple[str, ...]
    numbers: tuple[float, ...]
    far: bool


def parameter_rows(fit: Fit) -> tuple[ParameterRow, ...]:
    """Return a table row for each parameter, in the order of the fit."""
    return tuple(_row(one) for one in fit.parameters.values())


def _row(one: Parameter) -> ParameterRow:
    away = (one.value - one.start) / one.sigma if one.sigma > 0 else math.nan
    title = GROUPS.get(one.group).title if one.group in GROUPS else one.group
    value, sigma, start = (_rounded(number, one.sigma) for number in (one.value, one.sigma, one.start))
    far = "–" if math.isnan(away) else f"{away:+.1f}" if abs(away) < 1000 else f"{away:+.3g}"
    texts = (_plain(one.name), value, sigma, start, one.unit or "–", far, title)
    nan = math.nan
    return ParameterRow(texts, (nan, one.value, one.sigma, one.start, nan, away, nan), abs(away) >= 3)


def _plain(name: str) -> str:
    """Return the name of a parameter without its unit, which is shown with the value."""
    return re.sub("_(um|rad|px|nm|e)$", "", name).replace("f_number", "f-number").replace("_", " ")


def _rounded(value: float, sigma: float) -> str:
    """Return a value rounded to two significant digits of its standard deviation."""
    if not (math.isfinite(sigma) and sigma > 0):
        return f"{value:.6g}"
    digits = 1 - math.floor(math.log10(sigma))
    return f"{value:.{min(12, max(0, digits))}f}"


# -- verdict -----------------------------------------------------------------------------------------------
def merit_of(fit: Fit) -> str:
    """Return the merit of the verdict: bad if the model is incomplete, fair if a question is open."""
    if not fit.complete:
        return "bad"
    return "fair" if fit.answers or fit.unidentified else "good"


def verdict_of(fit: Fit) -> str:
    """Return a short text on how reliable the fit is."""
    error = fit.held_out_error
    off = (
        f"H of this camera has an error of {error}"
        if error.known
        else f"H of this camera has an error below {format_share(error.limit)}"
    )
    if fit.complete:
        return f"The model explains the patterns: χ² {fit.chi2:.3f}. {off}."
    more = f"χ² {fit.chi2:.3f}, {fit.chi_square.excess:.0f} σ above 1"
    return f"The model is incomplete: {more}. {off}; more positions do not help."


def detail_of(found: FoundFit) -> str:
    """Return the data behind the verdict as text: patterns fitted and held out, and stability of the setup."""
    fit = found.fit
    fates = [found.fate(place) for place in found.places]
    fitted, aside, out = (fates.count(fate) for fate in ("fitted", "held out", "left out"))
    by = f"error from {aside} held out" if aside else "none held out: the error is that of the fitted patterns"
    parts = [f"{fitted} patterns fitted, {by}"]
    if out:
        parts.append(f"{out} left out as outliers")
    if fit.spread.stage_px > 0:
        parts.append(f"source position error {fit.spread.stage_px:.2g} px (rms)")
    if fit.spread.lamp > 0:
        parts.append(f"lamp varies by {format_share(fit.spread.lamp)}")
    if fit.spread.response > 0:
        parts.append(f"pixel response varies by {format_share(fit.spread.response)}")
    parts += [f"{question}: {answer}" for question, answer in fit.answers.items()]
    return f"{found.question.name}: {'; '.join(parts)}."


# -- findings, also on what the scan does not determine ----------------------------------------------------
@dataclass(frozen=True)
class FitFinding:
    """A finding of a fit; ``place`` is the position (z, y, x) of its pattern, None if it has none."""

    kind: str
    text: str
    place: Place | None = None


def findings_of(fit: Fit) -> tuple[FitFinding, ...]:
    """Return the findings of a fit: answers, outliers, degeneracies, fixed parameters, and groups of unknowns."""
    found = [FitFinding(f"not as described: {question}", answer) for question, answer in fit.answers.items()]
    found += [_outlier(one) for one in fit.outliers]
    found += [FitFinding("not measured", fit.unseen_words)] if fit.unseen else []
    found += [FitFinding("not separated by this scan", one) for one in fit.unidentified]
    found += [FitFinding("fixed", one) for one in fit.held]
    found += [FitFinding("fitted", _title(name)) for name in fit.groups]
    found += [FitFinding("tried, did not help", _title(name)) for name in fit.unhelpful]
    return tuple(found)


def _outlier(one: Outlier) -> FitFinding:
    place = (one.z, one.y, one.x)
    return FitFinding("left out", f"plane {one.z}, y {one.y}, x {one.x}: {one.reason}", place)


def _title(name: str) -> str:
    return typeset(GROUPS.get(name).title) if name in GROUPS else name


def place_words(found: FoundFit, place: Place) -> tuple[str, str]:
    """Return position, fate and χ² of a pattern as text; then fate and χ² alone."""
    z, y, x = place
    depth = found.measured.plan.depths_um[z]
    camera = found.fit.camera
    virtual = f", v = {camera.virtual_depth(depth):.2f}" if camera.has_lattice else ""
    at = f"z = {format_length(depth)}{virtual}; y {y}, x {x}"
    brief = f"{found.fate(place)}, χ² {found.chi2[place]:.3g}"
    return f"{at}: {brief}", brief


def chi2_map(found: FoundFit, z: int) -> PositionMap | None:
    """Return the map of χ² in a plane; outliers are crossed out, held-out patterns are in a square."""
    places = [place for place in found.places if place[0] == z]
    if not places:
        return None
    values = np.full(found.measured.plan.period, np.nan)
    for _, y, x in places:
        values[y, x] = found.chi2[z, y, x]
    at = {
        fate: np.array([place[1:] for place in places if found.fate(place) == fate], float).reshape(-1, 2)
        for fate in ("left out", "held out")
    }
    kept = [value for place, value in found.chi2.items() if found.fate(place) != "left out"]

    def lines(between: str) -> Iterator[str]:
        yield between.join(("z", "y", "x", "chi2", "fate")) + "\n"
        for place in places:
            yield between.join((*map(str, place), f"{found.chi2[place]:.7g}", found.fate(place))) + "\n"

    return PositionMap(
        "χ² of fitted patterns",
        values,
        missing=at["left out"],
        aside=at["held out"],
        name="chi2",
        # colours mean the same in all planes
        levels=(min(LEAST_CHI2[0], *kept), max(LEAST_CHI2[1], *kept)) if kept else LEAST_CHI2,
        note=f"{len(places)} patterns",
        lines=lines,
    )


def chi2_words(found: FoundFit) -> str:
    """Return χ² of each plane and of each lens type as lines of text."""
    lines = []
    for name, values in (("plane", found.by_plane), ("lens type", found.by_type)):
        parts = [f"{k}: {value:.2f}" for k, value in enumerate(values.tolist()) if not math.isnan(value)]
        more = f" … {len(parts) - MOST} more" if len(parts) > MOST else ""
        lines.append(f"χ² by {name}  {', '.join(parts[:MOST])}{more}")
    return "\n".join(lines)
