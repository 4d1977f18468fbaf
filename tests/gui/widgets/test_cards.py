"""Cards, and tables in areas that scroll."""

from __future__ import annotations

from PySide6.QtWidgets import QVBoxLayout, QWidget
from pytestqt.qtbot import QtBot

from lfcal_gui.widgets.cards import VerdictCard, scrolling
from lfcal_gui.widgets.enlarging import enlarge
from lfcal_gui.widgets.rows_table import RowsTable
from tests.gui.layout import flaws

FAULTS = "(0, 1, 2) belongs to another position: its light is displaced by 3.0 px in its cutout; " * 4


def test_a_long_verdict_shows_its_first_sentence_and_the_rest_in_its_tip(qtbot: QtBot) -> None:
    card = VerdictCard("All checks")
    qtbot.addWidget(card)
    card.show_verdict("good", "This H is good by 31 checks. No fault was found.")
    assert card.sentence.text() == "This H is good by 31 checks. No fault was found."
    whole = f"This H can be used; look at 4 positions. {FAULTS}"
    card.show_verdict("fair", whole)
    assert card.sentence.text() == "This H can be used; look at 4 positions." and card.sentence.toolTip() == whole


def test_a_whole_table_has_no_scroll_bar_until_it_is_enlarged(qtbot: QtBot) -> None:
    root, inner = QWidget(), QWidget()
    table = RowsTable(("What", "Value", "More"), 0, spare=(2,), whole=True)
    column = QVBoxLayout(inner)
    column.addWidget(table)
    area = scrolling(inner)
    QVBoxLayout(root).addWidget(area)
    qtbot.addWidget(root)
    root.resize(300, 200)
    root.show()
    for count in (40, 3, 40):
        table.show_rows([(f"row {k}", "1", "2") for k in range(count)])
        qtbot.waitUntil(lambda many=count == 40: area.verticalScrollBar().isVisible() is many)
        assert not table.verticalScrollBar().isVisible() and table.viewport().height() == 26 * count
        assert not flaws(root)
    before = table.height()
    assert enlarge(table) is not None
    qtbot.waitUntil(lambda: table.height() < 200 and table.verticalScrollBar().isVisible())
    enlarge(table)
    qtbot.waitUntil(lambda: table.height() == before and not table.verticalScrollBar().isVisible())
