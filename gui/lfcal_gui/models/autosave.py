"""Copies of unsaved projects that outlive their window, and the offer to restore them. No Qt."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any, Protocol

from lfcal.base import LfcalError, read_text, write_text
from lfcal_gui.models.project import Project, ProjectState, read_project


class Claim(Protocol):
    """Exclusive right to a file, as provided by `lfcal_gui.locks.FileLock`."""

    def take(self) -> bool:
        """Claim the file; return whether it was free."""
        ...

    def release(self) -> None:
        """Release the claim."""
        ...


@dataclass(frozen=True)
class UnsavedCopy:
    """A copy of a project that was not saved when its window ended.

    Attributes
    ----------
    file
        The copy.
    state
        Content of the copy.
    project
        File of the project; empty if it has none.
    time
        When the copy was written (s since 1970).
    on_disk, disk_time
        Content and modification time of the project's file; None if there is none or it cannot be read.
    """

    file: Path
    state: ProjectState
    project: str
    time: float
    on_disk: ProjectState | None = None
    disk_time: float | None = None

    @property
    def newer(self) -> bool:
        """Whether the copy is newer than the project's file, or there is no such file."""
        return self.disk_time is None or self.time > self.disk_time

    @property
    def worth_asking(self) -> bool:
        """Whether the copy differs from the project's file."""
        return self.state != self.on_disk

    @property
    def path(self) -> Path | None:
        """File to which the restored project is saved; None if there is none, or it was written after the copy."""
        return Path(self.project) if self.project and self.newer else None

    def name(self) -> str:
        """Return the displayed name of the project."""
        return Path(self.project).name if self.project else f"{self.state.name} (never saved)"

    def words(self) -> tuple[str, ...]:
        """Return a description of the copy and its content, one item per line."""
        lines = [f"Copy from {_moment(self.time)}"]
        if self.project:
            lines.append(f"Project file: {self.project}")
        if self.disk_time is not None:
            order = "older than the copy" if self.newer else "newer than the copy: the project was saved later"
            lines.append(f"saved {_moment(self.disk_time)}, {order}")
        return (*lines, *_contents(self.state))


def _moment(time: float) -> str:
    return f"{datetime.fromtimestamp(time):%Y-%m-%d %H:%M:%S}"


def _contents(state: ProjectState) -> tuple[str, ...]:
    """Return the content of a project, one item per line."""
    lines = [f"Camera: {state.camera.name}"]
    if state.plan is not None:
        nz, ny, nx = state.plan.shape[:3]
        lines.append(f"Plan: {nz} planes of {nx} × {ny} positions, {math.prod((nz, ny, nx))} in all")
    named = (
        ("Frames", state.frames),
        ("H", state.psf),
        ("Recording", state.recording),
        ("Light field", state.light_field),
        ("Volume", state.volume),
    )
    return (*lines, *(f"{title}: {path}" for title, path in named if path))


def keep(project: Project, file: Path) -> None:
    """Write a copy of the project, with the path of its file. The copy opens as a project, too."""
    data: dict[str, Any] = json.loads(project.state.to_json())
    data["autosave"] = {"project": "" if project.path is None else str(project.path.absolute())}
    write_text(file, json.dumps(data, indent=2))


def read_kept(file: Path) -> UnsavedCopy:
    """Return the copy in ``file`` and the content of the project's own file; raise `LfcalError` if it is no copy."""
    text = read_text(file)
    state = ProjectState.from_json(text)
    about = json.loads(text).get("autosave")
    project = about.get("project") if isinstance(about, dict) else ""
    kept = UnsavedCopy(file, state, project if isinstance(project, str) else "", file.stat().st_mtime)
    own = Path(kept.project)
    if not kept.project or not own.is_file():
        return kept
    try:
        saved: ProjectState | None = read_project(own)
    except LfcalError:
        saved = None  # the project file is damaged; only the copy is left
    return UnsavedCopy(file, state, kept.project, kept.time, saved, own.stat().st_mtime if saved is not None else None)


def find_kept(folder: Path, claim: Callable[[Path], Claim]) -> list[tuple[UnsavedCopy, Claim]]:
    """Return the copies left by windows that ended, newest first; the caller has claimed each of them.

    Copies identical to their project file are removed; unreadable ones are renamed.
    """
    found: list[tuple[UnsavedCopy, Claim]] = []
    for file in folder.glob("*.lfcal"):
        claimed = claim(file)
        if not claimed.take():
            continue
        try:
            kept = read_kept(file)
        except LfcalError:
            file.replace(file.with_suffix(".damaged"))
            claimed.release()
            continue
        if kept.worth_asking:
            found.append((kept, claimed))
        else:
            file.unlink(missing_ok=True)
            claimed.release()
    return sorted(found, key=lambda entry: -entry[0].time)
