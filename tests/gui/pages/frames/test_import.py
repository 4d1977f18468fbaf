"""Frames that others recorded, through the window: what is found in them, stated of them, and refused."""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable
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
from lfcal.frames import scan_positions
from lfcal_gui.context import Context
from lfcal_gui.models import ProjectState, said_in_window
from lfcal_gui.pages.frames._import_dialog import ImportDialog
from lfcal_gui.pages.frames.import_choice import ImportChoice, columns_text
from lfcal_gui.pages.frames.model import FrameSettings, import_folder, load_frame, open_imported
from lfcal_gui.pages.frames.model_import import open_choice, survey
from tests.cli.test_colours import ANCHOR, PERIOD, SENSOR, mosaic, plan_of
from tests.cli.test_intake import foreign_list
from tests.frames.lists.scans import COLUMNS, ROWS, START, frame, scan, write_frames
from tests.gui.waiting import GUARD_MS


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("foreign")
    found = scan(right="-y", down="+x", away="-z", origin=(5300.0, 1200.0, -80.0))
    names = [f"shot{k:03d}.tif" for k in range(len(found.stage))]
    write_frames(root / "tiffs", found, names)
    foreign_list(root / "tiffs" / "stage.csv", found, names)
    return root


def test_a_list_whose_columns_are_not_clear_is_shown_as_far_as_it_goes(folder: Path) -> None:
    found = survey(ImportChoice(str(folder / "tiffs")), plan(), None)
    assert found.table is not None and found.imported is None
    assert found.table.columns[0] == "Bild" and "column of file" in found.problem and "--" not in found.problem
    assert [column.role for column in found.used] == ["z", "y", "x", "exposure"], "what is clear is shown"
    told = survey(ImportChoice(str(folder / "tiffs"), columns="file=1"), plan(), None)
    assert told.problem == "" and told.imported is not None
    assert [column.role for column in told.used] == ["file", "z", "y", "x", "exposure"]
    assert [loaded.position for loaded in told.shown] == [(0, 0, 0), (1, 3, 0), (1, 0, 0)]
    for loaded in told.shown:
        row, column, rows, columns = loaded.window
        cut = loaded.raw[row : row + rows, column : column + columns]
        assert np.unravel_index(cut.argmax(), cut.shape) == (4, 5), "the cutout is around the point"
    told.close()


def test_what_is_stated_of_columns_and_read_by_the_window() -> None:
    for text, said in SAID.items():
        shown = said_in_window(text)
        assert "--" not in shown and "lfcal plan" not in shown and shown.startswith(text[:12])
        assert said is None or shown == said, "it names no options of the command line"
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


def test_a_dropped_stack_is_imported_if_the_page_is_visible(open_page: Any, tmp_path: Path, qtbot: QtBot) -> None:
    page, path = open_page("frames"), tmp_path / "scan.tif"
    tifffile.imwrite(path, np.zeros((5, 16, 18), np.uint16))
    assert page.accept_drop([str(path)])
    qtbot.waitUntil(lambda: page.dialog.survey is not None, timeout=GUARD_MS)
    assert page.dialog.choice.frames == str(path)
    page.dialog.reject()
    page.hide()
    assert not page.accept_drop([str(path)])


def test_the_dialog_opens_the_frames(qtbot: QtBot, context: Context, open_page: Any, folder: Path) -> None:
    page = open_page("frames")
    context.project.update("camera", camera=scan().camera, plan=plan())
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


def test_frames_on_their_side_are_turned_before_a_plan_is_made(tmp_path: Path, folder: Path) -> None:
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
    assert told.imported.plan.anchor == START
    assert open_choice(told, FrameSettings()).settings.orientation == "rot90"
    told.close()
    found = survey(ImportChoice(str(folder / "tiffs"), columns="file=1"), plan(), None)
    kept = open_choice(found, FrameSettings(orientation="mirror x", use_background=True)).settings
    assert kept.orientation == "check" and kept.use_background
    found.close()


def written(folder: Path, suffix: str, change: Any) -> Path:
    """Write a scan of one plane with positions in the names, and its plan; return the folder of the frames."""
    own = plan_of()
    (place := folder / "frames").mkdir(parents=True)
    for y, x in np.ndindex(PERIOD):
        frame = mosaic((ANCHOR[0] + y, ANCHOR[1] + x)) // 16 + np.arange(SENSOR[1]) % 40
        cv2.imwrite(str(place / f"y{y}_x{x}.{suffix}"), change(frame.astype(np.uint16)))
    (folder / "plan.json").write_text(own.to_json())
    return place


