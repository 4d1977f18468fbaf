"""``session.json``: the description of a session, written completely at its start and after every run."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.acquire.frame_plan import FramePlan, frame_grid, read_frame_plan
from lfcal.acquire.options import Options
from lfcal.acquire.recording import Kind, RecordingFile, file_name
from lfcal.acquire.schedule import Schedule
from lfcal.base import (
    FileFormatError,
    InputError,
    LfcalError,
    StorageError,
    parse_json,
    read_text,
    stated_format,
    write_text,
)
from lfcal.camera import ScanPlan, build
from lfcal.devices import CheckedCamera, Rig
from lfcal.frames import Position

__all__ = ["Devices", "Run", "SessionFile", "frame_dtype", "keep_task", "kept_tasks", "optics_of"]

FORMAT = "lfcal-session"
VERSION = 1
TARGET_VERSION = 2
"""Version of a session of whole frames; all others are as in version 1."""
NAME = "session.json"


def keep_task(folder: Path, task: Mapping[str, Any], run: int = 0) -> None:
    """Write the task of recording ``run`` into the session's folder, as a job that `lfcal run` can continue.

    The job is a separate file, because older versions of lfcal reject a ``session.json`` with additional entries.
    """
    write_text(folder / _job_name(run), json.dumps({**task, "out": task.get("out", ".")}, indent=2))


def kept_tasks(folder: Path, recordings: int) -> tuple[dict[str, Any], ...]:
    """Return the tasks that made the first ``recordings`` recordings of a session, without their output paths.

    Recordings whose task is not stored or cannot be read are skipped.
    """
    found = []
    for path in (folder / _job_name(run) for run in range(recordings)):
        with suppress(LfcalError):  # frames can be used without knowing who asked for them
            data = parse_json(read_text(path), str(path)) if path.is_file() else None
            if isinstance(data, dict):
                found.append({key: value for key, value in data.items() if key != "out"})
    return tuple(found)


def _job_name(run: int) -> str:
    return "job.json" if run == 0 else f"job-{run + 1:03d}.json"


def optics_of(rig: Rig) -> str:
    """Return how the simulator of ``rig`` computes frames (`Devices.optics`); empty for a real camera."""
    return CheckedCamera.of(rig.camera).optics


@dataclass(frozen=True, slots=True)
class Devices:
    """Names of the devices of a session, and properties and settings that the camera reports.

    ``sensor_shape`` is (rows, columns), and ``max_value`` the sample value of a saturated pixel (counts). ``optics``
    states how frames of the simulator were computed: ``"pattern"``, or a level of `lfcal.simulate`. It is empty for
    real frames, and for sessions of older versions.

    ``settings`` maps the names of the settings by which the camera may change pixel values to their values at the
    start. ``automatic`` lists the settings with which samples are not proportional to light.
    """

    camera: str
    stage: str
    sensor_shape: tuple[int, int]
    bit_depth: int
    max_value: int
    optics: str = ""
    settings: Mapping[str, str] = field(default_factory=dict)
    automatic: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        """Check the settings, which may come from a file."""
        texts = isinstance(self.settings, Mapping) and all(isinstance(value, str) for value in self.settings.values())
        if not texts or not set(self.automatic) <= set(self.settings):
            remedy = "restore the file from a copy"
            raise FileFormatError.expected("devices.settings", "names, each with a text", self.settings, remedy)

    @property
    def automatic_words(self) -> str:
        """Names and values of the settings that make samples not proportional to light, as text; empty if none."""
        return ", ".join(f"{name} = {self.settings[name]}" for name in self.automatic)

    @classmethod
    def of(cls, rig: Rig) -> Devices:
        """Return the properties reported by the devices of ``rig``."""
        camera = CheckedCamera.of(rig.camera)
        found = camera.fixed_settings()
        return cls(
            camera.name,
            rig.stage.name,
            camera.sensor_shape,
            camera.bit_depth,
            camera.max_value,
            optics_of(rig),
            {name: str(setting.actual) for name, setting in found.items()},
            tuple(name for name, setting in found.items() if setting.requested not in (None, setting.actual)),
        )


@dataclass(frozen=True, slots=True)
class Run:
    """One run of a recording.

    ``started`` and ``ended`` are ISO 8601 times. ``how`` states how the run ended: ``"complete"``, ``"stopped"``,
    ``"aborted"``, ``"failed"`` (with the error as ``message``) or ``"interrupted"``. A run that has not ended yet, or
    whose program was terminated, is ``"interrupted"``. ``acknowledged`` is the number of positions whose frames are on
    disk, and ``seconds`` the duration without pauses (s).

    ``recording`` is the number of the recording, from 0. ``stage`` is the result of the stage check before the run, or
    why it was skipped. Older versions do not store these two: the number is then -1, and the text empty.
    """

    started: str
    ended: str = ""
    how: str = "interrupted"
    acknowledged: int = 0
    seconds: float = 0.0
    message: str = ""
    recording: int = -1
    stage: str = ""


@dataclass(frozen=True, slots=True)
class SessionFile:
    """Content of ``session.json``, which describes a recorded session.

    Attributes
    ----------
    identity
        Random identifier of the session, which is also stored in each of its recordings.
    plan, options, devices
        The plan, the settings, and the devices.
    recordings
        Names of the files with frames of positions, oldest first; if several files contain a position, the newest is
        used.
    redo
        Positions (z, y, x) of each recording; empty: all positions of the plan.
    runs
        All runs of the session.
    kept_aside
        Positions (z, y, x) whose patterns are held out from a fit to measure its quality.
    target
        The plan of a target whose whole frames are recorded; `plan` is then the scan that it replaces. None: single
        points.

    Examples
    --------
    >>> from pathlib import Path
    >>> from lfcal.acquire import SessionFile
    >>> session = SessionFile.read(Path("recorded"))
    >>> print(session.plan.period, session.recordings, session.devices.camera)
    (19, 33) ('recording.h5',) simulated camera
    """

    identity: str
    plan: ScanPlan
    options: Options
    devices: Devices
    recordings: tuple[str, ...] = ("recording.h5",)
    redo: tuple[tuple[tuple[int, ...], ...], ...] = ((),)
    runs: tuple[Run, ...] = ()
    kept_aside: tuple[tuple[int, ...], ...] = ()
    target: FramePlan | None = None

    @property
    def grid(self) -> tuple[int, int, int]:
        """Shape ``(nz, ny, nx)`` of the grid of positions; for whole frames, see `frame_grid`."""
        return self.plan.shape[:3] if self.target is None else frame_grid(self.target)

    @property
    def positions(self) -> int:
        """Total number of positions of the plan; for a target, of its frames."""
        return self.plan.n_positions if self.target is None else len(self.target.frames)

    @property
    def chosen(self) -> NDArray[np.bool_]:
        """Mask ``(nz, ny, nx)``, True at the positions to record: the whole grid unless positions were selected."""
        chosen = np.full(self.grid, not self.redo[0])
        if self.redo[0]:
            chosen[tuple(np.array([at for part in self.redo for at in part]).T)] = True
        return chosen

    def acknowledged(self, folder: Path) -> NDArray[np.bool_]:
        """Return a mask ``(nz, ny, nx)``, True at positions with an acknowledged frame in the files in ``folder``."""
        there = np.zeros(math.prod(self.grid), np.bool_)
        for name in self.recordings:
            with RecordingFile(folder / name) as file:
                flat = file.records["index"][file.taken]
                there[flat[flat < there.size]] = True
        return there.reshape(self.grid)

    def schedule(self, run: int) -> Schedule:
        """Return the steps of the recording with index ``run``."""
        if self.target is not None:
            own = [Position(*p) for p in self.redo[run]]
            return Schedule.of_frames(self.target, self.options, own or None)
        whole = Schedule.of(self.plan, self.options)
        if not self.redo[run]:  # an empty list means all positions
            return whole
        own = [Position(*p) for p in self.redo[run]]
        # the first recording brings what belongs to a session: darks, and controls
        part = Schedule.of(self.plan, self.options, only=own) if run == 0 else Schedule.of(self.plan, self.options, own)
        # the same region of the sensor is read out in all, so that only the position is taken again
        return replace(part, roi=whole.roi)

    def attributes(self, run: int, schedule: Schedule) -> dict[str, Any]:
        """Return the attributes of the files of the recording with index ``run``, which has the steps ``schedule``.

        They state the identity of the session, the region of the sensor, and the number of the recording.
        """
        roi = schedule.roi
        # the region is needed to place dark frames on the sensor
        return {"session": self.identity, "roi": [roi.row, roi.column, roi.rows, roi.columns], "run": run}

    def was_complete(self, run: int) -> bool:
        """Return whether the recording with index ``run`` is known to have been completed."""
        count = len(set(self.redo[run])) or self.positions
        # another recording may have had as many positions
        own = [past for past in self.runs if past.recording in (run, -1)]
        return any(past.how == "complete" and past.acknowledged == count for past in own)

    def write(self, folder: Path) -> None:
        """Write ``session.json`` to ``folder``; a failed write leaves the previous file unchanged."""
        data: dict[str, Any] = {
            "format": FORMAT,
            "version": VERSION,
            "identity": self.identity,
            "plan": self.plan.to_dict(),
            "options": self.options.to_dict(),
            "devices": _noted(self.devices),
            "recordings": self.recordings,
            "redo": self.redo,
            "runs": [asdict(run) for run in self.runs],
        }
        for run in data["runs"]:
            if len(self.recordings) == 1:  # there is no other
                del run["recording"]
            if not run["stage"]:
                del run["stage"]
        if self.kept_aside:  # sessions without them stay as older versions read them
            data["kept_aside"] = self.kept_aside
        if self.target is not None:  # so that an older version does not mistake whole frames for those of single points
            data |= {"version": TARGET_VERSION, "target": self.target.to_dict()}
        if not folder.is_dir():
            raise StorageError(
                f"{folder}: the session folder is missing; restore it from a copy, or start a new session"
            )
        write_text(folder / NAME, json.dumps(data, indent=2, allow_nan=False))

    @classmethod
    def read(cls, folder: Path) -> SessionFile:
        """Read the session in ``folder``.

        Raises `StorageError` if there is none, and `FileFormatError` if its file is damaged or of another version.
        """
        path = folder / NAME
        if not path.exists():
            raise StorageError.expected(str(folder), "a session folder", f"no {NAME} in it", "check the path")
        data: Any = parse_json(read_text(path), str(path), remedy="restore it from a copy")
        version = data.get("version") if isinstance(data, Mapping) else None
        if version not in (VERSION, TARGET_VERSION) or data.get("format") != FORMAT:
            wanted = f'"format": "{FORMAT}", version {VERSION} or {TARGET_VERSION}'
            raise FileFormatError.expected(str(path), wanted, stated_format(data), "choose the folder of a session")
        if (version == TARGET_VERSION) != ("target" in data):
            got = "none" if version == TARGET_VERSION else f"one in version {version}"
            wanted = f"a target in version {TARGET_VERSION}, and only there"
            raise FileFormatError.expected(str(path), wanted, got, "restore it from a copy")
        body = {"kept_aside": (), "target": None, **data}
        del body["format"], body["version"]
        body["runs"] = _runs(body.get("runs"), body.get("recordings"))
        try:
            body["plan"] = ScanPlan.from_dict(body["plan"])
            body["options"] = Options.from_dict(body["options"])
            if isinstance(body["devices"], Mapping):
                body["devices"] = {"optics": "", "settings": {}, "automatic": [], **body["devices"]}
            if body["target"] is not None:
                body["target"] = read_frame_plan(body["target"])
                if body["target"].scan != body["plan"]:
                    raise FileFormatError.expected(
                        f"{path}: plan", "that of the target", "a different plan", "restore the file from a copy"
                    )
            session = build(cls, body, "session")
        except KeyError as error:
            raise FileFormatError.expected(
                str(path), f"entry {error}", "none", "restore the file from a copy"
            ) from None
        # names follow from the numbers; others would let a file lead out of the session's folder
        names = tuple(file_name(Kind.POSITION, run) for run in range(len(session.recordings)))
        if not names or session.recordings != names or len(session.redo) != len(names):
            raise FileFormatError.expected(
                f"{path}: recordings", names or "recording.h5", session.recordings, "restore the file from a copy"
            )
        return replace(
            session,
            redo=tuple(tuple(tuple(int(v) for v in p) for p in positions) for positions in session.redo),
            kept_aside=tuple(tuple(int(v) for v in p) for p in session.kept_aside),
        )

    def _comparable(self, devices: Devices) -> Devices:
        """Return the current ``devices`` without entries that the session lacks, or that change automatically."""
        noted = self.devices
        if not noted.optics:  # an older version did not note them
            devices = replace(devices, optics="")
        if not noted.settings:
            return replace(devices, settings={}, automatic=())
        if noted.automatic and noted.automatic == devices.automatic:
            return replace(devices, settings=noted.settings)
        return devices

    def check_same(self, plan: ScanPlan | FramePlan, options: Options, devices: Devices) -> None:
        """Raise `InputError` unless a resumed run has the plan and devices of the session.

        Of the options, only those that affect the layout of the recording must be the same.
        """
        found = _difference((self.target or self.plan).to_dict(), plan.to_dict(), "plan")
        if found is None:
            names = self.options.differences(options)
            if names:
                name = names[0]
                found = f"option {name}", getattr(self.options, name), getattr(options, name)
        if found is None:
            found = _difference(asdict(self.devices), asdict(self._comparable(devices)), "devices")
        if found is not None:
            what, expected, got = found
            raise InputError.expected(
                f"resumed session: {what}",
                f"{expected} as recorded",
                got,
                "record with the same plan and devices, or start a new session folder",
            )


def _noted(devices: Devices) -> dict[str, Any]:
    """Return the entry on devices in ``session.json``, without empty values, so that older versions can read it."""
    late = ("optics", "settings", "automatic")
    return {key: value for key, value in asdict(devices).items() if value or key not in late}


def _runs(runs: Any, recordings: Any) -> Any:
    """Return the entries of runs, completed by the entries that older versions lack (recording and stage)."""
    only = 0 if isinstance(recordings, list) and len(recordings) == 1 else -1
    if not isinstance(runs, list):
        return runs
    return [{"recording": only, "stage": "", **run} if isinstance(run, Mapping) else run for run in runs]


def frame_dtype(plan: ScanPlan, options: Options, devices: Devices) -> np.dtype[Any]:
    """Return the sample type of recorded frames other than dark frames, which are float32.

    It is uint8 or uint16, as for the camera, or float32 if several exposures are combined.
    """
    if not options.plain or plan.frames_averaged > 1:
        return np.dtype(np.float32)
    return np.dtype(np.uint8 if devices.bit_depth <= 8 else np.uint16)


def _difference(old: Any, new: Any, what: str) -> tuple[str, Any, Any] | None:
    """Return the first place where two JSON values differ, as (name, old, new)."""
    # written to JSON and back, tuples become lists on both sides
    old, new = (json.loads(json.dumps(value)) for value in (old, new))
    if isinstance(old, dict) and isinstance(new, dict):
        # an entry that one side alone has is a difference too
        for key in [*old, *(k for k in new if k not in old)]:
            found = _difference(old.get(key), new.get(key), f"{what}.{key}")
            if found:
                return found
        return None
    return None if old == new else (what, old, new)
