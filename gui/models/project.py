"""The one session a window works on: what the user described and which files belong to it. No Qt, no arrays."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field, fields, replace
from pathlib import Path
from typing import Any

from lfcal.camera import Camera, ScanPlan, preset
from lfcal.errors import FileFormatError, LfcalError
from lfcal.files import replace_whole, storage_errors

__all__ = ["FrameSettings", "RecentSessions", "Session", "SessionState", "SimulateSettings"]

FORMAT = "lfcal-session"
VERSION = 1
UNDO_STEPS = 200


@dataclass(frozen=True)
class FrameSettings:
    """Which frames are imported and how they are cleaned and cut."""

    folder: str = ""
    manifest: str = ""
    pattern: str = ""
    dark: str = ""
    white: str = ""
    use_dark: bool = True
    use_white: bool = True
    use_defects: bool = False
    use_background: bool = False
    interpolation: str = "nearest"


@dataclass(frozen=True)
class SimulateSettings:
    """What the simulation is asked for."""

    tolerance: float = 0.05
    level: str = "auto"
    overrides: tuple[tuple[str, str], ...] = ()

    def override(self, effect: str) -> str:
        """Return ``"auto"``, ``"on"`` or ``"off"`` for an effect."""
        return dict(self.overrides).get(effect, "auto")

    def with_override(self, effect: str, choice: str) -> SimulateSettings:
        """Return the settings with one effect's choice changed."""
        rest = {k: v for k, v in self.overrides if k != effect}
        if choice != "auto":
            rest[effect] = choice
        return replace(self, overrides=tuple(sorted(rest.items())))


@dataclass(frozen=True)
class SessionState:
    """Everything a saved session holds.

    Attributes
    ----------
    name
        For people.
    camera, plan
        What the user described; the plan is None until it is first made.
    frames, simulate
        Settings of those stages.
    psf, reference, recording, light_field, volume
        Files that belong to the session: H, an H to compare with, a recording in progress, a light field
        to reconstruct and its reconstruction. Empty: none yet.
    redo
        Positions (z, y, x) to be recorded again.
    extra
        Settings of further stages, as plain JSON types by stage.
    """

    name: str = "untitled"
    camera: Camera = field(default_factory=lambda: preset("bench"))
    plan: ScanPlan | None = None
    frames: FrameSettings = FrameSettings()
    simulate: SimulateSettings = SimulateSettings()
    psf: str = ""
    reference: str = ""
    recording: str = ""
    light_field: str = ""
    volume: str = ""
    redo: tuple[tuple[int, int, int], ...] = ()
    extra: Mapping[str, Any] = field(default_factory=dict)

    def to_json(self) -> str:
        """Return the state as JSON text."""
        data: dict[str, Any] = {f.name: getattr(self, f.name) for f in fields(self)}
        data["camera"] = self.camera.to_dict()
        data["plan"] = None if self.plan is None else self.plan.to_dict()
        data["frames"] = asdict(self.frames)
        data["simulate"] = asdict(self.simulate)
        data["extra"] = dict(self.extra)
        return json.dumps({"format": FORMAT, "version": VERSION, **data}, indent=2, allow_nan=False)

    @classmethod
    def from_json(cls, text: str) -> SessionState:
        """Return the state described by JSON ``text``; raise `FileFormatError` in one line if it is none."""
        try:
            data = json.loads(text)
        except (ValueError, RecursionError) as error:
            raise FileFormatError.expected("session", "JSON text", str(error), "choose another file") from None
        if not isinstance(data, dict) or data.get("format") != FORMAT or data.get("version") != VERSION:
            raise FileFormatError.expected("session", f"format {FORMAT} version {VERSION}", "another", "check it")
        try:
            simulate = dict(data["simulate"])
            simulate["overrides"] = tuple((str(k), str(v)) for k, v in simulate["overrides"])
            return cls(
                name=str(data["name"]),
                camera=Camera.from_dict(data["camera"]),
                plan=None if data["plan"] is None else ScanPlan.from_dict(data["plan"]),
                frames=FrameSettings(**data["frames"]),
                simulate=SimulateSettings(**simulate),
                redo=tuple((int(z), int(y), int(x)) for z, y, x in data["redo"]),
                extra=dict(data["extra"]),
                **{k: str(data[k]) for k in ("psf", "reference", "recording", "light_field", "volume")},
            )
        except (KeyError, TypeError, ValueError) as error:
            if isinstance(error, LfcalError):
                raise
            raise FileFormatError.expected("session", "every entry", f"{error}", "the file is incomplete") from None


