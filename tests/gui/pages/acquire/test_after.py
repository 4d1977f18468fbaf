"""What is made of a recorded session: H fills in the map, and is kept where it is stopped."""

from __future__ import annotations

import shutil
import threading
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PySide6.QtCore import Qt
from pytestqt.qtbot import QtBot

from lfcal.acquire import SessionFile
from lfcal.acquire.stills import recipe_of
from lfcal.base.errors import InputError, StorageError
from lfcal.base.progress import drain
from lfcal.psf import PSFMatrix, open_psf, save
from lfcal.psf.assembly import AssemblyProgress
from lfcal.psf.store import PSFWriter
from lfcal.records import AssemblySettings
from lfcal.simulate import sample_recording
from lfcal.tasks import Assemble
from lfcal.work import parts_folder
from lfcal_gui.context import Context
from lfcal_gui.models.project import ProjectState
from lfcal_gui.pages.acquire.model import AcquireSettings
from lfcal_gui.pages.acquire.step import iter_assembly, remade
from tests.acquire.rigs import small_plan
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
    pictures, go_on = page.panel.record, threading.Event()
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
        lambda: bool(held_at) and f"H fills: plane 0, {held_at[0]} of " in pictures.map_words.text(), timeout=GUARD_MS
    )
    values, count = shown[-1], len(shown)
    assert 0 < held_at[0] == np.isfinite(values).sum() < values.size
    page.record.refresh()  # another quantity is chosen meanwhile: H stays
    qtbot.waitUntil(lambda: len(shown) > count, timeout=GUARD_MS)
    assert np.array_equal(shown[-1], values, equal_nan=True)
    go_on.set()
    idle(context.jobs, qtbot)
    assert "H fills" not in pictures.map_words.text() and not np.isnan(shown[-1]).all()
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
    assert "assemble plane" not in context.jobs.log(job.number).text().partition("resumed")[2]


def test_positions_are_recorded_again_and_h_is_made_anew_as_before(
    page: Any, context: Context, qtbot: QtBot, session: Path
) -> None:
    """The frames and the H of before stay; another H has them replaced, with the settings of the first."""
    folder = session.parent / "quick"
    plan = small_plan((3, 4), 2, settle_s=0.0)
    quick = AcquireSettings(device_options=(("optics", "pattern"), ("seed", "3")), darks=1, reference_every=0)
    context.project.update("quick", plan=plan, camera=plan.camera, settings=quick.into(context.state))
    context.project.update("folder", recording=str(folder))
    page.setup.connect_devices(page.record.start)
    qtbot.waitUntil(lambda: page.record.folder.complete and not page.record.recording, timeout=GUARD_MS)
    idle(context.jobs, qtbot)
    assert context.state.psf == str(folder / "H.h5"), "made without being asked for"
    made = Assemble(frames=folder, out=folder / "own.h5", settings=AssemblySettings(cutout=(15, 15)))
    drain(made.work())[0].report.matrix.close()
    page.setup.disconnect_devices()
    assert not page.redo(), "no position is asked for"
    again = ((0, 1, 2), (1, 0, 0), (1, 2, 3))
    context.project.update("open", psf=str(folder / "own.h5"), redo=again)
    # other noise, by which frames of the second run are known
    context.project.update(
        "seed", settings=replace(quick, device_options=(("optics", "pattern"), ("seed", "4"))).into(context.state)
    )
    before, went = (folder / "own.h5").read_bytes(), list[Any]()
    context.go.connect(lambda *sent: went.append(sent))
    assert not page.redo() and "3 positions are then recorded again" in page.notice.label.text()
    qtbot.mouseClick(page.notice.button, Qt.MouseButton.LeftButton)
    qtbot.waitUntil(lambda: context.state.psf == str(folder / "own-2.h5"), timeout=GUARD_MS)
    idle(context.jobs, qtbot)
    assert context.state.reference == str(folder / "own.h5") and context.state.redo == ()
    assert (folder / "own.h5").read_bytes() == before
    assert went == [("h", {"place": (1, 0, 0), "view": "difference"})]
    with open_psf(folder / "own.h5") as old, open_psf(folder / "own-2.h5") as new:
        assert new.cutout == (15, 15)
        changed = np.argwhere((np.asarray(old) != np.asarray(new)).any(axis=(3, 4)))
        assert [tuple(place) for place in changed.tolist()] == sorted(again)


def test_an_h_of_another_scan_is_not_made_anew(session: Path, tmp_path: Path) -> None:
    save(PSFMatrix(np.zeros((2, 3, 4, 5, 5), np.float32)), tmp_path / "one.h5")
    with pytest.raises(InputError, match="expected H of all planes of the session in"):
        remade(session, tmp_path / "one.h5", tmp_path / "two.h5", recipe_of(session))
