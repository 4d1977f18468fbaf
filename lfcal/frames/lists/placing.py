"""Stage coordinates to positions of a scan plan: the affine between them, and what it leaves."""

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
"""Micrometres of the units that a list without one may be in."""
SCALE_TOLERANCE = 0.01
"""Largest relative difference from the plan's scale that is not reported."""
PLANE_TOLERANCE = 0.1
"""Largest distance of a plane from the plan's that is not reported, as a share of the smallest distance of planes."""
ReadFrame = Callable[[int], NDArray[Any]]
"""Returns the frame of a row of the list."""


@dataclass(frozen=True, eq=False)
class Placing:
    """Where the frames of a list belong.

    Attributes
    ----------
    positions
        ``(N, 3)`` as (z, y, x) of the plan.
    drift
        ``(N, 2)``: how far the image of each lies from its position (rows, columns; sensor pixels).
    stage
        The axes that were found.
    rms_px, worst_px, worst
        Size of the drift, root of the mean square and largest, and the frame that has it.
    notes
        What was found, a line each.
    scales
        Those of them that say by how much steps and distances of planes differ from the plan's.
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
    """Return position and drift of each frame by its stage coordinates.

    Unit, offset, scale and small rotations of the coordinates are found, and which axis is which and its sense: from
    the light in some frames where ``read`` gives them and it is clear, else from the numbers of steps, else as the
    plan's ``stage`` says. An affine from coordinates to object space (`ScanPlan.object_um`) is then fitted
    to all frames.

    Parameters
    ----------
    listing
        Stage coordinates.
    plan
        The scan's.
    read
        Returns the frame of a row of the list.
    orientation
        ``"check"`` or ``"auto"``: frames may be flipped or turned, and axes that only such frames have are not taken
        for the stage's (`lfcal.frames.lists.motion`); else they are upright as ``read`` returns them.
    part
        Where frames that are a part of the sensor lie on it; None: they are whole.

    Raises
    ------
    InputError
        If the list is of another scan than the plan, two frames belong to one position, or one lies half a step off.
    """
    numbered = listing.counted
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
    # those that fit as well as the best are told apart by what the plan says; they stand in that order
    fitting = [entry for entry in tried if entry[0] <= 1.05 * best + 1e-9]
    _, stage, positions = fitting[0]
    found = _fitted(listing, plan, positions, stage)
    words = _axes_notes(plan, stage, reading, len(fitting) > 1)
    upright = reading is None or reading.turn.name == AS_IS
    notes = [*found.notes, *words, *(_light_notes(plan, light, stage, lateral) if upright else [])]
    return replace(found, notes=tuple(notes))


def grid_of(listing: Listing, stage: StageAxes, *, planes: int = 0) -> tuple[ScanGrid, tuple[int, int]]:
    """Return the grid of a list, and which of (x, y, z) are the first and second lateral axis."""
    depth = AXES.index(stage.away[1])
    lateral = tuple(k for k in range(3) if k != depth)
    if not listing.has_depth and (planes > 1 or depth != 2):
        raise InputError.expected(
            f"list {listing.name}", f"a column of z for {planes} planes", "none", "name it: --columns z_um=COLUMN"
        )
    places = np.where(np.isfinite(listing.places), listing.places, 0.0)
    grid = find_grid(places[:, lateral], places[:, depth], listing.name, counted=listing.counted)
    return grid, (lateral[0], lateral[1])


def light_of(grid: ScanGrid, read: ReadFrame) -> CentroidMotion | None:
    """Return how the light of the middle plane moves along the lateral axes."""
    plane = grid.planes[len(grid.planes) // 2]
    chosen = spread_out(plane.index)
    return image_motion(lambda k: read(int(plane.frames[chosen[k]])), plane.index[chosen])


def _turns(grid: ScanGrid, plan: ScanPlan, lateral: tuple[int, int]) -> list[StageAxes]:
    """Return the stage axes that the grid's numbers of steps allow, the plan's own first."""
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
        "places of the list",
        f"{nz} planes of {nx} across and {ny} down, as the plan has",
        f"{len(grid.planes)} planes of {first} along {AXES[lateral[0]]} and {second} along {AXES[lateral[1]]}",
        "the list is of another scan: make its plan with lfcal plan CAMERA --positions LIST",
    )


def _changes(first: Sequence[str], other: Sequence[str]) -> tuple[int, int]:
    """Return in how many axes, and in how many senses, two statements differ."""
    return sum(a[1] != b[1] for a, b in zip(first, other, strict=True)), sum(
        a[0] != b[0] for a, b in zip(first, other, strict=True)
    )


def _positions(
    index: NDArray[np.intp], grid: ScanGrid, plan: ScanPlan, stage: StageAxes, lateral: tuple[int, int]
) -> NDArray[np.intp]:
    """Return the positions (z, y, x) that places of the grid are with these stage axes."""
    place_of = {lateral[0]: index[:, 1], lateral[1]: index[:, 2]}
    rising = len(plan.depths_um) < 2 or plan.depths_um[1] > plan.depths_um[0]
    z = index[:, 0] if (stage.away[0] == "+") == rising else len(grid.planes) - 1 - index[:, 0]
    columns = [z]
    for axis, count in ((stage.down, plan.period[0]), (stage.right, plan.period[1])):
        along = place_of[AXES.index(axis[1])]
        columns.append(along if axis[0] == "+" else count - 1 - along)
    return np.stack(columns, axis=1)


def _affine(listing: Listing, plan: ScanPlan, positions: NDArray[np.intp]) -> tuple[NDArray[Any], NDArray[Any]]:
    """Return the affine ``(k, 3)`` from (1, coordinates) to object space, and object space less what it gives (um)."""
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
    """Return the root mean square of what the affine leaves, in steps and in distances of planes."""
    _, rest = _affine(listing, plan, positions)
    steps = np.array([plan.step_um(z) for z in range(plan.shape[0])])[positions[:, 0]]
    lateral = float((rest[:, 1] ** 2 / steps[:, 0] ** 2 + rest[:, 0] ** 2 / steps[:, 1] ** 2).mean())
    planes = np.abs(np.diff(plan.depths_um))
    return math.sqrt(lateral + (float((rest[:, 2] / planes.min()).std()) ** 2 if planes.size else 0.0))


def _fitted(listing: Listing, plan: ScanPlan, positions: NDArray[np.intp], stage: StageAxes) -> Placing:
    """Return the placing with its drift, or raise where it cannot be meant."""
    affine, rest = _affine(listing, plan, positions)
    steps = np.array([plan.step_um(z) for z in range(plan.shape[0])])[positions[:, 0]]
    # where the source truly was, less where the plan wants it, in resampled and then in sensor pixels
    drift = -rest[:, [1, 0]] / steps / np.array(plan.resample_factors)
    size = np.hypot(*drift.T)
    worst = int(size.argmax())
    if size[worst] > 0.5:
        raise InputError.expected(
            f"{listing.name}, place of {listing.label(worst)}",
            "within half a step of a position of the plan",
            f"{size[worst]:.2f} px off (all: {np.sqrt((size**2).mean()):.2f} px rms)",
            "correct the list, or make the plan of this scan with lfcal plan CAMERA --positions LIST",
        )
    _check_once(listing, plan, positions)
    planes = np.abs(np.diff(plan.depths_um))
    if planes.size and np.abs(rest[:, 2]).max() > 0.5 * planes.min():
        far = int(np.abs(rest[:, 2]).argmax())
        raise InputError.expected(
            f"{listing.name}, depth of {listing.label(far)}",
            "within half the distance of planes",
            f"{rest[far, 2]:.4g} um off",
            "the list is of another scan, or z is another column",
        )
    rms = float(np.sqrt((size**2).mean()))
    note = f"places: {rms:.3f} px rms off the grid, {listing.label(worst)} most with {size[worst]:.3f} px"
    unit, scales = _scale_notes(listing, affine, plan)
    scales += _depth_notes(listing, affine, rest, plan)
    return Placing(positions, drift, stage, rms, float(size[worst]), worst, (note, *unit, *scales), tuple(scales))


def _check_once(listing: Listing, plan: ScanPlan, positions: NDArray[np.intp]) -> None:
    """Raise where more frames belong to one position than the plan averages."""
    _, number, counts = np.unique(positions, axis=0, return_inverse=True, return_counts=True)
    if counts.max() > plan.frames_averaged:
        first, second = np.flatnonzero(number.ravel() == counts.argmax())[:2]
        z, y, x = positions[first].tolist()
        raise InputError.expected(
            f"{listing.name}, position z={z}, y={y}, x={x}",
            f"{plan.frames_averaged} frame{'s' if plan.frames_averaged > 1 else ''} as the plan averages",
            f"{listing.label(int(first))}, {listing.label(int(second))}",
            "correct the list, or the plan's number of frames averaged (lfcal plan --average)",
        )


def _lateral_scale(listing: Listing, affine: NDArray[Any], plan: ScanPlan) -> tuple[float, str]:
    """Return the micrometres along the plan's object space of one along x and y, 0 if none, and the unit nearest it."""
    lateral = [k for k in range(3) if AXES[k] != plan.stage.away[1]]
    per = [float(np.linalg.norm(affine[1 + k, :2])) for k in lateral if affine[1 + k].any()]
    if not per:
        return 0.0, listing.unit
    scale = math.prod(per) ** (1 / len(per))
    return scale, listing.unit or min(UNITS, key=lambda name: abs(math.log(scale / UNITS[name])))


