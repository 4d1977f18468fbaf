"""Texts of the help menu."""

from __future__ import annotations

import importlib.metadata
import platform

from gui.models.page import Stage

__all__ = ["about_text", "cheat_sheet"]

_KEYS = (
    ("Ctrl+1 … Ctrl+9", "go to a stage"),
    ("←  →  ↑  ↓", "step through source positions (Frames, PSF)"),
    ("Page up, Page down", "step through depth planes (Frames, PSF)"),
    ("Space", "play or stop (Frames)"),
    ("T", "H or its transpose (PSF)"),
    ("L, G", "log or gamma scaling of the pictures (PSF, Frames)"),
    ("Ctrl+Z, Ctrl+Shift+Z", "undo, redo"),
    ("Ctrl+N, Ctrl+O, Ctrl+S", "new, open, save session"),
    ("Ctrl+Shift+C", "copy a picture of the page"),
    ("Ctrl+T", "light or dark"),
    ("F1", "this sheet"),
)

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


def cheat_sheet(stages: tuple[Stage, ...]) -> str:
    """Return the keyboard shortcuts as rich text."""
    rows = "".join(f"<tr><td><b>{keys}</b>&nbsp;&nbsp;</td><td>{what}</td></tr>" for keys, what in _KEYS)
    order = ", ".join(f"{k} {stage.title}" for k, stage in enumerate(stages, 1))
    return f"<table>{rows}</table><p>Stages: {order}</p>"


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
