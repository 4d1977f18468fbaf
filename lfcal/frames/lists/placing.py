"""Conversion of stage coordinates to positions of a scan plan: the affine map, and its residuals."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import permutations, product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.base import InputError
from lfcal.camera import ScanPlan, StageAxes
from lfcal.frames.lists._depths import LEAST, MOST, with_depths
from lfcal.frames.lists._grid import ScanGrid, find_grid
from lfcal.frames.lists.listing import Listing
from lfcal.frames.lists.motion import (
    CentroidMotion,
    Part,
    StageOrientation,
    find_stage_orientation,
    image_motion,
    spread_out,
)
from lfcal.frames.orientation import AS_IS

__all__ = ["Placing", "anchor_of", "grid_of", "light_of", "place"]

AXES = "xyz"
UNITS = {"um": 1.0, "mm": 1e3, "nm": 1e-3, "m": 1e6}
"""Micrometres of the units that a list without a stated unit may have."""
SCALE_TOLERANCE = 0.01
"""Largest relative difference from the plan's scale that is not reported."""
PLANE_TOLERANCE = 0.1
"""Largest unreported distance of a plane from the planned one, as a fraction of the smallest plane spacing."""
ReadFrame = Callable[[int], NDArray[Any]]
"""Function that returns the frame of a row of the list."""


@dataclass(frozen=True, eq=False)
class Placing:
    """Positions of the frames of a list.

    Attributes
    ----------
    positions
        Position numbers in the plan, ``(N, 3)`` as (z, y, x).
    drift
        ``(N, 2)``: displacement of each image from its position (rows, columns; sensor pixels).
    stage
        The stage axes found.
    rms_px, worst_px, worst
        Rms and largest drift (px), and the row in the list (from 0) of the frame with the largest drift.
    notes
        Notes on what was found, one line each.
    scales
        Subset of ``notes`` that reports differences of steps and plane distances from the plan.
    """

    positions: NDArray[np.intp]
    drift: NDArray[np.float64]
    stage: StageAxes
    rms_px: float
    worst_px: float
    worst: int
    notes: tuple[str, ...]
    scales: tuple[str, ...] = ()


def place(
    listing: Listing, plan: ScanPlan, read: ReadFrame | None = None, orientation: str = "", part: Part | None = None
) -> Placing:
    """Return the position and the drift of each frame from its stage coordinates.

    The unit, offset, scale and small rotations of the coordinates are estimated, as are the assignment and sign of the
    axes. If ``read`` is given and the motion is clear, the axes are determined from the light in some frames. Otherwise
    they come from the numbers of steps, or, if these are equal, from the plan's ``stage``. Then an affine map from
    coordinates to object space (`ScanPlan.object_um`) is fitted to all frames.

    Parameters
    ----------
    listing
        Stage coordinates.
    plan
        Plan of the scan.
    read
        Function that returns the frame in row k of the list, ``(rows, columns)``.
    orientation
        ``"check"`` or ``"auto"``: frames may be flipped or turned, see `lfcal.frames.lists.motion`. Any other value:
        frames are upright as ``read`` returns them.
    part
        Part of the sensor that the frames show. None: the whole sensor.

    Raises
    ------
    InputError
        If the list belongs to another scan, or states no z for several planes. Also if more frames have the same
        position than the plan averages, or a frame is more than half a step away from its position.
    """
    numbered = listing.counted
    if (
        len(listing) > 1
        and plan.shape[1] * plan.shape[2] > 1
        and not np.nan_to_num(np.ptp(listing.places, axis=0)).any()
    ):
        raise InputError.expected(
            f"stage coordinates in {listing.name}",
            "different ones for each frame",
            f"the same ones for all {len(listing)} frames",
            "record them with the stage's position, or state the order of the frames (--order serpentine or raster)",
        )
    if numbered:
        listing = with_depths(listing, plan.depths_um, plan.stage)
    grid, lateral = grid_of(listing, plan.stage, planes=plan.shape[0])
    light = None if read is None else light_of(grid, read)
    if light is not None and part is not None:
        light = light.on_sensor(part, plan.camera.sensor.shape)
    seen = None if light is None or light.axes() is None else light
    turns = [s for s in _turns(grid, plan, lateral) if not numbered or s.away == plan.stage.away]
    reading = None if seen is None else find_stage_orientation(turns, seen, plan, lateral, orientation)
    if seen is not None:
        turns = [s for s in turns if reading and (s.right, s.down) == (reading.stage.right, reading.stage.down)]
    if not turns:
        raise _another_scan(grid, plan, lateral)
    index = grid.index(len(listing))
    tried = []
    for stage in turns:
        positions = _positions(index, grid, plan, stage, lateral)
        tried.append((_misfit(listing, plan, positions), stage, positions))
    best = min(misfit for misfit, _, _ in tried)
    # candidates that fit as well as the best keep their order, which follows the plan
    fitting = [entry for entry in tried if entry[0] <= 1.05 * best + 1e-9]
    _, stage, positions = fitting[0]
    found = _fitted(listing, plan, positions, stage)
    words = _axes_notes(plan, stage, reading, len(fitting) > 1)
    upright = reading is None or reading.turn.name == AS_IS
    notes = [*found.notes, *words, *(_light_notes(plan, light, stage, lateral) if upright else [])]
    return replace(found, notes=tuple(notes))


