"""Names of `lfcal.cli` for use within lfcal only: they may change without notice."""

from __future__ import annotations

from lfcal.cli.doctor import examine

__all__ = ["examine"]
