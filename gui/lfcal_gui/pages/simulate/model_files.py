"""Magnitudes and settings as the JSON file that ``lfcal simulate --effect`` reads. No Qt."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from lfcal_gui.pages.simulate.model import SimulateSettings


def settings_text(settings: SimulateSettings) -> str:
    """Return the text of a JSON file with what is given and chosen; effects that are not installed are left out."""
    from lfcal.simulate.effects import entries_json

    return entries_json(settings.entries())


def read_settings(path: Path, settings: SimulateSettings) -> tuple[SimulateSettings, str]:
    """Return ``settings`` with what the file says of its effects in place of what they said, and a line of words.

    An effect that the file names without a magnitude is switched on if nothing else would simulate it.

    Raises
    ------
    LfcalError
        If the file holds no effects, or others than this program knows.
    """
    from lfcal.simulate.effects import read_entries

    entries = read_entries(path)
    names = {entry.name for entry in entries}
    kept = replace(settings, magnitudes=tuple(one for one in settings.magnitudes if one[0] not in names))
    for entry in entries:
        bare = entry.effect is not None and not entry.given and entry.effect.deviation
        kept = kept.with_override(entry.name, "on" if bare and entry.setting == "auto" else entry.setting)
        for field, mark in entry.given.items():
            kept = kept.with_magnitude(entry.name, field, getattr(entry.effect, field), mark)
    count = len(names)
    return kept, f"{count} effect{'' if count == 1 else 's'} taken from {path.name}"
