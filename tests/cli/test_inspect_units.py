"""``lfcal inspect`` in units of a plane: the same numbers by every executor, kept until the report is written."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lfcal.acquire.session import record
from lfcal.base.errors import StorageError
from lfcal.psf import PSFMatrix, save
from lfcal.work import parts_folder
from tests.acquire.rigs import CAREFUL, rig_for, small_plan
from tests.cli.conftest import Run
from tests.judge.plain_report import undrawn

Lfcal = Callable[..., Run]


@pytest.fixture
def H(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Write an H of three planes, one of them dark, with noise and a missing position."""
    rows, columns = np.mgrid[:21, :21]
    values = np.empty((3, 3, 4, 21, 21), np.float32)
    for place in np.ndindex(values.shape[:3]):
        values[place] = 500 * np.exp(-((rows - 10) ** 2 + (columns - 10 - 0.1 * place[2]) ** 2) / (7 + 2 * place[0]))
    values[2] = 0
    values += np.random.default_rng(0).normal(0, 1, values.shape).astype(np.float32)
    recorded = np.ones(values.shape[:3], int)
    values[0, 1, 2], recorded[0, 1, 2] = 0, 0
    save(PSFMatrix(values, depths=[-20e3, -15e3, -10e3], recorded=recorded), tmp_path / "H.h5")
    monkeypatch.chdir(tmp_path)
    return tmp_path / "H.h5"


def alike(one: Any, two: Any) -> bool:
    """Return whether two reports say the same, but for the time they took and the page."""
    if isinstance(one, dict):
        return one.keys() == two.keys() and all(alike(one[k], two[k]) for k in one if k not in ("seconds", "report"))
    if isinstance(one, list):
        return len(one) == len(two) and all(map(alike, one, two))
    return bool(one == two) or (isinstance(one, float) and math.isnan(one) and math.isnan(two))


@pytest.mark.long
@pytest.mark.parametrize("executor", ["threads", "processes", "dask"])
def test_the_same_report_by_whoever(lfcal: Lfcal, H: Path, executor: str) -> None:
    if executor == "dask":
        pytest.importorskip("distributed", reason="dask.distributed is not installed")
    words = ("inspect", "H.h5", "--json", "--workers", 1, "--report")
    one = lfcal(*words, "one")
    two = lfcal(*words, "two", "--executor", executor)
    assert one.code == two.code == 0, two.err
    assert alike(one.json, two.json)
    assert not parts_folder(H.parent / "two").exists()
    assert (H.parent / "one" / "redo.json").read_text() == (H.parent / "two" / "redo.json").read_text()


@pytest.mark.long
def test_with_control_frames(lfcal: Lfcal, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    undrawn(monkeypatch)
    plan = small_plan()
    record(tmp_path / "session", plan, rig_for(plan), replace(CAREFUL, controls=1))
    assert lfcal("assemble", "session", "-o", "H.h5").code == 0
    words = ("inspect", "H.h5", "--session", "session", "--seconds", 0, "--json", "--workers", 1, "--report")
    one, two = lfcal(*words, "one"), lfcal(*words, "two", "--executor", "processes")
    assert one.code == two.code == 0, two.err
    assert alike(one.json, two.json)


def test_planes_are_kept_until_the_report_is_written(lfcal: Lfcal, H: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    words = ("inspect", "H.h5", "--report", "out", "--workers", 1, "--seconds", 0)
    undrawn(monkeypatch)

    def full(*_: Any, **__: Any) -> Any:
        raise StorageError("out: no space is left")

    with monkeypatch.context() as patch:
        patch.setattr("lfcal.tasks.inspect.Inspect._iter_report", full)
        assert lfcal(*words, "--executor", "threads").code == 2
    status = lfcal("status", "out")
    assert "inspect H.h5: 3 of 3 units done; not running" in status.out
    refused = lfcal(*words)
    assert refused.code == 2 and "left 3 of 3 units finished; continue from them (--resume)" in refused.err
    run = lfcal(*words, "--resume")
    assert run.code == 0, run.err
    assert (H.parent / "out" / "index.html").exists() and not parts_folder(H.parent / "out").exists()


def test_without_a_report_nothing_is_kept(lfcal: Lfcal, H: Path) -> None:
    for words in (("--executor", "threads"), ("--resume",), ("--scheduler", "tcp://a:1")):
        run = lfcal("inspect", "H.h5", *words)
        assert run.code == 2 and "expected --report, got none" in run.err
    run = lfcal("inspect", "H.h5", "--report", "out", "--executor", "magic")
    assert run.code == 2 and "dask, processes or threads" in run.err
    assert {path.name for path in H.parent.iterdir()} == {"H.h5"}
