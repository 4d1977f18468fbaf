"""Faults of the simulated devices in words. No Qt."""

from __future__ import annotations

from lfcal.devices.simulated import CAMERA_FAULTS, FAULTS, GAUGE_FAULTS, STAGE_FAULTS, DeviceFault

__all__ = ["COUNTED", "KINDS", "fault_words"]

_SAID = {
    "move fails": "a move fails",
    "stops short": "the stage stops short",
    "drifts": "the stage creeps after arrival",
    "never arrives": "the stage never arrives",
    "stage vanishes": "the stage is unplugged",
    "encoder off": "the stage reads a wrong place",
    "loses steps": "the stage loses steps",
    "times out": "no frame comes in time",
    "incomplete": "a frame lacks parts",
    "stale": "an old frame comes again",
    "wrong shape": "a frame has another shape",
    "vanishes": "the camera is unplugged",
    "clock jumps": "the camera's clock jumps",
    "bumped": "the table is bumped",
    "blank": "a blank frame",
    "repeats": "an earlier content comes again",
    "frozen": "the picture is frozen",
    "torn": "a frame is torn",
    "region slips": "the region read slips",
    "dark level": "the dark level rises",
    "clamps exposure": "the exposure is clamped",
    "lamp dims": "the lamp dims",
    "too warm": "the room is too warm (gauge)",
    "lamp low": "the lamp is low (gauge)",
}
COUNTED = {
    **dict.fromkeys(STAGE_FAULTS, "move"),
    **dict.fromkeys(CAMERA_FAULTS, "frame"),
    **dict.fromkeys(GAUGE_FAULTS, "reading"),
}
"""What the calls of each kind of fault are."""

KINDS = tuple((kind, _SAID.get(kind, kind)) for kind in FAULTS)
"""Pairs of kind and words, for a list."""


def fault_words(fault: DeviceFault, *, now: bool = False) -> str:
    """Return a fault in a line; ``now``: its calls are counted from now."""
    counted = COUNTED[fault.kind]
    last = f" to {fault.at + fault.times - 1}" if fault.times > 1 else ""
    after = " from now" if now else ""
    return f"{counted} {fault.at}{last}{after}: {_SAID.get(fault.kind, fault.kind)}"
