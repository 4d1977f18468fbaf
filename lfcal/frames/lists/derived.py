"""The scan plan that a list of stage coordinates was recorded by."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import permutations
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.camera import Camera, ScanPlan, StageAxes
from lfcal.errors import InputError
from lfcal.frames.lists.columns import LENGTHS
from lfcal.frames.lists.grid import ScanGrid
from lfcal.frames.lists.listing import Listing
from lfcal.frames.lists.motion import Motion
from lfcal.frames.lists.placing import AXES, READ, anchor_of, grid_of, light_of, place
from lfcal.frames.orientation import ORIENTATIONS

__all__ = ["plan_of_list"]


def plan_of_list(
    listing: Listing,
    camera: Camera,
    *,
    read: READ | None = None,
    stage: StageAxes | None = None,
    depths_um: tuple[float, ...] | None = None,
    **settings: Any,
) -> tuple[ScanPlan, tuple[str, ...]]:
    """Return the plan whose positions are the places of a list, and what was found for it, a line each.

    The numbers of steps give the period. Which axis moves the image where, and the anchor, come from the light in some
    frames where ``read`` gives them; else from the camera's period and ``stage``. Depths are those whose steps the
    list has: behind a main lens one pixel is a longer step the farther the plane. A microscope's steps are alike in
    all planes: there the stage's zero is taken for the working plane.

    Parameters
    ----------
    listing
        Stage coordinates.
    camera
        The camera under calibration.
    read
        Returns the frame of a row of the list.
    stage
        Axes as they are known; only their senses where the light tells the rest.
    depths_um
        Planes from the nearest to the farthest, where they are known better.
    settings
        What else `ScanPlan.for_camera` takes: cutout, anchor, order …

    Raises
    ------
    InputError
        If the list holds no places of the stage, or their steps are not those of one period of this camera.
    """
    if listing.unit == "index":
        raise InputError.expected(
            f"list {listing.name}",
            "coordinates of the stage",
            "numbers of positions",
            "give the planes with --depths or --virtual-depths instead of --positions",
        )
    said = stage or StageAxes()
    grid, lateral = grid_of(listing, said)
    light = None if read is None else light_of(grid, read)
    _check_lie(light, camera)
    listing, unit_notes = _with_unit(listing, grid, camera)
    factor = LENGTHS[unit_notes[1]] if unit_notes else 1.0
    axes, why = _lateral_axes(grid, camera, said, lateral, light)
    heights = np.array([plane.height for plane in grid.planes]) * factor
    sizes = np.array([_step(plane.steps) for plane in grid.planes]) * factor
    counts = dict(zip(lateral, grid.counts, strict=True))
    period = counts[AXES.index(axes.down[1])], counts[AXES.index(axes.right[1])]
    _check_period(period, camera)
    axes, depths, how = _depths(camera, axes, heights, sizes, depths_um)
    anchor, seen = _anchor(light, axes, lateral, period)
    given = {key: value for key, value in settings.items() if value is not None}
    plan = ScanPlan.for_camera(camera, depths_um=depths, stage=axes, **({"anchor": anchor} if anchor else {}) | given)
    plan = replace(plan, frames_averaged=_repeats(grid, len(listing)), **_exposures(listing, grid, axes, depths))
    if plan.period != period:
        plan = _with_period(plan, period, "anchor" in given or anchor is not None)
    found = place(listing, plan)
    origin = _origin(listing, plan, found.positions)
    how += _uncertainty(plan, found.rms_px, len(listing)) if depths_um is None else ""
    notes = [*listing.notes, *unit_notes[:1], f"axes: {axes.right},{axes.down},{axes.away} {why}", how, *seen]
    return replace(plan, stage=replace(axes, origin_um=origin)), (*notes, found.notes[0])


def _step(steps: NDArray[np.float64]) -> float:
    return float(np.sqrt(np.abs(np.linalg.det(steps))))


def _with_unit(listing: Listing, grid: ScanGrid, camera: Camera) -> tuple[Listing, tuple[str, ...]]:
    """Return the list in micrometres; with a note and the unit where it had to be found."""
    if listing.unit:
        return listing, ()
    size = np.median([_step(plane.steps) for plane in grid.planes])
    nominal = camera.step_um(0.0)
    # decades apart: a working distance is known better than to a factor of five
    likely = [unit for unit in ("um", "mm", "nm", "m") if 0.2 < size * LENGTHS[unit] / nominal < 5]
    if len(likely) != 1:
        raise InputError.expected(
            f"{listing.name}, steps",
            f"about {nominal:.4g} um, one pixel of the camera",
            f"{size:.4g} of no unit",
            "state the unit: --columns x_mm=COLUMN,y_mm=COLUMN,z_mm=COLUMN",
        )
    (unit,) = likely
    scaled = replace(listing, places=listing.places * LENGTHS[unit], unit="um")
    return scaled, (f"unit: {unit}, as the size of the steps tells", unit)


def _lateral_axes(
    grid: ScanGrid, camera: Camera, said: StageAxes, lateral: tuple[int, int], light: Motion | None
) -> tuple[StageAxes, str]:
    """Return the axes that move the image right and down, and how that is known."""
    seen = None if light is None else light.axes()
    if seen is not None:
        down, right = (("+" if sense > 0 else "-") + AXES[lateral[axis]] for axis, sense in seen)
        return StageAxes(right, down, said.away), "move the image right, down and the source away, as the light moves"
    counts = dict(zip(lateral, grid.counts, strict=True))
    periods = tuple(round(p) for p in camera.period_px)
    fitting = [
        (right, down)
        for right, down in permutations(lateral)
        if counts[down] % max(periods[0], 1) == 0 and counts[right] % max(periods[1], 1) == 0
    ]
    own = (AXES.index(said.right[1]), AXES.index(said.down[1]))
    if not fitting or own in fitting:
        return said, "as assumed: neither list nor frames tell their senses; --stage states them"
    first, second = (AXES[axis] for axis in fitting[0])
    axes = StageAxes(said.right[0] + first, said.down[0] + second, said.away)
    return axes, "as the numbers of steps tell; their senses are assumed, --stage states them"


def _depths(
    camera: Camera,
    axes: StageAxes,
    heights: NDArray[np.float64],
    sizes: NDArray[np.float64],
    given: tuple[float, ...] | None,
) -> tuple[StageAxes, tuple[float, ...], str]:
    """Return the depth of each plane of the list, rising, with the sense of the depth axis and how it is known."""
    rising = camera.step_um(1.0) - camera.step_um(0.0)
    sense = axes.away[0]
    if rising > 0 and len(heights) > 1:
        slope = float(np.polyfit(heights, sizes, 1)[0]) / rising
        if not 0.5 < abs(slope) < 2:
            raise InputError.expected(
                "steps of the list's planes",
                "longer in farther planes, one pixel each",
                f"{sizes.min():.5g} … {sizes.max():.5g} um",
                "check camera and columns; scans with one step for all planes are no scan of whole pixels",
            )
        sense = "+" if slope > 0 else "-"
    axes = replace(axes, away=sense + axes.away[1])
    offsets = np.sort(heights if sense == "+" else -heights)
    if given is not None:
        if len(given) != len(heights):
            raise InputError.expected("planes", f"{len(heights)} as the list has", len(given), "correct --depths")
        return axes, tuple(sorted(given)), "depths: as given"
    if rising <= 0:
        return axes, _rounded(offsets), "depths: those of the stage, whose zero is taken for the working plane"
    # one unknown for all planes: where the stage's zero is
    zero = float(np.mean((sizes - camera.step_um(0.0)) / rising) - offsets.mean())
    words = "depths: those whose steps are one pixel; --depths states them where they are known better"
    return axes, _rounded(offsets + zero), words


def _uncertainty(plan: ScanPlan, rms_px: float, frames: int) -> str:
    """Return in words what the stage's scatter leaves open of depths that were found from steps."""
    camera, longest = plan.camera, max(plan.period)
    rising = camera.step_um(1.0) - camera.step_um(0.0)
    if rising <= 0 or longest < 2:
        return ""
    # standard error of the slope of a line through n places of spread longest / sqrt(12)
    relative = rms_px / math.sqrt(frames) / (longest / math.sqrt(12))
    return f" (all by ± {camera.step_um(0.0) / rising * relative:.3g} um for the stage's scatter)"


