from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from PySide6.QtWidgets import QApplication
from pytestqt.qtbot import QtBot

from lfcal_gui.pages.h.checks_view import ChecksView
from lfcal_gui.pages.h.model_checks import CheckPicture, CheckRow


def rows(*names: str) -> tuple[CheckRow, ...]:
    nothing: Any = None
    return tuple(CheckRow(nothing, k, "1", "< 2", "> 3", "good", "good", "–", k) for k in names)


@pytest.fixture
def view(qtbot: QtBot) -> ChecksView:
    made = ChecksView()
    qtbot.addWidget(made)
    return made


def test_the_first_check_of_a_second_inspection_is_explained_too(view: ChecksView) -> None:
    """The row chosen stays the same, but it shows another inspection."""
    chosen: list[int] = []
    view.chosen.connect(chosen.append)
    view.show_checks("", rows("first", "second"))
    view.show_checks("", rows("second", "first"))
    assert chosen == [0, 0] and view.table.currentRow() == 0
    view.table.selectRow(1)
    assert chosen == [0, 0, 1]


def test_checks_sorted_by_hand_still_show_their_own(view: ChecksView) -> None:
    seen: list[int] = []
    view.chosen.connect(seen.append)
    view.show_checks("", rows("b", "a"))
    view.table.clearSelection()
    view.table.sortItems(1)
    view.table.selectRow(0)
    assert seen == [0, 1], "'a' was given as the second"


def test_a_narrow_table_hides_columns_that_it_copies(view: ChecksView) -> None:
    view.show()
    view.show_checks("", rows("a"))
    view.table.resize(280, 200)
    assert view.table.isColumnHidden(3) and "< 2\t> 3" in view.table.text()
    view.table.resize(900, 200)
    assert not view.table.isColumnHidden(3)


def test_a_map_of_displacements_is_numbered_from_its_origin(view: ChecksView) -> None:
    view.show_check("", CheckPicture("Left", ("down (px)", "across (px)"), "%", np.eye(5), origin=(-2, -2)))
    assert view.image.shot.origin == (-2, -2)
    view.show_check("", CheckPicture("Sensor", ("row (px)", "column (px)"), "counts", np.eye(5)))
    assert view.image.shot.origin == (0, 0), "the next one starts at 0 again"


def test_an_explanation_of_eight_lines_is_whole_in_a_low_window(view: ChecksView) -> None:
    """In a window of 1000 x 600, the list of checks left it three lines, which were cut."""
    view.resize(290, 300)
    view.show()
    view.show_checks("31 good", rows(*"abcdefghijkl"))
    for words in ("brief", "<b>Stage step: 0.266 px</b> " + "what it means and what to do " * 7):
        view.show_check(words, CheckPicture("none", ("", ""), "", None))
        QApplication.processEvents()
        seen = view.details.viewport().height()
        assert view.words.heightForWidth(view.words.width()) <= seen, words
    assert view.table.height() >= 90, "three rows are left"
