"""The file of a recording compared with HDF5 itself, and after crashes; its writer, and its lock."""

from __future__ import annotations

import errno
import os
import shutil
import struct
import subprocess
import sys
import threading
import zlib
from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from lfcal.acquire.recording import recording_file as journal_module
from lfcal.acquire.recording.durable import FolderLock
from lfcal.acquire.recording.recording_file import RecordingFile, RecordingJournal, read_layout
from lfcal.acquire.recording.records import RECORD, Kind, Note, Suspicion, frame_crc, intact, pack, suspicions
from lfcal.acquire.recording.writer import Writer
from lfcal.acquire.schedule import ScheduledFrame
from lfcal.base.errors import FileFormatError, StorageError

SHAPE = (11, 13)
RNG = np.random.default_rng(5)


# the record of `note` 3, frame 17 of a session, as version 1 of the recording writes it
GOLDEN = bytes.fromhex(
    "0300000011000000efbeadde0200030007000000fdffffffffff040005000000"
    "09000000000000000000f03f00000000000000400000000000000840000000000000f83f"
    "00000000000004400000000000000c407b14ae47e17a943f00000040fc54d941"
    "00000000000029400000000080842e4100f07f4569ba2cdaa1fc0100"
)


def note(index: int) -> Note:
    return Note(
        index=index,
        kind=Kind.CONTROL,
        row=7,
        column=-3,
        target_um=(1.0, 2.0, 3.0),
        stage_um=(1.5, 2.5, 3.5),
        exposure_s=0.02,
        time_s=1.7e9,
        elapsed_s=12.5,
        energy=1e6,
        peak=4095.0,
        saturated=5,
        sensor_saturated=9,
        attempts=2,
        period_y=-1,
        period_x=4,
    )


def frame(k: int) -> np.ndarray:
    return np.random.default_rng(k).integers(0, 4096, SHAPE, np.uint16)


def write(journal: RecordingJournal, slot: int, data: np.ndarray, about: Note, sequence: int) -> None:
    journal.put(slot, data, about, sequence)
    journal.sync()


def make(path: Path, count: int = 6, written: tuple[int, ...] = ()) -> RecordingJournal:
    journal = RecordingJournal.create(path, count, SHAPE, np.dtype(np.uint16), {"session": "s"})
    for sequence, slot in enumerate(written):
        write(journal, slot, frame(slot), note(slot), sequence)
    return journal


def whole(path: Path) -> list[bool]:
    with RecordingFile(path) as recording:
        return [recording.is_whole(slot) for slot in range(recording.layout.count)]


def test_the_layout_of_a_record_is_fixed_byte_by_byte() -> None:
    """An entry moved, resized or left out shows here."""
    assert pack(note(3), 17, 0xDEADBEEF) == GOLDEN and RECORD.itemsize == 128
    records = np.frombuffer(GOLDEN, RECORD)
    assert intact(records).tolist() == [True]
    want = {
        "index": 3,
        "sequence": 17,
        "frame_crc": 0xDEADBEEF,
        "attempts": 2,
        "kind": 3,
        "row": 7,
        "column": -3,
        "period_y": -1,
        "period_x": 4,
        "saturated": 5,
        "sensor_saturated": 9,
        "exposure_s": 0.02,
        "time_s": 1.7e9,
        "elapsed_s": 12.5,
        "energy": 1e6,
        "peak": 4095.0,
    }
    assert {key: records[0][key].item() for key in want} == want
    assert records["target_um"][0].tolist() == [1, 2, 3] and records["stage_um"][0].tolist() == [1.5, 2.5, 3.5]
    places = {"kind": 14, "target_um": 36, "peak": 116, "record_crc": 120, "valid": 124}
    assert {name: RECORD.fields[name][1] for name in places} == places
    assert frame_crc(b"123456789") == 0xCBF43926, "zlib's"


def test_hdf5_reads_what_was_written_in_place_while_it_is_open(tmp_path: Path) -> None:
    path = tmp_path / "r.h5"
    journal = make(path, written=(4, 0))
    with h5py.File(path, "r", locking=False) as file:
        assert np.array_equal(file["frames"][4], frame(4))
        assert np.array_equal(file["frames"][0], frame(0))
        assert file["records"][4]["frame_crc"] == zlib.crc32(frame(4).tobytes())
    assert whole(path) == [True, False, False, False, True, False]
    journal.close()
    journal.close()
    with RecordingFile(path) as recording:
        assert np.array_equal(recording.read(4), frame(4))
        with pytest.raises(FileFormatError, match="damaged or missing"):
            recording.read(1)


