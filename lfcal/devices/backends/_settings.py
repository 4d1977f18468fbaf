"""Settings by which a camera changes samples automatically: switched off, read back, and what else is recorded."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence

from lfcal.devices.protocols import Setting

__all__ = ["GENICAM", "NOTED", "UNREADABLE", "off_value", "read_settings", "switch_off"]

Read = Callable[[str], str | None]
"""Returns the value of a setting as text; None where the camera has none of that name, or it cannot be read now."""

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

Static correction of defects is left as it is: it replaces the same few pixels in every frame.
"""

NOTED = ("Gain", "GainRaw", "BlackLevel", "BlackLevelRaw", "DigitalShift")
"""Features that scale or shift all samples alike: only recorded."""

UNREADABLE = "cannot be read"
"""Value of a setting that is there and cannot be read."""

OFF = ("off", "false", "0", "no", "disable", "disabled", "manual", "none")


def off_value(allowed: Sequence[str]) -> str | None:
    """Return which of the ``allowed`` values switches a setting off; None where none is known to."""
    return next((value for word in OFF for value in allowed if value.strip().lower() == word), None)


def switch_off(wanted: Mapping[str, str], read: Read, write: Callable[[str, str], None]) -> None:
    """Give every setting that the camera has its ``wanted`` value.

    ``write`` raises nothing where a setting is read-only, locked or without that value: `read_settings` shows it.
    """
    for name, value, found in _found(wanted, read):
        if value is not None and not _same(value, found):
            write(name, value)


def read_settings(wanted: Mapping[str, str], noted: Sequence[str], read: Read) -> dict[str, Setting[str | None]]:
    """Return what the camera has of the settings: the value asked for, None where any will do, and the one it has."""
    settings: dict[str, Setting[str | None]] = {}
    for name, value, found in _found(wanted, read):
        settings[name] = Setting(value, value if value is not None and _same(value, found) else found)
    for name in noted:
        if (text := read(name)) is not None:
            settings[name] = Setting(None, text)
    return settings


def _found(wanted: Mapping[str, str], read: Read) -> Iterator[tuple[str, str | None, str]]:
    """Yield name, wanted and present value of the settings there are; None is wanted where any value will do."""
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
    """Return whether a gamma is on a scale of the camera's own, where 1 would not be a straight line."""
    try:
        return float(gamma) > 10
    except ValueError:
        return False


def _same(wanted: str, found: str) -> bool:
    """Return whether two texts are the same value: names in any case, numbers, or both a word for off."""
    words = wanted.strip().lower(), found.strip().lower()
    if words[0] == words[1] or (words[0] in OFF and words[1] in OFF):
        return True
    try:
        return math.isclose(float(words[0]), float(words[1]), abs_tol=1e-3)
    except ValueError:
        return False
