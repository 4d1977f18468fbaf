"""Order of all steps of a session, which is the same after every interruption.

Positions, dark, reference and control frames form blocks of one kind each; the schedule stores the steps as arrays.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfcal.acquire.frame_plan import FramePlan, frame_grid, frame_positions
from lfcal.acquire.options import Options
from lfcal.acquire.recording import Kind
from lfcal.base import InputError, centre, position_at
from lfcal.camera import ScanPlan
from lfcal.devices import Point, Roi
from lfcal.frames import Position
from lfcal.psf import Cutout

__all__ = ["Schedule", "ScheduledFrame", "coarse_order", "window_shape"]

SPLINE_MEMORY = 12
"""Distance at which a sample affects a cubic spline by less than 1e-6 (pixels)."""


@dataclass(frozen=True, slots=True, eq=False)
class Block:
    """Steps of one kind, as parallel arrays.

    Attributes
    ----------
    kind
        Kind of the steps.
    slots
        Index ``(N,)`` of each step in the file of its kind.
    positions
        Planned position ``(N, 3)`` as (z, y, x) to which each step belongs.
    periods
        Displacement ``(N, 2)`` of each step from that position, in periods (y, x).
    before
        Number ``(N,)`` of the position, in the order of recording, before which each step is made.
    """

    kind: Kind
    slots: NDArray[Any]
    positions: NDArray[Any]
    periods: NDArray[Any]
    before: NDArray[Any]

    @classmethod
    def of(cls, kind: Kind, positions: NDArray[Any], before: NDArray[Any], slots: NDArray[Any] | None = None) -> Block:
        """Return a block of steps at ``positions``, without displacement; by default, slots are numbered from 0."""
        counted = np.arange(len(positions)) if slots is None else slots
        return cls(kind, counted, positions, np.zeros((len(positions), 2), np.int64), before)


def blocks_of(
    plan: ScanPlan, options: Options, redo: Sequence[Position] | None, only: Sequence[Position] = ()
) -> list[Block]:
    """Return all blocks of steps to record for ``plan``: positions, and reference, dark and control frames.

    With ``only``, the session records only these positions (z, y, x). With ``redo``, it records only the positions
    ``redo`` (z, y, x) in the order of their indices, and reference frames; ``only`` is then ignored.

    Raises
    ------
    InputError
        If ``redo`` is empty, a position of ``redo`` or ``only`` is outside the plan, or no control frame fits on the
        sensor.
    """
    nz, ny, nx = plan.shape[:3]
    middle = (nz // 2, ny // 2, nx // 2)
    if redo is not None:
        again = _redo_positions(plan.shape[:3], redo)
        count = len(again)
        return [Block.of(Kind.POSITION, again, np.arange(count)), *_references(middle, options, count, count)]
    if only:
        positions = plan.in_scan_order(only)
        slots = np.arange(len(positions))
    else:
        positions = coarse_order(plan) if options.order == "coarse" else plan.order_indices()
        slots = np.ravel_multi_index(tuple(positions.T), plan.shape[:3]).astype(np.int64)
    count = len(positions)
    return [
        Block.of(Kind.POSITION, positions, np.arange(count), slots),
        *_references(middle, options, count, options.reference_every),
        *_darks(plan, options, count),
        *_controls(plan, options, count),
    ]


def frame_blocks(plan: FramePlan, options: Options, redo: Sequence[Position] | None) -> list[Block]:
    """Return all blocks of steps to record for a plan of whole frames: frames, and reference and dark frames.

    With ``redo``, only the frames ``redo`` (z, 0, k) are recorded, with reference frames.

    Raises
    ------
    InputError
        If the plan has no frames, ``redo`` is empty or contains frames that are not in the plan, or ``options``
        requests another order or control frames.
    """
    if options.order != "plan" or options.controls:
        named = "order" if options.order != "plan" else "controls"
        what = f"the order {options.order}" if named == "order" else f"{options.controls} control frames"
        raise InputError.expected(
            "recording of a target of many points",
            "the order of the plan and no control frames",
            what,
            f"leave out the option {named}",
        )
    there = frame_positions(plan)
    if not len(there):
        raise InputError.expected("plan of a target", "at least one frame", "none", "make the plan again")
    z = len(plan.scan.depths_um) // 2
    own = there[there[:, 0] == z]
    middle = tuple((own if len(own) else there)[0].tolist())
    if redo is not None:
        again = _redo_positions(frame_grid(plan), redo)
        for position in again.tolist():
            if not (there == position).all(axis=1).any():
                raise InputError.expected(
                    "frame to record again",
                    "a frame of the plan",
                    f"(z, y, x) = {tuple(position)}",
                    "use a list made for this plan",
                )
        count = len(again)
        return [Block.of(Kind.POSITION, again, np.arange(count)), *_references(middle, options, count, count)]
    count = len(there)
    return [
        Block.of(Kind.POSITION, there, np.arange(count)),
        *_references(middle, options, count, options.reference_every),
        *_darks(plan.scan, options, count),
    ]


def coarse_order(plan: ScanPlan) -> NDArray[np.intp]:
    """Return all N positions of the plan as an array ``(N, 3)`` of indices (z, y, x), coarse grids first.

    The first pass visits every plane on a grid with a pitch of up to 16 positions. Each later pass visits the remaining
    points of a grid twice as fine. With a pitch of 16, all planes are recorded coarsely after about 1/256 of the
    positions. Within a pass, the order is the order of the plan.

    Examples
    --------
    >>> from dataclasses import replace
    >>> from lfcal.camera import ScanPlan, preset
    >>> plan = replace(ScanPlan.for_camera(preset("bench"), virtual_depths=[3.0], cutout=21), period=(4, 4))
    >>> from lfcal.acquire import coarse_order
    >>> print(coarse_order(plan)[:5].tolist())  # corners of blocks first, then what lies between
    [[0, 0, 0], [0, 0, 2], [0, 2, 0], [0, 2, 2], [0, 0, 1]]
    """
    order = plan.order_indices()
    largest = 1 << max(0, min(4, (max(plan.period) - 1).bit_length() - 1))
    level = np.zeros(len(order), np.intp)
    pitch = 2
    while pitch <= largest:
        level += (order[:, 1] % pitch == 0) & (order[:, 2] % pitch == 0)
        pitch *= 2
    return order[np.argsort(-level, kind="stable")]


def window_shape(plan: ScanPlan, options: Options) -> tuple[int, int]:
    """Return the number of sensor rows and columns (both odd) to store from each frame of a single point source.

    They cover the cutout of ``plan`` plus the margin of ``options`` on each side.

    Examples
    --------
    >>> from lfcal.camera import ScanPlan, preset
    >>> plan = ScanPlan.for_camera(preset("bench"), virtual_depths=[3.0], cutout=21)
    >>> from lfcal.acquire import Options, window_shape
    >>> print(window_shape(plan, Options(margin_px=4)))  # of a cutout of 21 x 21, with room for the stage's errors
    (29, 29)
    """
    rows, columns = Cutout.for_plan(plan).reach
    margin = options.margin_px
    if margin is None:
        # at whole pixels nothing is interpolated, so assembly needs only the cutout
        whole = all(float(v).is_integer() for v in plan.anchor) and not plan.resample
        margin = 0 if whole else SPLINE_MEMORY
    return rows + 2 * margin, columns + 2 * margin


def _references(middle: tuple[int, int, int], options: Options, count: int, every: int) -> list[Block]:
    if not options.reference_every:
        return []
    # also after the last position, so that they enclose the whole session
    before = np.append(np.arange(0, count, every), count)
    return [Block.of(Kind.REFERENCE, np.tile([middle], (len(before), 1)), before)]


def _darks(plan: ScanPlan, options: Options, count: int) -> list[Block]:
    if not options.darks:
        return []
    times = np.arange(0, count, options.dark_every or count)
    exposures = plan.exposures
    # dark current grows with the exposure: one dark frame for each, labelled with a plane of this exposure
    planes = np.array([exposures.index(t) for t in sorted(set(exposures))])
    positions = np.zeros((len(times) * len(planes), 3), np.int64)
    positions[:, 0] = np.tile(planes, len(times))
    return [Block.of(Kind.DARK, positions, np.repeat(times, len(planes)))]


def _controls(plan: ScanPlan, options: Options, count: int) -> list[Block]:
    """Return control frames of the middle of the cell, evenly spaced from one period away to the edge of the field."""
    if not options.controls:
        return []
    nz, ny, nx = plan.shape[:3]
    middle = np.array([0, ny // 2, nx // 2])
    offsets = _control_offsets(plan, options, middle)
    if not offsets:
        raise InputError.expected(
            "control frames",
            "room for a position one period outside the plan",
            "no room for one",
            "omit control frames (--controls 0)",
        )
    positions = np.tile(middle, (nz * len(offsets), 1))
    positions[:, 0] = np.repeat(np.arange(nz), len(offsets))
    slots, periods = np.arange(len(positions)), np.tile(np.array(offsets), (nz, 1))
    return [Block(Kind.CONTROL, slots, positions, periods, np.full(len(positions), count + 1))]


def _control_offsets(plan: ScanPlan, options: Options, middle: NDArray[Any]) -> list[tuple[int, int]]:
    """Return displacements (y, x) of control frames from ``middle`` in the four directions, in whole periods."""
    shape = window_shape(plan, options)
    offsets: list[tuple[int, int]] = []
    for sign in (-1, 1):
        for axis in (0, 1):
            room = _periods_to_edge(plan, middle, shape, axis, sign)
            far = np.unique(np.linspace(1, room, min(options.controls, room)).round().astype(int)) if room else ()
            offsets += [(sign * int(k), 0) if axis == 0 else (0, sign * int(k)) for k in far]
    return offsets


def _periods_to_edge(plan: ScanPlan, middle: NDArray[Any], shape: tuple[int, int], axis: int, sign: int) -> int:
    image = float(plan.image_px(middle)[axis])
    half = shape[axis] / 2 + 1
    room = (plan.camera.sensor.shape[axis] - half - image) if sign > 0 else image - half
    return max(0, int(room * plan.resample_factors[axis] // plan.period[axis]))


def _redo_positions(shape: tuple[int, ...], redo: Sequence[Position]) -> NDArray[np.int64]:
    positions = np.array(sorted(set(redo)), np.int64).reshape(-1, 3)
    if not len(positions):
        raise InputError.expected(
            "positions to record again", "at least one", "an empty list", "leave the empty list out"
        )
    bad = ((positions < 0) | (positions >= np.array(shape))).any(axis=1)
    if bad.any():
        first = tuple(positions[np.flatnonzero(bad)[0]].tolist())
        raise InputError.expected(
            "position to record again", f"(z, y, x) inside {tuple(shape)}", first, "use a list made for this plan"
        )
    return positions


class ScheduledFrame(NamedTuple):
    """One frame to record.

    ``kind`` is the kind of the frame, and ``slot`` its index in the file for that kind. ``flat`` is the position in the
    plan as a flat index, ``(z * ny + y) * nx + x``, and ``z`` the index of its plane. ``target`` contains the stage
    coordinates (x, y, z) in µm. ``row`` and ``column`` are the sensor coordinates of the first stored pixel.
    ``period_y`` and ``period_x`` are the displacement of the source from the planned position, in whole periods.
    """

    kind: Kind
    slot: int
    flat: int
    z: int
    target: Point
    row: int
    column: int
    period_y: int
    period_x: int


@dataclass(frozen=True, slots=True, eq=False)
class Schedule:
    """All steps of a recording as arrays of equal length N = ``len(self)``.

    Attributes
    ----------
    kinds, slots, flat, planes, targets, origins, periods
        As in `ScheduledFrame`, one value for each step. ``targets`` ``(N, 3)`` is (x, y, z) in µm, ``origins`` ``(N,
        2)`` is (row, column) in sensor pixels, and ``periods`` ``(N, 2)`` is (y, x) in whole periods.
    window
        Number of rows and columns stored from each position, reference and control frame (px); dark frames contain the
        whole ``roi``.
    roi
        Region read for all frames except control frames, which use ``control_roi``.
    grid
        Shape ``(nz, ny, nx)`` of the grid to which position numbers refer: the grid of the plan, or `frame_grid`.

    Examples
    --------
    >>> from dataclasses import replace
    >>> from lfcal.camera import ScanPlan, preset
    >>> plan = replace(ScanPlan.for_camera(preset("bench"), virtual_depths=[3.0], cutout=21), period=(2, 3))
    >>> from lfcal.acquire import Kind, Options, Schedule
    >>> schedule = Schedule.of(plan, Options(darks=2, reference_every=3))
    >>> print(schedule.count(Kind.POSITION), "positions among", len(schedule), "frames")
    6 positions among 10 frames
    """

    kinds: NDArray[np.uint8]
    slots: NDArray[np.int64]
    flat: NDArray[np.int64]
    planes: NDArray[np.int64]
    targets: NDArray[np.float64]
    origins: NDArray[np.int64]
    periods: NDArray[np.int64]
    window: tuple[int, int]
    roi: Roi
    control_roi: Roi
    grid: tuple[int, int, int]

    def __len__(self) -> int:
        """Return the number of steps."""
        return len(self.kinds)

    def count(self, *kinds: Kind) -> int:
        """Return the number of steps of the given ``kinds``."""
        return int(np.isin(self.kinds, kinds).sum())

    def roi_of(self, kind: Kind) -> Roi:
        """Return the region of the sensor that is read for frames of ``kind`` (px)."""
        return self.control_roi if kind is Kind.CONTROL else self.roi

    def position(self, flat: int) -> Position:
        """Return the position (z, y, x) with the flat index ``flat`` = (z * ny + y) * nx + x."""
        return position_at(flat, self.grid[1:])

    def steps(self, todo: NDArray[np.bool_] | None = None) -> Iterator[ScheduledFrame]:
        """Yield the steps in order; with a mask ``todo`` ``(N,)``, only those where it is True."""
        which = np.arange(len(self)) if todo is None else np.flatnonzero(todo)
        kinds = list(Kind)
        for start in range(0, len(which), 4096):  # a block at a time, to avoid a list of all steps
            part = which[start : start + 4096]
            columns = zip(
                self.kinds[part].tolist(),
                self.slots[part].tolist(),
                self.flat[part].tolist(),
                self.planes[part].tolist(),
                self.targets[part].tolist(),
                self.origins[part].tolist(),
                self.periods[part].tolist(),
                strict=True,
            )
            for kind, slot, flat, z, (a, b, c), (row, column), (py, px) in columns:
                yield ScheduledFrame(kinds[kind], slot, flat, z, (a, b, c), row, column, py, px)

    @classmethod
    def of(
        cls,
        plan: ScanPlan,
        options: Options,
        redo: Sequence[Position] | None = None,
        *,
        only: Sequence[Position] = (),
    ) -> Schedule:
        """Return the schedule for all positions of ``plan``, or for some of them.

        ``redo`` are the positions (z, y, x) to record again, without dark and control frames. ``only`` are the
        positions (z, y, x) of a session that records no others. ``options`` are the settings of the recording.

        Raises
        ------
        InputError
            If a stored frame would extend beyond the sensor, or no control frame fits on it. Also if ``redo`` is empty,
            or a position of ``redo`` or ``only`` is outside the plan.
        """
        found = _Joined.of(blocks_of(plan, options, redo, only))
        shape = window_shape(plan, options)
        places = found.positions + np.pad(found.periods * np.array(plan.period), ((0, 0), (1, 0)))
        images = plan.image_px(places)
        # round as assembly does: half a pixel is rounded down
        origins = (np.ceil(images - 0.5) - [centre(shape[0]), centre(shape[1])]).astype(np.int64)
        _check_on_sensor(plan, origins, found.positions, shape)
        control = found.kinds == Kind.CONTROL
        return found.schedule(
            plan.shape[:3],
            plan.stage_um(places),
            origins,
            shape,
            (_union(origins[~control], shape), _union(origins[control] if control.any() else origins, shape)),
        )

    @classmethod
    def of_frames(cls, plan: FramePlan, options: Options, redo: Sequence[Position] | None = None) -> Schedule:
        """Return the schedule for all frames of ``plan``, or for its frames ``redo``, with the settings ``options``.

        The frames ``redo`` are positions (z, 0, k). Raises the errors of `frame_blocks`.
        """
        found = _Joined.of(frame_blocks(plan, options, redo))
        number = {frame: k for k, frame in enumerate(plan.frames)}
        places = plan.stage_um()[[number.get((z, k), 0) for z, _, k in found.positions.tolist()]]
        shape = plan.scan.camera.sensor.shape
        whole = Roi(0, 0, *shape)
        origins = np.zeros((len(found.kinds), 2), np.int64)
        return found.schedule(frame_grid(plan), places, origins, shape, (whole, whole))


class _Joined(NamedTuple):
    """Blocks as arrays in the order of recording; see `Schedule`."""

    kinds: NDArray[np.uint8]
    slots: NDArray[np.int64]
    positions: NDArray[np.int64]
    periods: NDArray[np.int64]

    @classmethod
    def of(cls, blocks: list[Block]) -> _Joined:
        kinds = np.concatenate([np.full(len(b.slots), b.kind, np.uint8) for b in blocks])
        order = _order(blocks, kinds)
        positions, periods = (
            np.concatenate(values)[order].astype(np.int64)
            for values in zip(*((b.positions, b.periods) for b in blocks), strict=True)
        )
        return cls(kinds[order], _slots(blocks)[order], positions, periods)

    def schedule(
        self,
        grid: tuple[int, int, int],
        targets: NDArray[np.float64],
        origins: NDArray[np.int64],
        window: tuple[int, int],
        rois: tuple[Roi, Roi],
    ) -> Schedule:
        """Return the schedule of these steps, at the given stage positions."""
        flat = np.ravel_multi_index(tuple(self.positions.T), grid).astype(np.int64)
        planes = self.positions[:, 0]
        return Schedule(self.kinds, self.slots, flat, planes, targets, origins, self.periods, window, *rois, grid)


def _order(blocks: list[Block], kinds: NDArray[np.uint8]) -> NDArray[np.intp]:
    """Return the order of recording: dark and reference frames come before the position with the same number."""
    rank = np.array([3, 0, 1, 2])[kinds]
    before = np.concatenate([block.before for block in blocks])
    return np.lexsort((np.concatenate([b.slots for b in blocks]), rank, before))


def _slots(blocks: list[Block]) -> NDArray[np.int64]:
    """Return the slots in the files; in the file of both, control frames follow reference frames."""
    references = sum(len(b.slots) for b in blocks if b.kind is Kind.REFERENCE)
    return np.concatenate([b.slots + (references if b.kind is Kind.CONTROL else 0) for b in blocks]).astype(np.int64)


def _union(origins: NDArray[np.int64], shape: tuple[int, int]) -> Roi:
    (row, column), (last_row, last_column) = origins.min(axis=0).tolist(), origins.max(axis=0).tolist()
    return Roi(row, column, last_row - row + shape[0], last_column - column + shape[1])


def _check_on_sensor(plan: ScanPlan, origins: NDArray[Any], positions: NDArray[Any], shape: tuple[int, int]) -> None:
    sensor = plan.camera.sensor.shape
    outside = ((origins < 0) | (origins + np.array(shape) > np.array(sensor))).any(axis=1)
    if outside.any():
        k = int(np.flatnonzero(outside)[0])
        z, y, x = positions[k].tolist()
        row, column = origins[k].tolist()
        raise InputError.expected(
            f"cutout of position z={z}, y={y}, x={x}",
            f"a cutout inside the sensor of {sensor[0]} x {sensor[1]} px",
            f"{shape[0]} x {shape[1]} px from row {row}, column {column}",
            "choose a smaller margin, or move the anchor inwards",
        )