def coloured(frame: np.ndarray) -> np.ndarray:
    """Return blue, green and red, in the order of the writer."""
    return np.stack([frame, 2 * frame, 3 * frame], -1)


def test_colour_pictures_ask_for_a_colour_and_open_with_it(tmp_path: Path) -> None:
    place = written(tmp_path, "png", coloured)
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


def test_frames_of_another_camera_are_named(qtbot: QtBot, context: Context, open_page: Any, tmp_path: Path) -> None:
    place = written(tmp_path, "tif", lambda frame: frame)
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


def test_a_folder_that_does_not_open_is_asked(qtbot: QtBot, context: Context, open_page: Any, tmp_path: Path) -> None:
    place = written(tmp_path, "tif", coloured)
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


def test_one_dataset_is_chosen(qtbot: QtBot, context: Context, open_page: Any, folder: Path, tmp_path: Path) -> None:
    """A beamline file holds several detectors, after Dioptas#119."""
    found = scan()
    frames = np.stack([frame((y, x)) for z in found.depths for y, x in np.ndindex(ROWS, COLUMNS)])
    with h5py.File(tmp_path / "scan.h5", "w") as file:
        file["entry/first/data"], file["entry/second/data"] = frames[:, :8, :8], frames
    page = open_page("frames")
    context.project.update("camera", camera=found.camera, plan=plan())
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
    assert survey(ImportChoice(str(folder / "tiffs"), columns="file=1"), plan(), None).datasets == ()


PLACES = ("X (mm)", "Y (mm)", "Z (mm)")


def recorded(folder: Path, header: tuple[str, ...] = ("file", *PLACES), scales: tuple[float, ...] = (1e-3,) * 3) -> str:
    """Write a scan with a list of this header, the stage's um times ``scales``; columns beyond places hold 20."""
    found = scan()
    names = [f"shot{k:03d}.tif" for k in range(len(found.stage))]
    write_frames(folder, found, names)
    rows = [";".join(header)]
    for name, place in zip(names, found.stage, strict=True):
        cells = [f"{value * scale:.6f}" for value, scale in zip(place, scales, strict=True)]
        rows.append(";".join([name, *cells, *["20"] * (len(header) - 4)]))
    (folder / "stage.csv").write_text("\n".join(rows))
    return str(folder)


def plan() -> ScanPlan:
    found = scan()
    return ScanPlan(found.camera, (ROWS, COLUMNS), (9, 11), found.depths, START)


@pytest.fixture
def dialog(qtbot: QtBot, context: Context, open_page: Any) -> ImportDialog:
    page = open_page("frames")
    context.project.update("camera", camera=scan().camera, plan=plan())
    page.start_import()
    made: ImportDialog = page.dialog
    return made


def looked(dialog: ImportDialog, qtbot: QtBot) -> str:
    qtbot.waitUntil(lambda: dialog.survey is not None, timeout=GUARD_MS)
    return dialog.words.text()


def hold(dialog: ImportDialog, qtbot: QtBot, column: int, role: str) -> str:
    box, _ = dialog.columns.boxes[column]
    box.setCurrentIndex(box.findData(role))
    return looked(dialog, qtbot)


def held(dialog: ImportDialog) -> list[str]:
    return [role.currentData() for role, _ in dialog.columns.boxes]


def type_frames(dialog: ImportDialog, qtbot: QtBot, path: str) -> str:
    dialog.frames_edit.setText(path)
    dialog.frames_edit.editingFinished.emit()
    return looked(dialog, qtbot)


def test_x_and_y_change_places_in_two_steps(dialog: ImportDialog, qtbot: QtBot, tmp_path: Path) -> None:
    dialog.look_at(recorded(tmp_path / "s"))
    looked(dialog, qtbot)
    assert held(dialog) == ["file", "x", "y", "z"]
    words = hold(dialog, qtbot, 1, "y")
    assert held(dialog) == ["file", "y", "y", "z"], "both as they were chosen"
    assert "content y: expected one column, got X (mm) and Y (mm); " in words and "--" not in words
    assert not dialog.open_button.isEnabled()
    words = hold(dialog, qtbot, 2, "x")
    assert held(dialog) == ["file", "y", "x", "z"] and "y=X (mm), x=Y (mm)" in words
    assert dialog.open_button.isEnabled()


