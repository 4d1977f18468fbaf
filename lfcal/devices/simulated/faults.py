"""Faults that can be injected into the simulated rig, each at a chosen call."""

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
# "bumped" displaces the stage during an exposure, so it is counted in frames
CONTENT_FAULTS = ("blank", "repeats", "frozen", "torn", "region slips", "dark level", "clamps exposure", "lamp dims")
"""Faults of frames that arrive complete, in time and with valid numbers."""
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
"""Faults of the readings of the simulated thermometer and photodiode; frames are not affected."""
FAULTS = STAGE_FAULTS + CAMERA_FAULTS + GAUGE_FAULTS


@dataclass(frozen=True, slots=True)
class DeviceFault:
    """A fault of a simulated device, and the calls that it affects.

    Attributes
    ----------
    kind
        One of `FAULTS`.
    at
        Index, from 0, of the first affected call to ``move`` (stage faults), ``grab`` (camera faults) or ``read``
        (gauge faults).
    times
        Number of consecutive affected calls; a vanished device and lost steps never recover.
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
        """Return the fault in the form that `parse_faults` reads."""
        return f"{self.kind}@{self.at}" + (f"*{self.times}" if self.times > 1 else "")


def parse_faults(text: str) -> list[DeviceFault]:
    """Return the faults in a text of entries ``kind@call[*times]``, separated by ``;``.

    Raise `InputError` if an entry is invalid.
    """
    faults = []
    for part in filter(None, (p.strip() for p in text.split(";"))):
        kind, _, call = part.partition("@")
        at, _, times = call.partition("*")
        try:
            faults.append(DeviceFault(kind.strip(), int(at), int(times or 1)))
        except ValueError as error:
            if isinstance(error, InputError):
                raise
            raise InputError.expected(
                "option faults", "kind@call[*times]", repr(part), "write it in the form times out@5*2"
            ) from None
    return faults


class FaultSchedule:
    """Schedule of the faults of one device: it counts the device's calls and decides which faults occur.

    The ``faults`` of kinds other than ``kinds`` are ignored.
    """

    def __init__(self, faults: Iterable[DeviceFault], kinds: tuple[str, ...]) -> None:
        self.kinds = kinds
        self._faults = [fault for fault in faults if fault.kind in kinds]
        self.calls = 0

    def next_call(self) -> frozenset[str]:
        """Count a call and return the kinds of fault that affect it."""
        active = self.pending()
        self.calls += 1
        return active

    def inject(self, fault: DeviceFault) -> None:
        """Add a fault; the next call is affected if ``fault.at`` is 0, the one after it if 1, and so on."""
        # one assignment: another thread may be counting
        self._faults = [*self._faults, replace(fault, at=self.calls + fault.at)]

    def pending(self) -> frozenset[str]:
        """Return the kinds of fault that will affect the next call."""
        if not self._faults:
            return frozenset()
        return frozenset(f.kind for f in self._faults if f.at <= self.calls < f.at + f.times)
