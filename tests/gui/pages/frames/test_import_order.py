"""Numbered frames without a list, through the window: their order says where they belong."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pytestqt.qtbot import QtBot

from lfcal.frames.positions import scan_positions
from lfcal_gui.context import Context
from lfcal_gui.models.project import ProjectState
from lfcal_gui.pages.frames.import_choice import ImportChoice
from lfcal_gui.pages.frames.model import FrameSettings, import_folder, open_imported
from lfcal_gui.pages.frames.model_import import open_choice, survey
from tests.frames.lists.scans import START, scan, write_frames
from tests.gui.pages.frames.test_import_columns import plan, recorded
from tests.gui.waiting import GUARD_MS

SHAPE = plan().shape[:3]


def numbered(folder: Path, order: str) -> str:
    """Write a scan as numbered files in an order of its positions."""
    found = scan()
    names = {p: f"shot_{k}.tif" for k, p in enumerate(scan_positions(SHAPE, order))}
    write_frames(folder, found, [names[tuple(p)] for p in found.positions.tolist()])
    return str(folder)


@pytest.mark.parametrize("order", ["serpentine", "raster"])
def test_numbered_files_open_in_the_order_that_is_said(tmp_path: Path, order: str) -> None:
    folder = numbered(tmp_path / "s", order)
    asked = survey(ImportChoice(folder), plan(), None)
    assert asked.imported is None and "56 numbered files" in asked.problem
    assert "choose their Order above" in asked.problem and "--" not in asked.problem
    found = survey(ImportChoice(folder, order=order), plan(), None)
    assert found.problem == "" and found.imported is not None
    kept = open_choice(found, FrameSettings()).settings
    assert kept.order == order and FrameSettings.from_dict(kept.to_dict()) == kept
    opened = open_imported(folder, kept, plan())
    for z, y, x in np.ndindex(SHAPE):
        light = opened.source.read(int(opened.frames[z, y, x])).astype(float) - 100
        light[3, 3] = 0  # the hot pixel
        assert np.unravel_index(light.argmax(), light.shape) == (START[0] + y, START[1] + x)
    opened.view.close()
    found.close()


def test_the_order_of_frames_before_does_not_hold_for_others(tmp_path: Path) -> None:
    before = FrameSettings(order="raster")
    found = import_folder(recorded(tmp_path / "s"), before, plan())
    assert found.settings.order == "" and found.opened is not None
    found.close()


def test_the_order_is_chosen_in_the_window(qtbot: QtBot, context: Context, open_page: Any, tmp_path: Path) -> None:
    page = open_page("frames")
    context.project.update("camera", camera=scan().camera, plan=plan())
    page.start_import(numbered(tmp_path / "s", "raster"))
    dialog = page.dialog
    qtbot.waitUntil(lambda: dialog.survey is not None, timeout=GUARD_MS)
    assert "choose their Order above" in dialog.words.text()
    dialog.order.setCurrentIndex(dialog.order.findData("raster"))
    qtbot.waitUntil(dialog.open_button.isEnabled, timeout=GUARD_MS)
    assert "order: raster, beginning with shot_0.tif" in dialog.words.text()
    dialog.open_button.click()
    qtbot.waitUntil(lambda: page.loaded is not None, timeout=GUARD_MS)
    state: ProjectState = context.state
    assert FrameSettings.of(state).order == "raster" and (page.opened.frames >= 0).all()


def test_list_names_and_order_are_not_said_together(tmp_path: Path) -> None:
    folder = recorded(tmp_path / "s")
    ordered = survey(ImportChoice(folder, order="raster"), plan(), None)
    assert ordered.problem == "" and ordered.table is None, "the list that lies there is not used, nor shown"
    ordered.close()
    choice = ImportChoice(folder, listed=f"{folder}/stage.csv", pattern="a{y}_{x}.tif", order="raster")
    found = survey(choice, plan(), None)
    assert found.problem == (
        "positions of the frames: expected one of List, Names and Order, got List, Names and Order; "
        "keep one and clear the others"
    )


def test_numbered_files_without_a_plan_are_asked_for_both(tmp_path: Path) -> None:
    folder = numbered(tmp_path / "s", "raster")
    assert "choose their Order above" in survey(ImportChoice(folder), None, None).problem
    found = survey(ImportChoice(folder, order="raster"), None, None)
    assert "scan plan: expected one with the frames or in the project" in found.problem


def test_fewer_frames_than_positions_have_no_order(tmp_path: Path) -> None:
    folder = numbered(tmp_path / "s", "raster")
    Path(folder, "shot_7.tif").unlink()
    found = survey(ImportChoice(folder, order="raster"), plan(), None)
    assert found.problem.startswith("frames: expected 56 for a scan of 2 x 4 x 7, got 55")
