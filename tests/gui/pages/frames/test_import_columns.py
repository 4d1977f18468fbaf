"""The columns of a list in the window: what is said of them stays as it was said, and is of this list alone."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pytestqt.qtbot import QtBot

from lfcal.camera import ScanPlan
from lfcal_gui.context import Context
from lfcal_gui.pages.frames._import_dialog import ImportDialog
from lfcal_gui.pages.frames.import_choice import ImportChoice
from lfcal_gui.pages.frames.model_import import survey
from tests.frames.lists.scans import COLUMNS, ROWS, START, scan, write_frames
from tests.gui.waiting import GUARD_MS

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
    assert dialog.survey is not None and "exposure=" in dialog.survey.choice.columns


def test_columns_said_of_another_list_are_found_anew_and_it_is_said(
    dialog: ImportDialog, qtbot: QtBot, tmp_path: Path
) -> None:
    dialog.look_at(recorded(tmp_path / "first", ("Bild", *PLACES, "t")))
    looked(dialog, qtbot)
    words = hold(dialog, qtbot, 4, "exposure")
    assert "exposure=t" in words and "another list" not in words
    words = type_frames(dialog, qtbot, recorded(tmp_path / "alike", ("Bild", *PLACES, "t")))
    assert "exposure=t" in words and "another list" not in words, "said of a list with these very columns"
    words = type_frames(dialog, qtbot, recorded(tmp_path / "second", ("t", *PLACES)))
    assert held(dialog) == ["file", "x", "y", "z"] and dialog.open_button.isEnabled()
    assert "columns: chosen for another list, so columns were identified again in stage.csv" in words
    assert dialog.choice.columns == ""


def test_columns_said_of_a_list_do_not_stand_in_the_way_of_none(
    dialog: ImportDialog, qtbot: QtBot, tmp_path: Path
) -> None:
    dialog.look_at(recorded(tmp_path / "first", ("file", *PLACES, "t")))
    looked(dialog, qtbot)
    hold(dialog, qtbot, 4, "exposure")
    found = scan()
    write_frames(tmp_path / "named", found, [f"z{z}_y{y}_x{x}.tif" for z, y, x in found.positions])
    words = type_frames(dialog, qtbot, str(tmp_path / "named"))
    assert dialog.open_button.isEnabled() and "columns: chosen for another list" in words


def test_frames_that_are_no_longer_named_are_not_opened(dialog: ImportDialog, qtbot: QtBot, tmp_path: Path) -> None:
    dialog.look_at(recorded(tmp_path / "s"))
    looked(dialog, qtbot)
    assert dialog.open_button.isEnabled()
    dialog.frames_edit.setText("")
    dialog.frames_edit.editingFinished.emit()
    assert not dialog.open_button.isEnabled() and dialog.words.text().startswith("Choose a folder of frames")
    assert not dialog.columns.isVisible()


def test_each_column_shows_its_unit_and_only_those_it_can_have(
    dialog: ImportDialog, qtbot: QtBot, tmp_path: Path
) -> None:
    header = ("file", "X (µm)", "Y (mm)", "Z (nm)", "Exposure (msec)")
    dialog.look_at(recorded(tmp_path / "s", header, (1.0, 1e-3, 1e3)))
    looked(dialog, qtbot)
    units = [unit.currentData() for _, unit in dialog.columns.boxes]
    assert units == ["", "um", "mm", "nm", "ms"]
    offered = [[unit.itemData(k) for k in range(unit.count())] for _, unit in dialog.columns.boxes]
    assert offered[1] == offered[3] == ["", "um", "mm", "nm", "m", "index"] and offered[4] == ["", "s", "ms", "us"]


@pytest.mark.parametrize("known", [True, False])
def test_the_range_of_z_is_told_against_the_plan_s(tmp_path: Path, known: bool) -> None:
    folder = recorded(tmp_path / "s", ("file", "X (mm)", "Y (mm)", "Z (nm)"), (1e-3, 1e-3, 1e3))
    found = survey(ImportChoice(folder), plan() if known else None, scan().camera)
    (note,) = (line for line in found.notes if line.startswith("z: from "))
    ends = [float(number) for number in re.findall(r"-?[0-9.]+", note)]
    np.testing.assert_allclose(ends, [-40e3, 10e3] * 2, atol=1)
    assert "µm in the list (Z (nm)), planes from" in note and note.endswith("µm in the plan")
    found.close()


def test_a_z_in_another_unit_than_it_says_is_refused(tmp_path: Path) -> None:
    folder = recorded(tmp_path / "s", ("file", "X (mm)", "Y (mm)", "Z (nm)"), (1e-3, 1e-3, 1.0))
    found = survey(ImportChoice(folder), plan(), None)
    assert "z of the planes: expected the spacing of the planned planes, got 0.001 times as much" in found.problem


def test_a_list_above_a_folder_named_frames_is_used(tmp_path: Path) -> None:
    recorded(tmp_path / "s" / "frames")
    (tmp_path / "s" / "frames" / "stage.csv").rename(tmp_path / "s" / "stage.csv")
    for known in (plan(), None):
        found = survey(ImportChoice(str(tmp_path / "s")), known, scan().camera)
        assert found.problem == "" and found.imported is not None and found.table is not None
        assert found.imported.settings.manifest == str(tmp_path / "s" / "stage.csv")
        found.close()


def test_the_list_that_is_shown_is_the_one_that_is_used(tmp_path: Path) -> None:
    folder = Path(recorded(tmp_path / "s"))
    (folder / "stage.csv").rename(folder / "manifest.csv")
    (folder / "temperatures.csv").write_text("time;kelvin\n1;293\n")
    (folder / "old.csv").mkdir()
    found = survey(ImportChoice(str(folder)), plan(), None)
    assert found.problem == "" and found.table is not None and found.table.name == "manifest.csv"
    found.close()


def test_a_list_that_is_typed_first_brings_the_folder_it_lies_in(
    dialog: ImportDialog, qtbot: QtBot, tmp_path: Path
) -> None:
    folder = recorded(tmp_path / "s")
    dialog.list_edit.setText(f"{folder}/stage.csv")
    dialog.list_edit.editingFinished.emit()
    assert "columns: file=file" in looked(dialog, qtbot) and dialog.frames_edit.text() == folder
