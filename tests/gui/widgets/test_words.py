"""Labels and cards whose text may be longer than their place, and tables that scroll."""

from __future__ import annotations

from PySide6.QtGui import QFontMetricsF
from PySide6.QtWidgets import QApplication, QLabel, QPlainTextEdit, QVBoxLayout, QWidget
from pytestqt.qtbot import QtBot

from lfcal_gui.widgets.cards import VerdictCard, scrolling
from lfcal_gui.widgets.enlarging import enlarge
from lfcal_gui.widgets.rows_table import RowsTable
from lfcal_gui.widgets.words import BREAK, WIDEST, ElidedLabel, WrappedLabel, breakable, lines_px, shortened
from tests.gui.layout import flaws

NAME = "/data/H_of_the_second_alignment_after_cleaning_the_main_lens_100mm_f2.8_2026-03-16.h5"
SENTENCE = "say which camera made this H, so that it can be judged fully; lfcal then checks the aperture."


def shown_by(label: QLabel) -> str:
    """Return the text that a label draws."""
    return QLabel.text(label)


def test_breaks_are_put_only_into_long_words() -> None:
    for text in (NAME, "x" * 100, "two words", "", f"{NAME}: expected an intact file\nnext line"):
        broken = breakable(text)
        assert broken.replace(BREAK, "") == text
        assert max((len(part) for word in broken.split() for part in word.split(BREAK)), default=0) <= 24
        assert all(word == word.replace(BREAK, "") for word in broken.split() if len(word) <= 24)


def test_a_long_name_is_wrapped_and_copied_unchanged(qtbot: QtBot) -> None:
    label = WrappedLabel(f"{NAME}: no such file")
    qtbot.addWidget(label)
    assert label.text() == f"{NAME}: no such file"
    assert label.minimumSizeHint().width() < label.fontMetrics().horizontalAdvance(NAME) / 2
    for text in (label.text(), "short"):
        label.setText(text)
        label.copy()
        assert QApplication.clipboard().text() == text


def test_a_label_in_one_line_shortens_its_middle_and_has_a_tooltip(qtbot: QtBot) -> None:
    label = ElidedLabel(NAME)
    qtbot.addWidget(label)
    assert label.minimumSizeHint().width() == 0
    label.show()
    for width, whole in ((label.sizeHint().width(), True), (200, False), (2000, True)):
        label.resize(width, label.sizeHint().height())
        shown = shown_by(label)
        assert (shown == NAME) == whole and label.toolTip() == ("" if whole else NAME) and label.text() == NAME
        assert whole or ("…" in shown and shown.endswith("h5"))


def test_a_sentence_takes_two_lines_or_a_shorter_text(qtbot: QtBot) -> None:
    label = ElidedLabel(SENTENCE, sentence=True, lines=2)
    qtbot.addWidget(label)
    label.show()
    whole = label.fontMetrics().horizontalAdvance(SENTENCE)
    label.resize(2 * whole, 40)
    assert shown_by(label) == SENTENCE and not label.toolTip()
    label.resize(2 * whole // 3, 40)
    first, second = shown_by(label).split("\n")
    assert f"{first} {second}" == SENTENCE and not label.toolTip() and not flaws(label)
    label.resize(whole // 4, 40)
    first, second = shown_by(label).split("\n")
    assert second.endswith("…") and SENTENCE.startswith(f"{first} {second[:-1]}".rstrip())
    assert label.toolTip() == SENTENCE == label.text()
    brief = ElidedLabel(sentence=True)
    qtbot.addWidget(brief)
    brief.show()
    seen: list[bool] = []
    brief.elided.connect(seen.append)
    brief.resize(1000, 20)
    brief.setText(SENTENCE, "say which camera")
    assert shown_by(brief) == SENTENCE and not seen[-1]
    brief.resize(200, 20)
    assert shown_by(brief) == "say which camera" and brief.toolTip() == SENTENCE and seen[-1]


def test_a_line_does_not_end_between_a_number_and_its_unit(qtbot: QtBot) -> None:
    label, words = ElidedLabel(sentence=True, lines=2), "record 5,643 positions in 9 planes, about 4 min 19 s."
    qtbot.addWidget(label)
    label.show()
    room = label.fontMetrics().horizontalAdvance(words.rpartition(" min")[0]) + 4
    label.setText(words)
    label.resize(room, 40)
    assert shown_by(label).replace("\u00a0", " ") == words.replace("about 4", "about\n4")
    wrapped = WrappedLabel("95 × 55 px")
    qtbot.addWidget(wrapped)
    assert " " not in shown_by(wrapped) and wrapped.text() == "95 × 55 px"


def test_the_width_of_lines_is_that_of_the_longest(qtbot: QtBot) -> None:
    view = QPlainTextEdit()
    qtbot.addWidget(view)
    view.setLineWrapMode(QPlainTextEdit.LineWrapMode.NoWrap)
    view.setPlainText(f"short\n{SENTENCE}\nshort")
    view.show()
    view.resize(lines_px(view), 200)
    QApplication.processEvents()
    assert not view.horizontalScrollBar().isVisible()
    view.setPlainText(SENTENCE * 100)
    assert lines_px(view) == WIDEST
    view.clear()
    assert 0 < lines_px(view) < 60


def test_the_unit_of_a_long_name_is_never_cut(qapp: QApplication) -> None:
    """Axes of 1000 x 600 pixels showed "relative rms error of the pro…", without its per cent."""
    metrics = QFontMetricsF(qapp.font())
    name = "relative rms error (the larger of both) (%)"
    whole = metrics.horizontalAdvance(name)
    assert shortened(name, metrics, whole + 1) == name
    for share in (0.3, 0.5, 0.9):
        cut = shortened(name, metrics, share * whole)
        assert cut.endswith("… (%)") and cut[:4] == name[:4] and metrics.horizontalAdvance(cut) <= share * whole
    assert shortened(name, metrics, metrics.horizontalAdvance("(%)") + 1) == "(%)"
    assert shortened("no unit at all", metrics, metrics.horizontalAdvance("no unit")).endswith("…")


def test_a_long_verdict_shows_its_first_sentence_and_a_tooltip(qtbot: QtBot) -> None:
    card = VerdictCard("All checks")
    qtbot.addWidget(card)
    card.show_verdict("good", "This H is good by 31 checks. No fault was found.")
    assert card.sentence.text() == "This H is good by 31 checks. No fault was found."
    whole = f"This H can be used; look at 4 positions. {'(0, 1, 2) belongs to another position; ' * 9}"
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
