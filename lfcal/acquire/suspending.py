"""Suspenders: automatic pauses of a session while conditions in the lab are out of bounds.

A gauge (temperature, the lamp's power) has bounds. Outside them, the session pauses after the current position; it
continues when the gauge has been within them for some time. The idea comes from suspenders in beamline control (Allan
et al., "Bluesky's Ahead", Synchrotron Radiation News 32, 2019).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from numbers import Real
from pathlib import Path

from lfcal.base import InputError
from lfcal.devices import Caller, DeviceError, FileGauge, Gauge, Rig

__all__ = ["Bound", "Suspender", "gauge_of"]

EVERY_S = 1.0
"""Time between two readings (s of the rig's time)."""


@dataclass(frozen=True, slots=True)
class Bound:
    """Allowed readings of a gauge while frames are taken.

    Attributes
    ----------
    gauge
        Name of a gauge of the rig, or path of a text file. The reading is then the last number in the last complete
        line of the file.
    low, high
        Smallest and largest allowed reading, in the gauge's unit; an infinite value means no bound.

    Examples
    --------
    >>> from lfcal.acquire import Bound
    >>> lab = Bound("temperature", low=20.0, high=22.0)
    >>> print(lab.gauge, lab.low, lab.high)  # the session pauses while the temperature is outside 20 to 22
    temperature 20.0 22.0
    """

    gauge: str
    low: float = -math.inf
    high: float = math.inf

    @classmethod
    def parse(cls, text: str) -> Bound:
        """Return the bound that the text ``GAUGE=LOW:HIGH`` describes; LOW or HIGH may be omitted, but not both.

        Raises `InputError` if the text has another form, or LOW is not below HIGH.
        """
        name, sign, span = text.rpartition("=")
        low, colon, high = span.partition(":")
        try:
            bound = cls(name.strip(), float(low or "-inf"), float(high or "inf"))
        except ValueError:
            bound = cls("")
        # the order of the comparison rejects NaN too
        known = math.isfinite(bound.low) or math.isfinite(bound.high)
        if not (sign and colon and bound.gauge and known and bound.low < bound.high):
            raise InputError.expected(
                "--suspend", "GAUGE=LOW:HIGH", repr(text), "write a name and two bounds: temperature=20:22"
            )
        return bound

    def holds(self, value: float) -> bool:
        """Return whether the reading ``value`` is between `low` and `high`, inclusive; False for NaN."""
        return self.low <= value <= self.high

    def words(self, value: float, unit: str) -> str:
        """Return a one-line reason why the reading ``value``, in ``unit``, suspends a session."""
        after = f" {unit}" if unit else ""
        return f"{self.gauge} {value:.4g}{after}, outside {self.low:g} to {self.high:g}{after}"


def gauge_of(rig: Rig, name: str) -> Gauge:
    """Return the gauge of ``rig`` named ``name``; if there is none, a gauge that reads the file at this path.

    Raises
    ------
    InputError
        If neither exists.
    """
    for gauge in rig.gauges:
        if gauge.name == name:
            return gauge
    if Path(name).is_file():
        return FileGauge(Path(name))
    own = ", ".join(gauge.name for gauge in rig.gauges) or "no gauge"
    raise InputError.expected(
        "--suspend",
        f"a gauge of the devices ({own}) or a file whose last line contains the newest number",
        name,
        "give one of these gauges, or an existing file",
    )


class Suspender:
    r"""Callable that returns the reason to suspend a session; empty if there is none.

    It reads the gauges at most once a second. A gauge that cannot be read is also a reason.

    Parameters
    ----------
    rig
        Rig with the gauges and the clock.
    bounds
        Bounds of the gauges; empty: none are read.
    steady_s
        Time for which all gauges must be within their bounds before a suspended session continues (s on the rig's
        clock).

    Raises
    ------
    InputError
        If a bound names neither a gauge of the rig nor an existing file.

    Examples
    --------
    >>> from dataclasses import replace
    >>> from lfcal.camera import ScanPlan, preset
    >>> plan = replace(ScanPlan.for_camera(preset("bench"), virtual_depths=[3.0], cutout=21), period=(2, 3))
    >>> from lfcal.devices import simulated_rig
    >>> from pathlib import Path
    >>> from lfcal.acquire import Bound, Suspender
    >>> _ = Path("room.csv").write_text("25.5\n")
    >>> hold = Suspender(simulated_rig(plan), (Bound("room.csv", 20, 22),), steady_s=60.0)
    >>> print(hold())
    suspended: room.csv 25.5, outside 20 to 22
    """

    def __init__(self, rig: Rig, bounds: Sequence[Bound], steady_s: float) -> None:
        found = [(bound, gauge_of(rig, bound.gauge)) for bound in bounds]
        self._gauges = [(bound, gauge, Caller(gauge, gauge.name)) for bound, gauge in found]
        self._time, self._steady = rig.time, steady_s
        self._next = -math.inf
        self._good_since: float | None = -math.inf
        self._why = ""

    def __call__(self) -> str:
        """Return the reason to suspend the session; empty if there is none."""
        now = self._time.monotonic()
        if not self._gauges or now < self._next:
            return self._why
        self._next = now + EVERY_S
        troubles = [words for one in self._gauges if (words := _trouble(*one))]
        if troubles:
            self._good_since = None
            self._why = "suspended: " + "; ".join(troubles)
        elif self._good_since is None:
            self._good_since = now
        if self._good_since is not None:
            left = self._steady - (now - self._good_since)
            self._why = f"suspended: within bounds again, continues in {left:.0f} s" if left > 0 else ""
        return self._why


def _trouble(bound: Bound, gauge: Gauge, caller: Caller) -> str:
    """Return the reason why a reading, or a failure to read, suspends a session; empty if there is none."""
    try:
        value = caller.call("read", gauge.read)
    except DeviceError as error:
        return str(error)
    if not isinstance(value, Real):
        return f"{gauge.name}: expected a number, got {value!r}; correct its driver"
    reading = float(value)
    return "" if bound.holds(reading) else bound.words(reading, gauge.unit)
