"""A short disk is refused before anything moves; a hold and its end are said on every way out."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from lfcal.acquire.forecast import forecast
from lfcal.acquire.options import LEAST_RESERVE, Options
from lfcal.acquire.recording.durable import DiskGuard, FolderLock, holder_of
from lfcal.acquire.session import record
from lfcal.camera import RegionPlan
from lfcal.errors import StorageError
from tests.acquire.rigs import frames_of, rig_for, small_plan
from tests.cli.conftest import Run, lfcal

__all__ = ["lfcal"]

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
        with pytest.raises(StorageError, match=r"the recording and its reserve .*expected .* MB, got 10.5 MB free"):
            refused()
    assert rig.stage.moves == 0 and not folder.exists()  # type: ignore[attr-defined]
    disk(monkeypatch, 500 << 20)
    assert record(folder, PLAN, rig, OPTIONS).how == "complete"


def test_a_session_that_goes_on_is_refused_on_a_short_disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / "s"
    from lfcal.acquire.control import Control
    from lfcal.acquire.session import iter_record

    control = Control()
    for step in iter_record(folder, PLAN, rig_for(PLAN), OPTIONS, control=control):
        if step.stage == "record" and step.done == 4:
            control.stop()
    rig = rig_for(PLAN)
    disk(monkeypatch, 1 << 20)
    with pytest.raises(
        StorageError, match=r"disk low: 1.0 MB free, 16.8 MB wanted; free some space, or give --keep-free"
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
        return "disk low: 1 MB free, 2 MB wanted; free some space" if 4 < looks <= 7 else ""

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
    start = next(k for k, line in enumerate(lines) if "on hold: disk low: 1 MB free, 2 MB wanted" in line)
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
