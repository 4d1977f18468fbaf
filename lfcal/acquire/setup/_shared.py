"""What other packages of lfcal use of `lfcal.acquire.setup`, and nobody else: it may change."""

from __future__ import annotations

from lfcal.acquire.setup.stage_check import STAGE

__all__ = [
    "STAGE",
]
