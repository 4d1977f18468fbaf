"""The sensor measured in the window: folders chosen, figures shown, the camera changed by one undoable step."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile
from PySide6.QtWidgets import QPushButton
from pytestqt.qtbot import QtBot

from lfcal.camera import ScanPlan
from lfcal_gui.context import Context
from lfcal_gui.pages.setup._sensor_dialog import SensorDialog
from tests.frames.photon_transfer.sensor_model import Truth, micro_images
from tests.gui.conftest import OpenPage
from tests.gui.waiting import idle

TRUTH = Truth(shape=(100, 120))


def write(place: Path, processed: bool = False) -> tuple[str, str]:
    frames = {"flats": TRUTH.flats([0.3, 1.2], 2, micro_images(TRUTH.shape)), "darks": TRUTH.darks(3)}
    for name, held in frames.items():
        (place / name).mkdir(parents=True)
        for k, frame in enumerate(held):
            shown = np.rint(255 * (frame / 4095) ** 0.45).astype(np.uint8) if processed else frame
            tifffile.imwrite(place / name / f"{k}.tif", shown)
    return str(place / "flats"), str(place / "darks")


@pytest.fixture
def page(open_page: OpenPage) -> Any:
    return open_page("setup")


@pytest.fixture
def dialog(page: Any) -> SensorDialog:
    button = next(b for b in page.findChildren(QPushButton) if b.text().startswith("Sensor"))
    button.click()
    made: SensorDialog = page.dialog
    button.click()
    assert page.dialog is made and made.isVisible()
    return made


def test_the_camera_is_measured(
    page: Any, dialog: SensorDialog, context: Context, qtbot: QtBot, tmp_path: Path
) -> None:
    flats, darks = write(tmp_path)
    dialog.set_folder("flats", flats)
    assert not context.jobs.busy and not dialog.take_button.isEnabled()
    dialog.set_folder("darks", darks)
    idle(context.jobs, qtbot)
    assert dialog.found is not None and dialog.take_button.isEnabled()
    shown = [dialog.table.item(row, 1).text() for row in range(dialog.table.rowCount())]
    assert any("e⁻ per count" in text for text in shown) and "structure" in dialog.words.text()
    assert len(dialog.plot._curves["fitted"].getOriginalDataset()[0]) > 10
    before = context.project.state.camera
    context.project.update("plan", plan=ScanPlan.for_camera(before, virtual_depths=(3.0,)))
    dialog.take_button.click()
    after = context.project.state.camera
    assert after.sensor.electrons_per_count == pytest.approx(5, rel=0.05) and after.lattice == before.lattice
    assert after.marks["sensor.full_well_e"] == "measured"
    assert any(text.startswith(f"{after.sensor.full_well_e:.0f} ± ") for text in shown), "what is taken was told"
    assert not dialog.take_button.isEnabled(), "it has it"
    plan = context.project.state.plan
    assert plan.camera == after, "no noise moves an image"
    form = page.panel.inspector.values
    assert form.mark("sensor.dsnu_e").property("mark") == "measured"
    assert float(form.editor("sensor.dsnu_e").text()) == pytest.approx(after.sensor.dsnu_e)
    context.project.undo()
    assert context.project.state.camera == before and dialog.take_button.isEnabled()
    dialog.close()
    assert page.dialog is None


def chosen(dialog: SensorDialog, context: Context, qtbot: QtBot, folders: tuple[str, str]) -> None:
    for which, path in zip(("flats", "darks"), folders, strict=True):
        dialog.set_folder(which, path)
    idle(context.jobs, qtbot)


def test_doubtful_folders_change_nothing(dialog: SensorDialog, context: Context, qtbot: QtBot, tmp_path: Path) -> None:
    chosen(dialog, context, qtbot, write(tmp_path / "processed", processed=True))
    assert not dialog.take_button.isEnabled() and "Doubtful: " in dialog.words.text()
    assert "record raw" in dialog.take_button.toolTip()
    (tmp_path / "empty").mkdir()
    dialog.set_folder("darks", str(tmp_path / "empty"))
    idle(context.jobs, qtbot)
    assert "expected images" in dialog.words.text() and not dialog.take_button.isEnabled()
    dialog.close()


def test_a_failure_clears_the_results(dialog: SensorDialog, context: Context, qtbot: QtBot, tmp_path: Path) -> None:
    flats, darks = write(tmp_path)
    chosen(dialog, context, qtbot, (flats, darks))
    assert dialog.table.rowCount() > 10 and "another camera" in dialog.words.text(), "of 100 x 120 px"
    assert not dialog.plot.blank.isVisible() and "# fitted:" in "".join(dialog.plot.table_lines(","))
    tifffile.imwrite(tmp_path / "darks" / "9.tif", np.zeros((50, 60), np.uint16))
    dialog.set_folder("darks", darks)
    idle(context.jobs, qtbot)
    assert "darks, 9.tif: expected 100 × 120 px" in dialog.words.text()
    assert dialog.found is None and dialog.table.rowCount() == 0 and dialog.plot.blank.isVisible()
    assert not dialog.take_button.isEnabled() and dialog.take_button.toolTip() == ""
    dialog.close()
