"""One frame of a project, before and after correction, and its cutout. No Qt."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.frames import Position
from lfcal.psf import Cutout, Window
from lfcal_gui.models import FrameNumbers, frame_numbers
from lfcal_gui.pages.frames.model import Opened
from lfcal_gui.pages.frames.orientation import turned


@dataclass(frozen=True, eq=False)
class Loaded:
    """One frame ``(rows, columns)``, before and after correction, with its numbers.

    Attributes
    ----------
    window
        First row, first column, rows and columns of the cutout.
    point
        Row and column of the paraxial image, where the plan has it.
    origin
        Sensor row and column of the frame's first pixel; window and point count from it.
    crop
        ``(nt, ns)`` the cutout as it goes into H, before and after correction; None where it leaves the frame.
    """

    position: Position
    label: str
    raw: NDArray[Any]
    fixed: NDArray[np.float32]
    numbers: FrameNumbers
    window: tuple[int, int, int, int]
    point: tuple[float, float]
    origin: tuple[int, int] = (0, 0)
    crop: tuple[NDArray[Any], NDArray[Any]] | None = None


def load_frame(opened: Opened, position: Position) -> Loaded:
    """Read one frame, correct it, count every pixel of it, and say where its cutout is."""
    index = int(opened.frames[position])
    info = opened.view.info(index)
    raw = turned(opened.source, opened.plan, opened.delivered.orientation).read(index)
    fixed = opened.view.samples(index)
    cutout = Cutout.for_plan(opened.plan, interpolation=opened.interpolation)
    wanted = opened.chosen.option_values.get("cutout")
    # the smallest one that loses little light is found from all frames, when H is assembled
    cutout = replace(cutout, shape=wanted) if isinstance(wanted, tuple) else cutout
    corner = cutout.window(position)
    row, column = opened.plan.image_px(position).tolist()
    top, left = info.origin
    return Loaded(
        position,
        info.label,
        raw,
        fixed.values,
        frame_numbers(raw, fixed.saturated),
        (corner.row - top, corner.column - left, *cutout.reach),
        (row - top, column - left),
        info.origin,
        _crop(cutout, corner, (raw, fixed.values), info.origin),
    )


def _crop(
    cutout: Cutout, window: Window, frames: tuple[NDArray[Any], NDArray[Any]], origin: tuple[int, int]
) -> tuple[NDArray[Any], NDArray[Any]] | None:
    """Return the cutout of both frames, whose first pixel is ``origin``; None where it leaves them."""
    rows, columns = cutout.region(window)
    top, left = rows.start - origin[0], columns.start - origin[1]
    bottom, right = rows.stop - origin[0], columns.stop - origin[1]
    height, width = frames[0].shape
    if top < 0 or left < 0 or bottom > height or right > width:
        return None
    raw, fixed = (cutout.resample(frame[top:bottom, left:right], window) for frame in frames)
    return raw, fixed


def first_middle_last(opened: Opened) -> tuple[Loaded, ...]:
    """Return the first, the middle and the last frame in scan order; none where there is no frame."""
    there = [p for p in opened.plan.positions() if opened.frames[p] >= 0]
    return tuple(load_frame(opened, there[k]) for k in (0, len(there) // 2, -1)) if there else ()
