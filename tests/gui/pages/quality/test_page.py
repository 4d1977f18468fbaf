from __future__ import annotations

import threading
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pytestqt.qtbot import QtBot

from lfcal.base.errors import InputError
from lfcal.base.progress import Progress, Work
from lfcal.psf import PSFMatrix, save
from lfcal_gui.jobs import JobState
from lfcal_gui.pages.quality.model import listed_metrics, map_of, metric_rows, metric_words, worst_positions
from lfcal_gui.window import MainWindow
from tests.gui.waiting import GUARD_MS, idle


def faulty(path: Path) -> Path:
    """Write a small H in which one frame is missing."""
    r, c = np.mgrid[-10:11, -10:11]
    values = np.zeros((2, 5, 6, 21, 21), np.float32)
    for z, y, x in np.ndindex(2, 5, 6):
        lens = np.cos(np.pi * (r + y) / 5) ** 2 * np.cos(np.pi * (c + x) / 6) ** 2
        values[z, y, x] = 1000 * lens * np.exp(-(r**2 + c**2) / (18.0 + 10 * z))
    values[1, 2, 3] = 0
    recorded = np.ones((2, 5, 6))
    recorded[1, 2, 3] = 0
    save(PSFMatrix(values, recorded=recorded, depths=[-1000, 1000]), path)
    return path


def test_from_h_to_the_list_of_positions(window: MainWindow, qtbot: QtBot, tmp_path: Path) -> None:
    window.project.update("open", psf=str(faulty(tmp_path / "H.h5")))
    with qtbot.waitSignal(window.jobs.finished, timeout=GUARD_MS) as end:
        window.go("quality")
    assert not end.args[0].error
    page: Any = window.page("quality")
    found, panel = page.inspection, page.panel.inspect
    report = found.quality
    listed = listed_metrics(found)
    assert panel.table.rowCount() == len(listed) == len(metric_rows(found)) < len(report.metrics)
    assert "not applicable" in panel.counts.text()
    panel.every.click()
    assert panel.table.rowCount() == len(report.metrics)
    panel.every.click()
    assert panel.verdict.text() == found.verdict and "H has no camera" in panel.summary.text()
    assert panel.faults.isHidden() and not panel.no_faults.isHidden()
    assert (1, 2, 3) in worst_positions(found)
    missing = next(k for k, m in enumerate(listed) if "issing" in m.spec.title)
    panel.table.selectRow(missing)
    assert "What to do" in metric_words(found, listed[missing]) and panel.words.toPlainText()
    panel.evidence.slider.setValue(1)
    mapped = [m for m in report.metrics if map_of(m, 1) is not None]
    assert mapped and map_of(mapped[0], 99) is None
    panel.redo.click()
    assert (1, 2, 3) in window.project.state.redo
    acquire = window.page("acquire")
    assert window.stack.currentWidget() is acquire and acquire.empty is not None, "there is no plan"
    panel.evidence.position_clicked.emit(2, 3)
    assert window.shown is window.page("psf")
    idle(window.jobs, qtbot)
    assert window.page("psf").intent.z == 1  # type: ignore[attr-defined]


@pytest.mark.parametrize("key", ["quality", "fit", "accuracy"])
def test_stop_ends_every_job_of_its_page(window: MainWindow, qtbot: QtBot, key: str) -> None:
    """A report could be stopped in the dock Jobs alone, beside a button Stop that was grey."""
    page: Any = window.page(key)
    going_on = threading.Event()

    def report() -> Work[None]:
        while True:
            yield Progress(0, 1, "writing")
            going_on.set()

    assert not page.stop_button.isEnabled()
    number = window.jobs.start("Report", key, report)
    qtbot.waitUntil(going_on.is_set, timeout=GUARD_MS)
    assert page.stop_button.isEnabled()
    page.stop_button.click()
    idle(window.jobs, qtbot)
    assert not page.stop_button.isEnabled()
    assert {job.number: job.state for job in window.jobs.jobs()}[number] is JobState.CANCELLED


def test_what_was_found_before_is_said_to_be_where_the_next_inspection_fails(
    window: MainWindow, qtbot: QtBot, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    window.project.update("open", psf=str(faulty(tmp_path / "H.h5")))
    page: Any = window.page("quality")
    page.measure()
    idle(window.jobs, qtbot)
    verdict, settings = page.panel.inspect.verdict.text(), page.settings

    def fails(asked: Any, kept: Any) -> Work[None]:
        yield Progress(0, 1, "reading")
        raise InputError("no memory; close something")

    monkeypatch.setattr("lfcal_gui.pages.quality.page.iter_judge", fails)
    state = window.project.state
    window.project.update("seconds", settings=replace(settings, seconds=settings.seconds + 60).into(state))
    page.measure(force=True)
    idle(window.jobs, qtbot)
    assert page.panel.inspect.verdict.text() == verdict and "found before" in page.notice.label.text()
    assert "Choices changed since" in page.panel.inspect.summary.text(), "these were not used"


def test_one_report_at_a_time(window: MainWindow, qtbot: QtBot, tmp_path: Path) -> None:
    window.project.update("open", psf=str(faulty(tmp_path / "H.h5")))
    page: Any = window.page("quality")
    page.measure()
    idle(window.jobs, qtbot)
    page.write_report(str(tmp_path / "report"))
    assert not page.report_button.isEnabled() and page.measure_button.isEnabled()
    window.jobs.cancel_all()
    idle(window.jobs, qtbot)
    assert page.report_button.isEnabled()


def test_nothing_to_judge(window: MainWindow) -> None:
    window.go("quality")
    page: Any = window.page("quality")
    assert page.inspection is None and not page.report_button.isEnabled()
    assert "No PSF" in page.empty.label.text()


def test_a_damaged_h_says_so(window: MainWindow, qtbot: QtBot, tmp_path: Path) -> None:
    (tmp_path / "H.h5").write_bytes(b"no hdf5")
    window.project.update("open", psf=str(tmp_path / "H.h5"))
    page: Any = window.page("quality")
    page.write_report(str(tmp_path / "report"))
    page.measure()
    idle(window.jobs, qtbot)
    assert window.log_view.toPlainText().count("HDF5") >= 2 and "HDF5" in page.empty.label.text()
