"""An assembling that is stopped, fails, or whose window is killed keeps its planes, and goes on to the same H."""

from __future__ import annotations

import shutil
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pytestqt.qtbot import QtBot

from lfcal.base.errors import StorageError
from lfcal.base.progress import Progress, drain
from lfcal.psf import open_psf
from lfcal.psf.assembly import Assembly
from lfcal.work import parts_folder, read_run
from lfcal_gui.context import Context
from lfcal_gui.job_panel import JobPanel
from lfcal_gui.jobs import Jobs, JobState
from lfcal_gui.models.job import KeptRun
from lfcal_gui.models.project import ProjectState
from lfcal_gui.pages.frames.model import iter_assembly
from tests.cli.conftest import SHAPE, small_plan, true_frame
from tests.gui.waiting import GUARD_MS, idle
from tests.psf.test_joining import contents


@pytest.fixture
def scan(tmp_path: Path) -> Path:
    """Write a scan of two planes."""
    folder, rows = tmp_path / "scan", ["file,z,y,x"]
    folder.mkdir()
    for z, y, x in np.ndindex(SHAPE):
        np.save(folder / f"{z}_{y}_{x}.npy", true_frame(z, y, x))
        rows.append(f"{z}_{y}_{x}.npy,{z},{y},{x}")
    (folder / "manifest.csv").write_text("\n".join(rows) + "\n")
    (folder / "plan.json").write_text(small_plan().to_json())
    return folder


@pytest.fixture
def scanned(scan: Path, open_page: Any, context: Context, qtbot: QtBot) -> Any:
    page = open_page("frames")
    page.open_folder(str(scan))
    idle(context.jobs, qtbot)
    return page


@pytest.fixture
def panel(context: Context, qtbot: QtBot) -> JobPanel:
    made = JobPanel(context.jobs)
    qtbot.addWidget(made)
    return made


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


@pytest.fixture
def whole(scanned: Any, tmp_path: Path) -> dict[str, Any]:
    """Return what is in the file of an assembling that nothing stopped."""
    drain(iter_assembly(scanned.opened, str(tmp_path / "whole.h5"))).matrix.close()
    return contents(tmp_path / "whole.h5")


def stored(path: Path) -> dict[str, Any]:
    """Return what is in an H file, which the window may have open."""
    return contents(Path(shutil.copy(path, path.with_name("copy.h5"))))


def stopped(page: Any, context: Context, qtbot: QtBot, out: Path, door: Door) -> int:
    """Stop an assembling in its second plane; return the job's number."""
    page.assemble(str(out))
    number = context.jobs.jobs()[0].number
    qtbot.waitUntil(door.reached.is_set, timeout=GUARD_MS)
    context.jobs.cancel(number)
    idle(context.jobs, qtbot)
    return number


def test_planes_of_a_stopped_assembling_are_kept_and_it_goes_on_to_the_same_h(
    scanned: Any, whole: Any, context: Context, panel: JobPanel, qtbot: QtBot, tmp_path: Path, door: Door
) -> None:
    out = tmp_path / "H.h5"
    number = stopped(scanned, context, qtbot, out, door)
    row = panel.row(number)
    assert row.status.text() == "stopped after 1 of 2 planes" and not out.exists()
    assert row.go_on.isVisibleTo(row) and row.button.text() == "Discard"
    assert "end      stopped after 1 of 2 planes" in context.jobs.log(number).text()
    context.project.update("rename", name="changed meanwhile")
    door.open.set()
    row.go_on.click()
    idle(context.jobs, qtbot)
    assert stored(out) == whole and door.made == [0, 1], "the first plane is not made again"
    assert row.status.text().startswith("done in") and not row.go_on.isVisibleTo(row)
    assert context.state.psf == str(out) and not parts_folder(out).exists()
    assert context.history.taken[-1].out == str(out)
    assert "resumed" in context.jobs.log(number).text()


