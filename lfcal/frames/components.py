"""Frames that are colour pictures: one of their components is taken for grey."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

from lfcal.base import FileFormatError

__all__ = ["COMPONENTS", "open_component"]

COMPONENTS = ("R", "G", "B")
"""Components of colour images."""

T = TypeVar("T")


def open_component(opened: Callable[..., T], channel: str) -> T:
    """Return what ``opened()`` does, or for colour pictures ``opened(colour=component)``.

    Parameters
    ----------
    opened
        Opens frames.
    channel
        Name of a colour, of a mosaic or a picture; ``"each"`` takes green first.

    Raises
    ------
    FileFormatError
        If the frames are colour pictures, and ``channel`` is none of their components.
    """
    try:
        return opened()
    except FileFormatError:
        component = "G" if channel == "each" else channel
        if component not in COMPONENTS:
            raise
    # grey frames that are damaged fail again, with the same words
    return opened(colour=component)
