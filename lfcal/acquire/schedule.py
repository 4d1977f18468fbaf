"""Everything a session will do, in order, as arrays: made once, the same after every interruption."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfcal.acquire.blocks import Block, blocks_of, frame_blocks, window_shape
from lfcal.acquire.frame_plan import FramePlan, frame_grid
from lfcal.acquire.options import Options
from lfcal.acquire.recording import Kind
from lfcal.base import InputError, centre, position_at
from lfcal.camera import ScanPlan
from lfcal.devices import Point, Roi
from lfcal.frames import Position

__all__ = ["Schedule", "ScheduledFrame", "window_shape"]


class ScheduledFrame(NamedTuple):
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
        As in `ScheduledFrame`; ``targets`` ``(N, 3)``, ``origins`` and ``periods`` ``(N, 2)``.
    window
        Rows and columns of every frame kept.
    roi
        Region read for all but control frames; ``control_roi`` for those.
    grid
        ``(nz, ny, nx)`` that positions are counted on: the plan's, or that of `frame_grid`.

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
        """Return how many steps are of these kinds."""
        return int(np.isin(self.kinds, kinds).sum())

    def roi_of(self, kind: Kind) -> Roi:
        """Return the region of the sensor that frames of ``kind`` need."""
        return self.control_roi if kind is Kind.CONTROL else self.roi

    def position(self, flat: int) -> Position:
        """Return the position that is counted as ``flat``."""
        return position_at(flat, self.grid[1:])

    def steps(self, todo: NDArray[np.bool_] | None = None) -> Iterator[ScheduledFrame]:
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
        """Return the schedule of ``plan``, of the positions ``redo`` of it, or of a session of ``only`` some of it.

        Raises
        ------
        InputError
            If a frame to be kept would leave the sensor, or ``redo`` lies outside the plan.
        """
        found = _Joined.of(blocks_of(plan, options, redo, only))
        shape = window_shape(plan, options)
        places = found.positions + np.pad(found.periods * np.array(plan.period), ((0, 0), (1, 0)))
        images = plan.image_px(places)
        # the same rounding as assembly's: half a pixel goes down
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
        """Return the schedule of whole frames, or of the frames ``redo`` of them; raises as `frame_blocks`."""
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
        """Return the schedule of these steps at places of the stage."""
        flat = np.ravel_multi_index(tuple(self.positions.T), grid).astype(np.int64)
        planes = self.positions[:, 0]
        return Schedule(self.kinds, self.slots, flat, planes, targets, origins, self.periods, window, *rois, grid)


def _order(blocks: list[Block], kinds: NDArray[np.uint8]) -> NDArray[np.intp]:
    """Return the order of recording: dark, reference, then the position that they come before."""
    rank = np.array([3, 0, 1, 2])[kinds]
    before = np.concatenate([block.before for block in blocks])
    return np.lexsort((np.concatenate([b.slots for b in blocks]), rank, before))


def _slots(blocks: list[Block]) -> NDArray[np.int64]:
    """Return the slots in the files: control frames follow the references in theirs."""
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
            f"inside the sensor of {sensor[0]} x {sensor[1]}",
            f"{shape[0]} x {shape[1]} from row {row}, column {column}",
            "choose a smaller margin or move the anchor inwards",
        )
