"""Read a recorded session as frames: cutouts with their positions on the sensor, or whole frames of a target."""

from __future__ import annotations

import weakref
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfcal.acquire.recording._recorded import RecordedFile
from lfcal.acquire.recording.recording_file import RecordingFile
from lfcal.acquire.recording.records import Kind, Suspicion, file_name, suspicions
from lfcal.acquire.schedule import Schedule
from lfcal.acquire.session_file import Devices, SessionFile, frame_dtype, kept_tasks
from lfcal.base import FileFormatError, InputError, Region, StorageError, check_region, position_at
from lfcal.camera import ScanPlan
from lfcal.frames import (
    ArraySource,
    Dark,
    FrameInfo,
    FrameMetadata,
    Frames,
    FrameSource,
    LeftOut,
    Noise,
    Position,
    Samples,
    average_frames,
    check_index,
    frame_errors,
    stated_noise,
)
from lfcal.frames.corrections import difference_variance
from lfcal.frames.formats import codec_fact

if TYPE_CHECKING:
    from lfcal.targets import Phases, TargetPlan

__all__ = ["CheckFrame", "RecordingSource", "TargetRecording", "read_checks", "sampled_references"]

SAMPLED = 32
"""Largest number of reference frames of a recording that are read to determine the light of an earlier run."""


@dataclass(frozen=True)
class RecordedDarks:
    """Mean dark frames by exposure (s), the excluded frames, and the exposures (s) without an intact dark frame."""

    darks: dict[float, Dark] = field(default_factory=dict)
    left_out: tuple[LeftOut, ...] = ()
    lost: tuple[float, ...] = ()


def read_darks(folder: Path, session: SessionFile, schedule: Schedule, *, skip_damaged: bool = False) -> RecordedDarks:
    """Return the dark frames of a session; empty if none were planned.

    Parameters
    ----------
    folder, session, schedule
        Folder and file of the session, and the steps of its first recording.
    skip_damaged
        Whether to average the intact frames and list the damaged ones.

    Raises
    ------
    FileFormatError, StorageError
        If a dark frame is damaged or the file of dark frames is missing, unless ``skip_damaged``.
    """
    if not schedule.count(Kind.DARK):
        return RecordedDarks()
    file = RecordedFile(folder, session, 0, schedule, Kind.DARK)
    darks: dict[float, Dark] = {}
    left_out: list[LeftOut] = []
    lost: list[float] = []
    try:
        if not skip_damaged:
            file.check()
        # nanoseconds: the same exposure read back twice may differ in its last bits
        exposures = np.round(file.records["exposure_s"], 9)
        for seconds in np.unique(exposures[file.there]).tolist():
            slots = np.flatnonzero(file.there & (exposures == seconds)).tolist()
            frames = _whole(file, slots, left_out, skip_damaged)
            if frames:
                first = file.records[next(iter(frames))]
                place = (int(first["row"]), int(first["column"]))
                # each frame in the file is the mean of the requested number of exposures
                count = len(frames) * session.options.darks
                shown = list(frames.values())
                pairs = [difference_variance(*pair) for pair in pairwise(shown)]
                variance = session.options.darks * float(np.mean(pairs)) if pairs else None
                darks[float(seconds)] = Dark(average_frames(shown), origin=place, count=count, variance=variance)
            else:
                lost.append(float(seconds))
    finally:
        file.close()
    return RecordedDarks(darks, tuple(left_out), tuple(lost))


def _whole(
    file: RecordedFile, slots: list[int], left_out: list[LeftOut], skip_damaged: bool
) -> dict[int, NDArray[np.float32]]:
    """Return the intact frames by slot, and add the others to ``left_out``."""
    frames = {}
    for slot in slots:
        try:
            frames[slot] = file.read(slot)
        except (FileFormatError, StorageError) as error:
            if not skip_damaged:
                raise type(error)(f"dark frame: {error}, or leave it out (--skip-damaged)") from error
            left_out.append(LeftOut(file.label(slot), None, str(error)))
    return frames


