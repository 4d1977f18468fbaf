"""Faults of the simulated rig, each at a chosen call."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

from lfcal.base import InputError, check_choice, check_number

__all__ = [
    "CAMERA_FAULTS",
    "CONTENT_FAULTS",
    "FAULTS",
    "GAUGE_FAULTS",
    "STAGE_FAULTS",
    "DeviceFault",
    "FaultSchedule",
    "parse_faults",
]

STAGE_FAULTS = (
    "move fails",
    "stops short",
    "drifts",
    "never arrives",
    "stage vanishes",
    "encoder off",
    "loses steps",
)
# "bumped" happens to the stage, but while a frame is exposed: it is counted in frames
CONTENT_FAULTS = ("blank", "repeats", "frozen", "torn", "region slips", "dark level", "clamps exposure", "lamp dims")
"""Faulty frames that are complete, in time and have valid numbers."""
CAMERA_FAULTS = (
    "times out",
    "incomplete",
    "stale",
    "wrong shape",
    "vanishes",
    "clock jumps",
    "bumped",
    *CONTENT_FAULTS,
)
GAUGE_FAULTS = ("too warm", "lamp low")
"""Readings of the simulated thermometer and photodiode that are off; frames are not."""
FAULTS = STAGE_FAULTS + CAMERA_FAULTS + GAUGE_FAULTS


@dataclass(frozen=True, slots=True)
class DeviceFault:
    """One fault.

    Attributes
    ----------
    kind
        One of `FAULTS`.
    at
        Number of the call to ``move`` (stage faults), ``grab`` (camera faults) or ``read`` (faults of gauges), from 0.
    times
        Number of consecutive affected calls; a vanished device does not return, nor do lost steps.
    """

    kind: str
    at: int
    times: int = 1

    def __post_init__(self) -> None:
        """Check every value."""
        check_choice("fault", self.kind, FAULTS)
        check_number("call", self.at, at_least=0, integer=True)
        check_number("times", self.times, at_least=1, integer=True)

    def text(self) -> str:
        """Return the fault as `parse_faults` reads it."""
        return f"{self.kind}@{self.at}" + (f"*{self.times}" if self.times > 1 else "")


def parse_faults(text: str) -> list[DeviceFault]:
    """Return the faults that ``kind@call[*times]``, separated by ``;``, say; raises `InputError`."""
    faults = []
    for part in filter(None, (p.strip() for p in text.split(";"))):
        kind, _, call = part.partition("@")
        at, _, times = call.partition("*")
        try:
            faults.append(DeviceFault(kind.strip(), int(at), int(times or 1)))
        except ValueError as error:
            if isinstance(error, InputError):
                raise
            raise InputError.expected("option faults", "kind@call[*times]", repr(part), "correct it") from None
    return faults


class FaultSchedule:
    """Count the calls of one device and decide which faults occur."""

    def __init__(self, faults: Iterable[DeviceFault], kinds: tuple[str, ...]) -> None:
        self.kinds = kinds
        self._faults = [fault for fault in faults if fault.kind in kinds]
        self.calls = 0

    def next_call(self) -> frozenset[str]:
        """Return the kinds of fault that strike this call."""
        active = self.pending()
        self.calls += 1
        return active

    def inject(self, fault: DeviceFault) -> None:
        """Let a further fault strike; it begins ``fault.at`` calls from the next one."""
        # one assignment: another thread may be counting
        self._faults = [*self._faults, replace(fault, at=self.calls + fault.at)]

    def pending(self) -> frozenset[str]:
        """Return the kinds of fault that will strike the next call."""
        if not self._faults:
            return frozenset()
        return frozenset(f.kind for f in self._faults if f.at <= self.calls < f.at + f.times)