def _scale_notes(listing: Listing, affine: NDArray[Any], plan: ScanPlan) -> tuple[list[str], list[str]]:
    """Return what the unit was taken for, and by how much the steps differ from the plan's."""
    scale, unit = _lateral_scale(listing, affine, plan)
    if not scale:
        return [], []
    ratio = UNITS[unit] / scale
    notes = [] if listing.unit else [f"unit: {unit}, as the plan's steps tell; --columns x_{unit}=… says it"]
    if not 0.8 < ratio < 1.25 and not listing.unit:
        return [f"unit: 1 of the list is {scale:.4g} um, as the plan's steps tell"], []
    if not 0.8 < ratio < 1.25:
        raise InputError.expected(
            f"{listing.name}, steps",
            "those of the plan",
            f"{ratio:.3g} times them",
            "correct the unit (--columns x_mm=…), or make the plan of this scan: lfcal plan CAMERA --positions LIST",
        )
    if abs(ratio - 1) <= SCALE_TOLERANCE:
        return notes, []
    return notes, [f"steps: {ratio:.3f} times the plan's; check pixel pitch, working distance and magnification"]


def _depth_notes(listing: Listing, affine: NDArray[Any], rest: NDArray[np.float64], plan: ScanPlan) -> list[str]:
    """Return by how much the list's distances of planes differ from the plan's, or raise where they cannot be meant."""
    if len(plan.depths_um) < 2:
        return []
    axis = AXES.index(plan.stage.away[1])
    scale, unit = _lateral_scale(listing, affine, plan)
    per = abs(float(affine[1 + axis, 2]))
    if not listing.unit and not (scale and 0.8 < UNITS[unit] / scale < 1.25):  # axes of units of their own may differ
        return [f"depths: 1 of the list's {AXES[axis]} is {per:.4g} um, as the plan's depths tell"]
    ratio, what = UNITS[unit] / per, f"{AXES[axis]} of the planes"
    if not LEAST < ratio < MOST:
        raise InputError.expected(
            f"{listing.name}, {what}",
            "the distances of the plan's",
            f"{ratio:.3g} times them",
            f"correct unit or column (--columns {AXES[axis]}_mm=…), or make the plan of this scan: "
            "lfcal plan CAMERA --positions LIST",
        )
    notes = []
    if abs(ratio - 1) > SCALE_TOLERANCE:
        notes.append(
            f"depths: {what} lie {ratio:.3f} times as far apart as the plan's; check unit and scale, and the plan"
        )
    far = int(np.abs(rest[:, 2]).argmax())
    off = abs(float(rest[far, 2]))
    if off > PLANE_TOLERANCE * np.abs(np.diff(plan.depths_um)).min():
        notes.append(f"depths: {what} are up to {off:.4g} um off the plan's, {listing.label(far)} most")
    return notes


