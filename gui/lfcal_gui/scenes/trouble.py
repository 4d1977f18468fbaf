"""Dialogs and problems: damaged files, failed jobs, many jobs, long names, faults of devices."""

from __future__ import annotations

import dataclasses
import shutil
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from lfcal.accuracy import PARTS
from lfcal.psf import PSFMatrix, open_psf, save
from lfcal.simulate import sample_session
from lfcal_gui._rescue import RestoreDialog
from lfcal_gui.app import safe_now
from lfcal_gui.crash_dialog import CrashDialog
from lfcal_gui.job_panel import JobPanel
from lfcal_gui.jobs import JobState
from lfcal_gui.models import Mishap, UnsavedCopy
from lfcal_gui.palette import Palette, doable
from lfcal_gui.scenes.sample import open_sample
from lfcal_gui.scenes.stage import Capture, Stage

LONG = "H_of_the_second_alignment_after_cleaning_the_main_lens_100mm_f2.8_2026-03-16_plane_by_plane.h5"


def trouble(stage: Stage) -> Iterator[Capture]:
    """Show long names, errors on pages, jobs and the log."""
    window = stage.window
    open_sample(stage)
    named = stage.folder / LONG
    if not named.is_file():
        shutil.copy(window.project.state.psf, named)
    window.project.update("a long name", psf=str(named))
    for key in ("h", "reconstruct"):
        stage.page(key)
        stage.tidy()
        yield Capture(f"{key}_long_name")
    broken = stage.folder / ("damaged_" + LONG)
    broken.write_bytes(named.read_bytes()[:3000])
    page = stage.page("h")
    page.open_file(str(broken))
    stage.settle()
    stage.tidy()
    yield Capture("h_refused")
    page = stage.page("frames")
    page.open_folder(str(stage.folder))
    stage.settle()
    stage.tidy()
    yield Capture("frames_refused")
    window.project.update("gone", psf=str(stage.folder / "gone.h5"), frames=str(stage.folder / "gone"))
    for key in ("h", "frames"):
        stage.page(key)
        stage.tidy()
        yield Capture(f"{key}_gone")
    yield from _jobs(stage)


def _jobs(stage: Stage) -> Iterator[Capture]:
    """Show jobs that have ended, failed, run and wait; then the log."""
    window = stage.window
    window.project.update("back", psf=str(stage.folder / LONG))
    page = stage.page("reconstruct")
    page.exporting.start(str(stage.folder / "exported.mat"))
    stage.settle()
    page.exporting.start("/proc/none/exported.mat")
    stage.settle()
    page = stage.page("accuracy")
    page.measure(PARTS.names())
    stage.window.page("simulate").measure()
    stage.window.page("simulate").simulate(str(stage.folder / "queued.h5"))
    stage.turn(100)
    window.job_line.toggle()
    stage.turn()
    yield Capture("jobs_running", window)
    for job in window.jobs.jobs():
        if job.active:
            window.jobs.cancel(job.number)
    stage.until(lambda: all(j.state is not JobState.RUNNING for j in window.jobs.jobs()), "the end")
    stage.settle()
    yield Capture("jobs_ended", window)
    window.job_line.toggle()
    window.log_dock.toggleViewAction().trigger()  # as a user opens it
    stage.turn()
    yield Capture("log", window.log_dock)
    window.log_dock.hide()


def dialogs(stage: Stage) -> Iterator[Capture]:
    """Open the dialogs one after the other."""
    window = stage.window
    open_sample(stage)
    page = stage.page("frames")
    page.start_import(str(sample_session() / "frames"))
    stage.settle()
    yield Capture("dialog_import", page.dialog)
    page.dialog.close()
    page = stage.page("setup")
    page.measure_sensor()
    stage.settle()
    yield Capture("dialog_sensor", page.dialog)
    page.dialog.close()
    for name in ("preferences", "doctor", "verify"):
        dialog = getattr(window.tools, name)()
        stage.settle()
        yield Capture(f"dialog_{name}", dialog)
        dialog.close()
    palette = Palette(window, doable(window.menus.menus, window.shown, "Set up"))
    palette.open()
    stage.turn()
    yield Capture("dialog_palette", palette)
    palette.close()
    window.show_manual("faults.md")
    stage.settle()
    yield Capture("dialog_manual", window._manual)
    window._manual.close()


def faults(stage: Stage) -> Iterator[Capture]:
    """Judge an H with misplaced, swapped and empty positions; then show the dialogs of unexpected errors."""
    window = stage.window
    open_sample(stage)
    spoilt = stage.folder / "spoilt.h5"
    if not spoilt.is_file():
        _spoil(Path(window.project.state.psf), spoilt)
    window.project.update("spoilt", psf=str(spoilt))
    stage.page("h")
    stage.settle()
    stage.tidy()
    yield Capture("h_spoilt")
    page = stage.page("h")
    page.look_into("checks")
    page.checking.measure(force=True)
    stage.settle()
    stage.tidy()
    yield Capture("h_faults")
    for row in range(1, 3):
        page.checking.view.table.choose(row)
        stage.settle()
        yield Capture(f"h_fault_{row}")
    page.look_into("")
    yield from _log(stage)
    yield from _mishaps(stage)


def _spoil(source: Path, target: Path) -> None:
    """Write an H with faults: two displaced patterns, two swapped ones, and one without light."""
    with open_psf(source) as whole:
        data = np.stack([whole.plane(z) for z in range(len(whole))])
        data[0, 1, 2] = np.roll(data[0, 1, 2], 3, axis=-1)
        data[0, 4, 4] = np.roll(data[0, 4, 4], -3, axis=-2)
        data[0, 2, [1, 5]] = data[0, 2, [5, 1]]
        data[0, 5, 1] = 0
        save(PSFMatrix(data, depths=whole.depths, camera=whole.camera, anchor=whole.anchor, facts=whole.facts), target)


def _log(stage: Stage) -> Iterator[Capture]:
    window = stage.window
    panel = window.findChild(JobPanel)
    view = panel.row(panel.listed()[-1]).show_log()
    stage.turn(100)
    yield Capture("dialog_job_log", view)
    view.close()


def _mishaps(stage: Stage) -> Iterator[Capture]:
    window = stage.window
    try:
        raise ZeroDivisionError("division by zero")
    except ZeroDivisionError as error:
        first = Mishap.of(error)
    crash = CrashDialog(stage.folder / "lfcal.log", window)
    crash.show_mishaps([dataclasses.replace(first, count=4)], safe_now(window))
    stage.turn()
    yield Capture("dialog_crash", crash)
    crash.more.setChecked(True)
    stage.turn()
    yield Capture("dialog_crash_details", crash)
    crash.close()
    kept = UnsavedCopy(
        stage.folder / "copy.lfcal", window.project.state, str(stage.folder / "bench.lfcal"), time.time()
    )
    restore = RestoreDialog(kept, window)
    restore.open()
    stage.turn()
    yield Capture("dialog_restore", restore)
    restore.close()