def test_what_is_kept_is_discarded(
    scanned: Any, context: Context, panel: JobPanel, qtbot: QtBot, tmp_path: Path, door: Door
) -> None:
    out = tmp_path / "H.h5"
    row = panel.row(stopped(scanned, context, qtbot, out, door))
    assert parts_folder(out).exists()
    row.button.click()
    idle(context.jobs, qtbot)
    assert not parts_folder(out).exists() and not row.go_on.isVisibleTo(row)
    assert row.button.text() == "Dismiss" and row.button.isEnabled()


def test_an_assembling_that_fails_keeps_its_planes(
    scanned: Any, whole: Any, context: Context, panel: JobPanel, qtbot: QtBot, tmp_path: Path, door: Door
) -> None:
    out, door.error = tmp_path / "H.h5", StorageError("H.h5: the disk is full; make room")
    scanned.assemble(str(out))
    idle(context.jobs, qtbot)
    job = context.jobs.jobs()[0]
    row = panel.row(job.number)
    assert job.state is JobState.FAILED and row.status.text() == "failed; 1 of 2 planes are kept"
    assert row.error.text() == "H.h5: the disk is full; make room"
    assert not out.exists() and not list(parts_folder(out).glob("*.part*"))
    door.error = None
    door.open.set()
    row.go_on.click()
    idle(context.jobs, qtbot)
    assert stored(out) == whole and not row.error.isVisibleTo(row)


@pytest.mark.long
def test_after_a_window_is_gone_another_goes_on(
    scanned: Any, whole: Any, context: Context, qtbot: QtBot, tmp_path: Path, door: Door
) -> None:
    """The threads of a window that is killed end with it; only the files of whole planes are there."""
    out = tmp_path / "H.h5"
    running = iter_assembly(scanned.opened, str(out))
    while not door.reached.is_set():
        next(running)
    running.close()
    door.made.clear()
    door.open.set()
    assert read_run(parts_folder(out)).count("done") == 1
    scanned.assemble(str(out))
    idle(context.jobs, qtbot)
    assert stored(out) == whole and door.made == [1]
    assert "1 by an earlier run" in context.jobs.log(context.jobs.jobs()[0].number).text()


def test_planes_of_other_frames_or_corrections_are_not_gone_on_with(
    scanned: Any, context: Context, panel: JobPanel, qtbot: QtBot, tmp_path: Path, scan: Path, door: Door
) -> None:
    out = tmp_path / "H.h5"
    first = stopped(scanned, context, qtbot, out, door)
    np.save(scan / "0_0_0.npy", true_frame(0, 0, 0) * 2)
    scanned.panel.choices.edited.emit("use_background", True)
    idle(context.jobs, qtbot)
    door.open.set()
    door.made.clear()
    scanned.assemble(str(out))
    assert not panel.row(first).go_on.isVisibleTo(panel.row(first)), "what it kept is the new one's"
    idle(context.jobs, qtbot)
    assert door.made == [0, 1]
    with open_psf(out) as H:
        assert H.provenance["corrections"]


def test_nothing_stays_where_no_plane_was_done(
    scanned: Any, context: Context, panel: JobPanel, qtbot: QtBot, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def failing(self: Assembly, z: int, clock: Any, **how: Any) -> Any:
        yield clock.at(0)
        raise StorageError("H.h5: the disk is full; make room")

    monkeypatch.setattr(Assembly, "iter_plane", failing)
    scanned.assemble(str(tmp_path / "H.h5"))
    idle(context.jobs, qtbot)
    row = panel.row(context.jobs.jobs()[0].number)
    assert not row.go_on.isVisibleTo(row) and not list(tmp_path.glob("H.h5*"))


def test_a_project_that_was_begun_meanwhile_takes_nothing(
    scanned: Any, context: Context, panel: JobPanel, qtbot: QtBot, tmp_path: Path, door: Door
) -> None:
    out, said = tmp_path / "H.h5", list[str]()
    number = stopped(scanned, context, qtbot, out, door)
    context.message.connect(said.append)
    context.project.start(ProjectState(name="another"))
    door.open.set()
    panel.row(number).go_on.click()
    idle(context.jobs, qtbot)
    assert out.exists() and context.state.psf == "" and "no longer open" in said[-1]


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
