"""An assembling that is stopped or fails keeps its planes, and continues to the same H."""

from __future__ import annotations

import shutil
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pytestqt.qtbot import QtBot

from lfcal.base import Progress, StorageError, drain
from lfcal.psf import open_psf
from lfcal.psf.assembly import Assembly
from lfcal.work import parts_folder
from lfcal_gui.job_panel import JobPanel
from lfcal_gui.jobs import Jobs, JobState
from lfcal_gui.models import KeptRun, ProjectState
from lfcal_gui.pages.frames.model import iter_assembly
from tests.cli.conftest import true_frame
from tests.gui.pages.frames._building import write_scan
from tests.gui.waiting import GUARD_MS, idle
from tests.psf.test_joining import contents


@pytest.fixture
def scan(tmp_path: Path) -> Path:
    return write_scan(tmp_path / "scan")


class Door:
    """Holds planes from the second on until it is opened; or they fail."""

    def __init__(self) -> None:
        self.reached, self.open = threading.Event(), threading.Event()
        self.error: Exception | None = None
        self.made: list[int] = []


@pytest.fixture
def door(monkeypatch: pytest.MonkeyPatch) -> Iterator[Door]:
    found, real = Door(), Assembly.iter_plane

    def held(self: Assembly, z: int, clock: Any, **how: Any) -> Any:
        if z > 0:
            found.reached.set()
            if found.error is not None:
                raise found.error
            while not found.open.wait(0.001):
                yield clock.at(0)
        found.made.append(z)
        return (yield from real(self, z, clock, **how))

    monkeypatch.setattr(Assembly, "iter_plane", held)
    yield found
    found.open.set()


class Desk:
    """A page that assembles into ``out``, with the rows of its jobs, and a door that holds its second plane."""

    def __init__(self, page: Any, qtbot: QtBot, out: Path, door: Door) -> None:
        self.page, self.context, self.qtbot, self.out, self.door = page, page.context, qtbot, out, door
        self.panel = JobPanel(self.context.jobs)
        qtbot.addWidget(self.panel)

    def row(self) -> Any:
        """Wait, and return the row of the latest job."""
        idle(self.context.jobs, self.qtbot)
        return self.panel.row(self.context.jobs.jobs()[0].number)

    def stopped(self) -> Any:
        """Stop an assembling in its second plane; return the job's row."""
        self.page.assemble(str(self.out))
        self.qtbot.waitUntil(self.door.reached.is_set, timeout=GUARD_MS)
        self.context.jobs.cancel(self.context.jobs.jobs()[0].number)
        return self.row()

    def log(self) -> str:
        return self.context.jobs.log(self.context.jobs.jobs()[0].number).text()


@pytest.fixture
def desk(scan: Path, open_page: Any, qtbot: QtBot, tmp_path: Path, door: Door) -> Desk:
    page = open_page("frames")
    page.open_folder(str(scan))
    idle(page.context.jobs, qtbot)
    return Desk(page, qtbot, tmp_path / "H.h5", door)


