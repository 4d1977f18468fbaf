"""Disks that are short, full or slow, power cuts and killed programs: no acknowledged frame is lost."""

from __future__ import annotations

import datetime
import errno
import itertools
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
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
from tests.acquire.crashing import equal_matrices, kill_and_resume, power_cuts, undisturbed, why_no_power_cut
from tests.acquire.rigs import assert_same_frames, frames_of, rig_for, small_plan, stopped
from tests.cli.conftest import Run
from tests.cli.test_outputs import Mount, mount

__all__ = ["mount"]

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
    """By the same rule as the forecast: a disk of 500 MB once let a session of 9 MB wait forever."""
    folder, rig = tmp_path / "s", rig_for(PLAN)
    disk(monkeypatch, 10 << 20)
    words = r"the recording and its reserve in .*expected at least .* MB, got 10\.5 MB"
    for refused in (lambda: forecast(PLAN, rig, OPTIONS, folder), lambda: record(folder, PLAN, rig, OPTIONS)):
        with pytest.raises(StorageError, match=words):
            refused()
    assert rig.stage.moves == 0 and not folder.exists()
    disk(monkeypatch, 500 << 20)
    assert record(folder, PLAN, rig, OPTIONS).how == "complete"


def test_a_resumed_session_is_refused_on_a_short_disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    stopped(tmp_path, PLAN, 4, OPTIONS)
    disk(monkeypatch, 1 << 20)
    words = r"disk low: 1.0 MB free, 16.8 MB required; free some space, or keep less space free \(--keep-free\)"
    with pytest.raises(StorageError, match=words):
        record(tmp_path, PLAN, rig_for(PLAN), resume=True)
    monkeypatch.undo()
    assert record(tmp_path, PLAN, rig_for(PLAN), resume=True).how == "complete"
    assert len(frames_of(tmp_path)) == PLAN.n_positions


@pytest.mark.parametrize("regions", [False, True])
def test_holds_are_lines_on_stderr_and_in_the_status(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, lfcal: Lfcal, regions: bool
) -> None:
    plan = RegionPlan.spread(PLAN, (1, 2)) if regions else PLAN
    (tmp_path / "plan.json").write_text(plan.to_json())
    folder, held, looks = tmp_path / "s", list[Any](), itertools.count(1)
    own = folder / plan.names[0] if isinstance(plan, RegionPlan) else folder

    def short(self: DiskGuard) -> str:
        """Be short for three looks after the fourth, and note what the folder's lock states meanwhile."""
        look = next(looks)
        held.extend([holder_of(own)] if look > 6 else [])
        return "disk low: 1 MB free, 2 MB required; free some space" if 4 < look <= 7 else ""

    monkeypatch.setattr(DiskGuard, "__call__", short)
    words = ("--darks", 0, "--reference-every", 0, "--no-check-stage", "--option", "optics=pattern")
    done = lfcal("acquire", tmp_path / "plan.json", "--out", folder, *words)
    assert done.code == 0, done.err
    lines = done.err.splitlines()
    start = next(k for k, line in enumerate(lines) if "on hold: disk low: 1 MB free, 2 MB required" in line)
    assert any("recording again" in line for line in lines[start:]), done.err
    (first, *_) = (one for one in held if one is not None and one.held)
    assert first.held.startswith("disk low") and first.process > 0
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
    syncs, acknowledged = list[float](), list[float]()

    def slow(descriptor: int) -> None:
        time.sleep(0.05)
        sync_data(descriptor)
        syncs.append(time.monotonic())

    monkeypatch.setattr("lfcal.acquire.recording.recording_file.sync_data", slow)
    watch = lambda *_: acknowledged.append(time.monotonic())  # noqa: E731
    assert record(tmp_path / "slow", PLAN, rig_for(PLAN), OPTIONS, observers=(watch,)).how == "complete"
    assert_same_frames(frames_of(tmp_path / "slow"), frames_of(tmp_path / "quick"))
    # several frames are made safe together, and none is acknowledged before one sync
    assert len(syncs) < PLAN.n_positions and min(acknowledged) > syncs[0]


