"""Nothing is acknowledged before it is on the disk, and no acknowledgement is lost, whatever fails."""

from __future__ import annotations

import threading
from typing import Any

import numpy as np
import pytest

from lfcal.acquire.recording.records import Kind, Note
from lfcal.acquire.recording.writer import Writer
from lfcal.acquire.schedule import ScheduledFrame
from lfcal.base.errors import StorageError

FRAME = np.zeros((2, 2), np.uint16)


def step(k: int, kind: Kind = Kind.POSITION) -> ScheduledFrame:
    return ScheduledFrame(kind, k, k, 0, (0.0, 0.0, 0.0), 0, 0, 0, 0)


def note(k: int) -> Note:
    return Note(
        index=k,
        kind=Kind.POSITION,
        row=0,
        column=0,
        target_um=(0, 0, 0),
        stage_um=(0, 0, 0),
        exposure_s=0.01,
        time_s=0.0,
        elapsed_s=0.0,
        energy=0.0,
        peak=0.0,
    )


class Disk:
    """A sink whose sync waits for leave, and may fail."""

    def __init__(self) -> None:
        self.put_slots: list[int] = []
        self.safe: set[int] = set()
        self.kinds: list[set[Kind]] = []
        self.leave = threading.Event()
        self.leave.set()
        self.put_fails_at = self.sync_fails_at = 10**9

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


def test_a_failed_put_loses_no_acknowledgement() -> None:
    disk = Disk()
    disk.put_fails_at = 7
    writer, done = Writer(disk), []
    with pytest.raises(StorageError, match="full"):
        for k in range(20):
            done += writer.submit(step(k), FRAME, note(k))
    done += writer.salvage()
    writer.close()
    assert [item.step.slot for item in done] == list(range(7))


def test_a_failed_sync_is_raised_and_nothing_after_it_acknowledged() -> None:
    disk = Disk()
    disk.sync_fails_at = 9
    writer, done = Writer(disk), []
    with pytest.raises(StorageError, match="gone"):
        for k in range(50):
            done += writer.submit(step(k), FRAME, note(k))
    done += writer.salvage()
    writer.close()
    slots = [item.step.slot for item in done]
    assert slots == list(range(len(slots)))
    assert set(slots) <= disk.safe
    assert len(slots) <= 9
