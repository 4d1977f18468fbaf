"""A short disk is refused before anything moves; a hold and its end are said on every way out."""

from __future__ import annotations

import datetime
import errno
import json
import os
import shutil
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from lfcal.acquire._forecast import forecast
from lfcal.acquire.control import Control
from lfcal.acquire.options import LEAST_RESERVE, Options
from lfcal.acquire.recording.durable import DiskGuard, FolderLock, holder_of
from lfcal.acquire.session import iter_record, record
from lfcal.acquire.session_file import SessionFile
from lfcal.base.errors import StorageError
from lfcal.base.system import sync_data
from lfcal.camera import RegionPlan
from tests.acquire.rigs import assert_same_frames, frames_of, rig_for, small_plan
from tests.cli.conftest import Run, lfcal
from tests.cli.test_disks import Mount, mount

__all__ = ["lfcal", "mount"]

PLAN = small_plan(planes=1)
OPTIONS = Options(darks=0, reference_every=0, retries=0)
Lfcal = Callable[..., Run]


class Usage(NamedTuple):
    """What a disk has."""

    total: int
    used: int
    free: int


def disk(monkeypatch: pytest.MonkeyPatch, free: int) -> None:
    monkeypatch.setattr(shutil, "disk_usage", lambda _: Usage(1 << 40, 0, free))


def test_the_reserve_is_a_share_of_the_recording() -> None:
    assert OPTIONS.reserve(10 << 30) == 1 << 30
    assert OPTIONS.reserve(9_000_000) == LEAST_RESERVE
    assert replace(OPTIONS, keep_free_bytes=5).reserve(10 << 30) == 5