class RecordingSource(Frames):
    """Frame source that reads the frames of a session that are safe on disk.

    If a position was repeated, its latest frame is used. Frames are cutouts, and `info` states their position on the
    sensor. ``metadata`` contains the session's ``plan``, the camera's bit depth and saturation, and the recorded
    ``darks``, by exposure time (s).

    Parameters
    ----------
    folder
        Folder of the session, which may still be in progress.
    planes
        Indices of the depth planes to use; the source numbers them from 0 in this order. None: all.
    skip_damaged
        Whether to open damaged files, and to average only the intact dark frames. Damaged frames remain in the source,
        but reading them raises an error; `lfcal.frames.iter_undamaged` removes them. A damaged frame is not replaced by
        an older frame of the same position.

    Raises
    ------
    StorageError, FileFormatError
        If the folder contains no session, or one of its files is damaged (see ``skip_damaged``).
    InputError
        If no frame was recorded, or the session contains whole frames of a target (open it with `TargetRecording`).
    """

    of_whole_frames = False

    def __init__(self, folder: Path, *, planes: Sequence[int] | None = None, skip_damaged: bool = False) -> None:
        self.session = session = SessionFile.read(folder)
        if (session.target is not None) != self.of_whole_frames:
            kinds = ("cutouts of a single point", "whole frames of a target")
            raise InputError.expected(
                str(folder),
                f"a session of {kinds[self.of_whole_frames]}",
                kinds[not self.of_whole_frames],
                "open it with lfcal.frames.open_frames",
            )
        self._shape3 = session.grid
        self.plan = session.plan if planes is None else _part_of(session.plan, planes)
        self._planes = {z: k for k, z in enumerate(range(self._shape3[0]) if planes is None else planes)}
        self._folder = folder
        self._stack = ExitStack()
        try:
            schedules = [session.schedule(run) for run in range(len(session.recordings))]
            self._frame_shape = schedules[0].window
            self._files: list[RecordedFile] = []
            for run, schedule in enumerate(schedules):
                file = RecordedFile(folder, session, run, schedule, Kind.POSITION)
                self._stack.callback(file.close)
                self._files.append(file)
            self._where, self._slots, self._flat = self._newest(planes)
            if not skip_damaged:
                for k in np.unique(self._where).tolist():  # ignore files whose positions were all recorded again
                    self._files[k].check()
            self._darks = read_darks(folder, session, schedules[0], skip_damaged=skip_damaged)
        except BaseException:
            self._stack.close()
            raise
        self._finalizer = weakref.finalize(self, self._stack.close)  # a released source closes its files

    def _newest(self, planes: Sequence[int] | None) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any]]:
        """Return file, slot and flat position of the newest frame of every recorded position, damaged or not."""
        count = self._shape3[0] * self._shape3[1] * self._shape3[2]
        where = np.full(count, -1)
        slots = np.zeros(count, np.int64)
        # oldest first, so that a later recording overwrites the entries of an earlier one
        for k, file in enumerate(self._files):
            held = np.flatnonzero(file.there & (file.records["index"] < count))
            flat = file.records["index"][held]
            where[flat], slots[flat] = k, held
        there = where >= 0
        if planes is not None:
            size = self._shape3[1] * self._shape3[2]
            there &= np.isin(np.arange(count) // size, planes)
        flat = np.flatnonzero(there)
        if not flat.size:
            raise InputError.expected(
                "recording", "frames of at least one position", "none", ("record the session first")
            )
        return where[flat], slots[flat], flat

    @property
    def shape(self) -> tuple[int, int]:
        """Shape ``(rows, columns)`` of every frame (px)."""
        return self._frame_shape

    @property
    def dtype(self) -> np.dtype[Any]:
        """Sample type of every frame."""
        return frame_dtype(self.session.plan, self.session.options, self.session.devices)

    @cached_property
    def metadata(self) -> FrameMetadata:
        """Metadata common to all frames."""
        return self._known()

    def _known(self) -> FrameMetadata:
        devices, found = self.session.devices, self._darks
        return FrameMetadata(
            bit_depth=devices.bit_depth,
            saturation=float(devices.max_value),
            devices=_devices(devices),
            session=self.session.identity,
            plan=self.plan,
            plan_shape=self.plan.shape[:3],
            path=str(self._folder),
            codec=codec_fact("recording"),
            darks=found.darks,
            lost_darks=found.lost,
            left_out=found.left_out,
            noise=self._noise_of_means(),
            suspect=[[*position, what.words] for position, what in self.suspects()],
            kept_aside=self._kept_aside(),
            optics=devices.optics,
            earlier_tasks=kept_tasks(self._folder, len(self.session.recordings)),
        )

    def _kept_aside(self) -> list[list[int]]:
        """Return the positions to hold out from a fit; empty unless the session records selected positions."""
        whole = self.session.plan.shape == self.plan.shape
        return [list(p) for p in self.session.kept_aside] if whole and self.session.redo[0] else []

    def _noise_of_means(self) -> Noise | None:
        """Return the noise of frames that are means of equal exposures; None for single and for bracketed exposures."""
        count = self.plan.frames_averaged
        if count < 2 or not self.session.options.plain:
            return None
        noise = stated_noise(self.plan.camera)
        return None if noise is None else noise.of_mean(count)

    def __len__(self) -> int:
        """Return the number of positions with a frame."""
        return len(self._flat)

    def info(self, index: int) -> FrameInfo:
        """Return the metadata of frame ``index`` from its record."""
        k = check_index(index, len(self))
        record = self.record(k)
        return FrameInfo(
            (self._place(k),),
            (int(record["row"]), int(record["column"])),
            float(record["exposure_s"]),
            saturated=int(record["saturated"]),
            label=self._files[self._where[k]].label(int(self._slots[k])),
        )

    def record(self, index: int) -> Any:
        """Return the record of frame ``index``, a scalar of the type `lfcal.acquire.recording.records.RECORD`."""
        return self._files[self._where[index]].records[self._slots[index]]

    def suspects(self) -> list[tuple[Position, Suspicion]]:
        """Return the positions (z, y, x) of frames that appeared suspect when recorded, with the suspected faults."""
        bits = np.zeros(len(self), np.uint8)
        for k, file in enumerate(self._files):
            here = self._where == k
            bits[here] = suspicions(file.records)[self._slots[here]]
        return [(self._place(k), Suspicion(int(bits[k]))) for k in np.flatnonzero(bits).tolist()]

    def _place(self, index: int) -> Position:
        """Return the position of frame ``index``, with the plane's number among the planes of this source."""
        place = position_at(int(self._flat[index]), self._shape3[1:])
        return place._replace(z=self._planes[place.z])

    def read(self, index: int, region: Region | None = None) -> NDArray[Any]:
        """Return frame ``index``, or the part of it in ``region``; raise `FileFormatError` if the frame is damaged."""
        k = check_index(index, len(self))
        file, slot = self._files[int(self._where[k])], int(self._slots[k])
        with frame_errors(file.label(slot), self._place(k)):
            frame = file.read(slot)
        if region is None:
            return frame
        return np.ascontiguousarray(frame[check_region(region, self.shape)])

    def samples(self, index: int, region: Region | None = None) -> Samples:
        """Return the samples of frame ``index``, or of the part of it in ``region``, with their validity and noise.

        For a frame computed from several exposures, the number of saturated pixels is taken from its record.
        """
        # means of several exposures have no single level of saturation
        if self.dtype.kind != "f":
            return super().samples(index, region)
        return Samples(
            self.read(index, region), noise=self.metadata.noise, saturated=int(self.record(index)["saturated"])
        )

    def repeats(self) -> FrameSource | None:
        """Return the reference frames of the session's newest recording that has at least two; None if there is none.

        All frames have the position (0, 0, 0).
        """
        for run in reversed(range(len(self.session.recordings))):
            found = [
                (record, frame) for record, frame in _checks(self._folder, run) if record["kind"] == Kind.REFERENCE
            ]
            if len(found) > 1:
                records, frames = zip(*found, strict=True)
                return ArraySource(
                    np.stack(frames),
                    [(0, 0, 0)] * len(frames),
                    exposures_s=[float(one["exposure_s"]) for one in records],
                    origins=[(int(one["row"]), int(one["column"])) for one in records],
                    metadata={"saturation": float(self.session.devices.max_value)} if self.dtype.kind != "f" else {},
                    name="reference frames",
                )
        return None

    def close(self) -> None:
        """Close the files; may be called twice."""
        self._finalizer()


def _part_of(plan: ScanPlan, planes: Sequence[int]) -> ScanPlan:
    """Return the plan of some of its planes."""
    return replace(
        plan,
        depths_um=tuple(plan.depths_um[z] for z in planes),
        exposure_s=tuple(plan.exposures[z] for z in planes),
    )


class CheckFrame(NamedTuple):
    """A reference or control frame of a session.

    ``kind`` distinguishes reference from control frames. The frame is compared with the frame of the planned
    ``position`` (z, y, x), from which the source is displaced by ``periods`` (y, x), in whole periods. ``elapsed_s`` is
    the time since the start of its recording, without pauses (s). ``energy`` is the sum of all samples, including the
    background (counts). ``origin`` is the (row, column) of the first pixel on the sensor (px), and ``frame`` contains
    the samples, ``(rows, columns)``.
    """

    kind: Kind
    position: Position
    periods: tuple[int, int]
    elapsed_s: float
    energy: float
    origin: tuple[int, int]
    frame: NDArray[Any]


def read_checks(folder: Path) -> list[CheckFrame]:
    """Return the reference frames (for lamp drift) and control frames (for periodicity) of the session in ``folder``.

    They are in the order of recording. Raises `FileFormatError` if one of them is damaged.

    Examples
    --------
    >>> from pathlib import Path
    >>> from lfcal.acquire import CheckFrame, read_checks
    >>> checks: list[CheckFrame] = read_checks(Path("recorded"))
    >>> print(len(checks), "frames of the first position again, to see lamp and stage")
    8 frames of the first position again, to see lamp and stage
    """
    session = SessionFile.read(folder)
    return [
        _check_frame(session, record, frame)
        for run in range(len(session.recordings))
        for record, frame in _checks(folder, run)
    ]


def sampled_references(folder: Path) -> Iterator[CheckFrame]:
    """Yield at most `SAMPLED` reference frames of each recording in ``folder``, evenly spread over the recording.

    They are in the order of recording; damaged frames are skipped.
    """
    session = SessionFile.read(folder)
    for run in range(len(session.recordings)):
        path = folder / file_name(Kind.REFERENCE, run)
        if not path.exists():
            continue
        with RecordingFile(path) as file:
            slots = np.flatnonzero(file.taken & (file.records["kind"] == Kind.REFERENCE))
            slots = slots[np.argsort(file.records["sequence"][slots])]
            chosen = np.unique(np.linspace(0, len(slots) - 1, min(SAMPLED, len(slots))).round().astype(np.intp))
            for slot in slots[chosen].tolist():
                with suppress(FileFormatError):
                    yield _check_frame(session, file.records[slot], file.read(slot))


def _check_frame(session: SessionFile, record: Any, frame: NDArray[Any]) -> CheckFrame:
    return CheckFrame(
        Kind(int(record["kind"])),
        position_at(int(record["index"]), session.grid[1:]),
        (int(record["period_y"]), int(record["period_x"])),
        float(record["elapsed_s"]),
        float(record["energy"]),
        (int(record["row"]), int(record["column"])),
        frame,
    )


def _checks(folder: Path, run: int) -> Iterator[tuple[Any, NDArray[Any]]]:
    """Yield the records and frames of a recording's reference and control frames, in time order."""
    path = folder / file_name(Kind.REFERENCE, run)
    if not path.exists():
        return
    with RecordingFile(path) as file:
        slots = np.flatnonzero(file.taken)
        for slot in slots[np.argsort(file.records["sequence"][slots])].tolist():
            yield file.records[slot], file.read(slot)


def _devices(devices: Devices) -> dict[str, Any]:
    """Return the entries on the devices for H: their names, and the camera's settings, if known."""
    more = {"settings": dict(devices.settings), "automatic": list(devices.automatic)}
    return {"camera": devices.camera, "stage": devices.stage} | {key: value for key, value in more.items() if value}


class TargetRecording(RecordingSource):
    """Frame source that reads the frames of a session with a target, in the order of the plan.

    It contains the frames that are safe on disk. In a complete session, frame ``k`` is frame ``k`` of the plan;
    otherwise, `frames` states which frames were recorded. The ``points`` of each frame are the positions nearest to its
    holes at the planned pose. They have the order of `TargetPlan.points` for the offsets that the frame shows. The
    actual pose of the target may differ and is not known here. It has to be fitted to the frames. ``metadata`` contains
    the ``plan`` of the scan and the ``target`` (`lfcal.targets.TargetPlan`), in addition to the entries of every
    session.

    Parameters
    ----------
    folder, skip_damaged
        As in `RecordingSource`. The errors are the same, except that a session of cutouts raises `InputError`.

    Examples
    --------
    >>> from pathlib import Path
    >>> from lfcal.acquire import Options, TargetRecording, open_session, record
    >>> from lfcal.camera import ScanPlan, preset
    >>> from lfcal.devices import simulated_rig
    >>> from lfcal.targets import Wishes, parse_target, plan_target
    >>> scan = ScanPlan.for_camera(preset("bench"), virtual_depths=(4.0,), cutout=31)
    >>> plan = plan_target(scan, parse_target("array:3x3@2mm"), Wishes(most_frames=3, level="geometric"))
    >>> _ = record(Path("new"), plan, simulated_rig(scan), Options(darks=0, reference_every=0, on_suspect="flag"))
    >>> session: TargetRecording
    >>> with open_session(Path("new")) as session:
    ...     print(len(session), "whole frames", session.shape, "- of", len(session.info(0).points), "points each")
    3 whole frames (320, 320) - of 9 points each
    """

    of_whole_frames = True

    def __init__(self, folder: Path, *, skip_damaged: bool = False) -> None:
        super().__init__(folder, skip_damaged=skip_damaged)

    @property
    def target(self) -> TargetPlan:
        """Plan of the recorded target."""
        return self.session.target  # type: ignore[return-value]  # `read_frame_plan` returns no other type

    @cached_property
    def frames(self) -> tuple[tuple[int, int], ...]:
        """Pairs (plane index, frame number within the plane), one for each recorded frame."""
        _, _, most = self.session.grid
        return tuple((flat // most, flat % most) for flat in self._flat.tolist())

    def _known(self) -> FrameMetadata:
        # frames are not those of a scan
        return replace(super()._known(), target=self.target, target_frames=self.frames, plan_shape=None)

    def info(self, index: int) -> FrameInfo:
        """Return the metadata of frame ``index`` from its record, with the positions (z, y, x) that it should show."""
        k = check_index(index, len(self))
        record = self.record(k)
        return FrameInfo(
            self._points[k],
            (int(record["row"]), int(record["column"])),
            float(record["exposure_s"]),
            saturated=int(record["saturated"]),
            label=self._files[self._where[k]].label(int(self._slots[k])),
        )

    @cached_property
    def _phases(self) -> Phases:
        from lfcal.targets import Phases

        return Phases.of(self.plan)

    @cached_property
    def _points(self) -> list[tuple[Position, ...]]:
        from lfcal.targets import nearest_positions

        found = []
        for z, k in self.frames:
            lit = [self.target.points(z, one).pixels for one in self.target.lit_in(z, k)]
            pixels: NDArray[np.float64] = np.concatenate(lit)
            index = nearest_positions(self._phases, pixels).positions
            found.append(tuple(Position(z, y, x) for y, x in index.tolist()))
        return found
