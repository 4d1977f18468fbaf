"""What a session records and when: positions in their order, and the frames around them, as blocks of one kind."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.acquire.frame_plan import FramePlan, frame_grid, frame_positions
from lfcal.acquire.options import Options
from lfcal.acquire.recording import Kind
from lfcal.base import InputError
from lfcal.camera import ScanPlan
from lfcal.frames import Position
from lfcal.psf import Cutout

__all__ = ["Block", "blocks_of", "coarse_order", "frame_blocks", "window_shape"]

SPLINE_MEMORY = 12
"""Pixels after which a cubic spline has forgotten its neighbours to 1e-6."""


@dataclass(frozen=True, slots=True, eq=False)
class Block:
    """Steps of one kind.

    Attributes
    ----------
    kind
        What they are.
    slots
        ``(N,)`` place of each in the file of its kind.
    positions
        ``(N, 3)`` position of the plan (z, y, x) each belongs to.
    periods
        ``(N, 2)`` whole periods (y, x) away from that position.
    before
        ``(N,)`` number of the position each comes before, in the order of recording.
    """

    kind: Kind
    slots: NDArray[Any]
    positions: NDArray[Any]
    periods: NDArray[Any]
    before: NDArray[Any]

    @classmethod
    def of(cls, kind: Kind, positions: NDArray[Any], before: NDArray[Any], slots: NDArray[Any] | None = None) -> Block:
        """Return a block at the positions themselves; slots count up by default."""
        counted = np.arange(len(positions)) if slots is None else slots
        return cls(kind, counted, positions, np.zeros((len(positions), 2), np.int64), before)


def blocks_of(
    plan: ScanPlan, options: Options, redo: Sequence[Position] | None, only: Sequence[Position] = ()
) -> list[Block]:
    """Return everything to record of ``plan``, or of the positions ``redo`` of it.

    With ``only`` positions the session records these and no others, with all that belongs to a session.

    Raises
    ------
    InputError
        If ``redo`` lies outside the plan, or no control frame fits on the sensor.
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
    """Return everything to record of a plan of whole frames, or of the frames ``redo`` of it.

    Raises
    ------
    InputError
        If the plan has no such frame, or the options are of single points.
    """
    if options.order != "plan" or options.controls:
        what = "order coarse" if options.order != "plan" else "control frames"
        raise InputError.expected("frames of many points", "the plan's order, no controls", what, "leave it out")
    there = frame_positions(plan)
    if not len(there):
        raise InputError.expected("plan of a target", "a frame or more", "none", "plan it again")
    z = len(plan.scan.depths_um) // 2
    own = there[there[:, 0] == z]
    middle = tuple((own if len(own) else there)[0].tolist())
    if redo is not None:
        again = _redo_positions(frame_grid(plan), redo)
        for position in again.tolist():
            if not (there == position).all(axis=1).any():
                raise InputError.expected("frame to redo", "one of the plan", tuple(position), "use this plan's list")
        count = len(again)
        return [Block.of(Kind.POSITION, again, np.arange(count)), *_references(middle, options, count, count)]
    count = len(there)
    return [
        Block.of(Kind.POSITION, there, np.arange(count)),
        *_references(middle, options, count, options.reference_every),
        *_darks(plan.scan, options, count),
    ]


def coarse_order(plan: ScanPlan) -> NDArray[np.intp]:
    """Return all positions ``(N, 3)`` as (z, y, x), coarse grids first.

    The first pass visits every plane on a grid of up to 16 pixels' pitch, each later pass the points of a
    grid twice as fine that are not yet taken; so that after 1/256 of the session all planes have been seen.
    Within a pass the plan's own order holds.

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
    """Return the rows and columns kept of each frame, odd: what the cutout covers, and the margin.

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
        # at whole pixels nothing is interpolated, and the cutout is all that assembly reads
        whole = all(float(v).is_integer() for v in plan.anchor) and not plan.resample
        margin = 0 if whole else SPLINE_MEMORY
    return rows + 2 * margin, columns + 2 * margin


def _references(middle: tuple[int, int, int], options: Options, count: int, every: int) -> list[Block]:
    if not options.reference_every:
        return []
    # also after the last position, so that the whole session lies between two of them
    before = np.append(np.arange(0, count, every), count)
    return [Block.of(Kind.REFERENCE, np.tile([middle], (len(before), 1)), before)]


def _darks(plan: ScanPlan, options: Options, count: int) -> list[Block]:
    if not options.darks:
        return []
    times = np.arange(0, count, options.dark_every or count)
    exposures = plan.exposures
    # dark current grows with the exposure: one dark frame for each, named by a plane that has it
    planes = np.array([exposures.index(t) for t in sorted(set(exposures))])
    positions = np.zeros((len(times) * len(planes), 3), np.int64)
    positions[:, 0] = np.tile(planes, len(times))
    return [Block.of(Kind.DARK, positions, np.repeat(times, len(planes)))]


def _controls(plan: ScanPlan, options: Options, count: int) -> list[Block]:
    """Return control frames of the middle of the cell: one period away, and evenly on to the field's edge."""
    if not options.controls:
        return []
    nz, ny, nx = plan.shape[:3]
    middle = np.array([0, ny // 2, nx // 2])
    offsets = _control_offsets(plan, options, middle)
    if not offsets:
        raise InputError.expected(
            "control frames",
            "a sensor at least one period wider than the plan",
            "none of them fits",
            "leave control frames out",
        )
    positions = np.tile(middle, (nz * len(offsets), 1))
    positions[:, 0] = np.repeat(np.arange(nz), len(offsets))
    slots, periods = np.arange(len(positions)), np.tile(np.array(offsets), (nz, 1))
    return [Block(Kind.CONTROL, slots, positions, periods, np.full(len(positions), count + 1))]


def _control_offsets(plan: ScanPlan, options: Options, middle: NDArray[Any]) -> list[tuple[int, int]]:
    """Return whole periods (y, x) in the four directions."""
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
        raise InputError.expected("positions to redo", "at least one", "none", "check the list")
    bad = ((positions < 0) | (positions >= np.array(shape))).any(axis=1)
    if bad.any():
        first = tuple(positions[np.flatnonzero(bad)[0]].tolist())
        raise InputError.expected("position to redo", f"(z, y, x) inside {shape}", first, "use the list of this plan")
    return positions
