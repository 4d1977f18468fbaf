"""Texts of the help menu."""

from __future__ import annotations

import importlib.metadata
import platform

from lfcal_gui.models import PageSpec

__all__ = ["about_text", "cheat_sheet"]

_KEYS = (
    ("Ctrl+1 … Ctrl+4, Alt+1 … Alt+3", "go to a place, to a view of it"),
    ("Ctrl+Return", "do what the line at the top says comes next"),
    ("Ctrl+M", "open Multiplexing"),
    ("Ctrl+Z, Ctrl+Shift+Z", "undo, redo"),
    ("Ctrl+N, Ctrl+O, Ctrl+S", "new, open, save project"),
    ("Ctrl+Shift+C", "copy a picture of the page"),
    ("Ctrl+Shift+K, Ctrl+Shift+Y", "copy what the page does as a command, as Python"),
    ("Ctrl+Shift+P", "command palette"),
    ("Ctrl+E, Esc", "enlarge the picture under the pointer, put it back"),
    ("Ctrl+T", "light or dark"),
    ("F1", "this sheet"),
)
"""Of the window; those of a page stand in its `PageSpec`."""

_PACKAGES = (
    "numpy",
    "scipy",
    "numba",
    "h5py",
    "opencv-contrib-python-headless",
    "rawpy",
    "tifffile",
    "PySide6-Essentials",
    "pyqtgraph",
)


def cheat_sheet(pages: tuple[PageSpec, ...]) -> str:
    """Return the keyboard shortcuts of the window and of its pages as rich text."""
    shared: dict[tuple[str, str], list[str]] = {}
    for spec in pages:
        for pair in spec.keys:
            shared.setdefault(pair, []).append(spec.title)
    own = [(keys, f"{what} ({', '.join(titles)})") for (keys, what), titles in shared.items()]
    rows = "".join(f"<tr><td><b>{keys}</b>&nbsp;&nbsp;</td><td>{what}</td></tr>" for keys, what in (*_KEYS, *own))
    return f"<table>{rows}</table>"


def about_text() -> str:
    """Return name, licence and versions as rich text."""
    from lfcal import __version__

    lines = []
    for name in _PACKAGES:
        try:
            lines.append(f"{name} {importlib.metadata.version(name)}")
        except importlib.metadata.PackageNotFoundError:
            lines.append(f"{name}: not installed")
    system = f"Python {platform.python_version()}, {platform.system()}"
    return (
        f"<h3>lfcal {__version__}</h3><p>PSF calibration and acquisition for plenoptic cameras.<br>"
        f"BSD-3-Clause licence.</p><p>{system}<br>{'<br>'.join(lines)}</p>"
    )
