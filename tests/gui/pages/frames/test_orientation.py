"""Frames that lie otherwise than the plan says: told on the page, turned on request, kept with H."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pytestqt.qtbot import QtBot

from gui.context import Context
from gui.pages.frames.model import FrameSettings, iter_assembly, load_frame, open_imported
from gui.pages.frames.orientation import advice
from lfcal.frames import open_frames
from lfcal.frames.source import Position
from lfcal.progress import drain
from lfcal.psf.orientation import FoundOrientation
from tests.frames.test_orientation import NUMPY
from tests.gui.waiting import GUARD_MS
from tests.psf.test_orientation import a_plan, upright

PLAN = a_plan((60, 72), (7, 9), (18.0, 20.0), 2, (25, 25))


@pytest.fixture(scope="module")
def mirrored(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write a scan whose frames are mirrored left to right, with its dark."""
    folder = tmp_path_factory.mktemp("mirrored")
    frames, places = upright(PLAN, width=5.0, noise=2.0)
    (folder / "frames").mkdir()
    (folder / "dark").mkdir()
    rows = ["file,z,y,x"]
    for frame, place in zip(frames, places, strict=True):
        name = f"z{place.z}_y{place.y}_x{place.x}.npy"
        np.save(folder / "frames" / name, NUMPY["mirror x"](frame).astype(np.uint16))
        rows.append(f"{name},{place.z},{place.y},{place.x}")
    (folder / "frames" / "manifest.csv").write_text("\n".join(rows) + "\n")
    np.save(folder / "dark" / "dark.npy", np.full(frames.shape[1:], 100, np.uint16))
    (folder / "plan.json").write_text(PLAN.to_json())
    return folder


def test_the_page_names_it_and_turns_the_frames(
    qtbot: QtBot, context: Context, open_page: Any, mirrored: Path, tmp_path: Path
) -> None:
    page = open_page("frames")
    page.open_folder(str(mirrored))
    qtbot.waitUntil(lambda: page.notice.isVisible() and "mirrored" in page.notice.label.text(), timeout=GUARD_MS)
    assert page.notice.label.text().startswith("The frames are mirrored left to right")
    assert page.notice.button.text() == "Turn them upright"
    page.notice.button.click()
    qtbot.waitUntil(lambda: page.opened is not None and page.opened.view.shape == (60, 72), timeout=GUARD_MS)
    assert FrameSettings.of(context.state).orientation == "mirror x"
    assert page.panel.orientation.currentData() == "mirror x"
    report = drain(iter_assembly(page.opened, str(tmp_path / "H.h5")))
    assert report.matrix.provenance["orientation"] == {"applied": "mirror x"}
    report.matrix.close()
    context.project.undo()
    assert FrameSettings.of(context.state).orientation == "as is"


def test_a_frame_is_shown_upright_before_and_after_its_correction(mirrored: Path) -> None:
    settings = FrameSettings(dark=str(mirrored / "dark"), orientation="mirror x")
    opened = open_imported(str(mirrored / "frames"), settings, PLAN)
    loaded = load_frame(opened, Position(0, 2, 3))
    assert np.array_equal(loaded.raw - 100.0, loaded.fixed)
    with open_frames(mirrored / "frames", plan_shape=PLAN.shape[:3]) as delivered:
        index = int(opened.frames[0, 2, 3])
        assert np.array_equal(loaded.raw, np.fliplr(delivered.read(index)))


def test_upright_frames_and_what_cannot_be_told_are_no_news() -> None:
    assert advice(FoundOrientation(name="as is"), "as is") is None
    assert advice(FoundOrientation(reason="light in 0 of 20 frames"), "as is") is None
    assert advice(FoundOrientation(name="rot90", cause="frames"), "rot90") is None
    undone = advice(FoundOrientation(name="as is"), "mirror x")
    assert undone is not None
    assert undone.apply == "as is"
    scan = advice(FoundOrientation(name="mirror x", cause="scan"), "as is")
    assert scan is not None
    assert scan.apply == ""


def test_a_new_folder_starts_upright(qtbot: QtBot, context: Context, open_page: Any, mirrored: Path) -> None:
    page = open_page("frames")
    page.open_folder(str(mirrored))
    qtbot.waitUntil(lambda: page.opened is not None, timeout=GUARD_MS)
    page._set("orientation", "mirror x")
    copy = mirrored.parent / "again"
    shutil.copytree(mirrored, copy, dirs_exist_ok=True)
    page.open_folder(str(copy))
    qtbot.waitUntil(lambda: FrameSettings.of(context.state).orientation == "as is", timeout=GUARD_MS)
