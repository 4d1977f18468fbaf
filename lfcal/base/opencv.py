"""OpenCV, checked: four packages write the same folder ``cv2``, and removing one of them damages the others."""

from __future__ import annotations

from importlib import metadata
from typing import Any

from lfcal.base.errors import LfcalError

__all__ = ["cv2"]

_DISTRIBUTION = "opencv-python-headless"
_OTHERS = ("opencv-python", "opencv-contrib-python", "opencv-contrib-python-headless")

_FUNCTIONS = (
    *("GaussianBlur", "blur", "boxFilter", "medianBlur", "sepFilter2D", "dilate", "threshold", "demosaicing"),
    *("remap", "resize", "warpAffine", "connectedComponentsWithStats", "distanceTransform"),
    *("contourArea", "drawContours", "findContours", "polylines", "imdecode", "imencode", "imwrite"),
    *("getNumThreads", "setNumThreads"),
)
"""All functions that lfcal uses; every distribution has them, because none belongs to the contrib modules."""


def _checked() -> Any:
    """Return the module cv2; raise `LfcalError` with the remedy if it is absent, broken or incomplete."""
    try:
        import cv2

        found = ", ".join(name for name in _FUNCTIONS if not hasattr(cv2, name))
        if not found:
            return cv2
        found = f"cv2 without {found}"
    except Exception as error:  # also AttributeError, where parts are of different versions
        found = f"{type(error).__name__} ({error})"
    others = [name for name in _OTHERS if _installed(name)]
    if others:
        found = f"{', '.join(others)} in the same environment, and {found}"
    raise LfcalError.expected(
        "OpenCV",
        "a working module cv2",
        found,
        f"run: python -m pip install --force-reinstall --no-deps {_DISTRIBUTION}",
    )


def _installed(name: str) -> bool:
    try:
        metadata.version(name)
    except metadata.PackageNotFoundError:
        return False
    return True


cv2: Any = _checked()
