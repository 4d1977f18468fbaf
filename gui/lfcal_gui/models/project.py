"""The project a window works on: what the user described and which files belong to it. No Qt, no arrays."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, fields, replace
from functools import partial
from pathlib import Path
from typing import Any

from lfcal.base import FileFormatError, LfcalError, on_network, parse_json, read_text, write_text
from lfcal.camera import Camera, ScanPlan, preset

FORMAT = "lfcal-project"
VERSION = 1
OLD_FORMAT = "lfcal-session"
"""Files of this format, version 1, are read, and saved as projects."""

FILES = ("frames", "psf", "reference", "recording", "light_field", "volume")
UNDO_STEPS = 200

LONGEST_PATH = 4095


@dataclass(frozen=True)
class ProjectState:
    """Everything a saved project holds.

    Attributes
    ----------
    name
        For people.
    camera, plan
        What the user described; the plan is None until it is first made.
    settings
        Settings of each page by its key, as plain JSON types; see `lfcal_gui.models.settings.PageSettings`.
    frames, psf, reference, recording, light_field, volume
        Files and folders that belong to the project: imported frames, H, an H to compare with, a recorded session,
        a light field to reconstruct and its reconstruction. Empty: none yet.
    redo
        Positions (z, y, x) to be recorded again.
    left_out
        Paths on network shares in the file of the project, as ``"psf //server/share/H.h5"``. They are ignored, since
        Windows logs on to any server that a path names. No part of the project.
    refused
        Why entries of the file were refused, a line each. They have their defaults. No part of the project.
    """

    name: str = "untitled"
    camera: Camera = field(default_factory=lambda: preset("bench"))
    plan: ScanPlan | None = None
    settings: Mapping[str, Any] = field(default_factory=dict)
    frames: str = ""
    psf: str = ""
    reference: str = ""
    recording: str = ""
    light_field: str = ""
    volume: str = ""
    redo: tuple[tuple[int, int, int], ...] = ()
    left_out: tuple[str, ...] = ()
    refused: tuple[str, ...] = ()

    def __eq__(self, other: object) -> bool:
        """Return whether all is the same, also where the camera's values come from: a file holds that, too."""
        if not isinstance(other, ProjectState):
            return NotImplemented
        same = all(getattr(self, name) == getattr(other, name) for name in ENTRIES)
        return same and self.camera.marks == other.camera.marks

    def to_json(self) -> str:
        """Return the state as JSON text."""
        data: dict[str, Any] = {name: getattr(self, name) for name in ENTRIES}
        data["camera"] = self.camera.to_dict()
        data["plan"] = None if self.plan is None else self.plan.to_dict()
        data["settings"] = dict(self.settings)
        return json.dumps({"format": FORMAT, "version": VERSION, **data}, indent=2, allow_nan=False)

    @classmethod
    def from_json(cls, text: str) -> ProjectState:
        """Return the state described by JSON ``text``; raise a one-line `FileFormatError` if it is invalid."""
        data = _parsed(text)
        try:
            data = _modern(data) if data["format"] == OLD_FORMAT else data
            given = {name: data[name] for name in ENTRIES}
        except (KeyError, TypeError, ValueError) as error:
            raise FileFormatError.expected("project", "every entry", f"{error}", "the file is incomplete") from None
        left_out: list[str] = []
        readers: dict[str, Callable[[Any], Any]] = {
            **{name: partial(_file, name, left_out=left_out) for name in FILES},
            "name": str,
            "camera": Camera.from_dict,
            "plan": lambda plan: None if plan is None else ScanPlan.from_dict(plan),
            "settings": lambda settings: dict(_local("settings", dict(settings), left_out)),
            "redo": lambda redo: tuple((int(z), int(y), int(x)) for z, y, x in redo),
        }
        found: dict[str, Any] = {}
        refused = []
        for name, read in readers.items():
            try:
                found[name] = read(given[name])
            except (LfcalError, KeyError, TypeError, ValueError) as error:
                # one bad value is no reason to lose all others
                refused.append(f"{name}: {error}")
        return cls(**found, left_out=tuple(left_out), refused=tuple(refused))


ENTRIES = tuple(f.name for f in fields(ProjectState) if f.name not in ("left_out", "refused"))
"""What a file of a project holds."""


