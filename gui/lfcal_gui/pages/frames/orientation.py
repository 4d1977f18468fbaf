"""Orientation of imported frames, found from the path of the pattern, and the choices to offer. No Qt."""

from __future__ import annotations

from dataclasses import dataclass

from lfcal.base import InputError
from lfcal.camera import ScanPlan
from lfcal.frames import AS_IS, ORIENTATIONS, FrameSource, named_orientation, oriented
from lfcal.psf import CHECK, FoundOrientation, check_found
from lfcal_gui.models import said_in_window

TURNS = [one for one in ORIENTATIONS.values() if one.name != AS_IS]
CHOICES = (
    (CHECK, "upright, checked"),
    (AS_IS, "as is, unchecked"),
    *((one.name, one.words) for one in TURNS),
)
"""Orientations that can be chosen, with their displayed names."""


@dataclass(frozen=True)
class Advice:
    """Advice on the orientation of frames, and the choices to offer.

    Attributes
    ----------
    words
        Description of the orientation.
    apply
        Orientation that makes the frames upright; empty if rotating them does not help.
    leave
        Orientation that is set if the frames are left unchanged; empty: the previous choice.
    chosen
        Whether the user chose this orientation, so that no question is needed.
    """

    words: str
    apply: str = ""
    leave: str = ""
    chosen: bool = False


def turned(source: FrameSource, plan: ScanPlan, name: str) -> FrameSource:
    """Return the frames turned by orientation ``name``; for `CHECK` they are returned unchanged."""
    return source if name == CHECK else oriented(source, named_orientation(name), plan.camera.sensor.shape)


def advice(found: FoundOrientation, chosen: str) -> Advice | None:
    """Return advice if the ``chosen`` orientation certainly differs from the one ``found``, else None."""
    if found.name in ("", AS_IS if chosen == CHECK else chosen):
        return None
    if found.name == AS_IS:
        return Advice("The frames are upright as delivered, but the settings turn them", CHECK)
    words = found.words[0].upper() + found.words[1:]
    if chosen == AS_IS:
        return Advice(f"{words}; they are used unchanged, as chosen", chosen=True)
    leave = AS_IS if chosen == CHECK else ""
    if found.cause == "scan":
        return Advice(f"{words}: correct the positions, or the plan's stage axes", leave=leave)
    return Advice(words, found.name, leave)


def other_sensor(source: FrameSource, plan: ScanPlan) -> str:
    """Return a warning if whole frames, in any orientation, do not have the sensor size of the plan; else empty."""
    whole = all(source.info(k).origin == (0, 0) for k in range(len(source)))
    sensor = plan.camera.sensor.shape
    if not whole or sensor in (source.shape, source.shape[::-1]):
        return ""
    (rows, columns), (known_rows, known_columns) = source.shape, sensor
    return (
        f"frames: {columns} × {rows} px, but the plan's sensor has {known_columns} × {known_rows} "
        "px: they are cropped, binned, or from another camera"
    )


def refusal(found: FoundOrientation, chosen: str) -> str:
    """Return why frames with the orientation ``found`` cannot be assembled; empty if they can."""
    try:
        check_found(found, chosen)
    except InputError as error:
        return said_in_window(str(error))
    return ""
