"""Modulators by the names people write."""

from __future__ import annotations

from lfcal.errors import InputError
from lfcal.multiplex.colour_filters import cfa
from lfcal.multiplex.masks import MASKS, mask
from lfcal.multiplex.modulator import Modulator

__all__ = ["modulator_of"]


def modulator_of(text: str) -> Modulator:
    """Return the modulator written as ``Bayer``, ``RG/GB``, ``MURA:11``, or two of these joined by ``*``."""
    if "*" in text:
        first, second = text.split("*", 1)
        return modulator_of(first) * modulator_of(second)
    kind, _, size = text.strip().partition(":")
    found = {m.lower(): m for m in MASKS}.get(kind.strip().lower().replace("-", "_").replace(" ", "_"))
    if found is None:
        return cfa(text.strip())
    if size and not size.isdigit():
        raise InputError.expected(f"size of {found} (px)", "a whole number", repr(size), "write it like MURA:11")
    return mask(found, int(size or 11))