def test_a_column_that_is_not_to_be_used_is_not_found_again(dialog: ImportDialog, qtbot: QtBot, tmp_path: Path) -> None:
    dialog.look_at(recorded(tmp_path / "s", ("file", *PLACES, "Exposure (ms)", "Gain")))
    assert "exposure=Exposure" in looked(dialog, qtbot)
    words = hold(dialog, qtbot, 4, "")
    assert held(dialog) == ["file", "x", "y", "z", "", ""] and "exposure=" not in words
    words = hold(dialog, qtbot, 5, "page")
    assert held(dialog) == ["file", "x", "y", "z", "", "page"], "it stays so when another is said"
    assert "exposure=" in dialog.survey.choice.columns


def test_each_column_shows_the_units_it_can_have(dialog: ImportDialog, qtbot: QtBot, tmp_path: Path) -> None:
    header = ("file", "X (µm)", "Y (mm)", "Z (nm)", "Exposure (msec)")
    dialog.look_at(recorded(tmp_path / "s", header, (1.0, 1e-3, 1e3)))
    looked(dialog, qtbot)
    units = [unit.currentData() for _, unit in dialog.columns.boxes]
    assert units == ["", "um", "mm", "nm", "ms"]
    offered = [[unit.itemData(k) for k in range(unit.count())] for _, unit in dialog.columns.boxes]
    assert offered[1] == offered[3] == ["", "um", "mm", "nm", "m", "index"] and offered[4] == ["", "s", "ms", "us"]


def test_the_list_that_is_shown_is_used_also_above_a_folder_named_frames(tmp_path: Path) -> None:
    recorded(tmp_path / "s" / "frames")
    (tmp_path / "s" / "frames" / "stage.csv").rename(tmp_path / "s" / "stage.csv")
    for known in (plan(), None):
        found = survey(ImportChoice(str(tmp_path / "s")), known, scan().camera)
        assert found.problem == "" and found.imported is not None and found.table is not None
        assert found.imported.settings.manifest == str(tmp_path / "s" / "stage.csv")
        found.close()
    folder = Path(recorded(tmp_path / "s"))
    (folder / "stage.csv").rename(folder / "manifest.csv")
    (folder / "temperatures.csv").write_text("time;kelvin\n1;293\n")
    (folder / "old.csv").mkdir()
    found = survey(ImportChoice(str(folder)), plan(), None)
    assert found.problem == "" and found.table is not None and found.table.name == "manifest.csv"
    found.close()


def test_a_list_that_is_typed_first_brings_its_folder(dialog: ImportDialog, qtbot: QtBot, tmp_path: Path) -> None:
    folder = recorded(tmp_path / "s")
    dialog.list_edit.setText(f"{folder}/stage.csv")
    dialog.list_edit.editingFinished.emit()
    assert "columns: file=file" in looked(dialog, qtbot) and dialog.frames_edit.text() == folder


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


def positions(folder: Path) -> str:
    """Write a scan with positions in the names, from 0."""
    found = scan()
    write_frames(folder, found, [f"z{z}_y{y}_x{x}.tif" for z, y, x in found.positions])
    return str(folder)


def counted(folder: Path) -> str:
    """Write a scan with a list of positions, from 0."""
    found = scan()
    names = [f"a{k}.tif" for k in range(len(found.positions))]
    write_frames(folder, found, names)
    rows = [f"{name},{z},{y},{x}" for name, (z, y, x) in zip(names, found.positions.tolist(), strict=True)]
    (folder / "list.csv").write_text("\n".join(["file,z,y,x", *rows]))
    return str(folder)


def two_lists(folder: Path) -> str:
    recorded(folder)
    shutil.copy(folder / "stage.csv", folder / "stage2.csv")
    return str(folder)


def empty(folder: Path) -> str:
    folder.mkdir()
    return str(folder)


def unlike(folder: Path) -> str:
    """Write frames of names without numbers of positions."""
    folder.mkdir()
    for name in ("left", "right"):
        tifffile.imwrite(folder / f"{name}.tif", np.zeros((40, 48), np.uint16))
    return str(folder)


def long_exposures(folder: Path) -> str:
    recorded(folder, ("file", *PLACES, "Exposure"))
    listed = folder / "stage.csv"
    listed.write_text(listed.read_text().replace(";20\n", ";20000\n").removesuffix("20") + "20000")
    return str(folder)


def stated(*header: str) -> Callable[[Path], str]:
    """Return what writes a scan with a list of this header."""
    return lambda folder: recorded(folder, ("file", *header))


