"""The journal against HDF5 itself, and against what a crash can leave."""

from __future__ import annotations

import errno
import os
import shutil
import struct
import zlib
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest

from lfcal.acquire.recording import recording_file as journal_module
from lfcal.acquire.recording.recording_file import RecordingFile, RecordingJournal, read_layout
from lfcal.acquire.recording.records import RECORD, Kind, Note, Suspicion, frame_crc, intact, pack, suspicions
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


def test_a_recording_of_before_still_reads_and_is_written_the_same() -> None:
    """The layout is fixed byte by byte: an entry moved, resized or left out shows here."""
    assert pack(note(3), 17, 0xDEADBEEF) == GOLDEN
    records = np.frombuffer(GOLDEN, RECORD)
    assert intact(records).tolist() == [True]
    assert records["index"][0] == 3
    assert records["stage_um"][0].tolist() == [1.5, 2.5, 3.5]
    assert RECORD.fields is not None
    assert [RECORD.fields[name][1] for name in ("kind", "target_um", "peak", "record_crc", "valid")] == [
        14,
        36,
        116,
        120,
        124,
    ]


def test_record_bytes_are_those_of_the_declared_type() -> None:
    record = np.frombuffer(pack(note(3), 17, 0xDEADBEEF), RECORD)[0]
    assert RECORD.itemsize == 128
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
    assert {key: record[key].item() for key in want} == want
    assert record["target_um"].tolist() == [1, 2, 3]
    assert record["stage_um"].tolist() == [1.5, 2.5, 3.5]


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


@pytest.mark.parametrize("spoil", ["frame", "record", "half a frame", "no mark"])
def test_what_a_crash_tore_counts_as_not_taken(tmp_path: Path, spoil: str) -> None:
    path = tmp_path / "r.h5"
    journal = make(path, written=(0, 1, 2))
    layout = journal.layout
    with path.open("r+b") as file:
        if spoil == "frame":
            file.seek(layout.frames_at + 2 * layout.frame_bytes + 9)
            file.write(b"\xff\x13")
        elif spoil == "half a frame":
            file.seek(layout.frames_at + 2 * layout.frame_bytes + layout.frame_bytes // 2)
            file.write(bytes(layout.frame_bytes // 2))
        elif spoil == "record":
            file.seek(layout.records_at + 2 * RECORD.itemsize + 40)
            file.write(struct.pack("<d", 99.0))
        else:
            file.seek(layout.records_at + 3 * RECORD.itemsize - 4)
            file.write(bytes(4))
    assert whole(path) == [True, True, False, False, False, False]
    write(journal, 2, frame(2), note(2), 3)
    assert whole(path) == [True, True, True, False, False, False]
    journal.close()


def test_intact_finds_every_flipped_byte() -> None:
    clean = np.frombuffer(pack(note(1), 2, 3) * 3, RECORD)
    for byte in range(RECORD.itemsize):
        raw = bytearray(clean.tobytes())
        raw[RECORD.itemsize + byte] ^= 1 << int(RNG.integers(8))
        assert intact(np.frombuffer(bytes(raw), RECORD)).tolist() == [True, False, True]


def test_full_disk_shows_at_once_and_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(journal_module, "reserve", full)
    with pytest.raises(StorageError, match="free some space"):
        make(tmp_path / "r.h5")
    assert list(tmp_path.iterdir()) == []


def test_disk_that_fills_during_a_write_is_an_error_and_the_frame_is_not_taken(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "r.h5"
    journal = make(path, written=(0,))

    def short(descriptor: int, data: bytes | memoryview, offset: int) -> int:
        os.pwrite(descriptor, memoryview(data)[:40], offset)
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(journal_module, "write_at", short)
    with pytest.raises(StorageError, match="free some space"):
        write(journal, 1, frame(1), note(1), 1)
    assert whole(path) == [True] + [False] * 5
    journal.close()


def test_removed_file_is_not_written_to_in_silence(tmp_path: Path) -> None:
    (tmp_path / "s").mkdir()
    journal = make(tmp_path / "s" / "r.h5", written=(0,))
    shutil.rmtree(tmp_path / "s")
    with pytest.raises(StorageError, match="removed while recording"):
        write(journal, 1, frame(1), note(1), 1)
    journal.close()


def test_wrong_frames_and_slots_are_refused(tmp_path: Path) -> None:
    journal = make(tmp_path / "r.h5")
    for slot, data in ((6, frame(0)), (-1, frame(0)), (0, frame(0)[:-1]), (0, frame(0).astype(np.int16))):
        with pytest.raises(StorageError, match="slot"):
            write(journal, slot, data, note(0), 0)
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


def test_crc_is_zlibs() -> None:
    assert frame_crc(b"123456789") == 0xCBF43926


def test_a_suspicion_is_kept_beside_the_attempts() -> None:
    """In bits that were always zero: the layout and what was recorded before stay as they are."""
    suspect = replace(note(3), suspicion=Suspicion.TORN | Suspicion.LIGHT, attempts=300)
    records = np.frombuffer(pack(suspect, 17, 1) + GOLDEN, RECORD)
    assert intact(records).all()
    assert [Suspicion(int(bits)) for bits in suspicions(records)] == [Suspicion.TORN | Suspicion.LIGHT, Suspicion.NONE]
    assert (records["attempts"] & 0xFF).tolist() == [255, 2]
    assert suspect.suspicion.words == "light, torn"
