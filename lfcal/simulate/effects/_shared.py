"""Names of `lfcal.simulate.effects` for other packages of lfcal only: they may change without notice."""

from __future__ import annotations

from lfcal.simulate.effects.base import WHITE_IMAGE
from lfcal.simulate.effects.described import (
    SETTINGS,
    Entry,
    effect_entries,
    effect_from,
    effect_words,
    entries_json,
    parse_effects,
    parse_entries,
    read_entries,
)
from lfcal.simulate.effects.kernel import NEIGHBOURS
from lfcal.simulate.effects.magnitudes import Magnitude, magnitudes_of, number_in

__all__ = [
    "NEIGHBOURS",
    "SETTINGS",
    "WHITE_IMAGE",
    "Entry",
    "Magnitude",
    "effect_entries",
    "effect_from",
    "effect_words",
    "entries_json",
    "magnitudes_of",
    "number_in",
    "parse_effects",
    "parse_entries",
    "read_entries",
]
