"""Names of `lfcal.cli` for other packages of lfcal only: they may change without notice."""

from __future__ import annotations

from lfcal.cli.doctor import examine
from lfcal.cli.window_libraries import ON_X11, missing_libraries, shows_on_x11, why_no_window, without

__all__ = [
    "ON_X11",
    "examine",
    "missing_libraries",
    "shows_on_x11",
    "why_no_window",
    "without",
]
