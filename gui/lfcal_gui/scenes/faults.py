"""An H with faults, as the inspection finds them; the log of a job; what is asked after an unexpected error."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from lfcal.psf import PSFMatrix, open_psf, save
from lfcal_gui.app import safe_now
from lfcal_gui.crash_dialog import CrashDialog
from lfcal_gui.job_panel import JobPanel
from lfcal_gui.models import Mishap, UnsavedCopy
from lfcal_gui.restore_dialog import RestoreDialog
from lfcal_gui.scenes.sample import open_sample
from lfcal_gui.scenes.stage import Capture, Stage

__all__ = ["faults"]


def faults(stage: Stage) -> Iterator[Capture]:
    """Judge an H with misplaced, swapped and empty positions; then the dialogs of mishaps."""
    window = stage.window
    open_sample(stage)
    spoilt = stage.folder / "spoilt.h5"
    if not spoilt.is_file():
        _spoil(Path(window.project.state.psf), spoilt)
    window.project.update("spoilt", psf=str(spoilt))
    stage.page("psf")
    stage.settle()
    stage.tidy()
    yield Capture("psf_spoilt")
    page = stage.page("psf")
    page.look_into("checks")
    page.checking.measure(force=True)
    stage.settle()
    stage.tidy()
    yield Capture("psf_faults")
    for row in range(1, 3):
        page.checking.view.table.choose(row)
        stage.settle()
        yield Capture(f"psf_fault_{row}")
    page.look_into("")
    yield from _log(stage)
    yield from _mishaps(stage)


def _spoil(source: Path, target: Path) -> None:
    """Write an H with faults: two patterns moved, two swapped, one that holds no light."""
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
