"""The project of a window: the user's description and the files that belong to it. No Qt, no arrays."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, fields, replace
from functools import partial
from pathlib import Path
from typing import Any

from lfcal.base import FileFormatError, LfcalError, on_network, parse_json, read_text, stated_format, write_text
from lfcal.camera import Camera, ScanPlan, preset

FORMAT = "lfcal-project"
VERSION = 1
OLD_FORMAT = "lfcal-session"
"""Earlier format (version 1), which can be read and is saved in the current format."""

FILES = ("frames", "psf", "reference", "recording", "light_field", "volume")
UNDO_STEPS = 200

LONGEST_PATH = 4095


@dataclass(frozen=True)
class ProjectState:
    """Content of a saved project.

    Attributes
    ----------
    name
        Displayed name.
    camera, plan
        Camera description and scan plan; the plan is None until it is first made.
    settings
        Settings of each page by its key, as plain JSON types; see `lfcal_gui.models.settings.PageSettings`.
    frames, psf, reference, recording, light_field, volume
        Files and folders that belong to the project: imported frames, H, an H to compare with, a recorded session,
        a light field to reconstruct and its reconstruction. Empty: none yet.
    redo
        Positions (z, y, x) to record again.
    left_out
        Paths on network shares in the file of the project, as ``"psf //server/share/H.h5"``. They are ignored, since
        Windows logs on to any server that a path names. Not saved.
    refused
        Reasons why entries of the file were refused, one line each; defaults replace them. Not saved.
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
        """Return whether all saved entries are equal, including the sources of camera values."""
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
        except KeyError as error:
            raise FileFormatError.expected(
                "project", f"the entry {error}", "none", "the file is incomplete; choose another project file"
            ) from None
        except (TypeError, ValueError):
            raise FileFormatError.expected(
                "project", "the entries of a project", "damaged entries", "choose another project file"
            ) from None
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
"""Names of the entries of a project file."""


def _local(name: str, value: Any, left_out: list[str]) -> Any:
    """Return a value without its paths on network shares, which are added to ``left_out``."""
    if isinstance(value, dict):
        return {key: _local(f"{name}.{key}", part, left_out) for key, part in value.items()}
    if isinstance(value, list):
        return [_local(name, part, left_out) for part in value]
    if isinstance(value, str) and on_network(value):
        left_out.append(f"{name} {value}")
        return ""
    return value


def _file(name: str, given: object, left_out: list[str]) -> Any:
    """Return the path of an entry; empty if it is on a network share."""
    return _local(name, _path(name, given), left_out)


def _path(name: str, given: object) -> str:
    """Return the path of an entry; raise `InputError` if it is not a valid path."""
    path = str(given)
    if "\0" in path or len(path) > LONGEST_PATH or any(len(part) > 255 for part in Path(path).parts):
        wanted = f"a path of at most {LONGEST_PATH} characters, names of at most 255, without NUL"
        raise FileFormatError.expected(f"project: {name}", wanted, path, "correct this path in the project file")
    return path


def _parsed(text: str) -> dict[str, Any]:
    data = parse_json(text, "project", remedy="choose another file")
    known = ((FORMAT, VERSION), (OLD_FORMAT, 1))
    if not isinstance(data, dict) or (data.get("format"), data.get("version")) not in known:
        raise FileFormatError.expected(
            "project",
            f"format {FORMAT} version {VERSION}",
            stated_format(data),
            "choose a project file of this version",
        )
    return data


def _modern(data: dict[str, Any]) -> dict[str, Any]:
    """Return the entries of an old file under their current names; settings of two pages were separate entries."""
    frames = dict(data["frames"])
    folder = frames.pop("folder")
    settings = {**data["extra"], "frames": frames, "simulate": dict(data["simulate"])}
    return {**data, "frames": folder, "settings": settings}


def read_project(path: Path) -> ProjectState:
    """Return the project in a file; raise `LfcalError` if it contains none."""
    return ProjectState.from_json(read_text(path))


@dataclass(frozen=True)
class Hold:
    """Part of a project that must not change while a job runs.

    Attributes
    ----------
    reason
        Reason shown to the user.
    fields, pages
        Fields of the state, and keys of pages whose settings must not change.
    report
        Called with the reason when a change was refused.
    """

    reason: str
    fields: tuple[str, ...]
    pages: tuple[str, ...] = ()
    report: Callable[[str], None] = lambda _: None

    def concerns(self, old: ProjectState, new: ProjectState) -> bool:
        """Return whether the change from ``old`` to ``new`` affects what must not change."""
        if any(getattr(old, name) != getattr(new, name) for name in self.fields):
            return True
        if "camera" in self.fields and old.camera.marks != new.camera.marks:
            return True
        return any(old.settings.get(page) != new.settings.get(page) for page in self.pages)