def test_space_is_reserved_before_the_first_frame(tmp_path: Path) -> None:
    make(tmp_path / "r.h5", count=1000).close()
    with h5py.File(tmp_path / "r.h5", "r") as file:
        assert file["frames"].id.get_offset() % 4096 == 0
    info = os.stat(tmp_path / "r.h5")
    assert info.st_blocks * 512 >= 1000 * (SHAPE[0] * SHAPE[1] * 2 + RECORD.itemsize)
    assert not list(tmp_path.glob(".*"))


def test_frames_torn_by_a_crash_count_as_not_taken(tmp_path: Path) -> None:
    path = tmp_path / "r.h5"
    journal = make(path, written=(0, 1, 2))
    layout = journal.layout
    at, after = layout.frames_at + 2 * layout.frame_bytes, layout.records_at + 3 * RECORD.itemsize
    half = layout.frame_bytes // 2
    for place, torn in (
        (at + 9, b"\xff\x13"),
        (at + half, bytes(half)),
        (after - RECORD.itemsize + 40, struct.pack("<d", 99.0)),
        (after - 4, bytes(4)),  # the mark
    ):
        with path.open("r+b") as file:
            file.seek(place)
            file.write(torn)
        assert whole(path) == [True, True, False, False, False, False], place
        write(journal, 2, frame(2), note(2), 3)
        assert whole(path) == [True, True, True, False, False, False], place
    journal.close()


def test_intact_finds_every_flipped_byte() -> None:
    clean = np.frombuffer(pack(note(1), 2, 3) * 3, RECORD)
    for byte in range(RECORD.itemsize):
        raw = bytearray(clean.tobytes())
        raw[RECORD.itemsize + byte] ^= 1 << int(RNG.integers(8))
        assert intact(np.frombuffer(bytes(raw), RECORD)).tolist() == [True, False, True]