CONTENT, SET_UP = (
    "; choose the content above the column",
    "; choose the camera, or make the plan of the scan, in Set up",
)
COUNTED = "; choose above whether Positions are counted from 0 or 1"
CASES: tuple[tuple[Callable[[Path], str], dict[str, str], str], ...] = (
    (positions, {"first": "1"}, "got 0; count from 0" + COUNTED),
    (counted, {"first": "1"}, "correct the number of the first position" + COUNTED),
    (two_lists, {}, "expected one, got stage.csv, stage2.csv; choose the right one; choose the List above"),
    (empty, {}, "expected images (TIFF, PNG, NPY, RAW …), got none; give the folder that contains them"),
    (unlike, {}, "; choose the List above, type the pattern of Names above, or choose their Order above"),
    (long_exposures, {}, "state the unit in the contents of the columns" + CONTENT),
    (stated("X (mm)", "Y", "Z (mm)"), {}, "got none" + CONTENT),
    (stated("X", "Y", "other"), {}, "got none; state which column is z" + CONTENT),
)


@pytest.mark.parametrize(("made", "choice", "end"), CASES)
def test_a_problem_ends_with_a_remedy(
    tmp_path: Path, made: Callable[[Path], str], choice: dict[str, str], end: str
) -> None:
    found = survey(ImportChoice(made(tmp_path / "s"), **choice), plan(), None)
    assert found.problem.endswith(end)
    for word in ("--", "lfcal ", "first=", "MANIFEST", "CAMERA"):
        assert word not in found.problem


SAID = {
    "axes: assumed, as neither list nor frames show them; --stage states them": "axes: assumed, as neither list nor "
    "frames show them",
    "samples: left-aligned, moved down by 4": "samples: left-aligned, moved down by 4",
    "list: expected 2, got 3; correct --first": "list: expected 2, got 3",
    "names: read as --pattern 'y{y}_x{x}.png'": "names: read as 'y{y}_x{x}.png'",
    "axes: from the steps; their signs are assumed, --stage states them": None,
    "list: expected 2, got 3; check the contents of the columns (--columns)": None,
    "list: expected 2, got 3; it is of another scan: make its plan with lfcal plan CAMERA --positions L": None,
}


def test_frames_without_their_plan_ask_for_camera_unit_or_plan(tmp_path: Path) -> None:
    for made in (empty, two_lists):
        found = survey(ImportChoice(made(tmp_path / made.__name__)), None, None)
        assert found.problem and "plan" not in found.problem.replace(str(tmp_path), ""), (
            "what is wrong with the frames comes first"
        )
    choice = ImportChoice(recorded(tmp_path / "s"))
    assert survey(choice, None, None).problem.endswith("got none" + SET_UP)
    small = ScanPlan(scan().camera, (3, 2), (9, 11), scan().depths, (18.0, 21.0))
    other = survey(choice, small, preset("bench")).problem
    assert "another scan" in other and other.endswith(SET_UP[2:])
    known = survey(choice, None, scan().camera)
    (depths,) = {said_in_window(note) for note in known.notes if note.startswith("depths: inferred")}
    assert "for all" in depths and "--" not in depths
    known.close()
    in_um = ImportChoice(recorded(tmp_path / "um", ("file", "X (mm)", "Y (mm)", "Z (um)")))
    assert survey(in_um, None, scan().camera).problem.endswith("is z in mm? state its unit" + CONTENT)


def test_the_order_is_asked_for_with_a_plan_of_as_many_frames_and_alone(tmp_path: Path) -> None:
    folder = numbered(tmp_path / "n", "raster")
    assert "choose their Order above" in survey(ImportChoice(folder), None, None).problem
    unplanned = survey(ImportChoice(folder, order="raster"), None, None)
    assert "scan plan: expected one with the frames or in the project" in unplanned.problem
    Path(folder, "shot_7.tif").unlink()
    fewer = survey(ImportChoice(folder, order="raster"), plan(), None)
    assert fewer.problem.startswith("frames: expected 56 for a scan of 2 x 4 x 7, got 55")
    listed = recorded(tmp_path / "s")
    ordered = survey(ImportChoice(listed, order="raster"), plan(), None)
    assert ordered.problem == "" and ordered.table is None, "the list that lies there is not used, nor shown"
    ordered.close()
    choice = ImportChoice(listed, listed=f"{listed}/stage.csv", pattern="a{y}_{x}.tif", order="raster")
    assert survey(choice, plan(), None).problem == (
        "positions of the frames: expected one of List, Names and Order, got List, Names and Order; "
        "keep one and clear the others"
    )
    kept = import_folder(listed, FrameSettings(order="raster"), plan())
    assert kept.settings.order == "" and kept.opened is not None, "the order of frames before is not that of others"
    kept.close()


