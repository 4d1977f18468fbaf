"""What other packages of lfcal use of `lfcal.psf.aperture`, and nobody else: it may change."""

from __future__ import annotations

from lfcal.psf.aperture.shape import KINDS, REFUSALS

__all__ = [
    "KINDS",
    "REFUSALS",
]
