"""Frames that others recorded, through the window: what is found, what may be said, and that nothing is lost."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import h5py
import numpy as np
import pytest
import tifffile
from pytestqt.qtbot import QtBot

from lfcal.camera import ScanPlan, preset
from lfcal_gui.context import Context
from lfcal_gui.models.words import said_in_window
from lfcal_gui.pages.frames.import_choice import ImportChoice, columns_text
from lfcal_gui.pages.frames.model import FrameSettings, load_frame, open_imported
from lfcal_gui.pages.frames.model_import import open_choice, survey
from tests.cli.test_colours import ANCHOR, PERIOD, SENSOR, mosaic, plan_of
from tests.cli.test_intake import foreign_list
from tests.frames.lists.scans import COLUMNS, ROWS, START, Scan, frame, scan, write_frames
from tests.gui.waiting import GUARD_MS


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("foreign")
    found = scan(right="-y", down="+x", away="-z", origin=(5300.0, 1200.0, -80.0))
    names = [f"shot{k:03d}.tif" for k in range(len(found.stage))]
    write_frames(root / "tiffs", found, names)
    foreign_list(root / "tiffs" / "stage.csv", found, names)
    return root


def plan(found: Scan) -> ScanPlan:
    return ScanPlan(found.camera, (ROWS, COLUMNS), (9, 11), found.depths, START)


def test_a_list_whose_columns_are_not_clear_is_shown_as_far_as_it_goes(folder: Path) -> None:
    found = survey(ImportChoice(str(folder / "tiffs")), plan(scan()), None)
    assert found.table is not None and found.imported is None
    assert found.table.columns[0] == "Bild" and "column of file" in found.problem and "--" not in found.problem
    assert [column.role for column in found.used] == ["z", "y", "x", "exposure"], "what is clear is shown"
    told = survey(ImportChoice(str(folder / "tiffs"), columns="file=1"), plan(scan()), None)
    assert told.problem == "" and told.imported is not None
    assert [column.role for column in told.used] == ["file", "z", "y", "x", "exposure"]
    assert [loaded.position for loaded in told.shown] == [(0, 0, 0), (1, 3, 0), (1, 0, 0)]
    for loaded in told.shown:
        row, column, rows, columns = loaded.window
        cut = loaded.raw[row : row + rows, column : column + columns]
        assert np.unravel_index(cut.argmax(), cut.shape) == (4, 5), "the cutout is around the point"
    told.close()


def test_a_plan_is_made_of_the_list_where_there_is_none(folder: Path) -> None:
    found = survey(ImportChoice(str(folder / "tiffs"), columns="file=1"), None, scan().camera)
    assert found.problem == "" and found.imported is not None and found.imported.plan is not None
    assert found.imported.plan.period == (ROWS, COLUMNS) and found.imported.plan.anchor == START
    found.close()
    other = survey(ImportChoice(str(folder / "tiffs"), columns="file=1"), None, preset("bench"))
    assert "a whole number of the camera's periods" in other.problem and other.table is not None


def test_what_the_choices_of_columns_say() -> None:
    holds = {"1": ("file", ""), "2": ("x", "mm"), "3": ("y", "index"), "4": ("exposure", "ms"), "5": ("", "um")}
    assert columns_text(holds) == "file=1,x_mm=2,y_index=3,exposure_ms=4"
    assert columns_text({"1": ("file", "um"), "2": ("exposure", "mm")}) == "file=1,exposure=2"


def test_samples_and_colours(tmp_path: Path) -> None:
    for y, x in np.ndindex(PERIOD):
        frame = (mosaic((ANCHOR[0] + y, ANCHOR[1] + x)) // 32 + np.arange(SENSOR[1]) % 40).astype(np.uint16) << 4
        tifffile.imwrite(tmp_path / f"y{y}_x{x}.tif", frame.astype(np.uint16))
    found = survey(ImportChoice(str(tmp_path)), plan_of(), None)
    assert found.colours == ("G1", "R", "B", "G2") and found.shift == 4
    assert found.shown[0].raw.max() < 700, "moved down by four bits"
    found.close()
    red = survey(ImportChoice(str(tmp_path), channel="R"), plan_of(), None)
    assert red.problem == "" and red.imported is not None and red.imported.opened is not None
    assert red.shown[0].raw.shape == (21, 26) and red.imported.opened.frames.shape == (1, 2, 3)
    assert red.imported.settings.channel == "R" and red.imported.settings.shift == 4
    again = open_imported(red.imported.folder, red.imported.settings, plan_of())
    first = next(again.plan.positions())
    np.testing.assert_array_equal(load_frame(again, first).raw, red.shown[0].raw)
    again.view.close()
    red.close()
    assert "expected G1, R, B or G2" in survey(ImportChoice(str(tmp_path), channel="X"), plan_of(), None).problem


def test_the_dialog_opens_the_frames(qtbot: QtBot, context: Context, open_page: Any, folder: Path) -> None:
    page = open_page("frames")
    context.project.update("camera", camera=scan().camera, plan=plan(scan()))
    assert page.accept_drop([str(folder / "tiffs" / "stage.csv")])
    dialog = page.dialog
    qtbot.waitUntil(lambda: dialog.survey is not None, timeout=GUARD_MS)
    assert "column of file" in dialog.words.text() and not dialog.open_button.isEnabled()
    assert [stack.currentIndex() for stack in dialog.previews.stacks] == [0, 0, 0], "no axes around nothing"
    box, _ = dialog.columns.boxes[0]
    box.setCurrentIndex(box.findData("file"))
    qtbot.waitUntil(lambda: dialog.survey is not None, timeout=GUARD_MS)
    assert dialog.survey.problem == "" and "columns: file=Bild" in dialog.words.text()
    assert dialog.previews.labels[2].text() == "last frame: z 1, y 0, x 0"
    assert [stack.currentIndex() for stack in dialog.previews.stacks] == [1, 1, 1]
    dialog.resize(1000, 600)
    assert (dialog.width(), dialog.height()) == (1000, 600), "it fits the smallest window"
    assert dialog.rect().contains(dialog.open_button.geometry()) and dialog.open_button.isVisible()
    dialog.open_button.click()
    qtbot.waitUntil(lambda: page.loaded is not None, timeout=GUARD_MS)
    assert (page.opened.frames >= 0).all()
    assert FrameSettings.of(context.state).columns.startswith("file=1")


def test_a_dialog_that_is_closed_changes_nothing(qtbot: QtBot, context: Context, open_page: Any, folder: Path) -> None:
    page = open_page("frames")
    before = context.state
    page.start_import(str(folder / "tiffs"))
    page.dialog.reject()
    page.start_import(str(folder / "none"))
    qtbot.waitUntil(lambda: page.dialog.survey is not None, timeout=GUARD_MS)
    assert "no such file" in page.dialog.words.text().lower()
    page.dialog.reject()
    assert context.state == before and page.opened is None


def test_a_list_of_another_scan_than_the_project_s_brings_its_own_plan(folder: Path) -> None:
    found = scan()
    small = ScanPlan(found.camera, (3, 2), (9, 11), found.depths, START)
    told = survey(ImportChoice(str(folder / "tiffs"), columns="file=1"), small, found.camera)
    assert told.problem == "" and told.imported is not None and told.imported.plan is not None
    assert told.imported.plan.period == (ROWS, COLUMNS) and told.notes[0].startswith("plan: the project's")
    told.close()
    other = survey(ImportChoice(str(folder / "tiffs"), columns="file=1"), small, preset("bench"))
    assert "another scan" in other.problem and other.imported is None


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (
            "axes: +x as assumed: neither list nor frames tell; --stage states them",
            "axes: +x as assumed: neither list nor frames tell",
        ),
        ("axes: as the steps tell; their senses are assumed, --stage states them", None),
        ("samples: left-aligned, moved down by 4", "samples: left-aligned, moved down by 4"),
        ("list: expected 2, got 3; check the contents of the columns (--columns)", None),
        (
            "list: expected 2, got 3; the list is of another scan: make its plan with lfcal plan CAMERA --positions L",
            None,
        ),
        ("list: expected 2, got 3; correct --first", "list: expected 2, got 3"),
        ("names: read as --pattern 'y{y}_x{x}.png'", "names: read as 'y{y}_x{x}.png'"),
    ],
)
def test_the_window_names_no_options_of_the_command_line(text: str, said: str | None) -> None:
    shown = said_in_window(text)
    assert "--" not in shown and "lfcal plan" not in shown and shown.startswith(text[:12])
    assert said is None or shown == said


def test_frames_imported_after_turned_ones_are_upright_until_told(folder: Path) -> None:
    found = survey(ImportChoice(str(folder / "tiffs"), columns="file=1"), plan(scan()), None)
    kept = open_choice(found, FrameSettings(orientation="mirror x", use_background=True)).settings
    assert kept.orientation == "check" and kept.use_background
    found.close()


def test_frames_on_their_side_are_turned_before_a_plan_is_made(tmp_path: Path) -> None:
    found = scan()
    names = [f"shot{k:03d}.tif" for k in range(len(found.stage))]
    write_frames(tmp_path / "s", found, names)
    for name in names:
        path = tmp_path / "s" / name
        tifffile.imwrite(path, np.rot90(tifffile.imread(path), -1).copy())
    foreign_list(tmp_path / "s" / "stage.csv", found, names)
    choice = ImportChoice(str(tmp_path / "s"), columns="file=1")
    refused = survey(choice, None, found.camera)
    assert refused.imported is None and refused.problem.endswith("; choose their Orientation above")
    assert "--" not in refused.problem
    told = survey(replace(choice, orientation="rot90"), None, found.camera)
    assert told.problem == "" and told.imported is not None
    assert told.imported.plan is not None and told.imported.plan.anchor == START
    assert open_choice(told, FrameSettings()).settings.orientation == "rot90"
    told.close()


def written(folder: Path, frames: str, suffix: str, change: Any) -> Path:
    """Write a scan of one plane with positions in the names, and its plan; return the folder of the frames."""
    own = plan_of()
    (folder / frames).mkdir(parents=True)
    for y, x in np.ndindex(PERIOD):
        frame = mosaic((ANCHOR[0] + y, ANCHOR[1] + x)) // 16 + np.arange(SENSOR[1]) % 40
        cv2.imwrite(str(folder / frames / f"y{y}_x{x}.{suffix}"), change(frame.astype(np.uint16)))
    (folder / "plan.json").write_text(own.to_json())
    return folder / frames


def coloured(frame: np.ndarray) -> np.ndarray:
    """Return blue, green and red, in the order of the writer."""
    return np.stack([frame, 2 * frame, 3 * frame], -1)


@pytest.mark.parametrize("suffix", ["tif", "png"])
def test_colour_pictures_ask_for_a_colour_and_open_with_it(tmp_path: Path, suffix: str) -> None:
    place = written(tmp_path, "frames", suffix, coloured)
    asked = survey(ImportChoice(str(place)), None, None)
    assert asked.imported is None and asked.colours == ("R", "G", "B")
    assert asked.problem.endswith("; choose a colour above") and "--" not in asked.problem
    brightest = {}
    for colour in asked.colours:
        found = survey(ImportChoice(str(place), channel=colour, shift="0"), None, None)
        assert found.problem == "" and found.imported is not None and found.shown[0].raw.shape == SENSOR
        again = open_imported(found.imported.folder, found.imported.settings, plan_of())
        np.testing.assert_array_equal(load_frame(again, found.shown[0].position).raw, found.shown[0].raw)
        brightest[colour] = float(found.shown[0].raw.max())
        again.view.close()
        found.close()
    assert brightest["R"] == 3 * brightest["B"] and brightest["G"] == 2 * brightest["B"]


def test_frames_of_eight_bits_open(tmp_path: Path) -> None:
    place = written(tmp_path, "frames", "png", lambda frame: np.minimum(frame >> 4, 255).astype(np.uint8))
    found = survey(ImportChoice(str(place)), None, None)
    assert found.problem == "" and found.shown[0].raw.dtype == np.uint8
    assert "names: read as 'y{y}_x{x}.png'" in {said_in_window(note) for note in found.notes}
    found.close()


def test_a_folder_of_darks_among_the_frames_is_used_and_said(tmp_path: Path) -> None:
    place = written(tmp_path, "frames", "tif", lambda frame: frame)
    (place / "dark").mkdir()
    tifffile.imwrite(place / "dark" / "d.tif", np.full(SENSOR, 7, np.uint16))
    found = survey(ImportChoice(str(place), shift="0"), None, None)
    assert found.imported is not None and found.imported.settings.dark == str(place / "dark")
    assert "dark frames: from the folder dark in frames" in found.notes
    loaded = found.shown[0]
    np.testing.assert_allclose(loaded.fixed, loaded.raw - 7.0)
    assert found.imported.opened is not None and (found.imported.opened.frames >= 0).all()
    found.close()


def test_frames_of_another_camera_than_the_plan_s_are_named(
    qtbot: QtBot, context: Context, open_page: Any, tmp_path: Path
) -> None:
    place = written(tmp_path, "frames", "tif", lambda frame: frame)
    own = plan_of()
    (tmp_path / "plan.json").unlink()
    sensor = replace(own.camera.sensor, shape=(100, 120), cfa="")
    other = replace(own, camera=replace(own.camera, sensor=sensor))
    line = f"{SENSOR[1]} × {SENSOR[0]} px, but the plan's sensor has 120 × 100 px"
    found = survey(ImportChoice(str(place)), other, None)
    assert any(line in note for note in found.notes)
    found.close()
    same = survey(ImportChoice(str(place)), own, None)
    assert not any("another camera" in note for note in same.notes)
    same.close()
    context.project.update("plan", plan=other, camera=other.camera)
    page = open_page("frames")
    page.open_folder(str(place))
    qtbot.waitUntil(lambda: page.notice.isVisible() and line in page.notice.label.text(), timeout=GUARD_MS)
    assert context.state.plan == other and page.opened is not None


def test_a_folder_that_does_not_open_is_asked_about(
    qtbot: QtBot, context: Context, open_page: Any, tmp_path: Path
) -> None:
    place = written(tmp_path, "frames", "tif", coloured)
    page, before = open_page("frames"), context.state
    page.open_folder(str(place))
    qtbot.waitUntil(lambda: page.dialog is not None and page.dialog.channel.isEnabled(), timeout=GUARD_MS)
    assert "expected grey" in page.dialog.words.text() and "--" not in page.dialog.words.text()
    why = page.notice.label.text()
    assert context.state == before and page.notice.isVisible() and "expected grey" in why and "--" not in why
    page.dialog.channel.setCurrentIndex(page.dialog.channel.findData("G"))
    qtbot.waitUntil(page.dialog.open_button.isEnabled, timeout=GUARD_MS)
    page.dialog.open_button.click()
    qtbot.waitUntil(lambda: page.loaded is not None, timeout=GUARD_MS)
    assert page.hint.text().startswith("24 frames of") and not page.notice.isVisible()
    context.project.undo()
    assert page.hint.text() == page.spec.hint, "no numbers of frames that are gone"


def test_one_of_several_datasets_is_chosen(
    qtbot: QtBot, context: Context, open_page: Any, folder: Path, tmp_path: Path
) -> None:
    """A beamline file holds several detectors, after Dioptas#119."""
    found = scan()
    frames = np.stack([frame((y, x)) for z in found.depths for y, x in np.ndindex(ROWS, COLUMNS)])
    with h5py.File(tmp_path / "scan.h5", "w") as file:
        file["entry/first/data"], file["entry/second/data"] = frames[:, :8, :8], frames
    page = open_page("frames")
    context.project.update("camera", camera=found.camera, plan=plan(found))
    page.start_import()
    dialog = page.dialog
    dialog._say(frames=str(tmp_path / "scan.h5"), order="raster")
    qtbot.waitUntil(lambda: dialog.survey is not None, timeout=GUARD_MS)
    assert "choose their Dataset above" in dialog.words.text() and not dialog.open_button.isEnabled()
    box = dialog.dataset
    assert box.isVisibleTo(dialog) and [box.itemText(k).split()[0] for k in range(box.count())] == [
        "/entry/first/data",
        "/entry/second/data",
    ]
    box.setCurrentIndex(1)
    box.activated.emit(1)
    qtbot.waitUntil(lambda: dialog.survey is not None, timeout=GUARD_MS)
    assert dialog.survey.problem == "" and dialog.frames_edit.text().endswith("scan.h5::/entry/second/data")
    assert box.currentIndex() == 1
    dialog.open_button.click()
    qtbot.waitUntil(lambda: page.loaded is not None, timeout=GUARD_MS)
    np.testing.assert_array_equal(page.opened.source.read(0), frames[0])
    assert survey(ImportChoice(str(folder / "tiffs"), columns="file=1"), plan(found), None).datasets == ()
