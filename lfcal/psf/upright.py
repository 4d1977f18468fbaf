"""Check or find the orientation of frames by comparison with the planned path."""

from __future__ import annotations

import math
from typing import Any

from lfcal.base import InputError, Work
from lfcal.camera import ScanPlan
from lfcal.frames import (
    AS_IS,
    AUTO,
    CHECK,
    ORIENTATIONS,
    FrameSource,
    Orientation,
    check_stated,
    is_part_of_sensor,
    named_orientation,
    part_refusal,
)
from lfcal.psf.orientation import FoundOrientation, iter_find_orientation

__all__ = ["AUTO", "CHECK", "check_found", "check_place", "iter_upright"]


def iter_upright(view: FrameSource, plan: ScanPlan, choice: str = CHECK) -> Work[tuple[Orientation, dict[str, Any]]]:
    """Return the orientation of frames, with which `lfcal.frames.oriented` turns them upright, and its provenance.

    Parameters
    ----------
    view
        Corrected frames in the orientation as delivered.
    plan
        Scan plan, from which the expected position of the image is computed.
    choice
        Name of the orientation; ``"auto"``: find it; ``"check"``: leave the frames unchanged, and raise an error if
        this is certainly wrong.

    Raises
    ------
    InputError
        If the frames show a part of the sensor that was not stated or differs from the stated one, according to their
        metadata or their light. With ``"check"``, if the frames certainly do not match the plan. With ``"auto"``, if
        their orientation cannot be determined, or if the axes of the scan are wrong instead.
    """
    check_stated(view, plan.camera)
    if choice not in (CHECK, AUTO):
        turn = named_orientation(choice)
        record: dict[str, Any] = {"applied": turn.name, "found": None}
        check_place(None, view, plan, turn)
    else:
        found = yield from iter_find_orientation(view, plan)
        check_place(found, view, plan)
        check_found(found, choice)
        turn = ORIENTATIONS[found.name or AS_IS]
        record = {"applied": turn.name, "found": found.name or None, "cause": found.cause, "margin": found.margin}
        if not found.name or found.cause == "either":
            record["note"] = found.words
    return turn, {"orientation": record}


def check_place(
    found: FoundOrientation | None, view: FrameSource, plan: ScanPlan, turn: Orientation = ORIENTATIONS[AS_IS]
) -> None:
    """Raise `InputError` if frames show a part of the sensor that was not stated or differs from the stated one.

    Frames of a session and single colour channels are not checked.

    Parameters
    ----------
    found
        Orientation from the path of the light; None if the user stated the orientation.
    view
        Frames in the orientation as delivered.
    plan
        Scan plan, which contains the shapes of the sensor and of the cutout.
    turn
        Orientation stated by the user; upright if ``found`` is used.
    """
    sensor, known = plan.camera.sensor.shape, view.metadata
    # channels have pixels of another size; the positions of sessions and given cutouts are known
    if known.plan is not None or known.channel:
        return
    seen = found is not None and found.name in ("", AS_IS) and math.isfinite(found.offset_px[0])
    if known.origin is None:
        if is_part_of_sensor(turn.shape(view.shape), plan.camera) and all(
            view.info(k).origin == (0, 0) for k in range(len(view))
        ):
            place = [-n for n in found.offset_px] if seen and found is not None else None
            raise part_refusal(
                view.shape, sensor, place, "according to the position of the light (to within a few pixels)"
            )
        return
    if found is None or found.name != AS_IS:
        return
    slack = max(2.0, 0.1 * max(plan.cutout), 2 * found.residual_px)
    if math.hypot(*found.offset_px) > slack:
        first = known.origin
        row, column = (round(a - b) for a, b in zip(first, found.offset_px, strict=True))
        raise InputError.expected(
            "origin of the frames (--origin ROW,COLUMN)",
            f"about {row},{column}, according to the position of the light",
            f"{first[0]},{first[1]}",
            "correct the origin, or the anchor in the plan",
        )


def check_found(found: FoundOrientation, choice: str) -> None:
    """Raise `InputError` if ``found`` does not permit ``choice``, which is as in `iter_upright`.

    ``"check"`` requires that frames and scan do not certainly differ from the plan. ``"auto"`` requires that the
    orientation is determined and the scan axes are as planned. The name of an orientation is always permitted.
    """
    if choice not in (CHECK, AUTO):
        return
    keep = "or leave them unchanged (--orientation as-is)"
    if not found.name and choice == AUTO:
        raise InputError.expected(
            "frames",
            "motion of the pattern that shows their orientation",
            found.reason,
            "state the orientation (--orientation)",
        )
    if not found.wrong or (choice == AUTO and found.cause != "scan"):
        return
    scan = "correct the order of the positions, or the plan's stage axes"
    option = ORIENTATIONS[found.name].option
    turn = f"set the orientation of the frames to {option} (--orientation {option})"
    remedy = {"scan": scan, "frames": turn, "either": f"{turn}, or {scan}"}[found.cause]
    raise InputError.expected(
        "frames", "an image that moves as planned", f"another motion: {found.words}", f"{remedy}, {keep}"
    )