def _local(name: str, value: Any, left_out: list[str]) -> Any:
    """Return a value without the paths on network shares in it, which are added to ``left_out``."""
    if isinstance(value, dict):
        return {key: _local(f"{name}.{key}", part, left_out) for key, part in value.items()}
    if isinstance(value, list):
        return [_local(name, part, left_out) for part in value]
    if isinstance(value, str) and on_network(value):
        left_out.append(f"{name} {value}")
        return ""
    return value


def _file(name: str, given: object, left_out: list[str]) -> Any:
    """Return the path of an entry, empty where it is on a network share."""
    return _local(name, _path(name, given), left_out)


def _path(name: str, given: object) -> str:
    """Return the path of an entry; raise where no file can have it, before anything looks for it."""
    path = str(given)
    if "\0" in path or len(path) > LONGEST_PATH or any(len(part) > 255 for part in Path(path).parts):
        wanted = f"a path of at most {LONGEST_PATH} characters, names of at most 255, without NUL"
        raise FileFormatError.expected(f"project: {name}", wanted, path, "correct the file")
    return path


def _parsed(text: str) -> dict[str, Any]:
    data = parse_json(text, "project", remedy="choose another file")
    known = ((FORMAT, VERSION), (OLD_FORMAT, 1))
    if not isinstance(data, dict) or (data.get("format"), data.get("version")) not in known:
        raise FileFormatError.expected("project", f"format {FORMAT} version {VERSION}", "another", "check it")
    return data


def _modern(data: dict[str, Any]) -> dict[str, Any]:
    """Return the entries of an old file with the present names. Settings of two pages had their own entries."""
    frames = dict(data["frames"])
    folder = frames.pop("folder")
    settings = {**data["extra"], "frames": frames, "simulate": dict(data["simulate"])}
    return {**data, "frames": folder, "settings": settings}


def read_project(path: Path) -> ProjectState:
    """Return the project in a file; raises `LfcalError` where there is none."""
    return ProjectState.from_json(read_text(path))


@dataclass(frozen=True)
class Hold:
    """What of a project must not change while a job runs.

    Attributes
    ----------
    reason
        Why, as shown to the user.
    fields, pages
        Fields of the state, and pages whose settings stay.
    tell
        Called with the reason when a change was refused.
    """

    reason: str
    fields: tuple[str, ...]
    pages: tuple[str, ...] = ()
    tell: Callable[[str], None] = lambda _: None

    def concerns(self, old: ProjectState, new: ProjectState) -> bool:
        """Return whether the change from ``old`` to ``new`` is of what stays, with where camera values come from."""
        if any(getattr(old, name) != getattr(new, name) for name in self.fields):
            return True
        if "camera" in self.fields and old.camera.marks != new.camera.marks:
            return True
        return any(old.settings.get(page) != new.settings.get(page) for page in self.pages)


Listener = Callable[[ProjectState, ProjectState], None]