Listener = Callable[[SessionState, SessionState], None]


class Session:
    """The current state with undo, saving and listeners; one per window."""

    def __init__(self, state: SessionState | None = None, path: Path | None = None) -> None:
        self._state = state or SessionState()
        self._saved = self._state
        self.path = path
        self._past: list[tuple[str, SessionState]] = []
        self._future: list[tuple[str, SessionState]] = []
        self._listeners: list[Listener] = []

    # -- state -----------------------------------------------------------------------------------------
    @property
    def state(self) -> SessionState:
        """The current state."""
        return self._state

    @property
    def unsaved(self) -> bool:
        """Whether something changed since the session was saved or opened."""
        return self._state != self._saved

    def listen(self, listener: Listener) -> None:
        """Call ``listener(old, new)`` after every change."""
        self._listeners.append(listener)

    def update(self, label: str, **changes: Any) -> None:
        """Change the state; ``label`` names the change in the undo menu.

        Changes with the label of the last one replace it in the undo list only if they touch the same
        entries at once, as dragging a slider does.
        """
        new = replace(self._state, **changes)
        if new == self._state:
            return
        self._past.append((label, self._state))
        del self._past[:-UNDO_STEPS]
        self._future.clear()
        self._set(new)

    def merge(self, label: str, **changes: Any) -> None:
        """Change the state as part of the last change of the same label (a drag is one step of undo)."""
        if self._past and self._past[-1][0] == label and not self._future:
            new = replace(self._state, **changes)
            if new != self._state:
                self._set(new)
        else:
            self.update(label, **changes)

    def _set(self, new: SessionState) -> None:
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
        if self._past:
            label, state = self._past.pop()
            self._future.append((label, self._state))
            self._set(state)

    def redo(self) -> None:
        """Bring back the change taken back last."""
        if self._future:
            label, state = self._future.pop()
            self._past.append((label, self._state))
            self._set(state)

    # -- files -----------------------------------------------------------------------------------------
    def save(self, path: Path | None = None) -> None:
        """Write the session to its file, whole or not at all."""
        target = path or self.path
        if target is None:
            raise FileFormatError("session: it has no file yet; choose a name")
        with replace_whole(target) as part:
            part.write_text(self._state.to_json(), encoding="utf-8")
        self.path, self._saved = target, self._state

    def autosave(self, path: Path) -> None:
        """Write the state to ``path`` without calling it saved."""
        with replace_whole(path) as part:
            part.write_text(self._state.to_json(), encoding="utf-8")

    def open(self, path: Path) -> None:
        """Replace the state by that of a session file; the old one stays if the file cannot be read."""
        with storage_errors(path):
            text = path.read_text(encoding="utf-8", errors="replace")
        self.start(SessionState.from_json(text), path)

    def start(self, state: SessionState, path: Path | None = None) -> None:
        """Begin with ``state``: nothing to undo, nothing unsaved."""
        self._past.clear()
        self._future.clear()
        self.path, self._saved = path, state
        self._set(state)


class RecentSessions:
    """Sessions opened lately, newest first, kept in a small file."""

    def __init__(self, store: Path, limit: int = 8) -> None:
        self.store, self.limit = store, limit

    def paths(self) -> list[Path]:
        """Return the sessions that still exist."""
        try:
            listed = json.loads(self.store.read_text(encoding="utf-8"))
        except (OSError, ValueError):
            return []
        found = [Path(p) for p in listed if isinstance(p, str)] if isinstance(listed, list) else []
        return [p for p in found if p.is_file()][: self.limit]

    def add(self, path: Path) -> None:
        """Put ``path`` first."""
        path = path.absolute()
        listed = [str(path), *(str(p) for p in self.paths() if p != path)][: self.limit]
        with replace_whole(self.store) as part:
            part.write_text(json.dumps(listed), encoding="utf-8")
