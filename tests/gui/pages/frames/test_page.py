"""Record > Folder: frames are opened, shown, judged and assembled; gaps and damaged frames are left out."""

from __future__ import annotations

import threading
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from PySide6.QtCore import Qt
from PySide6.QtTest import QTest
from PySide6.QtWidgets import QPushButton
from pytestqt.qtbot import QtBot

from lfcal.acquire import record as record_session
from lfcal.base import InputError
from lfcal.frames import Position, parse_origin
from lfcal.psf import AssemblyProgress, FoundOrientation, open_psf
from lfcal.simulate import sample_recording
from lfcal_gui.context import Context
from lfcal_gui.models import Symbols
from lfcal_gui.pages.frames import model as frames_model
from lfcal_gui.pages.frames.model import FrameSettings, facts_of, import_folder, iter_assembly, understood
from lfcal_gui.pages.frames.step import step
from tests.acquire.rigs import CAREFUL, rig_for
from tests.acquire.rigs import small_plan as rig_plan
from tests.cli.conftest import SHAPE, small_plan, true_frame
from tests.frames.test_part import ORIGIN, PLAN, write_part
from tests.gui.pages.frames._building import as_png, write_scan
from tests.gui.waiting import GUARD_MS, idle


def test_a_recorded_session_opens_by_dropping_it(qtbot: QtBot, context: Context, open_page: Any) -> None:
    page = open_page("frames")
    assert page.accept_drop([str(sample_recording())])
    qtbot.waitUntil(lambda: page.loaded is not None, timeout=GUARD_MS)
    assert context.state.plan.shape[:3] == (1, 19, 33)
    assert context.state.camera == context.state.plan.camera
    assert "627 frames of 55 × 55 px" in page.hint.text() and page.panel.view.shot.pixel_um == 5.5
    assert "saturated pixels: <b>0</b>" in page.panel.numbers.text()
    page.panel.lattice_box.setChecked(True)
    points = sum(len(one.points) for one in page.panel.view.overlays if isinstance(one, Symbols) and one.filled)
    assert points > 4, "lenslets of the place the cutout was taken from"


@pytest.mark.parametrize("close", ["undo", "frames", "plan"])
def test_frames_that_open_late_are_not_shown_for_what_the_project_has_now(
    qtbot: QtBot, context: Context, open_page: Any, monkeypatch: pytest.MonkeyPatch, close: str
) -> None:
    door, asked = threading.Event(), threading.Event()
    plain = frames_model.open_imported

    def late(*arguments: Any) -> Any:
        asked.set()
        assert door.wait(GUARD_MS / 1e3)
        return plain(*arguments)

    page = open_page("frames")
    monkeypatch.setattr(frames_model, "open_imported", late)
    context.project.update("open", frames=str(sample_recording()), plan=small_plan(), camera=small_plan().camera)
    qtbot.waitUntil(asked.is_set, timeout=GUARD_MS)
    if close == "undo":
        context.project.undo()
    else:
        context.project.update("close", **{close: "" if close == "frames" else None})
    door.set()
    idle(context.jobs, qtbot)
    assert page.opened is None and page.loaded is None and page.empty is not None
    assert not page.assemble_button.isEnabled() and not page.notice.isVisible()


def test_playing_goes_through_the_positions_until_it_is_stopped(qtbot: QtBot, open_page: Any) -> None:
    page = open_page("frames")
    assert page.accept_drop([str(sample_recording())])
    qtbot.waitUntil(lambda: page.loaded is not None, timeout=GUARD_MS)
    first = page.position
    page.panel.play_button.toggle()
    seen = [first]

    def moved() -> bool:
        if page.position != seen[-1]:
            seen.append(page.position)
        return len(seen) > 3

    qtbot.waitUntil(moved, timeout=GUARD_MS)
    page.panel.play_button.toggle()
    assert not page.play_timer.isActive()
    assert all(a.z == b.z and (b.y, b.x) > (a.y, a.x) for a, b in pairwise(seen))


GONE = (0, 1, 2)


@pytest.fixture
def scan(tmp_path: Path) -> Path:
    """Write a scan whose frame of position `GONE` is missing."""
    return write_scan(tmp_path / "scan", GONE)


