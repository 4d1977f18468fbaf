"""Everything a session will do, in order, as arrays: made once, the same after every interruption."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfcal.acquire.options import Options
from lfcal.acquire.orders import coarse_order
from lfcal.acquire.recording.records import Kind
from lfcal.axes import centre
from lfcal.camera import ScanPlan
from lfcal.devices.protocols import Point, Roi
from lfcal.errors import InputError
from lfcal.frames.source import Position
from lfcal.psf.cutout import Cutout

__all__ = ["Schedule", "Step", "window_shape"]

SPLINE_MEMORY = 12
"""Pixels after which a cubic spline has forgotten its neighbours to 1e-6."""


class Step(NamedTuple):
    """One frame to record.

    ``slot`` is its place in the file of its kind, ``flat`` the plan's position as ``(z * ny + y) * nx + x``,
    ``target`` stage coordinates (µm), ``row, column`` the first sensor pixel kept, ``period_y, period_x``
    whole periods away from the plan's position.
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
    """All steps of a session as parallel arrays of length ``len(self)``.

    Attributes
    ----------
    kinds, slots, flat, planes, targets, origins, periods
        As in `Step`; ``targets`` ``(N, 3)``, ``origins`` and ``periods`` ``(N, 2)``.
    window
        Rows and columns of every frame kept.
    roi
        Region read for all but control frames; ``control_roi`` for those.
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

    def __len__(self) -> int:
        """Return the number of steps."""
        return len(self.kinds)

    def count(self, *kinds: Kind) -> int:
        """Return how many steps are of these kinds."""
        return int(np.isin(self.kinds, kinds).sum())

    def roi_of(self, kind: Kind) -> Roi:
        """Return the region of the sensor that frames of ``kind`` need."""
        return self.control_roi if kind is Kind.CONTROL else self.roi

    def steps(self, todo: NDArray[np.bool_] | None = None) -> Iterator[Step]:
        """Iterate over the steps in order, those of ``todo`` ``(N,)`` only."""
        which = np.arange(len(self)) if todo is None else np.flatnonzero(todo)
        kinds = list(Kind)
        for start in range(0, len(which), 4096):  # a block at a time, so that no list of all steps is ever made
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
                yield Step(kinds[kind], slot, flat, z, (a, b, c), row, column, py, px)

    @classmethod
    def of(cls, plan: ScanPlan, options: Options, redo: Sequence[Position] | None = None) -> Schedule:
        """Return the schedule of ``plan``, or of the positions ``redo`` of it.

        Raises
        ------
        InputError
            If a frame to be kept would leave the sensor, or ``redo`` lies outside the plan.
        """
        if redo is None:
            positions = coarse_order(plan) if options.order == "coarse" else plan.order_indices()
            slots = np.ravel_multi_index(tuple(positions.T), plan.shape[:3]).astype(np.int64)
        else:
            positions = _redo_positions(plan, redo)
            slots = np.arange(len(positions), dtype=np.int64)
        blocks = [_block(plan, options, Kind.POSITION, positions, slots, np.arange(len(positions)))]
        blocks += _references(plan, options, len(positions), whole=redo is None)
        if redo is None:
            blocks += _darks(plan, options, len(positions)) + _controls(plan, options, len(positions))
        return _merged(plan, options, blocks)


class _Block(NamedTuple):
    """Steps of one kind, with the number of the position each comes before."""

    kind: Kind
    slots: NDArray[Any]
    positions: NDArray[Any]
    targets: NDArray[np.float64]
    images: NDArray[np.float64]
    periods: NDArray[Any]
    before: NDArray[Any]


def _block(
    plan: ScanPlan,
    options: Options,
    kind: Kind,
    positions: NDArray[Any],
    slots: NDArray[Any],
    before: NDArray[Any],
    periods: NDArray[Any] | None = None,
) -> _Block:
    shift = np.zeros((len(positions), 2), np.int64) if periods is None else periods
    there = positions + np.pad(shift * np.array(plan.period), ((0, 0), (1, 0)))
    return _Block(kind, slots, positions, plan.stage_um(there), plan.image_px(there), shift, before)


def _references(plan: ScanPlan, options: Options, count: int, *, whole: bool) -> list[_Block]:
    if not options.reference_every:
        return []
    before = np.append(np.arange(0, count, options.reference_every if whole else count), count)
    nz, ny, nx = plan.shape[:3]
    positions = np.tile([[nz // 2, ny // 2, nx // 2]], (len(before), 1))
    return [_block(plan, options, Kind.REFERENCE, positions, np.arange(len(before)), before)]


def _darks(plan: ScanPlan, options: Options, count: int) -> list[_Block]:
    if not options.darks:
        return []
    times = np.arange(0, count, options.dark_every or count)
    exposures = plan.exposures
    planes = np.array([exposures.index(t) for t in sorted(set(exposures))])  # one dark frame per exposure
    positions = np.zeros((len(times) * len(planes), 3), np.int64)
    positions[:, 0] = np.tile(planes, len(times))
    before = np.repeat(times, len(planes))
    return [_block(plan, options, Kind.DARK, positions, np.arange(len(before)), before)]


def _controls(plan: ScanPlan, options: Options, count: int) -> list[_Block]:
    """Return control frames of the middle of the cell: one period away, and evenly on to the field's edge."""
    if not options.controls:
        return []
    nz, ny, nx = plan.shape[:3]
    middle = np.array([0, ny // 2, nx // 2])
    shape = window_shape(plan, options)
    offsets: list[tuple[int, int]] = []
    for sign in (-1, 1):
        for axis in (0, 1):
            room = _periods_to_edge(plan, middle, shape, axis, sign)
            far = np.unique(np.linspace(1, room, min(options.controls, room)).round().astype(int)) if room else ()
            offsets += [(sign * int(k), 0) if axis == 0 else (0, sign * int(k)) for k in far]
    if not offsets:
        raise InputError.expected(
            "control frames",
            "a sensor at least one period wider than the plan",
            "none of them fits",
            "leave control frames out",
        )
    positions = np.tile(middle, (nz * len(offsets), 1))
    positions[:, 0] = np.repeat(np.arange(nz), len(offsets))
    slots = np.arange(len(positions))
    periods = np.tile(np.array(offsets), (nz, 1))
    return [_block(plan, options, Kind.CONTROL, positions, slots, np.full(len(positions), count + 1), periods)]


def _periods_to_edge(plan: ScanPlan, middle: NDArray[Any], shape: tuple[int, int], axis: int, sign: int) -> int:
    image = float(plan.image_px(middle)[axis])
    half = shape[axis] / 2 + 1
    room = (plan.camera.sensor.shape[axis] - half - image) if sign > 0 else image - half
    return max(0, int(room * plan.resample_factors[axis] // plan.period[axis]))


def _merged(plan: ScanPlan, options: Options, blocks: list[_Block]) -> Schedule:
    references = sum(len(b.slots) for b in blocks if b.kind is Kind.REFERENCE)
    before = np.concatenate([block.before for block in blocks])
    kinds = np.concatenate([np.full(len(b.slots), b.kind, np.uint8) for b in blocks])
    slots = np.concatenate([b.slots + (references if b.kind is Kind.CONTROL else 0) for b in blocks])
    positions = np.concatenate([b.positions for b in blocks])
    # at one place in the order: dark, reference, then the position itself
    rank = np.array([3, 0, 1, 2])[kinds]
    order = np.lexsort((slots, rank, before))
    shape = window_shape(plan, options)
    images = np.concatenate([b.images for b in blocks])
    origins = (np.ceil(images - 0.5) - [centre(shape[0]), centre(shape[1])]).astype(np.int64)
    _check_on_sensor(plan, origins, positions, shape)
    control = kinds == Kind.CONTROL
    return Schedule(
        kinds[order],
        slots[order].astype(np.int64),
        np.ravel_multi_index(tuple(positions.T), plan.shape[:3]).astype(np.int64)[order],
        positions[order, 0].astype(np.int64),
        np.concatenate([b.targets for b in blocks])[order],
        origins[order],
        np.concatenate([b.periods for b in blocks])[order].astype(np.int64),
        shape,
        _union(origins[~control], shape),
        _union(origins[control] if control.any() else origins, shape),
    )


def window_shape(plan: ScanPlan, options: Options) -> tuple[int, int]:
    """Return the rows and columns kept of each frame, odd: what the cutout covers, and the margin."""
    rows, columns = Cutout.for_plan(plan).reach
    margin = options.margin_px
    if margin is None:
        whole = all(float(v).is_integer() for v in plan.anchor) and not plan.resample
        margin = 0 if whole else SPLINE_MEMORY
    return rows + 2 * margin, columns + 2 * margin


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
            f"inside the sensor of {sensor[0]} x {sensor[1]}",
            f"{shape[0]} x {shape[1]} from row {row}, column {column}",
            "choose a smaller margin or move the anchor inwards",
        )


def _redo_positions(plan: ScanPlan, redo: Sequence[Position]) -> NDArray[np.int64]:
    positions = np.array(sorted(set(redo)), np.int64).reshape(-1, 3)
    if not len(positions):
        raise InputError.expected("positions to redo", "at least one", "none", "check the list")
    bad = ((positions < 0) | (positions >= np.array(plan.shape[:3]))).any(axis=1)
    if bad.any():
        first = tuple(positions[np.flatnonzero(bad)[0]].tolist())
        raise InputError.expected(
            "position to redo", f"(z, y, x) inside {plan.shape[:3]}", first, "use the list of this plan"
        )
    return positions