@pytest.mark.parametrize("known", [True, False])
def test_the_range_of_z_is_compared_with_the_plan_s(tmp_path: Path, known: bool) -> None:
    header = ("file", "X (mm)", "Y (mm)", "Z (nm)")
    folder = recorded(tmp_path / "s", header, (1e-3, 1e-3, 1e3))
    found = survey(ImportChoice(folder), plan() if known else None, scan().camera)
    (note,) = (line for line in found.notes if line.startswith("z: from "))
    ends = [float(number) for number in re.findall(r"-?[0-9.]+", note)]
    np.testing.assert_allclose(ends, [-40e3, 10e3] * 2, atol=1)
    assert "µm in the list (Z (nm)), planes from" in note and note.endswith("µm in the plan")
    found.close()
    if known:
        wrong = survey(ImportChoice(recorded(tmp_path / "w", header, (1e-3, 1e-3, 1.0))), plan(), None)
        assert "z of the planes: expected the spacing of the planned planes, got 0.001 times as much" in wrong.problem


def test_columns_stated_of_a_list_hold_for_no_other(dialog: ImportDialog, qtbot: QtBot, tmp_path: Path) -> None:
    dialog.look_at(recorded(tmp_path / "first", ("Bild", *PLACES, "t")))
    looked(dialog, qtbot)
    words = hold(dialog, qtbot, 4, "exposure")
    assert "exposure=t" in words and "another list" not in words
    words = type_frames(dialog, qtbot, recorded(tmp_path / "alike", ("Bild", *PLACES, "t")))
    assert "exposure=t" in words and "another list" not in words, "stated of a list with these very columns"
    words = type_frames(dialog, qtbot, recorded(tmp_path / "second", ("t", *PLACES)))
    assert held(dialog) == ["file", "x", "y", "z"] and dialog.open_button.isEnabled()
    assert "columns: chosen for another list, so columns were identified again in stage.csv" in words
    assert dialog.choice.columns == ""
    hold(dialog, qtbot, 0, "exposure")
    found = scan()
    write_frames(tmp_path / "named", found, [f"z{z}_y{y}_x{x}.tif" for z, y, x in found.positions])
    words = type_frames(dialog, qtbot, str(tmp_path / "named"))
    assert dialog.open_button.isEnabled() and "columns: chosen for another list" in words
    dialog.frames_edit.setText("")
    dialog.frames_edit.editingFinished.emit()
    assert not dialog.open_button.isEnabled() and dialog.words.text().startswith("Choose a folder of frames")
    assert not dialog.columns.isVisible(), "frames that are no longer named are not opened"


def test_frames_of_eight_bits_open_with_their_darks(tmp_path: Path) -> None:
    place = written(tmp_path, "png", lambda frame: np.minimum(frame >> 4, 255).astype(np.uint8))
    (place / "dark").mkdir()
    cv2.imwrite(str(place / "dark" / "d.png"), np.full(SENSOR, 7, np.uint8))
    found = survey(ImportChoice(str(place), shift="0"), None, None)
    assert found.problem == "" and found.shown[0].raw.dtype == np.uint8
    assert "names: read as 'y{y}_x{x}.png'" in {said_in_window(note) for note in found.notes}
    assert found.imported.settings.dark == str(place / "dark")
    assert "dark frames: from the folder dark in frames" in found.notes
    loaded = found.shown[0]
    np.testing.assert_allclose(loaded.fixed, loaded.raw - 7.0)
    assert (found.imported.opened.frames >= 0).all()
    found.close()


def test_a_plan_is_made_of_the_list_where_there_is_none_of_its_scan(folder: Path) -> None:
    camera = scan().camera
    small = ScanPlan(camera, (3, 2), (9, 11), scan().depths, START)
    choice = ImportChoice(str(folder / "tiffs"), columns="file=1")
    for known, words in ((None, "a whole number of the camera's periods"), (small, "another scan")):
        found = survey(choice, known, camera)
        assert found.problem == "" and found.imported.plan.period == (ROWS, COLUMNS)
        assert found.imported.plan.anchor == START
        assert known is None or found.notes[0].startswith("plan: the project's")
        found.close()
        other = survey(choice, known, preset("bench"))
        assert words in other.problem and other.table is not None and other.imported is None
