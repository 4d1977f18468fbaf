"""Check for system libraries that the window needs on Linux and that no Python package provides."""

from __future__ import annotations

import ctypes
import os
import sys
from collections.abc import Callable, Mapping
from importlib.util import find_spec
from typing import Any

__all__ = ["NEEDED", "ON_X11", "missing_libraries", "shows_on_x11", "why_no_window", "without"]

NEEDED = {
    "libEGL.so.1": "libegl1",
    "libGL.so.1": "libgl1",
    "libxkbcommon.so.0": "libxkbcommon0",
    "libdbus-1.so.3": "libdbus-1-3",
    "libfontconfig.so.1": "libfontconfig1",
    "libglib-2.0.so.0": "libglib2.0-0",
}
"""Libraries that Qt is linked with, and the Debian and Ubuntu packages that contain them."""

ON_X11 = {
    "libxcb-cursor.so.0": "libxcb-cursor0",
    "libxkbcommon-x11.so.0": "libxkbcommon-x11-0",
    "libxcb-icccm.so.4": "libxcb-icccm4",
    "libxcb-keysyms.so.1": "libxcb-keysyms1",
    "libxcb-image.so.0": "libxcb-image0",
    "libxcb-render-util.so.0": "libxcb-render-util0",
    "libxcb-shape.so.0": "libxcb-shape0",
}
"""Libraries that Qt loads to show windows on X11; without them it aborts."""


def missing_libraries(
    names: Mapping[str, str], load: Callable[[str], Any] = ctypes.CDLL, platform: str = sys.platform
) -> dict[str, str]:
    """Return the entries of ``names`` (library: package) whose library cannot be loaded; empty except on Linux.

    ``load`` loads a library by name and raises OSError if it fails. ``platform`` is as in `sys.platform`.
    """
    if not platform.startswith("linux"):
        return {}
    missing = {}
    for name, package in names.items():
        try:
            load(name)
        except OSError:
            missing[name] = package
    return missing


def without(missing: Mapping[str, str]) -> str:
    """Return a one-line message with the libraries in ``missing`` (library: package) and how to install them."""
    return (
        f"the window needs system libraries that are missing: {', '.join(missing)}; "
        f"run: sudo apt install {' '.join(missing.values())} (Debian, Ubuntu)"
    )


def shows_on_x11(environment: Mapping[str, str] = os.environ) -> bool:
    """Return whether Qt will show windows on X11, from the variables in ``environment``.

    It does if ``QT_QPA_PLATFORM`` is xcb. It also does if there is an X11 display but no Wayland display, and
    ``QT_QPA_PLATFORM`` is not set.
    """
    chosen = environment.get("QT_QPA_PLATFORM", "")
    return chosen.startswith("xcb") or (
        not chosen and bool(environment.get("DISPLAY")) and not environment.get("WAYLAND_DISPLAY")
    )


def why_no_window(error: ImportError) -> str:
    """Return a one-line message with the reason why PySide6 cannot be imported, and the remedy."""
    if find_spec("PySide6") is None:
        return 'PySide6 is not installed; run: pip install "lfcal[gui]"'
    if missing := missing_libraries(NEEDED):
        return without(missing)
    return f"PySide6 is installed but cannot be loaded: {error}; lfcal doctor --gui shows details"
