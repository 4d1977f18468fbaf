"""Scans with gaps and frames that cannot be read: what is shown of them, and how H is made without them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from pytestqt.qtbot import QtBot

from lfcal.frames.source import Position
from lfcal.psf import open_psf
from lfcal_gui.context import Context
from lfcal_gui.pages.frames.model import FrameSettings, import_folder
from lfcal_gui.pages.frames.step import step
from tests.cli.conftest import SHAPE, small_plan, true_frame
from tests.gui.waiting import idle

DAMAGED = (0, 1, 1)
FIRST = (0, 0, 0)


@pytest.fixture
def scan(tmp_path: Path) -> Path:
    """Write a scan without its first frame, and with a damaged one."""
    folder, rows = tmp_path / "scan", ["file,z,y,x"]
    folder.mkdir()
    for place in np.ndindex(SHAPE):
        if place != FIRST:
            name = "{}_{}_{}.png".format(*place)
            cv2.imwrite(str(folder / name), true_frame(*place))
            rows.append(name + ",{},{},{}".format(*place))
    (folder / "manifest.csv").write_text("\n".join(rows) + "\n")
    (folder / "plan.json").write_text(small_plan().to_json())
    file = folder / "{}_{}_{}.png".format(*DAMAGED)
    file.write_bytes(file.read_bytes()[:80])
    return folder


def test_a_scan_without_its_first_frame_opens_where_there_is_one(
    scan: Path, open_page: Any, context: Context, qtbot: QtBot
) -> None:
    page = open_page("frames")
    page.open_folder(str(scan))
    idle(context.jobs, qtbot)
    assert page.position == Position(0, 0, 1) and page.loaded is not None
    page.go_to(Position(*FIRST))  # asked for, the gap is shown
    assert page.position == Position(*FIRST) and page.loaded is None


def test_the_nearest_frame_is_one_of_the_same_plane_if_that_has_any(scan: Path) -> None:
    opened = import_folder(str(scan), FrameSettings(), None).opened
    assert opened is not None
    assert opened.recorded(Position(1, 1, 1)) == (1, 1, 1)
    table = opened.frames.copy()
    table[0] = -1
    table[0, -1, -1] = 5
    assert replace(opened, frames=table).recorded(Position(0, 0, 0)) == (0, SHAPE[1] - 1, SHAPE[2] - 1)
    table[0] = -1
    assert replace(opened, frames=table).recorded(Position(0, 1, 2)) == (1, 1, 2)
    table[:] = -1
    assert replace(opened, frames=table).recorded(Position(0, 1, 2)) == (0, 1, 2)
    opened.view.close()


def test_damaged_frames_can_be_left_out_of_h(
    scan: Path, open_page: Any, context: Context, qtbot: QtBot, tmp_path: Path
) -> None:
    page = open_page("frames")
    page.open_folder(str(scan))
    idle(context.jobs, qtbot)
    page.go_to(Position(*DAMAGED))
    idle(context.jobs, qtbot)
    assert page.notice.isVisible() and page.notice.button.text() == "Leave out damaged frames"
    page.notice.button.click()
    idle(context.jobs, qtbot)
    assert page.panel.choices.editor("skip_damaged").isChecked() and FrameSettings.of(context.state).skip_damaged
    assert page.notice.label.text().startswith("1 damaged frame is left out")
    assert page.opened.frames[DAMAGED] < 0 and "damaged" in page.opened.left_out[0]
    page.assemble(str(tmp_path / "H.h5"))
    idle(context.jobs, qtbot)
    with open_psf(tmp_path / "H.h5") as made:
        assert [tuple(place) for place in made.missing.tolist()] == [FIRST, DAMAGED]
    made = step(context.state)
    assert "--skip-damaged" in made.arguments and "skip_damaged=True" in made.python
    context.project.undo()  # the H
    context.project.undo()
    assert not page.panel.choices.editor("skip_damaged").isChecked()
    assert "--skip-damaged" not in step(context.state).arguments


def test_what_is_subtracted_as_no_light_is_said(scan: Path, open_page: Any, context: Context, qtbot: QtBot) -> None:
    page = open_page("frames")
    box = page.panel.choices.editor("use_dark")
    page.open_folder(str(scan))
    idle(context.jobs, qtbot)
    assert not box.isChecked() and not box.isEnabled() and "No dark frame and no black level" in box.toolTip()
    folder = scan / "dark"
    folder.mkdir()
    cv2.imwrite(str(folder / "0.png"), np.full_like(true_frame(*FIRST), 3))
    page.open_folder(str(scan))
    idle(context.jobs, qtbot)
    assert box.isChecked() and box.isEnabled() and "the mean dark frame" in box.toolTip()
    box.setChecked(False)
    idle(context.jobs, qtbot)
    assert not box.isChecked() and box.isEnabled()


def test_the_offer_goes_with_the_frame_that_it_is_of(
    scan: Path, open_page: Any, context: Context, qtbot: QtBot
) -> None:
    page = open_page("frames")
    page.open_folder(str(scan))
    idle(context.jobs, qtbot)
    page.go_to(Position(*DAMAGED))
    idle(context.jobs, qtbot)
    assert page.notice.isVisible()
    page.go_to(Position(0, 0, 1))
    idle(context.jobs, qtbot)
    assert page.loaded is not None and not page.notice.isVisible()
