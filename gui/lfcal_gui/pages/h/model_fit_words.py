"""A fit in words and as a map: verdict, rows of the table, what the scan cannot determine. No Qt."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from lfcal.base import format_length, format_share
from lfcal.fit import GROUPS, Fit, Outlier, Parameter
from lfcal_gui.models import typeset
from lfcal_gui.pages.h.model import PositionMap
from lfcal_gui.pages.h.model_fit_run import FoundFit, Place

COLUMNS = ("Parameter", "Found", "± σ", "Stated", "Unit", "Off (σ)", "Group")
NUMBERS = (1, 2, 3, 5)
"""Columns that are sorted by their numbers."""

SPARE = (2, 3, 4, 6)
"""Columns that a narrow table hides."""


MOST = 6
"""Largest number of planes that are listed one by one."""

LEAST_CHI2 = (0.8, 1.5)
"""χ² at the ends of the colours, at least: scatter by noise alone is no pattern."""


@dataclass(frozen=True)
class ParameterRow:
    """One parameter as a row: what is shown, and the numbers that columns are sorted by (NaN where it has none)."""

    texts: tuple[str, ...]
    numbers: tuple[float, ...]
    far: bool


def parameter_rows(fit: Fit) -> tuple[ParameterRow, ...]:
    """Return a row for each parameter, in the fit's order."""
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
    """Return a value with the digits that its standard deviation gives it: two of that."""
    if not (math.isfinite(sigma) and sigma > 0):
        return f"{value:.6g}"
    digits = 1 - math.floor(math.log10(sigma))
    return f"{value:.{min(12, max(0, digits))}f}"


# -- verdict -----------------------------------------------------------------------------------------------
def merit_of(fit: Fit) -> str:
    """Return the colour of the verdict: bad where the model does not suffice, fair where a question is open."""
    if not fit.complete:
        return "bad"
    return "fair" if fit.answers or fit.unidentified else "good"


def verdict_of(fit: Fit) -> str:
    """Return one sentence on how reliable the fit is."""
    error = fit.held_out_error
    off = (
        f"H of this camera is {error} off"
        if error.known
        else f"H of this camera is off by less than {format_share(error.limit)}"
    )
    if fit.complete:
        return f"The model explains the patterns: χ² {fit.chi2:.3f}. {off}."
    more = f"χ² {fit.chi2:.3f}, {fit.chi_square.excess:.0f} σ above 1"
    return f"The model is incomplete: {more}. {off}; more positions do not help."


def detail_of(found: FoundFit) -> str:
    """Return the data behind the verdict: patterns fitted and held out, and unsteadiness of the setup."""
    fit = found.fit
    fates = [found.fate(place) for place in found.places]
    fitted, aside, out = (fates.count(fate) for fate in ("fitted", "kept aside", "left out"))
    by = f"error from {aside} held out" if aside else "none held out: the error is from the fitted ones"
    parts = [f"{fitted} patterns fitted, {by}"]
    if out:
        parts.append(f"{out} left out as unlike the others")
    if fit.spread.stage_px > 0:
        parts.append(f"sources {fit.spread.stage_px:.2g} px (rms) off their positions")
    if fit.spread.lamp > 0:
        parts.append(f"lamp unsteady by {format_share(fit.spread.lamp)}")
    if fit.spread.response > 0:
        parts.append(f"pixels respond unevenly by {format_share(fit.spread.response)}")
    parts += [f"{question}: {answer}" for question, answer in fit.answers.items()]
    return f"{found.question.name}: {'; '.join(parts)}."


# -- findings, also on what the scan does not determine ----------------------------------------------------
@dataclass(frozen=True)
class FitFinding:
    """A line on the fit; ``place`` (z, y, x) is the pattern that it is about, None where it is about none."""

    kind: str
    text: str
    place: Place | None = None


def findings_of(fit: Fit) -> tuple[FitFinding, ...]:
    """Return the findings of a fit: answers, outliers, degeneracies, fixed parameters, and groups that did not help."""
    found = [FitFinding(f"not as described: {question}", answer) for question, answer in fit.answers.items()]
    found += [_outlier(one) for one in fit.outliers]
    found += [FitFinding("not measured", fit.unseen_words)] if fit.unseen else []
    found += [FitFinding("this scan does not distinguish", one) for one in fit.unidentified]
    found += [FitFinding("held", one) for one in fit.held]
    found += [FitFinding("fitted", _title(name)) for name in fit.groups]
    found += [FitFinding("tried, did not help", _title(name)) for name in fit.unhelpful]
    return tuple(found)


def _outlier(one: Outlier) -> FitFinding:
    place = (one.z, one.y, one.x)
    return FitFinding("left out", f"plane {one.z}, y {one.y}, x {one.x}: {one.reason}", place)


def _title(name: str) -> str:
    return typeset(GROUPS.get(name).title) if name in GROUPS else name


def place_words(found: FoundFit, place: Place) -> str:
    """Return a pattern in words: where it is, what became of it, and how well it is explained."""
    z, y, x = place
    depth = found.measured.plan.depths_um[z]
    virtual = found.fit.camera.virtual_depth(depth)
    at = f"z = {format_length(depth)}, v = {virtual:.2f}; y {y}, x {x}"
    return f"{at}: {found.fate(place)}, χ² {found.chi2[place]:.3g}"


def chi2_map(found: FoundFit, z: int) -> PositionMap | None:
    """Return χ² of each pattern of a plane; those left out are crossed out, those kept aside are in a square."""
    places = [place for place in found.places if place[0] == z]
    if not places:
        return None
    values = np.full(found.measured.plan.period, np.nan)
    for _, y, x in places:
        values[y, x] = found.chi2[z, y, x]
    at = {
        fate: np.array([place[1:] for place in places if found.fate(place) == fate], float).reshape(-1, 2)
        for fate in ("left out", "kept aside")
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
        aside=at["kept aside"],
        name="chi2",
        # colours mean the same in all planes
        levels=(min(LEAST_CHI2[0], *kept), max(LEAST_CHI2[1], *kept)) if kept else LEAST_CHI2,
        note=f"{len(places)} patterns",
        lines=lines,
    )


def chi2_words(found: FoundFit) -> str:
    """Return chi² of each plane and lens type in lines."""
    lines = []
    for name, values in (("plane", found.by_plane), ("lens type", found.by_type)):
        parts = [f"{k}: {value:.2f}" for k, value in enumerate(values.tolist()) if not math.isnan(value)]
        more = f" … {len(parts) - MOST} more" if len(parts) > MOST else ""
        lines.append(f"χ² by {name}  {', '.join(parts[:MOST])}{more}")
    return "\n".join(lines)
