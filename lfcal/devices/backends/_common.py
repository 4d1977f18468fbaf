"""Common parts of the backends of real cameras: sensor properties, fixed settings, and substitutes for a stage."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence

from lfcal.devices.errors import StageError
from lfcal.devices.protocols import Limits, Point, Setting

__all__ = [
    "GENICAM",
    "RECORDED",
    "UNREADABLE",
    "CameraFacts",
    "ExternalStage",
    "NoStage",
    "off_value",
    "read_settings",
    "switch_off",
]


class CameraFacts:
    """Shape and sample range of a camera's sensor; the backend sets ``_shape`` and ``_bits`` on opening it."""

    _shape: tuple[int, int]
    _bits: int

    @property
    def sensor_shape(self) -> tuple[int, int]:
        """Rows and columns of the whole sensor."""
        return self._shape

    @property
    def bit_depth(self) -> int:
        """Bits per sample."""
        return self._bits

    @property
    def max_value(self) -> int:
        """Sample value of a saturated pixel."""
        return (1 << self._bits) - 1


Read = Callable[[str], str | None]
"""Function that returns a setting as text, or None if the camera does not have it or cannot read it now."""

GENICAM: Mapping[str, str] = {
    "ExposureAuto": "Off",
    "GainAuto": "Off",
    "GainAutoBalance": "Off",
    "BlackLevelAuto": "Off",
    "BlackLevelAutoBalance": "Off",
    "BlackLevelClampingEnable": "False",
    "BalanceWhiteAuto": "Off",
    "GammaEnable": "False",
    "Gamma": "1",
    "LUTEnable": "False",
    "SharpeningEnable": "False",
    "DenoiseEnable": "False",
    "DefectCorrectDynamicEnable": "False",
}
"""Features of GenICam cameras (most are in the SFNC), and the value that leaves samples proportional to light.

Static correction of defects is not changed, because it replaces the same few pixels in every frame.
"""

RECORDED = ("Gain", "GainRaw", "BlackLevel", "BlackLevelRaw", "DigitalShift")
"""Features that scale or shift all samples equally; they are only recorded."""

UNREADABLE = "cannot be read"
"""Value recorded for a setting that exists but cannot be read."""

OFF = ("off", "false", "0", "no", "disable", "disabled", "manual", "none")


def off_value(allowed: Sequence[str]) -> str | None:
    """Return the value among ``allowed`` that switches a setting off; None if none is known."""
    return next((value for word in OFF for value in allowed if value.strip().lower() == word), None)


def switch_off(wanted: Mapping[str, str], read: Read, write: Callable[[str, str], None]) -> None:
    """Set every setting that the camera has to its ``wanted`` value.

    ``write`` must not raise an error if a setting is read-only, locked or lacks that value; `read_settings` reports
    this.
    """
    for name, value, found in _found(wanted, read):
        if value is not None and not _same(value, found):
            write(name, value)


def read_settings(wanted: Mapping[str, str], noted: Sequence[str], read: Read) -> dict[str, Setting[str | None]]:
    """Return the camera's settings, each with the requested value (None: any) and the current one."""
    settings: dict[str, Setting[str | None]] = {}
    for name, value, found in _found(wanted, read):
        settings[name] = Setting(value, value if value is not None and _same(value, found) else found)
    for name in noted:
        if (text := read(name)) is not None:
            settings[name] = Setting(None, text)
    return settings


def _found(wanted: Mapping[str, str], read: Read) -> Iterator[tuple[str, str | None, str]]:
    """Yield name, requested value (None: any) and current value of the settings that the camera has."""
    gamma_off = False
    for name, value in wanted.items():
        found = read(name)
        if found is None:
            continue
        free = name.lower() == "gamma" and (gamma_off or _is_percent(found))
        yield name, None if free else value, found
        if re.match("gamma.?enable", name, re.IGNORECASE):
            gamma_off = _same(value, read(name) or "")


def _is_percent(gamma: str) -> bool:
    """Return whether a gamma is on a scale of the manufacturer, on which 1 would not be linear."""
    try:
        return float(gamma) > 10
    except ValueError:
        return False


def _same(wanted: str, found: str) -> bool:
    """Return whether two texts mean the same value: names in any case, equal numbers, or words for off."""
    words = wanted.strip().lower(), found.strip().lower()
    if words[0] == words[1] or (words[0] in OFF and words[1] in OFF):
        return True
    try:
        return math.isclose(float(words[0]), float(words[1]), abs_tol=1e-3)
    except ValueError:
        return False


_ANYWHERE: Limits = ((-math.inf, math.inf), (-math.inf, math.inf), (-math.inf, math.inf))


class NoStage:
    """Substitute for the stage of a camera without one."""

    name = "no stage"
    limits = _ANYWHERE

    def move(self, target: Point) -> None:
        """Raise `StageError`."""
        raise StageError("stage: this camera has none; choose the backend of the stage (--stage)")

    def moving(self) -> bool:
        """Return False."""
        return False

    def position(self) -> Point:
        """Raise `StageError`."""
        raise StageError("stage: this camera has none; choose the backend of the stage (--stage)")

    def stop(self) -> None:
        """Do nothing."""

    def home(self) -> None:
        """Raise `StageError`."""
        self.move((0.0, 0.0, 0.0))

    def close(self) -> None:
        """Do nothing."""


class ExternalStage:
    """A source that a person or another program moves; it is assumed to be at the last target."""

    name = "moved by another program"
    moved_elsewhere = True
    limits = _ANYWHERE

    def __init__(self) -> None:
        self._target: Point = (0.0, 0.0, 0.0)

    def move(self, target: Point) -> None:
        """Remember the target."""
        self._target = target

    def moving(self) -> bool:
        """Return False."""
        return False

    def position(self) -> Point:
        """Return the last target (µm)."""
        return self._target

    def stop(self) -> None:
        """Do nothing."""

    def home(self) -> None:
        """Set the target to the origin."""
        self._target = (0.0, 0.0, 0.0)

    def close(self) -> None:
        """Do nothing."""
