"""A recorded session as frames: cutouts that know where on the sensor they were."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from types import TracebackType
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfcal.acquire.recording.reader import RecordingFile
from lfcal.acquire.recording.records import Kind, file_name
from lfcal.acquire.session_file import SessionFile
from lfcal.errors import InputError
from lfcal.frames.source import Position

__all__ = ["CheckFrame", "RecordingSource", "complete_planes", "read_checks"]


class RecordingSource:
    """The acknowledged positions of a session as a `FrameSource`, oldest recording first, later ones winning.

    Parameters
    ----------
    folder
        The session's; it may still be recording.
    planes
        Depth planes to take; their positions are counted from 0 in this order. None takes all.
    dark
        Subtract the mean of the session's dark frames of the same exposure; frames are then float32.

    Raises
    ------
    StorageError, FileFormatError
        If there is no session, or a file of it is damaged.
    InputError
        If nothing was recorded, or dark frames are asked for and there are none.
    """

    def __init__(self, folder: Path, *, planes: Sequence[int] | None = None, dark: bool = False) -> None:
        self.session = SessionFile.read(folder)
        self.plan = self.session.plan
        self._shape3 = self.plan.shape[:3]
        self._stack = ExitStack()
        try:
            self._files = [self._stack.enter_context(RecordingFile(folder / n)) for n in self.session.recordings]
            self._where, self._slots, self._flat = self._newest(planes)
            self._planes = {z: k for k, z in enumerate(range(self._shape3[0]) if planes is None else planes)}
            self._darks = _darks(folder, self._files[0].layout.attributes["roi"]) if dark else None
        except BaseException:
            self._stack.close()
            raise

    def _newest(self, planes: Sequence[int] | None) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any]]:
        """Return file, slot and flat position of the newest frame of every position there is."""
        count = self._shape3[0] * self._shape3[1] * self._shape3[2]
        where = np.full(count, -1)
        slots = np.zeros(count, np.int64)
        for k, file in enumerate(self._files):
            taken = np.flatnonzero(file.taken & (file.records["index"] < count))
            flat = file.records["index"][taken]
            where[flat], slots[flat] = k, taken
        there = where >= 0
        if planes is not None:
            size = self._shape3[1] * self._shape3[2]
            there &= np.isin(np.arange(count) // size, planes)
        flat = np.flatnonzero(there)
        if not flat.size:
            raise InputError.expected("recording", "frames of some positions", "none", "record the session first")
        return where[flat], slots[flat], flat

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of every frame."""
        return self._files[0].layout.shape

    @property
    def dtype(self) -> np.dtype[Any]:
        """Sample type of every frame."""
        return np.dtype(np.float32) if self._darks is not None else self._files[0].layout.dtype

    @property
    def metadata(self) -> Mapping[str, Any]:
        """What is known of the frames."""
        devices = self.session.devices
        return {
            "bit_depth": devices.bit_depth,
            "saturation": devices.max_value,
            "camera": devices.camera,
            "stage": devices.stage,
            "session": self.session.identity,
            "plan_shape": (len(self._planes), *self._shape3[1:]),
        }

    def __len__(self) -> int:
        """Return the number of positions with a frame."""
        return len(self._flat)

    def position(self, index: int) -> Position:
        """Return the scan position of frame ``index``."""
        _, ny, nx = self._shape3
        flat = int(self._flat[index])
        return Position(self._planes[flat // (ny * nx)], flat // nx % ny, flat % nx)

    def origin(self, index: int) -> tuple[int, int]:
        """Return the sensor (row, column) of the first pixel of frame ``index``."""
        record = self.record(index)
        return int(record["row"]), int(record["column"])

    def exposure_s(self, index: int) -> float:
        """Return the exposure of frame ``index`` (s)."""
        return float(self.record(index)["exposure_s"])

    def record(self, index: int) -> Any:
        """Return the record of frame ``index``; see `lfcal.acquire.recording.records.RECORD`."""
        return self._files[self._where[index]].records[self._slots[index]]

    def read(self, index: int) -> NDArray[Any]:
        """Return frame ``index`` as a new array; raises `FileFormatError` if it is damaged."""
        frame = self._files[int(self._where[index])].read(int(self._slots[index]))
        if self._darks is None:
            return frame
        record = self.record(index)
        return np.asarray(frame - self._darks.part(record, frame.shape), np.float32)

    def label(self, index: int) -> str:
        """Return a short name of frame ``index``."""
        return f"{self._files[self._where[index]].path.name}[{self._slots[index]}]"

    def close(self) -> None:
        """Close the files; may be called twice."""
        self._stack.close()

    def __enter__(self) -> RecordingSource:
        """Return the source."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close the files."""
        self.close()


class _Darks:
    """Mean dark frame of each exposure, with the sensor place of its first pixel."""

    def __init__(self, means: dict[float, NDArray[np.float32]], row: int, column: int) -> None:
        self._means, self._row, self._column = means, row, column

    def part(self, record: Any, shape: tuple[int, ...]) -> NDArray[np.float32]:
        """Return what to subtract from the frame of ``record``."""
        seconds = float(record["exposure_s"])
        nearest = min(self._means, key=lambda t: abs(t - seconds))
        if abs(nearest - seconds) > 0.01 * seconds:
            raise InputError.expected(
                "dark frame", f"one of {seconds:g} s", f"{sorted(self._means)} s", "record the darks again"
            )
        top, left = int(record["row"]) - self._row, int(record["column"]) - self._column
        part: NDArray[np.float32] = self._means[nearest][top : top + shape[0], left : left + shape[1]]
        return part


def _darks(folder: Path, roi: Any) -> _Darks:
    path = folder / file_name(Kind.DARK, 0)
    if not path.exists():
        raise InputError.expected("dark frames", path.name, "none", "record some, or leave dark correction out")
    with RecordingFile(path) as file:
        exposures = np.round(file.records["exposure_s"], 9)
        means = {}
        for seconds in np.unique(exposures[file.taken]).tolist():
            slots = np.flatnonzero(file.taken & (exposures == seconds))
            total = np.zeros(file.layout.shape, np.float64)
            for slot in slots.tolist():
                total += file.read(slot)
            means[float(seconds)] = (total / len(slots)).astype(np.float32)
    if not means:
        raise InputError.expected("dark frames", f"some in {path.name}", "none", "resume the session")
    return _Darks(means, int(roi[0]), int(roi[1]))


class CheckFrame(NamedTuple):
    """A reference or control frame.

    ``kind`` says which; ``position`` is the plan's position it is held against, ``periods`` (y, x) how many
    whole periods away it was taken, ``elapsed_s`` when (s of recording), ``energy`` its sum (counts),
    ``origin`` the sensor (row, column) of its first pixel.
    """

    kind: Kind
    position: Position
    periods: tuple[int, int]
    elapsed_s: float
    energy: float
    origin: tuple[int, int]
    frame: NDArray[Any]


def read_checks(folder: Path) -> list[CheckFrame]:
    """Return the reference frames (lamp drift) and control frames (periodicity) of a session, in time order."""
    session = SessionFile.read(folder)
    _, ny, nx = session.plan.shape[:3]
    found = []
    for run in range(len(session.recordings)):
        path = folder / file_name(Kind.REFERENCE, run)
        if not path.exists():
            continue
        with RecordingFile(path) as file:
            slots = np.flatnonzero(file.taken)
            for slot in slots[np.argsort(file.records["sequence"][slots])].tolist():
                record = file.records[slot]
                flat = int(record["index"])
                found.append(
                    CheckFrame(
                        Kind(int(record["kind"])),
                        Position(flat // (ny * nx), flat // nx % ny, flat % nx),
                        (int(record["period_y"]), int(record["period_x"])),
                        float(record["elapsed_s"]),
                        float(record["energy"]),
                        (int(record["row"]), int(record["column"])),
                        file.read(slot),
                    )
                )
    return found


def complete_planes(folder: Path) -> tuple[int, ...]:
    """Return the depth planes of which every position is acknowledged; they can be assembled meanwhile."""
    session = SessionFile.read(folder)
    nz, ny, nx = session.plan.shape[:3]
    there = np.zeros(nz * ny * nx, np.bool_)
    for name in session.recordings:
        with RecordingFile(folder / name) as file:
            flat = file.records["index"][file.taken]
            there[flat[flat < there.size]] = True
    return tuple(np.flatnonzero(there.reshape(nz, -1).all(axis=1)).tolist())