Listener = Callable[[ProjectState, ProjectState], None]


class Project:
    """Current state of the project with undo, saving and listeners; one per window."""

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
        """Number of projects opened so far, with which delayed results check that the project is still the same."""

    # -- state -----------------------------------------------------------------------------------------
    @property
    def state(self) -> ProjectState:
        """The current state."""
        return self._state

    @property
    def unsaved(self) -> bool:
        """Whether the project changed since it was saved or opened."""
        return self._state != self._saved

    def listen(self, listener: Listener) -> None:
        """Call ``listener(old, new)`` after every change."""
        self._listeners.append(listener)

    def update(self, label: str, **changes: Any) -> bool:
        """Change the state as an undo step named ``label`` in the menu; return False if the change was refused."""
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
        """Change the state; if the last change has the same label, as in a drag, both are one undo step."""
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
        """Change the state without an undo step, for results of jobs."""
        new = replace(self._state, **changes)
        if new != self._state and not self._refused(new):
            self._set(new)

    def before(self, label: str) -> ProjectState:
        """Return the state that undo would restore after `merge` with this label."""
        return self._past[-1][1] if self._merges(label) else self._state

    def _merges(self, label: str) -> bool:
        return bool(self._past) and self._past[-1][0] == label and not self._future

    # -- holding ---------------------------------------------------------------------------------------
    def hold(self, hold: Hold) -> None:
        """Refuse changes of the given part until `release`, or until another project starts."""
        self._hold = hold

    def release(self) -> None:
        """Allow all changes again."""
        self._hold = None

    def held(self, state: ProjectState) -> str:
        """Return why the state cannot change to ``state`` now; empty if it can."""
        hold = self._hold
        return "" if hold is None or not hold.concerns(self._state, state) else hold.reason

    def _refused(self, new: ProjectState) -> bool:
        reason = self.held(new)
        if reason and self._hold is not None:
            self._hold.report(reason)
        return bool(reason)

    def _set(self, new: ProjectState) -> None:
        old, self._state = self._state, new
        for listener in list(self._listeners):
            listener(old, new)

    # -- undo ------------------------------------------------------------------------------------------
    @property
    def undo_label(self) -> str:
        """Label of the change that undo would revert; empty if there is none."""
        return self._past[-1][0] if self._past else ""

    @property
    def redo_label(self) -> str:
        """Label of the change that redo would repeat; empty if there is none."""
        return self._future[-1][0] if self._future else ""

    def undo(self) -> None:
        """Revert the last change."""
        if self._past and not self._refused(self._past[-1][1]):
            label, state = self._past.pop()
            self._future.append((label, self._state))
            self._set(state)

    def redo(self) -> None:
        """Repeat the change reverted last."""
        if self._future and not self._refused(self._future[-1][1]):
            label, state = self._future.pop()
            self._past.append((label, self._state))
            self._set(state)

    # -- files -----------------------------------------------------------------------------------------
    def save(self, path: Path | None = None) -> None:
        """Write the project to its file (atomically)."""
        target = path or self.path
        if target is None:
            raise FileFormatError("project: not saved to a file yet; choose a file name")
        write_text(target, self._state.to_json())
        self.path, self._saved = target, self._state
        self._stamp = _stamp(target)

    @property
    def changed_on_disk(self) -> bool:
        """Whether another program wrote the project's file since it was opened or saved here."""
        now = None if self.path is None else _stamp(self.path)
        return now is not None and now != self._stamp

    def open(self, path: Path) -> None:
        """Replace the state by the state in a project file; keep it if the file cannot be read."""
        self.start(read_project(path), path)

    def start(self, state: ProjectState, path: Path | None = None, saved: ProjectState | None = None) -> None:
        """Start with ``state`` and an empty undo history; it is unsaved if it differs from ``saved``."""
        self.begun += 1
        self._past.clear()
        self._future.clear()
        self.release()
        self.path, self._saved = path, state if saved is None else saved
        self._stamp = None if path is None else _stamp(path)
        self._set(state)


def _stamp(path: Path) -> tuple[int, int] | None:
    """Return a stamp that changes when the file is written; None if there is no file."""
    try:
        found = path.stat()
    except OSError:
        return None
    return found.st_mtime_ns, found.st_size


class RecentProjects:
    """Recently opened projects, newest first, stored in a small file."""

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
        """Put ``path`` first; if the list cannot be written, as on a full disk, it does not change."""
        path = path.absolute()
        listed = [str(path), *(str(p) for p in self.paths() if p != path)][: self.limit]
        with suppress(LfcalError):
            write_text(self.store, json.dumps(listed))