def _rounded(depths: NDArray[np.float64]) -> tuple[float, ...]:
    return tuple(round(float(z), 3) for z in depths)


def _check_lie(light: Motion | None, camera: Camera) -> None:
    """Raise where frames have the shape of the sensor on its side."""
    rows, columns = camera.sensor.shape
    if light is not None and light.shape == (columns, rows) and rows != columns:
        sides = ", ".join(turn.option for turn in ORIENTATIONS.values() if turn.transposed)
        raise InputError.expected(
            "shape of the frames",
            f"{camera.sensor.shape}, the camera's sensor",
            f"{light.shape}, as if on their side",
            f"say what makes them upright with --orientation, one of {sides}, or correct the sensor",
        )


def _check_period(period: tuple[int, int], camera: Camera) -> None:
    """Raise unless the places are those of whole periods of the camera."""
    for n, p, what in zip(period, camera.period_px, ("rows", "columns"), strict=True):
        cells = max(1, round(n / p))
        if abs(n - cells * p) > 0.5 * cells + 1e-6:
            raise InputError.expected(
                f"{what} of places in the list",
                f"{round(cells * p)}, one period of the camera",
                n,
                "the scan is of another camera, not of a whole period, or its frames are turned (--orientation)",
            )


def _anchor(
    light: Motion | None, axes: StageAxes, lateral: tuple[int, int], period: tuple[int, int]
) -> tuple[tuple[float, float] | None, list[str]]:
    if light is None or light.axes() is None:
        return None, ["anchor: the sensor's centre is assumed, no frames tell; --anchor states it"]
    row, column = anchor_of(light, axes, lateral, period)
    where = (float(round(row)), float(round(column)))
    return where, [f"anchor: row {where[0]:g}, column {where[1]:g}, where the light of y = x = 0 has its centre"]


