"""What goes wrong: files that are damaged or gone, a job that fails, many jobs, long names."""

from __future__ import annotations

import shutil
from collections.abc import Iterator

from lfcal.accuracy import PLACES
from lfcal_gui.jobs import JobState
from lfcal_gui.scenes.sample import open_sample
from lfcal_gui.scenes.stage import Capture, Stage

__all__ = ["trouble"]

LONG = "H_of_the_second_alignment_after_cleaning_the_main_lens_100mm_f2.8_2026-03-16_plane_by_plane.h5"


def trouble(stage: Stage) -> Iterator[Capture]:
    """Show long names, errors on pages, jobs and the log."""
    window = stage.window
    open_sample(stage)
    named = stage.folder / LONG
    if not named.is_file():
        shutil.copy(window.project.state.psf, named)
    window.project.update("a long name", psf=str(named))
    for key in ("psf", "reconstruct"):
        stage.page(key)
        stage.tidy()
        yield Capture(f"{key}_long_name")
    broken = stage.folder / ("damaged_" + LONG)
    broken.write_bytes(named.read_bytes()[:3000])
    page = stage.page("psf")
    page.open_file(str(broken))
    stage.settle()
    stage.tidy()
    yield Capture("psf_refused")
    page = stage.page("frames")
    page.open_folder(str(stage.folder))
    stage.settle()
    stage.tidy()
    yield Capture("frames_refused")
    window.project.update("gone", psf=str(stage.folder / "gone.h5"), frames=str(stage.folder / "gone"))
    for key in ("psf", "frames"):
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
    page.measure(PLACES.names())
    stage.window.page("simulate").measure()
    stage.window.page("simulate").simulate(str(stage.folder / "queued.h5"))
    stage.turn(100)
    window.job_line.toggle()
    stage.turn()
    yield Capture("jobs_running")
    for job in window.jobs.jobs():
        if job.active:
            window.jobs.cancel(job.number)
    stage.until(lambda: all(j.state is not JobState.RUNNING for j in window.jobs.jobs()), "the end")
    stage.settle()
    yield Capture("jobs_ended")
    window.job_line.toggle()
    window.log_dock.show()
    window.log_dock.raise_()
    stage.turn()
    yield Capture("log")
    window.log_dock.hide()
