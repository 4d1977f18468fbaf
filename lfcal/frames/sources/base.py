"""The interface of a kind of frame source for `lfcal.frames.open_frames`."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass, fields
from pathlib import Path

from lfcal.base import InputError
from lfcal.camera import ScanPlan
from lfcal.frames.manifest import Manifest
from lfcal.frames.orientation import AS_IS
from lfcal.frames.positions import NamePattern
from lfcal.frames.source import Frames

__all__ = ["FrameOptions", "SourceKind"]


@dataclass(frozen=True)
class FrameOptions:
    """The user's options for frames in files; see `lfcal.frames.open_frames`."""

    manifest: str | os.PathLike[str] | Manifest | None = None
    pattern: str | NamePattern | None = None
    order: str | None = None
    plan_shape: tuple[int, int, int] | None = None
    colour: str | None = None
    dataset: str | None = None
    nan: str = "auto"
    blank: str = "reject"
    skip_damaged: bool = False
    columns: str = ""
    first: int | None = None
    plan: ScanPlan | None = None
    orientation: str = AS_IS
    origin: tuple[int, int] | None = None

    def refuse(self, what: str, *accepted: str) -> None:
        """Raise `InputError` if an option is set that is not in ``accepted``; ``what`` names the kind of source.

        The plan, its shape and the orientation are always accepted.
        """
        for entry in fields(self):
            value = getattr(self, entry.name)
            if entry.name not in (*accepted, "plan_shape", "plan", "orientation") and value != entry.default:
                raise InputError.expected(
                    what, f"no option '{entry.name}'", repr(value), "omit it: the source defines this itself"
                )


@dataclass(frozen=True, slots=True)
class SourceKind:
    """A kind of frame source, defined as ``SOURCE`` in its module or by an entry point in the group ``lfcal.sources``.

    Attributes
    ----------
    name
        Name in messages and documentation.
    recognises
        Function that decides whether a path is of this kind.
    open
        Function that opens a path of this kind with the given options.
    rank
        Kinds are tried in ascending rank; folders of files come last, with rank 100.
    """

    name: str
    recognises: Callable[[Path], bool]
    open: Callable[[Path, FrameOptions], Frames]
    rank: int = 0