@pytest.fixture
def scanned(scan: Path, open_page: Any, context: Context, qtbot: QtBot) -> Any:
    page = open_page("frames")
    page.open_folder(str(scan))
    idle(context.jobs, qtbot)
    return page


def test_the_cutout_is_followed_and_shown_as_it_goes_into_h(scanned: Any, context: Context, qtbot: QtBot) -> None:
    page, panel, plan = scanned, scanned.panel, small_plan()
    nt, ns = plan.cutout
    panel.follow.setChecked(True)
    for place in ((0, 0, 0), (1, 1, 1), (0, 2, 3)):
        page.go_to(Position(*place))
        idle(context.jobs, qtbot)
        row, column = (round(v) for v in plan.image_px(place))
        part = true_frame(*place)[row - nt // 2 :, column - ns // 2 :][:nt, :ns]
        np.testing.assert_allclose(panel.crop.values, part, atol=0.5)
        seen = panel.view.box.viewRect()
        assert seen.contains(column, row) and seen.height() < 2 * nt
        assert abs(seen.center().x() - column) <= 0.5 and abs(seen.center().y() - row) <= 0.5
    panel.before_box.setChecked(True)
    np.testing.assert_array_equal(panel.crop.values, part)
    panel.toggle_scale("log")
    assert panel.crop.display.scale == "log"
    for button in panel.findChildren(QPushButton):
        if button.text() == "Whole":
            button.click()
    assert not panel.follow.isChecked() and panel.view.box.viewRect().width() > 40


def test_without_frames_assembling_says_so(open_page: Any) -> None:
    page = open_page("frames")
    page.assemble()
    assert "no frames" in page.notice.label.text()


def test_h_fills_in_the_map_while_it_is_assembled(
    scanned: Any, context: Context, qtbot: QtBot, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    page, panel, go_on = scanned, scanned.panel, threading.Event()

    def held(opened: Any, path: str) -> Any:
        running = iter_assembly(opened, path)
        while True:
            try:
                record = next(running)
            except StopIteration as end:
                return end.value
            yield record
            if isinstance(record, AssemblyProgress) and not go_on.is_set():
                go_on.wait(GUARD_MS / 1e3)

    monkeypatch.setattr("lfcal_gui.pages.frames.model.iter_assembly", held)
    shown: list[Any] = []
    monkeypatch.setattr(panel.map, "set_values", lambda values, recorded: shown.append((values, recorded)))
    page.go_to(Position(1, 0, 0))
    page.assemble(str(tmp_path / "H.h5"))
    qtbot.waitUntil(lambda: "of H fills" in panel.map_words.text(), timeout=GUARD_MS)
    values, recorded = shown[-1]
    there = int(np.isfinite(values).sum())
    assert "Plane 0" in panel.map_words.text() and f"light at {there} of {values.size}" in panel.map_words.text()
    assert there >= SHAPE[2] - 1 and recorded[GONE[1:]] == 0
    page.go_to(Position(1, 1, 0))  # another is looked at: the plane that fills stays
    page.go_to(Position(0, 1, 0))
    np.testing.assert_array_equal(shown[-1][0], values)
    go_on.set()
    idle(context.jobs, qtbot)
    with open_psf(tmp_path / "H.h5") as H:
        for z in (0, 1):
            page.go_to(Position(z, 0, 0))
            light, seen = H.plane(z).sum((2, 3), dtype=float), np.isfinite(shown[-1][0])
            np.testing.assert_allclose(shown[-1][0][seen], light[seen], rtol=1e-5)
            assert seen.sum() == seen.size - (z == GONE[0]) and "of H holds" in panel.map_words.text()


def test_first_middle_and_last_frame_stand_side_by_side(scanned: Any, context: Context, qtbot: QtBot) -> None:
    page, panel, three = scanned, scanned.panel, scanned.panel.three
    panel.three_button.click()
    idle(context.jobs, qtbot)
    assert [label.text().split(":")[0] for label in three.labels] == ["first frame", "middle frame", "last frame"]
    np.testing.assert_array_equal(three.views[0].values, true_frame(0, 0, 0))
    assert three.isVisibleTo(page) and not panel.view.isVisibleTo(page)
    panel.contrast.set_levels((10.0, 200.0))
    assert {view.levels for view in (panel.view, *three.views)} == {(10.0, 200.0)}, "they share the contrast"
    panel.one_button.click()
    assert panel.view.isVisibleTo(page) and panel.one_button.isChecked() and not panel.three_button.isChecked()


def test_it_is_said_whether_the_frames_are_understood(scanned: Any, context: Context, qtbot: QtBot) -> None:
    page = scanned
    idle(context.jobs, qtbot)
    opened, found = page.opened, page.found
    assert understood(opened, None, "check")[0] == ""
    assert understood(opened, found, "check")[0] in ("good", "fair")
    turned = FoundOrientation("transpose", "frames", margin=9.0, residual_px=0.1, frames=12)
    assert understood(opened, turned, "check")[0] == "bad"
    gaps = opened.frames.copy()
    gaps[0, 0, :2] = -1
    mark, _, words = understood(replace(opened, frames=gaps), found, "check")
    assert mark == "fair" and words.startswith(f"{np.count_nonzero(gaps < 0)} of {gaps.size}")
    rows = {name: (number, remark) for name, number, remark in facts_of(opened)}
    assert rows["Frames"][0] == f"{len(opened.source):,}" and rows["Missing"][0] == f"{opened.missing}"
    assert "Some positions have no frame" in page.panel.found.text()
    assert context.reported["frames"]["missing"] == opened.missing > 0
    fold = page.panel.choices
    assert (fold.head.text(), fold.head.words) == ("How the frames are read", "defaults")
    page.panel.choices.editor("use_defects").setChecked(True)
    assert fold.head.words == "1 changed" and fold.changed == ("use_defects",)
    fold.reset("use_defects")
    assert fold.head.words == "defaults" and not FrameSettings.of(context.state).use_defects


DAMAGED = (0, 1, 1)
FIRST = (0, 0, 0)


@pytest.fixture
def spoiled(tmp_path: Path) -> Path:
    """Write a scan without its first frame, and with a damaged one."""
    folder = write_scan(tmp_path / "scan", FIRST, "png", as_png)
    file = folder / "{}_{}_{}.png".format(*DAMAGED)
    file.write_bytes(file.read_bytes()[:80])
    return folder


def test_the_nearest_frame_is_one_of_the_same_plane_if_that_has_any(spoiled: Path) -> None:
    opened = import_folder(str(spoiled), FrameSettings(), None).opened
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


def test_damaged_frames_are_left_out(
    spoiled: Path, open_page: Any, context: Context, qtbot: QtBot, tmp_path: Path
) -> None:
    page = open_page("frames")
    page.open_folder(str(spoiled))
    idle(context.jobs, qtbot)
    assert page.position == Position(0, 0, 1) and page.loaded is not None, "the first place with a frame"
    page.go_to(Position(*FIRST))  # asked for, the gap is shown
    assert page.position == Position(*FIRST) and page.loaded is None
    for place, offered in ((DAMAGED, True), ((0, 0, 1), False), (DAMAGED, True)):
        page.go_to(Position(*place))
        idle(context.jobs, qtbot)
        assert page.notice.isVisible() is offered, "the offer goes with the frame that it is of"
    assert page.notice.button.text() == "Leave out damaged frames"
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


def test_gaps_and_damaged_frames_have_no_picture(scan: Path, scanned: Any, context: Context, qtbot: QtBot) -> None:
    page, panel = scanned, scanned.panel
    page.go_to(Position(0, 1, 1))  # which is still being read when the next is asked for
    page.go_to(Position(*GONE))
    idle(context.jobs, qtbot)
    assert "no frame" in panel.position_label.text() and panel.view.item.image is None
    assert panel.numbers.text() == "" and panel.crop.values is None and not panel.view.overlays
    panel.before_box.setChecked(True)
    panel.lattice_box.setChecked(True)
    assert panel.view.item.image is None and not panel.view.overlays
    page.go_to(Position(0, 0, 0))
    idle(context.jobs, qtbot)
    assert panel.numbers.text() and panel.crop.values is not None
    (scan / "0_0_2.npy").write_bytes(b"no array")
    page.go_to(Position(0, 0, 2))
    idle(context.jobs, qtbot)
    assert "0_0_2.npy" in panel.position_label.text() and panel.view.item.image is None
    assert panel.numbers.text() == "" and panel.crop.values is None and page.loaded is None
    page.go_to(Position(0, 0, 3))
    idle(context.jobs, qtbot)
    assert page.loaded is not None and panel.view.item.image is not None and not page.notice.isVisible()


def test_what_is_subtracted_as_no_light_is_said(spoiled: Path, open_page: Any, context: Context, qtbot: QtBot) -> None:
    page = open_page("frames")
    box = page.panel.choices.editor("use_dark")
    page.open_folder(str(spoiled))
    idle(context.jobs, qtbot)
    assert not box.isChecked() and not box.isEnabled() and "No dark frame and no black level" in box.toolTip()
    folder = spoiled / "dark"
    folder.mkdir()
    cv2.imwrite(str(folder / "0.png"), np.full_like(true_frame(*FIRST), 3))
    page.open_folder(str(spoiled))
    idle(context.jobs, qtbot)
    assert box.isChecked() and box.isEnabled() and "the mean dark frame" in box.toolTip()
    box.setChecked(False)
    idle(context.jobs, qtbot)
    assert not box.isChecked() and box.isEnabled()


def test_the_first_pixel_is_stated_on_the_page(open_page: Any, context: Context, qtbot: QtBot, tmp_path: Path) -> None:
    write_part(tmp_path / "f")
    (tmp_path / "f" / "plan.json").write_text(PLAN.to_json())
    page = open_page("frames")
    page.open_folder(str(tmp_path / "f"))
    idle(context.jobs, qtbot)
    edit = page.panel.choices.editor("origin")
    assert edit.text() == "" and "origin" not in " ".join(step(context.state).arguments)
    QTest.keyClicks(edit, "5,")
    QTest.keyClick(edit, Qt.Key.Key_Return)
    assert edit.property("invalid") and not FrameSettings.of(context.state).origin
    QTest.keyClicks(edit, " 6")
    assert not FrameSettings.of(context.state).origin, "it is reported when typing ends"
    QTest.keyClick(edit, Qt.Key.Key_Return)
    idle(context.jobs, qtbot)
    assert FrameSettings.of(context.state).origin == "5, 6"
    assert page.opened.source.info(0).origin == ORIGIN
    made = step(context.state)
    assert "origin='5, 6'" in made.python and any("origin" in word and "5, 6" in word for word in made.arguments)
    page.panel.choices.editor("use_background").setChecked(True)
    idle(context.jobs, qtbot)
    page.assemble(str(tmp_path / "H.h5"))
    idle(context.jobs, qtbot)
    with open_psf(tmp_path / "H.h5") as H:
        assert H.shape[:3] == PLAN.shape[:3] and not len(H.missing)


def test_a_place_that_is_none() -> None:
    assert parse_origin(" ") is None and parse_origin("5, 6") == ORIGIN
    for text in ("5", "5,6,7", "-5,6", "a,b", "٥,6"):
        with pytest.raises(InputError, match="ROW,COLUMN"):
            parse_origin(text)


RECORDED = rig_plan((3, 4), 2)


def test_the_white_image_of_a_session_is_found(tmp_path: Path) -> None:
    record_session(tmp_path, RECORDED, rig_for(RECORDED), CAREFUL)
    plain = import_folder(str(tmp_path), FrameSettings(), None)
    assert (plain.settings.white, plain.settings.dark) == ("", "")
    plain.close()
    (tmp_path / "dark").mkdir()
    alone = import_folder(str(tmp_path), FrameSettings(use_white=False), None)
    assert alone.settings.dark == "", "a recording contains its darks"
    alone.close()
    (tmp_path / "white").mkdir()
    found = import_folder(str(tmp_path), FrameSettings(use_white=False, use_dark=False), None)
    assert found.settings.white == str(tmp_path / "white") and found.settings.dark == str(tmp_path / "dark")
    found.close()