def _axes_notes(plan: ScanPlan, stage: StageAxes, reading: StageOrientation | None, several: bool) -> list[str]:
    found = f"{stage.right},{stage.down},{stage.away}"
    own = f"{plan.stage.right},{plan.stage.down},{plan.stage.away}"
    if reading is not None and reading.turn.name != AS_IS:
        return [f"axes: {found} of the stage are meant; the light moves otherwise in the frames as they lie"]
    if found != own:
        why = "as the light moves" if reading is not None else "as the numbers of steps tell"
        words = f"axes: {found} move the image right, down and the source away, {why}; the plan says {own}"
        other = None if reading is None else reading.other
        if other is None:
            return [words]
        return [f"{words}; if the plan is right the frames are {other.words} (--orientation {other.option})"]
    if reading is not None:
        return [f"axes: {found} move the image right, down and the source away; the light agrees"]
    return [f"axes: {found} as the plan says; the list alone does not tell their sense"] if several else []


def _light_notes(plan: ScanPlan, light: CentroidMotion | None, stage: StageAxes, lateral: tuple[int, int]) -> list[str]:
    """Return a note where the light lies elsewhere than the plan puts it."""
    if light is None or light.axes() is None:
        return []
    where = anchor_of(light, stage, lateral, plan.period)
    off = math.hypot(where[0] - plan.anchor[0], where[1] - plan.anchor[1])
    if off < 0.2 * min(plan.cutout):
        return []
    return [
        f"light: at y = x = 0 it is near row {where[0]:.0f}, column {where[1]:.0f}, {off:.0f} px from the plan's "
        "anchor; lfcal plan --anchor moves it"
    ]


def anchor_of(
    light: CentroidMotion, stage: StageAxes, lateral: tuple[int, int], period: tuple[int, int]
) -> tuple[float, float]:
    """Return row and column of the light at position y = x = 0."""
    start = np.array(light.start)
    for axis, count in ((stage.down, period[0]), (stage.right, period[1])):
        if axis[0] == "-":  # the first place of the axis is then the last position
            start = start + light.matrix[:, lateral.index(AXES.index(axis[1]))] * (count - 1)
    return float(start[0]), float(start[1])
