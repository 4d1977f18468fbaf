"""How far the stage moves in depth, by how the image changes between the first and the last plane."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfcal.acquire.setup.stage_fit import CELL_PX, StageFit
from lfcal.base import InputError
from lfcal.camera import ScanPlan, half_extent_px, rms_radius_px

__all__ = ["DepthFit", "DepthLook", "check_depth", "depth_fit"]

ENOUGH = 0.1
"""Largest error of the depth scale for which the growth of the image is used."""
GROWTH_OFF, SPREAD_OFF, SPREAD_NOTED = 0.05, 1 / 3, 0.06
"""Depth scales that are refused, by the growth and by the spread, and one of the spread that is noted.

The first depends on the working distance of the lens too, the others on how the source fills the aperture.
"""
STANDS = 0.2
"""A depth axis that moves less than this part of what it should is said not to move."""
ALIKE, APART_PX = 0.98, 2.0
"""Correlation of two planes that are one, where the pattern's edge should have moved so far (pixels)."""


class DepthLook(NamedTuple):
    """What was seen in a plane: fit, spread of the light at the places (pixels), cutout of the middle of the cell."""

    fit: StageFit
    spread: NDArray[np.float64]
    frame: NDArray[Any]


@dataclass(frozen=True, slots=True)
class DepthFit:
    """Movement in depth over the plan's, from the first to the last plane.

    Attributes
    ----------
    scale, error
        Ideally 1, with its standard deviation; NaN where nothing shows it.
    by
        ``"growth"`` of the image's movement with depth, ``"spread"`` of the pattern (where the camera is telecentric),
        or why neither shows it.
    """

    scale: float
    error: float
    by: str


def depth_fit(
    plan: ScanPlan, looks: Sequence[DepthLook], slope_error: NDArray[np.float64], optics: str = ""
) -> DepthFit:
    """Return the movement in depth from what was seen in the first and the last plane.

    Parameters
    ----------
    plan
        What was expected.
    looks
        Of the first and of the last plane.
    slope_error
        Error of a fit's slopes (right, down).
    optics
        Of a simulated camera: the quick pattern spreads as no lens does.
    """
    step, last = (plan.camera.step_um(plan.depths_um[z]) for z in (0, -1))
    grows = last / step - 1
    error = float(np.mean(slope_error)) / abs(grows) if grows else math.inf
    if error <= ENOUGH:
        first_seen, last_seen = (math.sqrt(abs(np.linalg.det(np.array(look.fit.matrix)))) for look in looks)
        return DepthFit((last / last_seen / (step / first_seen) - 1) / grows, error, "growth")
    if optics == "pattern":
        return DepthFit(math.nan, math.nan, "the quick pattern of the simulator does not spread as a lens does")
    first, second = looks
    edges = [half_extent_px(plan.camera, plan.depths_um[z]) for z in (0, -1)]
    if abs(edges[1] - edges[0]) > APART_PX and _correlation(first.frame, second.frame) > ALIKE:
        return DepthFit(0.0, 0.0, "spread")
    places = [_depth_of(plan, z, look.spread) for z, look in zip((0, -1), looks, strict=True)]
    if not any(known for _, known in places):
        return DepthFit(math.nan, math.nan, "patterns of few lenslets do not show it")
    away = places[1][0] - places[0][0]
    return DepthFit(away / (plan.depths_um[-1] - plan.depths_um[0]), SPREAD_NOTED / 3, "spread")


def _depth_of(plan: ScanPlan, z: int, spread: NDArray[np.float64]) -> tuple[float, bool]:
    """Return the depth at which the light spreads as seen, on the plan's side of the focus (µm), and whether it shows.

    Near the focus the spread does not show the depth: it is taken to be the plan's.
    """
    camera, planned = plan.camera, plan.depths_um[z]
    if rms_radius_px(camera, planned) < camera.pitch_px:
        return planned, False
    share = np.linspace(0.0, 4.0, 201)
    radii = np.array([rms_radius_px(camera, planned * s) for s in share])
    # from the focus on it grows
    start = int(np.argmin(radii))
    return planned * float(np.interp(float(np.median(spread)), radii[start:], share[start:])), True


def _correlation(a: NDArray[Any], b: NDArray[Any]) -> float:
    rows, columns = (min(a.shape[k], b.shape[k]) for k in range(2))
    with np.errstate(invalid="ignore", divide="ignore"):  # a cutout without any light has no correlation
        return float(np.corrcoef(a[:rows, :columns].ravel(), b[:rows, :columns].ravel())[0, 1])


def check_depth(fit: DepthFit, plan: ScanPlan) -> tuple[str, ...]:
    """Raise `InputError` if the movement in depth is not the plan's; return what is worth knowing of it."""
    if math.isnan(fit.scale):
        return (f"depth axis not checked: {fit.by}",)
    off, axis = abs(fit.scale - 1), plan.stage.away[1]
    way = abs(plan.depths_um[-1] - plan.depths_um[0])
    by = "how the image's movement" if fit.by == "growth" else "how the pattern"
    what = f"depth axis {axis} of the stage"
    if off > (GROWTH_OFF if fit.by == "growth" else SPREAD_OFF) + 3 * fit.error:
        got = f"{fit.scale:.3f} times that by {by} grows"
        remedy = f"correct the scale of axis {axis}, or the camera's working distance, or record with --no-check-stage"
        if abs(fit.scale) < STANDS + 3 * fit.error:
            got, remedy = "the image of one plane in both", f"axis {axis} does not move: check its drive"
        elif fit.scale < 0:
            remedy = "it runs the wrong way: set the other sense in the plan"
        raise InputError.expected(what, f"a move of {way:g} µm from the first to the last plane", got, remedy)
    edges = [half_extent_px(plan.camera, plan.depths_um[z]) for z in (0, -1)]
    moved = max(abs(edges[1] - edges[0]), 1e-9)
    notes = () if fit.by == "growth" else (f"sense of the {what} not checked: the camera is telecentric",)
    if off <= (max(CELL_PX / moved, 3 * fit.error) if fit.by == "growth" else SPREAD_NOTED):
        return notes
    how = f"{fit.scale:.3f} ± {fit.error:.3f} times as far as planned by {by} grows"
    return (*notes, f"{what} moves {how}: check its scale")
