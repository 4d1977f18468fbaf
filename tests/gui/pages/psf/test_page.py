from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from pytestqt.qtbot import QtBot

from gui.window import MainWindow
from lfcal.psf import PSFMatrix, save
from tests.gui.waiting import idle


def test_psf_controls_follow_the_intent_and_back(window: MainWindow, qtbot: QtBot, tmp_path: Path) -> None:
    values = np.random.default_rng(0).random((3, 4, 5, 9, 11)).astype(np.float32)
    save(PSFMatrix(values, depths=[-10, 0, 10]), tmp_path / "H.h5")
    save(PSFMatrix(values * 3, depths=[-10, 0, 10]), tmp_path / "R.h5")
    window.project.update("open", psf=str(tmp_path / "H.h5"), reference=str(tmp_path / "R.h5"))
    window.go("psf")
    page: Any = window.page("psf")
    idle(window.jobs, qtbot)
    assert (page.intent.z, page.intent.y, page.intent.x) == (1, 2, 2)
    page.panel.map.chosen.emit(3, 4)
    np.testing.assert_array_equal(page.panel.main_view.image, values[1, 3, 4])
    page.panel.plane_slider.setValue(2)
    idle(window.jobs, qtbot)
    np.testing.assert_array_equal(page.panel.main_view.image, values[2, 3, 4])
    page.panel.strip.setCurrentRow(0)
    idle(window.jobs, qtbot)
    assert page.intent.z == 0 and page.panel.plane_slider.value() == 0
    page.panel.ht_button.click()
    np.testing.assert_array_equal(page.panel.main_view.image, page.matrix.T[0, 3, 4])
    page.panel.main_view.hovered.emit(2, 3, 0.0)
    assert page.panel.linked_view.cursor.isVisible()
    page.panel.main_view.hovered.emit(-1, -1, float("nan"))
    assert not page.panel.linked_view.cursor.isVisible()
    page.panel.show_box.setCurrentIndex(page.panel.show_box.findData("difference"))
    assert page.panel.main_view.signed and np.abs(page.panel.main_view.image).max() < 1e-5
    page.panel.scale_box.setCurrentIndex(page.panel.scale_box.findData("log"))
    page.panel.show_box.setCurrentIndex(page.panel.show_box.findData("measured"))
    assert not page.panel.main_view.signed
    page.panel.main_view.save_picture(str(tmp_path / "p.png"))
    page.panel.main_view.save_data(str(tmp_path / "p.csv"))
    page.panel.profile.save_data(str(tmp_path / "q.csv"))
    np.testing.assert_allclose(np.loadtxt(tmp_path / "p.csv", delimiter=","), page.panel.main_view.image, rtol=1e-6)
    assert (tmp_path / "p.png").stat().st_size > 1000 and (tmp_path / "q.csv").read_text().startswith("#")


def test_a_damaged_h_says_so(window: MainWindow, qtbot: QtBot, tmp_path: Path) -> None:
    (tmp_path / "H.h5").write_bytes(b"no hdf5")
    window.project.update("open", psf=str(tmp_path / "H.h5"))
    page: Any = window.page("psf")
    idle(window.jobs, qtbot)
    assert page.matrix is None and "HDF5" in page.empty.label.text()
    assert "HDF5" in window.log_view.toPlainText()