def test_a_short_disk_is_refused_before_anything_moves(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """By the same rule as the forecast: a disk of 500 MB once let a session of 9 MB wait for ever."""
    folder, rig = tmp_path / "s", rig_for(PLAN)
    disk(monkeypatch, 10 << 20)
    for refused in (lambda: forecast(PLAN, rig, OPTIONS, folder), lambda: record(folder, PLAN, rig, OPTIONS)):
        with pytest.raises(
            StorageError, match=r"the recording and its reserve in .*expected at least .* MB, got 10\.5 MB"
        ):
            refused()
    assert rig.stage.moves == 0 and not folder.exists()  # type: ignore[attr-defined]
    disk(monkeypatch, 500 << 20)
    assert record(folder, PLAN, rig, OPTIONS).how == "complete"


def test_a_session_that_goes_on_is_refused_on_a_short_disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / "s"
    control = Control()
    for step in iter_record(folder, PLAN, rig_for(PLAN), OPTIONS, control=control):
        if step.stage == "record" and step.done >= 4:
            control.stop()
    rig = rig_for(PLAN)
    disk(monkeypatch, 1 << 20)
    with pytest.raises(
        StorageError,
        match=r"disk low: 1.0 MB free, 16.8 MB required; free some space, or keep less space free \(--keep-free\)",
    ):
        record(folder, PLAN, rig, resume=True)
    monkeypatch.undo()
    assert record(folder, PLAN, rig, resume=True).how == "complete" and len(frames_of(folder)) == PLAN.n_positions


def holding(monkeypatch: pytest.MonkeyPatch, seen: list[Any], folder: Path) -> None:
    """Let the disk be short for three looks after the fourth, and note what the folder's lock says meanwhile."""
    looks = 0

    def short(self: DiskGuard) -> str:
        nonlocal looks
        looks += 1
        if looks > 6:
            seen.append(holder_of(folder))
        return "disk low: 1 MB free, 2 MB required; free some space" if 4 < looks <= 7 else ""

    monkeypatch.setattr(DiskGuard, "__call__", short)


@pytest.mark.parametrize("regions", [False, True])
def test_holds_are_lines_on_stderr_and_in_the_status(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, lfcal: Lfcal, regions: bool
) -> None:
    plan = RegionPlan.spread(PLAN, (1, 2)) if regions else PLAN
    (tmp_path / "plan.json").write_text(plan.to_json())
    folder, seen = tmp_path / "s", list[Any]()
    own = folder / plan.names[0] if isinstance(plan, RegionPlan) else folder
    holding(monkeypatch, seen, own)
    words = ("--darks", 0, "--reference-every", 0, "--no-check-stage", "--option", "optics=pattern")
    done = lfcal("acquire", tmp_path / "plan.json", "--out", folder, *words)
    assert done.code == 0, done.err
    lines = done.err.splitlines()
    start = next(k for k, line in enumerate(lines) if "on hold: disk low: 1 MB free, 2 MB required" in line)
    assert any("recording again" in line for line in lines[start:]), done.err
    held = [one for one in seen if one is not None and one.held]
    assert held and held[0].held.startswith("disk low") and held[0].process > 0
    assert holder_of(own) is None and "complete" in lfcal("status", own).out


def test_the_status_names_who_records_and_why_it_holds(tmp_path: Path, lfcal: Lfcal) -> None:
    record(tmp_path, PLAN, rig_for(PLAN), OPTIONS)
    lock = FolderLock(tmp_path)
    try:
        assert "being recorded (process" in lfcal("status", tmp_path).out
        lock.note("disk low: 1 MB free")
        assert "on hold: disk low: 1 MB free (process" in lfcal("status", tmp_path).out
        facts = json.loads(lfcal("status", tmp_path, "--json").out)
        assert facts["recording"] and facts["held"] == "disk low: 1 MB free" and facts["process"] > 0
    finally:
        lock.release()


def fill(folder: Path, left: int = 0) -> Path:
    """Take all of a disk but ``left`` bytes; return the file that does."""
    taken = folder / "filling"
    with taken.open("wb", buffering=0) as file, suppress(OSError):
        while True:
            file.write(bytes(4096))
    if left:
        os.truncate(taken, taken.stat().st_size - left)
    return taken


def test_a_disk_that_fills_up_holds_the_session_until_there_is_space(
    tmp_path: Path, mount: Mount, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A real disk, full to the last byte, on which also the note in the lock is refused."""
    disk, control, taken, held = mount("size=4m"), Control(), list[Path](), list[str]()
    monkeypatch.setitem(DiskGuard.__init__.__kwdefaults__, "every_s", 0.0)

    def refused(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    for step in iter_record(disk / "s", PLAN, rig_for(PLAN), replace(OPTIONS, keep_free_bytes=65536), control=control):
        if step.stage == "record" and step.done >= 4 and not taken:
            taken.append(fill(disk))
            monkeypatch.setattr("lfcal.acquire.recording.durable.write_at", refused)
        elif control.held:
            held.append(control.held)
            taken[0].unlink(missing_ok=True)
    assert held and held[0].startswith("disk low: 0 B free, 65.5 kB required; free some space")
    monkeypatch.undo()
    assert record(tmp_path / "s", PLAN, rig_for(PLAN), OPTIONS).how == "complete"
    assert_same_frames(frames_of(disk / "s"), frames_of(tmp_path / "s"))


@pytest.mark.parametrize("when", [4, PLAN.n_positions])
def test_a_disk_that_is_full_loses_no_frame_and_the_session_goes_on(tmp_path: Path, mount: Mount, when: int) -> None:
    """What was reserved is written; how the run ended cannot be noted where no other byte can be written."""
    disk, taken = mount("size=4m"), list[Path]()
    options = replace(OPTIONS, keep_free_bytes=0)

    def watch(*_: object) -> None:
        taken.append(fill(disk) if len(taken) + 1 == when else disk)

    with pytest.raises(StorageError, match=r"session.json: No space left on device; free some space") as caught:
        record(disk / "s", PLAN, rig_for(PLAN), options, observers=(watch,))
    assert "\n" not in str(caught.value) and len(frames_of(disk / "s")) == PLAN.n_positions
    assert not list((disk / "s").glob(".*.part"))
    (disk / "filling").unlink()
    assert record(disk / "s", PLAN, rig_for(PLAN), resume=True).how == "complete"
    assert record(tmp_path / "s", PLAN, rig_for(PLAN), options).how == "complete"
    assert_same_frames(frames_of(disk / "s"), frames_of(tmp_path / "s"))


def test_a_slow_disk_records_the_same_frames(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    record(tmp_path / "quick", PLAN, rig_for(PLAN), OPTIONS)
    syncs = list[float]()

    def slow(descriptor: int) -> None:
        time.sleep(0.05)
        sync_data(descriptor)
        syncs.append(time.monotonic())

    monkeypatch.setattr("lfcal.acquire.recording.recording_file.sync_data", slow)
    acknowledged = list[float]()
    watch = lambda *_: acknowledged.append(time.monotonic())  # noqa: E731
    assert record(tmp_path / "slow", PLAN, rig_for(PLAN), OPTIONS, observers=(watch,)).how == "complete"
    assert_same_frames(frames_of(tmp_path / "slow"), frames_of(tmp_path / "quick"))
    # several frames are made safe together, and none is acknowledged before one sync
    assert len(syncs) < PLAN.n_positions and min(acknowledged) > syncs[0]


def test_a_clock_that_is_set_back_between_runs_changes_nothing_but_the_dates(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, lfcal: Lfcal
) -> None:
    control = Control()
    for step in iter_record(tmp_path / "s", PLAN, rig_for(PLAN), OPTIONS, control=control):
        if step.stage == "record" and step.done >= 4:
            control.stop()
    real = datetime.datetime

    class Back(datetime.datetime):
        @classmethod
        def now(cls, tz: datetime.tzinfo | None = None) -> datetime.datetime:
            return real.now(tz) - datetime.timedelta(hours=1)

    monkeypatch.setattr("lfcal.acquire.session.datetime.datetime", Back)
    # what an earlier clock wrote lies in the future now
    future = time.time() + 3600
    for path in (tmp_path / "s").iterdir():
        os.utime(path, (future, future))
    assert record(tmp_path / "s", PLAN, rig_for(PLAN), resume=True).how == "complete"
    first, second = SessionFile.read(tmp_path / "s").runs
    assert (first.how, second.how) == ("stopped", "complete") and second.started < first.started
    assert min(first.seconds, second.seconds) >= 0
    assert "complete" in lfcal("status", tmp_path / "s").out
    monkeypatch.undo()
    record(tmp_path / "whole", PLAN, rig_for(PLAN), OPTIONS)
    assert_same_frames(frames_of(tmp_path / "s"), frames_of(tmp_path / "whole"))