def test_a_clock_that_is_set_back_between_runs_changes_only_the_dates(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, lfcal: Lfcal
) -> None:
    stopped(tmp_path / "s", PLAN, 4, OPTIONS)
    real = datetime.datetime

    class Back(datetime.datetime):
        @classmethod
        def now(cls, tz: datetime.tzinfo | None = None) -> datetime.datetime:
            return real.now(tz) - datetime.timedelta(hours=1)

    monkeypatch.setattr("lfcal.acquire.session.datetime.datetime", Back)
    future = time.time() + 3600  # what an earlier clock wrote lies in the future now
    for path in (tmp_path / "s").iterdir():
        os.utime(path, (future, future))
    assert record(tmp_path / "s", PLAN, rig_for(PLAN), resume=True).how == "complete"
    first, second = SessionFile.read(tmp_path / "s").runs
    assert (first.how, second.how) == ("stopped", "complete") and second.started < first.started
    assert min(first.seconds, second.seconds) >= 0 and "complete" in lfcal("status", tmp_path / "s").out
    monkeypatch.undo()
    record(tmp_path / "whole", PLAN, rig_for(PLAN), OPTIONS)
    assert_same_frames(frames_of(tmp_path / "s"), frames_of(tmp_path / "whole"))


# -- kills and power cuts; `tests.acquire.crash_figures` gives the full figures -----------------------------
CRASHED = small_plan((16, 20), 3, cutout=(65, 65), shape=(110, 110))


@pytest.mark.long
@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="no kill -9 on this platform")
@pytest.mark.parametrize("kills", [1, 3])
def test_killed_and_resumed_equals_undisturbed(tmp_path: Path, kills: int) -> None:
    undisturbed(tmp_path / "calm", CRASHED)
    tally = kill_and_resume(tmp_path / "killed", CRASHED, kills, random.Random(3), 0.12)
    assert tally.crashes >= 1 and tally.lost == 0
    assert equal_matrices(tmp_path / "calm", tmp_path / "killed")


@pytest.mark.skipif(bool(why_no_power_cut()), reason=why_no_power_cut() or "possible")
def test_power_cut_loses_nothing_acknowledged(tmp_path: Path) -> None:
    tally = power_cuts(tmp_path, CRASHED, 1, random.Random(4), 0.2, 64 << 20)
    assert tally.acknowledged > 0 and (tally.unreadable, tally.lost) == (0, 0)


MEASURING = """
import json, os, sys
from pathlib import Path
from lfcal.acquire.live_quality import LiveQuality
from lfcal.acquire.preview import Preview
from lfcal.acquire.schedule import window_shape
from lfcal.acquire.session import iter_record
from tests.acquire.rigs import CAREFUL, rig_for, small_plan

page = os.sysconf("SC_PAGE_SIZE")
plan = small_plan((50, 50), 4, cutout=(41, 41), shape=(150, 150))
quality = LiveQuality(plan, window_shape(plan, CAREFUL))
found = []
for progress in iter_record(Path(sys.argv[1]) / "s", plan, rig_for(plan), CAREFUL, preview=Preview(),
                            observers=(quality,)):
    if progress.done % 250 == 0:
        resident = int(open("/proc/self/statm").read().split()[1]) * page
        found.append((progress.done, resident))
print(json.dumps(found))
"""


@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="resident memory is read from /proc")
@pytest.mark.long
def test_memory_is_flat_over_ten_thousand_positions(tmp_path: Path) -> None:
    command = [sys.executable, "-c", MEASURING, str(tmp_path)]
    child = subprocess.run(command, cwd=Path(__file__).parents[2], capture_output=True, text=True, timeout=300)
    assert child.returncode == 0, child.stderr
    done, resident = np.array(json.loads(child.stdout), float).T
    assert done[-1] == 10_000
    later = done >= 1000  # after the first tables and buffers have been made
    slope = np.polyfit(done[later], resident[later], 1)[0] * 1000
    assert slope < 1e6, f"{slope / 1e6:.2f} MB per 1,000 positions"