def _with_period(plan: ScanPlan, period: tuple[int, int], anchored: bool) -> ScanPlan:
    """Return the plan for a longer period, still centred where the anchor is not known."""
    if anchored:
        return replace(plan, period=period)
    shift = [(n - m) // 2 for n, m in zip(period, plan.period, strict=True)]
    return replace(plan, period=period, anchor=(plan.anchor[0] - shift[0], plan.anchor[1] - shift[1]))


def _repeats(grid: ScanGrid, frames: int) -> int:
    return int(np.unique(grid.index(frames), axis=0, return_counts=True)[1].max())


def _exposures(listing: Listing, grid: ScanGrid, axes: StageAxes, depths: tuple[float, ...]) -> dict[str, Any]:
    """Return the exposure of each plane, where the list has them."""
    if listing.exposures is None:
        return {}
    times = np.array(listing.exposures)
    planes = grid.planes if axes.away[0] == "+" else grid.planes[::-1]
    per = tuple(float(np.median(times[plane.frames])) for plane in planes)
    return {"exposure_s": per if len(set(per)) > 1 else per[0]}


def _origin(listing: Listing, plan: ScanPlan, positions: NDArray[np.intp]) -> tuple[float, float, float]:
    """Return the stage coordinates of the optical axis in the working plane (um)."""
    places = np.where(np.isfinite(listing.places), listing.places, 0.0)
    rest = places - plan.object_um(positions) @ plan.stage.matrix().T
    x, y, z = (round(float(v), 4) for v in rest.mean(axis=0))
    return x, y, z
