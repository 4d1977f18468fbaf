"""What is made of a recorded session: H fills in the map, and is kept where it is stopped."""

from __future__ import annotations

import shutil
import threading
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pytestqt.qtbot import QtBot

from lfcal.acquire import SessionFile
from lfcal.base.errors import StorageError
from lfcal.base.progress import drain
from lfcal.cli.sample import sample_recording
from lfcal.psf.assembly import AssemblyProgress
from lfcal.psf.store import PSFWriter
from lfcal.work import parts_folder
from lfcal_gui.context import Context
from lfcal_gui.models.project import ProjectState
from lfcal_gui.pages.acquire.model_assembly import iter_assembly
from lfcal_gui.pages.acquire.model_stills import recipe_of
from tests.gui.waiting import GUARD_MS, idle
from tests.psf.test_joining import contents


@pytest.fixture
def session(tmp_path: Path) -> Path:
    return Path(shutil.copytree(sample_recording(), tmp_path / "session"))


@pytest.fixture
def state(session: Path) -> ProjectState:
    plan = SessionFile.read(session).plan
    return ProjectState(camera=plan.camera, plan=plan, recording=str(session))


@pytest.fixture
def page(open_page: Any, context: Context, qtbot: QtBot) -> Any:
    made = open_page("acquire")
    made.entered()
    made.panel.record.pictures.show()
    idle(context.jobs, qtbot)
    return made


def test_h_fills_in_the_map_while_a_session_is_assembled(
    page: Any, context: Context, qtbot: QtBot, session: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pictures, go_on = page.panel.record.pictures, threading.Event()
    shown: list[Any] = []
    held_at: list[int] = []
    monkeypatch.setattr(pictures.map, "set_values", shown.append)

    def held(*asked: Any) -> Any:
        running, rows = iter_assembly(*asked), 0
        while True:
            try:
                record = next(running)
            except StopIteration as end:
                return end.value
            rows += isinstance(record, AssemblyProgress)
            if rows == 4 and not held_at:
                held_at.append(int(np.isfinite(record.energy).sum()))
            yield record
            while held_at and not go_on.wait(0.001):
                yield record

    monkeypatch.setattr("lfcal_gui.pages.acquire._after.iter_assembly", held)
    page.record.after.assemble(str(session / "H.h5"))
    qtbot.waitUntil(
        lambda: bool(held_at) and f"H fills: plane 0, {held_at[0]} of " in pictures.map_title.text(), timeout=GUARD_MS
    )
    values, count = shown[-1], len(shown)
    assert 0 < held_at[0] == np.isfinite(values).sum() < values.size
    page.record._refresh_picture()  # another quantity is chosen meanwhile: H stays
    qtbot.waitUntil(lambda: len(shown) > count, timeout=GUARD_MS)
    assert np.array_equal(shown[-1], values, equal_nan=True)
    go_on.set()
    idle(context.jobs, qtbot)
    assert pictures.map_title.text() == "Period map" and not np.isnan(shown[-1]).all()
    assert context.state.psf == str(session / "H.h5")


def test_a_session_s_h_that_failed_goes_on_to_the_same(
    page: Any, context: Context, qtbot: QtBot, session: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The disk is full when the planes are joined: none is made again."""
    whole = tmp_path / "whole.h5"
    drain(iter_assembly(session, whole, None, recipe_of(session))).matrix.close()
    out, real = session / "H.h5", PSFWriter.adopt_plane

    def full(*_: Any) -> None:
        raise StorageError("H.h5: the disk is full; make room")

    monkeypatch.setattr(PSFWriter, "adopt_plane", full)
    page.record.after.assemble(str(out))
    idle(context.jobs, qtbot)
    job = context.jobs.jobs()[0]
    assert job.kept == "1 of 1 planes" and not out.exists() and parts_folder(out).exists()
    monkeypatch.setattr(PSFWriter, "adopt_plane", real)
    (session / "plane-00.h5").write_bytes(b"another that was made meanwhile")
    context.jobs.go_on(job.number)
    idle(context.jobs, qtbot)
    context.matrices.forget(str(out))
    assert contents(out) == contents(whole)
    assert "assemble plane" not in context.jobs.log(job.number).text().partition("goes on")[2]
