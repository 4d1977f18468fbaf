"""Names of `lfcal.acquire.setup` for other packages of lfcal only: they may change without notice."""

from __future__ import annotations

from lfcal.acquire.setup.stage_check import STAGE

__all__ = [
    "STAGE",
]
