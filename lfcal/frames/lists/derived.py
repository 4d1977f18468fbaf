"""Derivation of the scan plan from a list of stage coordinates."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import permutations
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.base import InputError, any_of, format_pixels
from lfcal.camera import Camera, ScanPlan, StageAxes
from lfcal.frames.lists._depths import ListedPlanes, find_depths, with_depths
from lfcal.frames.lists._grid import PlaneGrid, ScanGrid
from lfcal.frames.lists.listing import Listing
from lfcal.frames.lists.motion import CentroidMotion, Part
from lfcal.frames.lists.placing import AXES, ReadFrame, anchor_of, grid_of, light_of, place
from lfcal.frames.lists.table import LENGTHS
from lfcal.frames.orientation import ORIENTATIONS

__all__ = ["plan_of_list", "rounding", "step_error", "step_size"]


def plan_of_list(
    listing: Listing,
    camera: Camera,
    *,
    read: ReadFrame | None = None,
    stage: StageAxes | None = None,
    depths_um: tuple[float, ...] | None = None,
    part: Part | None = None,
    **settings: Any,
) -> tuple[ScanPlan, tuple[str, ...]]:
    """Return the plan with the positions of a list, and notes on what was found, one line each.

    The period is the number of positions along each lateral axis. With ``read``, the axes and the anchor are determined
    from the light in some frames; otherwise they come from the camera's period and ``stage``. Depths are found from the
    steps in the list. With a main lens, the step that moves the image by one pixel is longer for planes farther away.
    The steps of a microscope are equal in all planes, so its working plane is assumed to be at the stage's zero. See
    `lfcal.frames.lists._depths`.

    Parameters
    ----------
    listing
        Stage coordinates.
    camera
        The camera to calibrate.
    read
        Function that returns the frame in row k of the list, ``(rows, columns)``.
    stage
        Known stage axes. None: the defaults of `StageAxes`. If the light determines the lateral axes, only ``away`` is
        used. If the numbers of positions determine them, only the signs are used.
    depths_um
        Depths of the planes (µm) from the nearest to the farthest, if they are known more accurately.
    part
        Part of the sensor that the frames show. None: the whole sensor.
    settings
        Further arguments of `ScanPlan.for_camera`, such as cutout, anchor and order.

    Raises
    ------
    InputError
        If the list has no stage coordinates, or their steps do not match a period of this camera.
    """
    if listing.unit == "index":
        raise InputError.expected(
            f"list {listing.name}",
            "stage coordinates",
            "position numbers",
            "plan the scan by the depths of its planes instead of this list (--depths or --virtual-depths "
            "instead of --positions)",
        )
    stated = stage or StageAxes()
    grid, lateral = grid_of(listing, stated)
    light = None if read is None else light_of(grid, read)
    if light is not None and part is not None:
        light = light.on_sensor(part, camera.sensor.shape)
    _check_orientation(light, camera)
    unit, unit_notes = _unit_of(listing, grid, camera)
    factor = LENGTHS[unit]
    axes, why = _lateral_axes(grid, camera, stated, lateral, light)
    counts = dict(zip(lateral, grid.counts, strict=True))
    period = counts[AXES.index(axes.down[1])], counts[AXES.index(axes.right[1])]
    _check_period(period, camera)
    found = find_depths(camera, axes, _planes(listing, grid, lateral, factor), depths_um)
    axes, depths = found.axes, found.depths
    ordered = grid.planes if listing.counted or axes.away[0] == "+" else grid.planes[::-1]
    listing = _in_um(listing, factor, depths, axes)
    anchor, seen = _anchor(light, axes, lateral, period)
    given = {key: value for key, value in settings.items() if value is not None}
    plan = ScanPlan.for_camera(camera, depths_um=depths, stage=axes, **({"anchor": anchor} if anchor else {}) | given)
    plan = replace(plan, frames_averaged=_repeats(grid, len(listing)), **_exposures(listing, ordered))
    if plan.period != period:
        plan = _with_period(plan, period, "anchor" in given or anchor is not None)
    placed = place(listing, plan)
    origin = _origin(listing, plan, placed.positions)
    words = f"axes: {axes.right},{axes.down},{axes.away} {why}"
    scales = placed.scales if depths_um is not None else ()  # depths that were found follow the scale of z
    notes = [*listing.notes, *unit_notes, words, *found.notes, *seen, placed.notes[0], *scales]
    return replace(plan, stage=replace(axes, origin_um=origin)), tuple(notes)


def _planes(listing: Listing, grid: ScanGrid, lateral: tuple[int, int], factor: float) -> ListedPlanes:
    """Return the planes of a list in micrometres; ``factor`` is the size of its unit."""
    places = listing.places[:, lateral]
    heights = np.array([plane.height for plane in grid.planes])
    sizes = np.array([step_size(plane.steps) for plane in grid.planes])
    errors = np.array([step_error(places, plane) for plane in grid.planes])
    heights = heights if listing.counted else heights * factor
    return ListedPlanes(listing.name, heights, sizes * factor, errors * factor, listing.counted)


def _in_um(listing: Listing, factor: float, depths: tuple[float, ...], axes: StageAxes) -> Listing:
    """Return the list with all coordinates in micrometres, including those of numbered planes."""
    places = listing.places * factor
    if not listing.counted:
        return replace(listing, places=places, unit="um")
    places[:, 2] = listing.places[:, 2]
    return with_depths(replace(listing, places=places, unit="um"), depths, axes)


def _unit_of(listing: Listing, grid: ScanGrid, camera: Camera) -> tuple[str, list[str]]:
    """Return the unit of a list, with a note if it was inferred.

    Raises
    ------
    InputError
        If the steps differ strongly from a pixel of the camera, in the stated unit or in every unit.
    """
    size = float(np.median([step_size(plane.steps) for plane in grid.planes]))
    nominal = camera.step_um(0.0)
    # units are decades apart: a working distance is known better than to a factor of five
    likely = [unit for unit in ("um", "mm", "nm", "m") if 0.2 < size * LENGTHS[unit] / nominal < 5]
    if listing.unit and (listing.unit in likely or not likely):
        return listing.unit, []  # if no unit fits, the planes are far from the working plane
    if listing.unit or len(likely) != 1:
        remedy = "state the unit in the contents of the columns (--columns x_mm=COLUMN,y_mm=COLUMN,z_mm=COLUMN)"
        if listing.unit:  # the micrometre fits, even if the list states another unit
            remedy = f"lengths that are {LENGTHS[likely[0]]:g} times as large would fit; {remedy}"
        raise InputError.expected(
            f"{listing.name}, steps",
            f"about {nominal:.4g} µm, one pixel of the camera",
            f"{size:.4g} {listing.unit or 'without a unit'}",
            remedy,
        )
    (unit,) = likely
    return unit, [f"unit: {unit}, inferred from the size of the steps"]


def _lateral_axes(
    grid: ScanGrid, camera: Camera, stated: StageAxes, lateral: tuple[int, int], light: CentroidMotion | None
) -> tuple[StageAxes, str]:
    """Return the axes that move the image right and down, and how they were determined."""
    seen = None if light is None else light.axes()
    if seen is not None:
        down, right = (("+" if sense > 0 else "-") + AXES[lateral[axis]] for axis, sense in seen)
        why = "move the image right and down and the source away, inferred from the motion of the light"
        return StageAxes(right, down, stated.away), why
    counts = dict(zip(lateral, grid.counts, strict=True))
    periods = tuple(round(p) for p in camera.period_px)
    fitting = [
        (right, down)
        for right, down in permutations(lateral)
        if counts[down] % max(periods[0], 1) == 0 and counts[right] % max(periods[1], 1) == 0
    ]
    own = (AXES.index(stated.right[1]), AXES.index(stated.down[1]))
    if not fitting or own in fitting:
        return (
            stated,
            "assumed, because neither the list nor the frames show their signs; state the stage axes if they "
            "differ (--stage)",
        )
    first, second = (AXES[axis] for axis in fitting[0])
    axes = StageAxes(stated.right[0] + first, stated.down[0] + second, stated.away)
    return axes, "inferred from the numbers of steps, with assumed signs; state the stage axes if they differ (--stage)"


def _check_orientation(light: CentroidMotion | None, camera: Camera) -> None:
    """Raise `InputError` if frames have the shape of the sensor turned by 90 degrees."""
    rows, columns = camera.sensor.shape
    if light is not None and light.shape == (columns, rows) and rows != columns:
        sides = any_of(turn.option for turn in ORIENTATIONS.values() if turn.transposed)
        raise InputError.expected(
            "shape of the frames",
            f"{format_pixels(camera.sensor.shape)}, as the camera's sensor has",
            f"{format_pixels(light.shape)}, rotated by 90°",
            f"turn them upright (--orientation {sides}), or correct the camera's sensor",
        )


def _check_period(period: tuple[int, int], camera: Camera) -> None:
    """Raise `InputError` unless the positions cover whole periods of the camera."""
    for n, p, what in zip(period, camera.period_px, ("rows", "columns"), strict=True):
        cells = max(1, round(n / p))
        if abs(n - cells * p) > 0.5 * cells + 1e-6:
            raise InputError.expected(
                f"{what} of positions in the list",
                f"{round(cells * p)}, a whole number of the camera's periods",
                n,
                "check that the list covers whole periods of this camera and that the frames are upright "
                "(--orientation)",
            )


def _anchor(
    light: CentroidMotion | None, axes: StageAxes, lateral: tuple[int, int], period: tuple[int, int]
) -> tuple[tuple[float, float] | None, list[str]]:
    if light is None or light.axes() is None:
        return None, [
            "anchor: assumed at the sensor's centre, because no frames show it; state it if it is elsewhere (--anchor)"
        ]
    row, column = anchor_of(light, axes, lateral, period)
    where = (float(round(row)), float(round(column)))
    return where, [f"anchor: row {where[0]:g}, column {where[1]:g}, the centroid of the light at y = x = 0"]


def _with_period(plan: ScanPlan, period: tuple[int, int], anchored: bool) -> ScanPlan:
    """Return the plan for a longer period, still centred if the anchor is unknown."""
    if anchored:
        return replace(plan, period=period)
    shift = [(n - m) // 2 for n, m in zip(period, plan.period, strict=True)]
    return replace(plan, period=period, anchor=(plan.anchor[0] - shift[0], plan.anchor[1] - shift[1]))


def _repeats(grid: ScanGrid, frames: int) -> int:
    return int(np.unique(grid.index(frames), axis=0, return_counts=True)[1].max())


def _exposures(listing: Listing, planes: tuple[PlaneGrid, ...]) -> dict[str, Any]:
    """Return the exposure of each plane of the plan, if the list has exposures."""
    if listing.exposures is None:
        return {}
    times = np.array(listing.exposures)
    per = tuple(float(np.median(times[plane.frames])) for plane in planes)
    return {"exposure_s": per if len(set(per)) > 1 else per[0]}


def _origin(listing: Listing, plan: ScanPlan, positions: NDArray[np.intp]) -> tuple[float, float, float]:
    """Return the stage coordinates of the optical axis in the working plane (µm)."""
    places = np.where(np.isfinite(listing.places), listing.places, 0.0)
    rest = places - plan.object_um(positions) @ plan.stage.matrix().T
    x, y, z = (round(float(v), 4) for v in rest.mean(axis=0))
    return x, y, z


MIN_UNITS_PER_STEP = 8.0
"""Smallest number of rounding units in a step: coarser ones would be the steps themselves."""


def step_size(steps: NDArray[np.float64]) -> float:
    """Return the side of a square with the same area as the cell spanned by the two lateral ``steps`` ``(2, 2)``."""
    return float(np.sqrt(np.abs(np.linalg.det(steps))))


def step_error(lateral: NDArray[np.float64], plane: PlaneGrid) -> float:
    """Return the standard error of a plane's `step_size`, in the unit of the list.

    The frames of a column share the rounding error of its coordinate, and so do those of a row. A column therefore
    counts once, however many frames it has.

    Parameters
    ----------
    lateral
        ``(N, 2)`` coordinates of all frames of the list along the two lateral axes.
    plane
        The plane with its grid.
    """
    points, index = lateral[plane.frames], plane.index.astype(float)
    used = np.ptp(index, axis=0) > 0
    if not used.any():
        return 0.0
    design = np.column_stack([np.ones(len(points)), index[:, used]])
    solve = np.linalg.pinv(design)
    rest = points - design @ (solve @ points)
    size = step_size(plane.steps)
    # derivative of the size by each step; for a single row or column both steps are the same
    gradient = size / used.sum() * np.linalg.inv(plane.steps).T
    total = 0.0
    for axis in (0, 1):
        weights = gradient[used, axis] @ solve[1:]
        numbers, group = np.unique(plane.index[:, axis], return_inverse=True)
        columns = float((np.bincount(group, weights * rest[:, axis]) ** 2).sum())
        columns *= len(numbers) / max(1, len(numbers) - 2)
        frames = float(((weights * rest[:, axis]) ** 2).sum()) * len(points) / max(1, len(points) - 3)
        error = max(columns, frames)  # the errors of few columns may cancel by chance
        if used[axis]:
            straight = points[:, axis] - index[:, 1 - axis] * plane.steps[1 - axis, axis] * used[1 - axis]
            unit = rounding(points[:, axis], size)
            left, scatter = _rounding_error(straight, group, numbers, unit, plane.steps[axis, axis])
            left = (gradient[axis, axis] * left) ** 2
            # the digits of positions without scatter determine everything
            error = left if left and scatter < 0.01 else max(error, left)
        total += error
    return math.sqrt(total)


def rounding(values: NDArray[np.float64], step: float) -> float:
    """Return the unit to which all values are rounded: 1, 2, 2.5 or 5 times a power of ten; 0 if there is none.

    Only units of at most 1/8 of ``step`` are considered, because coarser ones would be the steps themselves. Seven
    decades are searched; finer units leave no relevant uncertainty.
    """
    top = math.floor(math.log10(step / MIN_UNITS_PER_STEP)) if step > 0 else 0
    for exponent in range(top, top - 7, -1):
        for digit in (5, 2.5, 2, 1):
            unit = digit * 10.0**exponent
            if unit <= step / MIN_UNITS_PER_STEP and np.abs(values / unit - np.round(values / unit)).max() < 1e-4:
                return unit
    return 0.0


def _rounding_error(
    values: NDArray[np.float64], group: NDArray[np.intp], numbers: NDArray[np.intp], unit: float, step: float
) -> tuple[float, float]:
    """Return the error of a step that rounding to ``unit`` leaves, and the variance within columns (in ``unit²``).

    The error is 0 if the stage scatters by more than the rounding.

    Steps that are nearly a whole number of digits are rounded identically in many columns. The values then lie on a
    line as if they were exact, and their scatter is uninformative. The remaining uncertainty is the range of slopes of
    lines through the intervals that the digits represent.
    """
    if not unit:
        return 0.0, 0.0
    means = np.bincount(group, values) / np.bincount(group)
    scatter = float(np.mean((values - means[group]) ** 2)) / unit**2
    # frames of a column that scatter by a part of a digit have a mean more accurate than a digit
    unit *= math.exp(-2 * math.pi**2 * scatter)
    first, second = np.triu_indices(len(numbers), 1)
    apart, rise = numbers[second] - numbers[first], means[second] - means[first]
    low, high = float(((rise - unit) / apart).max()), float(((rise + unit) / apart).min())
    if low > high:
        return 0.0, scatter
    # more lines have middle slopes: a triangular instead of a uniform distribution
    return math.sqrt((high - low) ** 2 / 24 + ((low + high) / 2 - step) ** 2), scatter
