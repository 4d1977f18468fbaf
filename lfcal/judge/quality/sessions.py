"""Inspections that lie in files: which a folder holds, and what to call them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from lfcal.base import InputError
from lfcal.judge.quality.trend import NAME

__all__ = ["inspections_in", "labels_of"]


def inspections_in(path: Path) -> list[Path]:
    """Return what a path names: a file, or the quality.json of a report's folder, or of a folder of such folders.

    Raises
    ------
    InputError
        If there is none.
    """
    if path.is_file():
        return [path]
    found = [path / NAME] if (path / NAME).is_file() else []
    if not found and path.is_dir():
        found = sorted(path.glob(f"*/{NAME}"))
    if not found:
        got = "none" if path.is_dir() else "no such folder"
        raise InputError.expected(
            f"inspections in {path}", f"{NAME} of lfcal inspect --report, or an H file", got, "name the report's folder"
        )
    return found


def labels_of(places: Sequence[Path]) -> list[str]:
    """Return short names that tell them apart: that of the file, or of the folders above it."""
    for above in range(1, 8):
        told = ["/".join(place.parts[-above:]) for place in places]
        if len(set(told)) == len(told):
            return [label.removesuffix(f"/{NAME}") for label in told]
    return [str(place) for place in places]