@pytest.fixture
def whole(desk: Desk, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """Return what is in the file of an assembling that nothing stopped."""
    desk.door.open.set()
    drain(iter_assembly(desk.page.opened, str(tmp_path / "whole.h5"))).matrix.close()
    for event in (desk.door.open, desk.door.reached):
        event.clear()
    desk.door.made.clear()
    return contents(tmp_path / "whole.h5")


def test_planes_of_a_stopped_assembling_are_kept_and_it_continues_to_the_same_h(desk: Desk, whole: Any) -> None:
    row = desk.stopped()
    assert row.status.text() == "stopped after 1 of 2 planes" and not desk.out.exists()
    assert row.go_on.isVisibleTo(row) and row.button.text() == "Discard"
    assert "end      stopped after 1 of 2 planes" in desk.log()
    desk.context.project.update("rename", name="changed meanwhile")
    desk.door.open.set()
    row.go_on.click()
    assert desk.row() is row
    assert stored(desk.out) == whole and desk.door.made == [0, 1], "the first plane is not made again"
    assert row.status.text().startswith("done in") and not row.go_on.isVisibleTo(row)
    assert desk.context.state.psf == str(desk.out) and not parts_folder(desk.out).exists()
    assert desk.context.history.taken[-1].out == str(desk.out) and "resumed" in desk.log()


def stored(path: Path) -> dict[str, Any]:
    """Return what is in an H file, which the window may have open."""
    return contents(Path(shutil.copy(path, path.with_name("copy.h5"))))


def test_an_assembling_that_fails_keeps_its_planes(desk: Desk, whole: Any) -> None:
    desk.door.error = StorageError("H.h5: the disk is full; make room")
    desk.page.assemble(str(desk.out))
    row = desk.row()
    assert desk.context.jobs.jobs()[0].state is JobState.FAILED
    assert row.status.text() == "failed; 1 of 2 planes are kept"
    assert row.error.text() == "H.h5: the disk is full; make room"
    assert not desk.out.exists() and not list(parts_folder(desk.out).glob("*.part*"))
    desk.door.error = None
    desk.door.open.set()
    row.go_on.click()
    desk.row()
    assert stored(desk.out) == whole and not row.error.isVisibleTo(row)


def test_planes_of_other_frames_or_corrections_are_not_continued(desk: Desk, scan: Path) -> None:
    first = desk.stopped()
    np.save(scan / "0_0_0.npy", true_frame(0, 0, 0) * 2)
    desk.page.panel.choices.edited.emit("use_background", True)
    idle(desk.context.jobs, desk.qtbot)
    desk.door.open.set()
    desk.door.made.clear()
    desk.page.assemble(str(desk.out))
    assert not first.go_on.isVisibleTo(first), "what it kept is the new one's"
    desk.row()
    assert desk.door.made == [0, 1]
    with open_psf(desk.out) as H:
        assert H.provenance["corrections"]


def test_a_project_that_was_begun_meanwhile_takes_nothing(desk: Desk) -> None:
    row, said = desk.stopped(), list[str]()
    desk.context.message.connect(said.append)
    desk.context.project.start(ProjectState(name="another"))
    desk.door.open.set()
    row.go_on.click()
    desk.row()
    assert desk.out.exists() and desk.context.state.psf == "" and "no longer open" in said[-1]


def test_what_another_program_works_at_is_not_offered(tmp_path: Path) -> None:
    from lfcal.work.journal import Journal

    folder = parts_folder(tmp_path / "H.h5")
    folder.mkdir()
    with Journal.open(folder) as journal:
        journal.begin("assemble", ["plane 0000"], "threads", 1, "")
        journal.note("done", unit="plane 0000")
    kept = KeptRun(str(tmp_path / "H.h5"))
    assert kept.look() == "" and folder.exists()
    with Journal.open(folder) as journal:
        journal.note("stopped")
    assert kept.look() == "1 of 1 planes"
    kept.discard()
    assert kept.look() == "" and not folder.exists()


def test_jobs_that_keep_nothing_cannot_go_on(qapp: Any) -> None:
    def working() -> Any:
        yield Progress(0, 1, "work")

    jobs = Jobs()
    number = jobs.start("short", "frames", working)
    jobs.go_on(number)
    jobs.discard(number)
    jobs.close()


def test_what_is_kept_is_discarded_and_nothing_stays_where_no_plane_was_done(
    desk: Desk, monkeypatch: pytest.MonkeyPatch
) -> None:
    row = desk.stopped()
    assert parts_folder(desk.out).exists()
    row.button.click()
    desk.row()
    assert not parts_folder(desk.out).exists() and not row.go_on.isVisibleTo(row)
    assert row.button.text() == "Dismiss" and row.button.isEnabled()

    def failing(self: Assembly, z: int, clock: Any, **how: Any) -> Any:
        yield clock.at(0)
        raise StorageError("H.h5: the disk is full; make room")

    monkeypatch.setattr(Assembly, "iter_plane", failing)
    desk.page.assemble(str(desk.out))
    row = desk.row()
    assert not row.go_on.isVisibleTo(row) and not list(desk.out.parent.glob("H.h5*"))
