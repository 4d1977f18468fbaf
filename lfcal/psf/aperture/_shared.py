"""Names of `lfcal.psf.aperture` for other packages of lfcal only: they may change without notice."""

from __future__ import annotations

from lfcal.psf.aperture.shape import KINDS, REFUSALS

__all__ = [
    "KINDS",
    "REFUSALS",
]