def grid_of(listing: Listing, stage: StageAxes, *, planes: int = 0) -> tuple[ScanGrid, tuple[int, int]]:
    """Return the grid of the stage coordinates in a list, and the indices in (x, y, z) of the two lateral axes.

    ``stage`` states which axis is the depth. ``planes`` is the number of planes of the scan; 0: unknown.

    Raises
    ------
    InputError
        If z is missing although there are several planes or z is a lateral axis.
    """
    depth = AXES.index(stage.away[1])
    lateral = tuple(k for k in range(3) if k != depth)
    if not listing.has_depth and (planes > 1 or depth != 2):
        raise InputError.expected(
            f"list {listing.name}",
            f"a z column for {planes} planes",
            "none",
            "state which column is z (--columns z_um=COLUMN)",
        )
    places = np.where(np.isfinite(listing.places), listing.places, 0.0)
    grid = find_grid(places[:, lateral], places[:, depth], listing.name, counted=listing.counted)
    return grid, (lateral[0], lateral[1])


def light_of(grid: ScanGrid, read: ReadFrame) -> CentroidMotion | None:
    """Return the motion of the light along the lateral axes; None if it cannot be determined.

    It is measured in some frames of the middle plane of ``grid``. ``read`` returns the frame in row k of the list.
    """
    plane = grid.planes[len(grid.planes) // 2]
    chosen = spread_out(plane.index)
    return image_motion(lambda k: read(int(plane.frames[chosen[k]])), plane.index[chosen])


def _turns(grid: ScanGrid, plan: ScanPlan, lateral: tuple[int, int]) -> list[StageAxes]:
    """Return the stage axes that the grid's numbers of steps allow, those of the plan first."""
    nz, ny, nx = plan.shape[:3]
    counts = dict(zip(lateral, grid.counts, strict=True))
    found = []
    for (right, down), senses in product(permutations(lateral), product("+-", repeat=3)):
        if (counts[right], counts[down]) != (nx, ny):
            continue
        axes = (senses[0] + AXES[right], senses[1] + AXES[down], senses[2] + plan.stage.away[1])
        found.append(StageAxes(*axes, origin_um=plan.stage.origin_um))
    if len(grid.planes) != nz or not found:
        raise _another_scan(grid, plan, lateral)
    own = (plan.stage.right, plan.stage.down, plan.stage.away)
    return sorted(found, key=lambda s: _changes(own, (s.right, s.down, s.away)))


def _another_scan(grid: ScanGrid, plan: ScanPlan, lateral: tuple[int, int]) -> InputError:
    nz, ny, nx = plan.shape[:3]
    first, second = grid.counts
    return InputError.expected(
        "positions in the list",
        f"{nz} planes of {nx} across and {ny} down, as in the plan",
        f"{len(grid.planes)} planes of {first} along {AXES[lateral[0]]} and {second} along {AXES[lateral[1]]}",
        "the list is of another scan; make its plan (lfcal plan CAMERA --positions LIST)",
    )


def _changes(first: Sequence[str], other: Sequence[str]) -> tuple[int, int]:
    """Return the number of axes, and of signs, in which two sets of stage axes differ."""
    return sum(a[1] != b[1] for a, b in zip(first, other, strict=True)), sum(
        a[0] != b[0] for a, b in zip(first, other, strict=True)
    )


def _positions(
    index: NDArray[np.intp], grid: ScanGrid, plan: ScanPlan, stage: StageAxes, lateral: tuple[int, int]
) -> NDArray[np.intp]:
    """Return the scan positions (z, y, x) of the points of a grid, given the stage axes."""
    place_of = {lateral[0]: index[:, 1], lateral[1]: index[:, 2]}
    rising = len(plan.depths_um) < 2 or plan.depths_um[1] > plan.depths_um[0]
    z = index[:, 0] if (stage.away[0] == "+") == rising else len(grid.planes) - 1 - index[:, 0]
    columns = [z]
    for axis, count in ((stage.down, plan.period[0]), (stage.right, plan.period[1])):
        along = place_of[AXES.index(axis[1])]
        columns.append(along if axis[0] == "+" else count - 1 - along)
    return np.stack(columns, axis=1)


def _affine(listing: Listing, plan: ScanPlan, positions: NDArray[np.intp]) -> tuple[NDArray[Any], NDArray[Any]]:
    """Return the affine map ``(4, 3)`` from (1, coordinates) to object space, and its residuals (µm)."""
    places = np.where(np.isfinite(listing.places), listing.places, 0.0)
    centred = places - places.mean(axis=0)
    spread = np.ptp(centred, axis=0)
    used = spread > (1e-3 * np.max(spread) if plan.shape[0] == 1 else 0)
    design = np.column_stack([np.ones(len(places)), centred[:, used]])
    wanted = plan.object_um(positions)
    fitted, *_ = np.linalg.lstsq(design, wanted, rcond=None)
    whole = np.zeros((4, 3))
    whole[np.concatenate([[True], used])] = fitted
    return whole, wanted - design @ fitted


def _misfit(listing: Listing, plan: ScanPlan, positions: NDArray[np.intp]) -> float:
    """Return the rms residual of the affine map, in steps and in distances of planes."""
    _, rest = _affine(listing, plan, positions)
    steps = np.array([plan.step_um(z) for z in range(plan.shape[0])])[positions[:, 0]]
    lateral = float((rest[:, 1] ** 2 / steps[:, 0] ** 2 + rest[:, 0] ** 2 / steps[:, 1] ** 2).mean())
    planes = np.abs(np.diff(plan.depths_um))
    return math.sqrt(lateral + (float((rest[:, 2] / planes.min()).std()) ** 2 if planes.size else 0.0))


def _fitted(listing: Listing, plan: ScanPlan, positions: NDArray[np.intp], stage: StageAxes) -> Placing:
    """Return the placing with its drift; raise `InputError` if it is implausible."""
    affine, rest = _affine(listing, plan, positions)
    steps = np.array([plan.step_um(z) for z in range(plan.shape[0])])[positions[:, 0]]
    # actual minus planned position of the source, in resampled and then in sensor pixels
    drift = -rest[:, [1, 0]] / steps / np.array(plan.resample_factors)
    size = np.hypot(*drift.T)
    worst = int(size.argmax())
    if size[worst] > 0.5:
        raise InputError.expected(
            f"{listing.name}, position of {listing.label(worst)}",
            "at most half a step from a planned position",
            f"{size[worst]:.2f} px (all frames: {np.sqrt((size**2).mean()):.2f} px rms)",
            "correct the list, or make the plan of the scan in the list (lfcal plan CAMERA --positions LIST)",
        )
    _check_once(listing, plan, positions)
    planes = np.abs(np.diff(plan.depths_um))
    if planes.size and np.abs(rest[:, 2]).max() > 0.5 * planes.min():
        far = int(np.abs(rest[:, 2]).argmax())
        raise InputError.expected(
            f"{listing.name}, depth of {listing.label(far)}",
            "at most half the plane spacing from a planned plane",
            f"{rest[far, 2]:.4g} µm",
            "the list is of another scan, or z is the wrong column",
        )
    rms = float(np.sqrt((size**2).mean()))
    note = f"positions: {rms:.3f} px rms from the grid, at most {size[worst]:.3f} px ({listing.label(worst)})"
    unit, scales = _scale_notes(listing, affine, plan)
    scales += _depth_notes(listing, affine, rest, plan)
    return Placing(positions, drift, stage, rms, float(size[worst]), worst, (note, *unit, *scales), tuple(scales))


def _check_once(listing: Listing, plan: ScanPlan, positions: NDArray[np.intp]) -> None:
    """Raise `InputError` if more frames belong to one position than the plan averages."""
    _, number, counts = np.unique(positions, axis=0, return_inverse=True, return_counts=True)
    if counts.max() > plan.frames_averaged:
        first, second = np.flatnonzero(number.ravel() == counts.argmax())[:2]
        z, y, x = positions[first].tolist()
        raise InputError.expected(
            f"{listing.name}, position z={z}, y={y}, x={x}",
            f"{plan.frames_averaged} frame{'s' if plan.frames_averaged > 1 else ''} per position, as in the plan",
            f"{listing.label(int(first))}, {listing.label(int(second))}",
            "correct the list, or the plan's number of frames averaged (lfcal plan --average)",
        )


def _lateral_scale(listing: Listing, affine: NDArray[Any], plan: ScanPlan) -> tuple[float, str]:
    """Return the size of the list's unit along the lateral axes (µm; 0: undetermined), and the nearest unit."""
    lateral = [k for k in range(3) if AXES[k] != plan.stage.away[1]]
    per = [float(np.linalg.norm(affine[1 + k, :2])) for k in lateral if affine[1 + k].any()]
    if not per:
        return 0.0, listing.unit
    scale = math.prod(per) ** (1 / len(per))
    return scale, listing.unit or min(UNITS, key=lambda name: abs(math.log(scale / UNITS[name])))


def _scale_notes(listing: Listing, affine: NDArray[Any], plan: ScanPlan) -> tuple[list[str], list[str]]:
    """Return a note on the assumed unit, and one on the difference of the steps from the plan, as lists."""
    scale, unit = _lateral_scale(listing, affine, plan)
    if not scale:
        return [], []
    ratio = UNITS[unit] / scale
    notes = (
        []
        if listing.unit
        else [f"unit: {unit}, inferred from the plan's steps; state it if it differs (--columns x_{unit}=…)"]
    )
    if not 0.8 < ratio < 1.25 and not listing.unit:
        return [f"unit: 1 in the list is {scale:.4g} µm, inferred from the plan's steps"], []
    if not 0.8 < ratio < 1.25:
        raise InputError.expected(
            f"{listing.name}, steps",
            "those of the plan",
            f"{ratio:.3g} times as much",
            "correct the unit (--columns x_mm=…), or make the plan of the scan in the list (lfcal plan "
            "CAMERA --positions LIST)",
        )
    if abs(ratio - 1) <= SCALE_TOLERANCE:
        return notes, []
    return notes, [f"steps: {ratio:.3f} times the plan's; check pixel pitch, working distance and magnification"]


def _depth_notes(listing: Listing, affine: NDArray[Any], rest: NDArray[np.float64], plan: ScanPlan) -> list[str]:
    """Return notes on how the list's plane distances differ from the plan; raise `InputError` if implausible."""
    if len(plan.depths_um) < 2:
        return []
    axis = AXES.index(plan.stage.away[1])
    scale, unit = _lateral_scale(listing, affine, plan)
    per = abs(float(affine[1 + axis, 2]))
    if not listing.unit and not (scale and 0.8 < UNITS[unit] / scale < 1.25):  # axes with stated units may differ
        return [f"depths: 1 in the list's {AXES[axis]} is {per:.4g} µm, inferred from the plan's depths"]
    ratio, what = UNITS[unit] / per, f"{AXES[axis]} of the planes"
    if not LEAST < ratio < MOST:
        raise InputError.expected(
            f"{listing.name}, {what}",
            "the spacing of the planned planes",
            f"{ratio:.3g} times as much",
            f"correct unit or column (--columns {AXES[axis]}_mm=…), or make the plan of the scan in "
            "the list (lfcal plan CAMERA --positions LIST)",
        )
    notes = []
    if abs(ratio - 1) > SCALE_TOLERANCE:
        notes.append(
            f"depths: the planes are {ratio:.3f} times as far apart in {AXES[axis]} as planned; check unit and "
            "scale, and the plan"
        )
    far = int(np.abs(rest[:, 2]).argmax())
    off = abs(float(rest[far, 2]))
    if off > PLANE_TOLERANCE * np.abs(np.diff(plan.depths_um)).min():
        notes.append(f"depths: {what} differs by up to {off:.4g} µm from the plan ({listing.label(far)})")
    return notes


def _axes_notes(plan: ScanPlan, stage: StageAxes, reading: StageOrientation | None, several: bool) -> list[str]:
    found = f"{stage.right},{stage.down},{stage.away}"
    own = f"{plan.stage.right},{plan.stage.down},{plan.stage.away}"
    if reading is not None and reading.turn.name != AS_IS:
        return [f"axes: {found} of the stage are used; the light moves along other axes in the frames as delivered"]
    if found != own:
        why = "inferred from the motion of the light" if reading is not None else "inferred from the numbers of steps"
        words = f"axes: {found} move the image right and down and the source away, {why}; the plan states {own}"
        other = None if reading is None else reading.other
        if other is None:
            return [words]
        return [f"{words}; if the plan is right, the frames are {other.words} (--orientation {other.option})"]
    if reading is not None:
        return [f"axes: {found} move the image right and down and the source away; the motion of the light agrees"]
    return [f"axes: {found} as in the plan; the list alone does not show their signs"] if several else []


def _light_notes(plan: ScanPlan, light: CentroidMotion | None, stage: StageAxes, lateral: tuple[int, int]) -> list[str]:
    """Return a note if the position of the light differs from the plan."""
    if light is None or light.axes() is None:
        return []
    where = anchor_of(light, stage, lateral, plan.period)
    off = math.hypot(where[0] - plan.anchor[0], where[1] - plan.anchor[1])
    if off < 0.2 * min(plan.cutout):
        return []
    return [
        f"light: at y = x = 0 it is near row {where[0]:.0f}, column {where[1]:.0f}, {off:.0f} px from the plan's "
        "anchor; correct the anchor in the plan (lfcal plan --anchor)"
    ]


def anchor_of(
    light: CentroidMotion, stage: StageAxes, lateral: tuple[int, int], period: tuple[int, int]
) -> tuple[float, float]:
    """Return the row and the column (px) of the centroid of the light at the plan's position y = x = 0.

    ``lateral`` contains the indices of the first and the second lateral axis in (x, y, z). The number of positions (ny,
    nx) is ``period``.
    """
    start = np.array(light.start)
    for axis, count in ((stage.down, period[0]), (stage.right, period[1])):
        if axis[0] == "-":  # the first place along the axis is then the last position
            start = start + light.matrix[:, lateral.index(AXES.index(axis[1]))] * (count - 1)
    return float(start[0]), float(start[1])
