"""More > Watch H: frames are checked, the table shows their drift, and H is recalibrated after a drift."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
import tifffile
from PySide6.QtCore import Qt
from pytestqt.qtbot import QtBot

from lfcal.psf import open_psf, save
from lfcal_gui.context import Context
from lfcal_gui.pages.watch.model import WatchSettings
from tests.cli.test_recalibrate import stored
from tests.gui.conftest import OpenPage
from tests.gui.waiting import idle
from tests.recalibrate.common import small_h, small_plan, true_setup
from tests.recalibrate.test_watch import drifted, frame

PLAN = small_plan((2.4,), 66)


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with H, a quiet frame, and a frame after a shift of the array by 0.08 px."""
    folder, setup = tmp_path_factory.mktemp("watch"), true_setup(PLAN)
    sensor = replace(setup.camera.sensor, bit_depth=16, full_well_e=65535.0, black_level=100.0, saturation=None)
    save(small_h(PLAN, replace(setup, camera=replace(setup.camera, sensor=sensor))), folder / "H.h5")
    for name, shift in (("quiet", 0.0), ("moved", 0.08)):
        tifffile.imwrite(folder / f"{name}.tif", stored(frame(drifted(shift, plan=PLAN), 40, plan=PLAN).values))
    return folder


def test_frames_are_checked_and_h_is_recalibrated(
    open_page: OpenPage, context: Context, place: Path, tmp_path: Path, qtbot: QtBot
) -> None:
    page = open_page("watch")
    assert page.empty is not None and "Open an H with its camera" in page.empty.label.text()
    options = (("black_level", 100.0), ("noise", (9.0, 1.0)))
    context.project.update("open", psf=str(place / "H.h5"), settings=WatchSettings(options=options).into(context.state))
    panel = page.panel
    assert not panel.go.isEnabled() and not panel.recalibrate.isEnabled()
    page._use([str(place / "quiet.tif"), str(place / "moved.tif")])
    assert panel.frames.text() == "quiet.tif; moved.tif" and panel.go.isEnabled()
    qtbot.mouseClick(panel.go, Qt.MouseButton.LeftButton)
    assert panel.go.text() == "Stop" and not panel.form.isEnabled()
    idle(context.jobs, qtbot)
    assert panel.go.text() == "Check frames" and panel.table.rowCount() == 2, panel.status.text()
    assert "H is no longer valid: shift x +0.0" in panel.verdict.text() and "is an alarm" in panel.trend.text()
    cells = [[panel.table.item(row, column).text() for column in range(7)] for row in range(2)]
    assert [row[0] for row in cells] == ["quiet.tif", "moved.tif"] and [row[6] for row in cells] == ["valid", "alarm"]
    assert float(cells[1][1].split(" ±")[0]) == pytest.approx(0.08, abs=0.03) and float(cells[1][4]) < 1.05
    assert panel.recalibrate.isEnabled()
    page.recalibrate(str(tmp_path))
    idle(context.jobs, qtbot)
    assert context.state.psf == str(tmp_path / "recalibrated" / "H.h5"), panel.status.text()
    assert panel.status.text().startswith("recalibrated from 1\u00a0frame, goodness of fit")
    assert not panel.table.rowCount()
    with open_psf(place / "H.h5") as old, open_psf(context.state.psf) as new:
        assert old.camera is not None and new.camera is not None
        moved = new.camera.lattice.offset_um[0] - old.camera.lattice.offset_um[0]
        assert moved / PLAN.camera.sensor.pixel_um == pytest.approx(0.08, abs=0.02)


def test_problems_are_named(open_page: OpenPage, context: Context, place: Path, tmp_path: Path, qtbot: QtBot) -> None:
    chosen = WatchSettings(frames=(str(place / "none.tif"),))
    context.project.update("open", psf=str(place / "H.h5"), settings=chosen.into(context.state))
    page = open_page("watch")
    page.start()
    idle(context.jobs, qtbot)
    assert "none.tif" in page.panel.status.text() and page.panel.status.property("role") == "error"
    (tmp_path / "watch.csv").write_text("")
    page.recalibrate(str(tmp_path))
    assert "watch.csv: exists; choose another folder" in page.panel.status.text()
    assert page.settings.why_not("mean", 0) and not page.settings.why_not("mean", 3)