class Project:
    """The current state with undo, saving and listeners; one per window."""

    def __init__(self, state: ProjectState | None = None, path: Path | None = None) -> None:
        self._state = state or ProjectState()
        self._saved = self._state
        self.path = path
        self._stamp = None if path is None else _stamp(path)
        self._past: list[tuple[str, ProjectState]] = []
        self._future: list[tuple[str, ProjectState]] = []
        self._listeners: list[Listener] = []
        self._hold: Hold | None = None
        self.begun = 0
        """Projects that were begun here: who waits for long knows whether it is still the same."""

    # -- state -----------------------------------------------------------------------------------------
    @property
    def state(self) -> ProjectState:
        """The current state."""
        return self._state

    @property
    def unsaved(self) -> bool:
        """Whether something changed since the project was saved or opened."""
        return self._state != self._saved

    def listen(self, listener: Listener) -> None:
        """Call ``listener(old, new)`` after every change."""
        self._listeners.append(listener)

    def update(self, label: str, **changes: Any) -> bool:
        """Change the state as a new step of undo; ``label`` names it in the menu. Return False where it was refused."""
        new = replace(self._state, **changes)
        if new == self._state:
            return True
        if self._refused(new):
            return False
        self._past.append((label, self._state))
        del self._past[:-UNDO_STEPS]
        self._future.clear()
        self._set(new)
        return True

    def merge(self, label: str, **changes: Any) -> None:
        """Change the state as part of the last change of the same label: a drag, or a number that is typed."""
        if not self._merges(label):
            self.update(label, **changes)
            return
        new = replace(self._state, **changes)
        if new == self._state or self._refused(new):
            return
        if new == self._past[-1][1]:  # the user reverted the change: nothing is left to undo
            self._past.pop()
        self._set(new)

    def note(self, **changes: Any) -> None:
        """Change the state without a step of undo: what a job found is nothing that the user did."""
        new = replace(self._state, **changes)
        if new != self._state and not self._refused(new):
            self._set(new)

    def before(self, label: str) -> ProjectState:
        """Return what undo would lead back to after `merge` with this label."""
        return self._past[-1][1] if self._merges(label) else self._state

    def _merges(self, label: str) -> bool:
        return bool(self._past) and self._past[-1][0] == label and not self._future

    # -- holding ---------------------------------------------------------------------------------------
    def hold(self, hold: Hold) -> None:
        """Refuse changes of what is held until `release`, or until another project is begun."""
        self._hold = hold

    def release(self) -> None:
        """Allow all changes again."""
        self._hold = None

    def held(self, state: ProjectState) -> str:
        """Return why the state cannot become ``state`` now; empty: it can."""
        hold = self._hold
        return "" if hold is None or not hold.concerns(self._state, state) else hold.reason

    def _refused(self, new: ProjectState) -> bool:
        reason = self.held(new)
        if reason and self._hold is not None:
            self._hold.tell(reason)
        return bool(reason)

    def _set(self, new: ProjectState) -> None:
        old, self._state = self._state, new
        for listener in list(self._listeners):
            listener(old, new)

    # -- undo ------------------------------------------------------------------------------------------
    @property
    def undo_label(self) -> str:
        """What undo would take back; empty: nothing."""
        return self._past[-1][0] if self._past else ""

    @property
    def redo_label(self) -> str:
        """What redo would bring back; empty: nothing."""
        return self._future[-1][0] if self._future else ""

    def undo(self) -> None:
        """Take back the last change."""
        if self._past and not self._refused(self._past[-1][1]):
            label, state = self._past.pop()
            self._future.append((label, self._state))
            self._set(state)

    def redo(self) -> None:
        """Bring back the change taken back last."""
        if self._future and not self._refused(self._future[-1][1]):
            label, state = self._future.pop()
            self._past.append((label, self._state))
            self._set(state)

    # -- files -----------------------------------------------------------------------------------------
    def save(self, path: Path | None = None) -> None:
        """Write the project to its file, whole or not at all."""
        target = path or self.path
        if target is None:
            raise FileFormatError("project: it has no file yet; choose a name")
        write_text(target, self._state.to_json())
        self.path, self._saved = target, self._state
        self._stamp = _stamp(target)

    @property
    def changed_on_disk(self) -> bool:
        """Whether another program has written the project's file since it was opened or saved here."""
        now = None if self.path is None else _stamp(self.path)
        return now is not None and now != self._stamp

    def open(self, path: Path) -> None:
        """Replace the state by that of a project file; the old one stays if the file cannot be read."""
        self.start(read_project(path), path)

    def start(self, state: ProjectState, path: Path | None = None, saved: ProjectState | None = None) -> None:
        """Begin with ``state``: nothing to undo; unsaved if its file holds something else (``saved``)."""
        self.begun += 1
        self._past.clear()
        self._future.clear()
        self.release()
        self.path, self._saved = path, state if saved is None else saved
        self._stamp = None if path is None else _stamp(path)
        self._set(state)


def _stamp(path: Path) -> tuple[int, int] | None:
    """Return what changes when a file is written, None where there is none."""
    try:
        found = path.stat()
    except OSError:
        return None
    return found.st_mtime_ns, found.st_size


class RecentProjects:
    """Projects opened lately, newest first, kept in a small file."""

    def __init__(self, store: Path, limit: int = 8) -> None:
        self.store, self.limit = store, limit

    def paths(self) -> list[Path]:
        """Return the projects that still exist."""
        try:
            listed = parse_json(read_text(self.store), "recent projects")
        except (OSError, ValueError):
            return []
        found = [Path(p) for p in listed if isinstance(p, str)] if isinstance(listed, list) else []
        return [p for p in found if p.is_file()][: self.limit]

    def add(self, path: Path) -> None:
        """Put ``path`` first; where the list cannot be written, as on a full disk, it stays as it is."""
        path = path.absolute()
        listed = [str(path), *(str(p) for p in self.paths() if p != path)][: self.limit]
        with suppress(LfcalError):
            write_text(self.store, json.dumps(listed))
