"""What is made of a fit: its camera in the whole window, H, a folder, a report."""

from __future__ import annotations

import json
import threading
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pytestqt.qtbot import QtBot

from lfcal.base.progress import Progress
from lfcal.fit.files import fit_outputs, measured_camera
from lfcal.psf import open_psf
from lfcal_gui.pages.h.page import Page
from tests.gui.pages.h.fit.common import saved
from tests.gui.waiting import idle


def test_the_camera_is_used_and_taken_back(fitted: Page) -> None:
    found, project = fitted.fitting.found, fitted.context.project
    assert found is not None
    before = project.state
    fitted.fitting.view.use_button.click()
    assert project.state.camera == measured_camera(found.fit) and project.undo_label == "fitted camera"
    assert {name for name, _ in project.state.settings["simulate"]["overrides"]} == {e.name for e in found.fit.effects}
    assert "In use" in fitted.fitting.view.detail.text() and fitted.fitting.found is found
    project.undo()
    assert project.state == before and "In use" not in fitted.fitting.view.detail.text()


def test_the_camera_stays_while_a_session_is_recorded(fitted: Page, qtbot: QtBot) -> None:
    go_on, jobs, camera = threading.Event(), fitted.context.jobs, fitted.context.state.camera

    def recording() -> Any:
        while not go_on.is_set():
            yield Progress(0, 1, "recording")
            go_on.wait(0.01)

    jobs.start("Record", "acquire", recording)
    assert not fitted.fitting.view.use_button.isEnabled() and "recorded" in fitted.fitting.view.use_button.toolTip()
    fitted.fitting.use()
    assert fitted.context.state.camera == camera and "recorded" in fitted.notice.label.text()
    go_on.set()
    idle(jobs, qtbot)
    assert fitted.fitting.view.use_button.isEnabled()


def test_h_of_the_fit_is_the_reference(fitted: Page, qtbot: QtBot, tmp_path: Path) -> None:
    found = fitted.fitting.found
    assert found is not None
    fitted.fitting.results.compute(str(tmp_path / "model.h5"))
    idle(fitted.context.jobs, qtbot)
    with open_psf(tmp_path / "model.h5") as H:
        np.testing.assert_array_equal(np.asarray(H), np.asarray(found.fit.model()))
        assert H.provenance["source"] == "H.h5"
    assert fitted.context.state.reference == str(tmp_path / "model.h5") and fitted.fitting.found is found
    own = Path(fitted.context.state.psf)
    before = own.stat()
    fitted.fitting.results.compute(str(own.parent / "." / own.name))
    assert "is the H that was fitted" in fitted.notice.label.text() and own.stat() == before


def test_a_fit_is_saved_as_the_command_writes_it(
    fitted: Page, qtbot: QtBot, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    found, opened = fitted.fitting.found, list[Path]()
    assert found is not None
    monkeypatch.setattr(fitted.fitting.results, "show_page", opened.append)
    fitted.fitting.results.save(str(tmp_path / "fit"))
    idle(fitted.context.jobs, qtbot)
    written = {path for path in (tmp_path / "fit").rglob("*") if path.is_file()}
    assert written == set(fit_outputs(tmp_path / "fit"))
    data = json.loads((tmp_path / "fit" / "fit.json").read_text())
    assert data["source"] == "H.h5" and [one["name"] for one in data["parameters"]] == list(found.fit.parameters)
    fitted.fitting.view.report_button.click()
    assert opened == [tmp_path / "fit" / "report" / "index.html"]
    fitted.fitting.results.save(str(tmp_path))  # its H.h5 is the one that was fitted
    assert "is the H that was fitted" in fitted.notice.label.text()


@pytest.mark.long
def test_a_report_that_nobody_saved_goes_with_the_fit(
    fitted: Page, qtbot: QtBot, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    opened: list[Path] = []
    monkeypatch.setattr(fitted.fitting.results, "show_page", opened.append)
    fitted.fitting.view.report_button.click()
    idle(fitted.context.jobs, qtbot)
    assert len(opened) == 1 and "optics fitted from 6 patterns" in opened[0].read_text()
    fitted.context.project.update("open", psf=str(saved(tmp_path / "other.h5")))
    assert not opened[0].exists()
