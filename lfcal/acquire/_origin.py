"""Check that the stage's origin is where it was: the last position taken is taken again and compared."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.acquire._looking import Looker
from lfcal.acquire.control import Control
from lfcal.acquire.options import Options
from lfcal.acquire.schedule import Schedule
from lfcal.acquire.spots import image_shift
from lfcal.base import InputError
from lfcal.camera import ScanPlan
from lfcal.devices import Rig

__all__ = ["check_origin"]

CORRELATION = 0.8


def check_origin(
    rig: Rig,
    plan: ScanPlan,
    options: Options,
    schedule: Schedule,
    latest: tuple[int, NDArray[Any], NDArray[Any]],
    control: Control,
) -> None:
    """Raise `InputError` unless the latest recorded position looks as it did.

    Parameters
    ----------
    rig, plan, options, schedule, control
        As in `Runner`.
    latest
        Slot, frame and record of the latest acknowledged position.
    """
    slot, before, note = latest
    tolerance = options.origin_tolerance_px
    if tolerance is None:
        return
    x, y, depth = (float(v) for v in note["target_um"])
    targets = np.array([[x, y, depth]])
    looker = Looker(rig, plan, options, control, targets=targets, roi=schedule.roi, bracket=options.bracket)
    looker.go((x, y, depth))
    z = schedule.position(int(note["index"])).z
    data = looker.expose(plan.exposures[z], plan.frames_averaged)
    top, left = int(note["row"]) - looker.roi.row, int(note["column"]) - looker.roi.column
    after = data[top : top + before.shape[0], left : left + before.shape[1]]
    what = f"image of the last recorded position (slot {slot})"
    remedy = "restore the stage's origin and the optics, or start a new session"
    try:
        down, right, correlation = image_shift(before, after)
    except InputError as error:
        raise InputError(f"{what}: {error}") from error
    if max(abs(down), abs(right)) > tolerance:
        got = f"moved by ({down:.2f}, {right:.2f}) px"
        raise InputError.expected(what, f"where it was to {tolerance:g} px (row, column)", got, remedy)
    # an image in the same place may still be another one: defocused, or of another spot
    if correlation < CORRELATION:
        raise InputError.expected(what, f"a correlation above {CORRELATION}", f"{correlation:.2f}", remedy)