def test_a_full_disk_is_reported_at_once_and_the_frame_is_not_taken(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    def short(descriptor: int, data: bytes | memoryview, offset: int) -> None:
        os.pwrite(descriptor, memoryview(data)[:40], offset)
        full()

    path = tmp_path / "r.h5"
    with monkeypatch.context() as patch:
        patch.setattr(journal_module, "reserve", full)
        with pytest.raises(StorageError, match="free some space"):
            make(path)
        assert list(tmp_path.iterdir()) == []
    journal = make(path, written=(0,))
    monkeypatch.setattr(journal_module, "write_at", short)
    with pytest.raises(StorageError, match="free some space"):
        write(journal, 1, frame(1), note(1), 1)
    assert whole(path) == [True] + [False] * 5
    journal.close()


def test_wrong_frames_slots_and_a_removed_file_are_refused(tmp_path: Path) -> None:
    (tmp_path / "s").mkdir()
    journal = make(tmp_path / "s" / "r.h5", written=(0,))
    for slot, data in ((6, frame(0)), (-1, frame(0)), (0, frame(0)[:-1]), (0, frame(0).astype(np.int16))):
        with pytest.raises(StorageError, match="slot"):
            write(journal, slot, data, note(0), 0)
    shutil.rmtree(tmp_path / "s")
    with pytest.raises(StorageError, match="removed while recording"):
        write(journal, 1, frame(1), note(1), 1)
    journal.close()


def test_other_files_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "other.h5"
    with h5py.File(path, "w") as file:
        file["frames"] = np.zeros((2, 3, 4), np.uint16)
    with pytest.raises(FileFormatError, match="expected a recording"):
        read_layout(path)
    make(tmp_path / "r.h5").close()
    with h5py.File(tmp_path / "r.h5", "r+") as file:
        file.attrs["version"] = 99
    with pytest.raises(FileFormatError, match="update lfcal"):
        RecordingJournal(tmp_path / "r.h5")
    (tmp_path / "cut.h5").write_bytes((tmp_path / "r.h5").read_bytes()[:600])
    with pytest.raises(FileFormatError):
        RecordingJournal(tmp_path / "cut.h5")


def test_a_suspicion_is_kept_with_the_attempts() -> None:
    """In bits that were always zero: the layout and what was recorded before stay as they are."""
    suspect = replace(note(3), suspicion=Suspicion.TORN | Suspicion.LIGHT, attempts=300)
    records = np.frombuffer(pack(suspect, 17, 1) + GOLDEN, RECORD)
    assert intact(records).all()
    assert [Suspicion(int(bits)) for bits in suspicions(records)] == [Suspicion.TORN | Suspicion.LIGHT, Suspicion.NONE]
    assert (records["attempts"] & 0xFF).tolist() == [255, 2]
    assert suspect.suspicion.words == "light, torn"


# -- the writer: nothing is acknowledged before it is on the disk, whatever fails ------------------------
FRAME = np.zeros((2, 2), np.uint16)


def step(k: int, kind: Kind = Kind.POSITION) -> ScheduledFrame:
    return ScheduledFrame(kind, k, k, 0, (0.0, 0.0, 0.0), 0, 0, 0, 0)


class Disk:
    """A sink whose sync waits for leave, and may fail."""

    def __init__(self, put_fails_at: int = 10**9, sync_fails_at: int = 10**9) -> None:
        self.put_slots: list[int] = []
        self.safe: set[int] = set()
        self.kinds: list[set[Kind]] = []
        self.leave = threading.Event()
        self.leave.set()
        self.put_fails_at, self.sync_fails_at = put_fails_at, sync_fails_at

    def put(self, step: ScheduledFrame, frame: Any, note: Note) -> None:
        if step.slot >= self.put_fails_at:
            raise StorageError("full")
        self.put_slots.append(step.slot)

    def sync(self, kinds: set[Kind]) -> None:
        known = set(self.put_slots)
        assert self.leave.wait(10)
        if max(known) >= self.sync_fails_at:
            raise StorageError("gone")
        self.safe |= known
        self.kinds.append(kinds)


def test_acknowledged_means_safe_and_in_order() -> None:
    disk, done = Disk(), []
    writer = Writer(disk)
    for k in range(200):
        for item in writer.submit(step(k), FRAME, note(k)):
            assert item.step.slot in disk.safe
            done.append(item.step.slot)
    done += [item.step.slot for item in writer.flush()]
    writer.close()
    assert done == list(range(200))


def test_a_waiting_disk_holds_the_writer_and_makes_frames_safe_together() -> None:
    disk = Disk()
    disk.leave.clear()
    writer = Writer(disk, depth=4)
    for k in range(4):
        assert writer.submit(step(k, Kind.REFERENCE if k == 3 else Kind.POSITION), FRAME, note(k)) == []
    assert writer.collect() == []
    threading.Timer(0.05, disk.leave.set).start()
    done = writer.submit(step(4), FRAME, note(4)) + writer.flush()
    assert [item.step.slot for item in done] == [0, 1, 2, 3, 4]
    assert len(disk.kinds) < 5
    assert {Kind.REFERENCE} <= set.union(*disk.kinds)
    writer.close()
    writer.close()


@pytest.mark.parametrize(("failing", "words"), [("put_fails_at", "full"), ("sync_fails_at", "gone")])
def test_a_failed_write_or_sync_loses_no_acknowledgement_and_gives_none(failing: str, words: str) -> None:
    disk = Disk(**{failing: 7})
    writer, done = Writer(disk), []
    with pytest.raises(StorageError, match=words):
        for k in range(50):
            done += writer.submit(step(k), FRAME, note(k))
    done += writer.salvage()
    writer.close()
    slots = [item.step.slot for item in done]
    assert slots == list(range(len(slots))) and set(slots) <= disk.safe
    assert len(slots) == 7 if failing == "put_fails_at" else len(slots) <= 7


# -- the lock of a session folder against a second program -----------------------------------------------
def test_second_program_is_kept_out_and_a_killed_one_is_not(tmp_path: Path) -> None:
    code = (
        "import sys, time; from pathlib import Path; from lfcal.acquire.recording.durable import FolderLock;"
        "FolderLock(Path(sys.argv[1])); print('locked', flush=True); time.sleep(60)"
    )
    child = subprocess.Popen([sys.executable, "-c", code, str(tmp_path)], stdout=subprocess.PIPE)
    try:
        assert child.stdout is not None
        assert child.stdout.readline() == b"locked\n"
        with pytest.raises(StorageError, match=f"process {child.pid}"):
            FolderLock(tmp_path)
    finally:
        child.kill()
        child.wait()
        child.stdout.close()
    lock = FolderLock(tmp_path)
    with pytest.raises(StorageError):
        FolderLock(tmp_path)
    lock.release()
    lock.release()
    FolderLock(tmp_path).release()
