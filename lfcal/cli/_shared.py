"""Names of `lfcal.cli` for other packages of lfcal only: they may change without notice."""

from __future__ import annotations

from lfcal.cli.doctor import examine

__all__ = ["examine"]
