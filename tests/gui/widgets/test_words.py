"""Labels whose words may be longer than their place."""

from __future__ import annotations

import pytest
from PySide6.QtGui import QFontMetricsF
from PySide6.QtWidgets import QApplication, QLabel, QPlainTextEdit
from pytestqt.qtbot import QtBot

from lfcal_gui.widgets.words import (
    BREAK,
    WIDEST,
    ElidedLabel,
    WrappedLabel,
    breakable,
    lines_px,
    shortened,
)
from tests.gui.layout import flaws

NAME = "/data/H_of_the_second_alignment_after_cleaning_the_main_lens_100mm_f2.8_2026-03-16.h5"


@pytest.mark.parametrize("text", [NAME, "x" * 100, "two words", "", f"{NAME}: expected an intact file\nnext line"])
def test_breaks_are_put_into_long_words_only_and_change_nothing_else(text: str) -> None:
    broken = breakable(text)
    assert broken.replace(BREAK, "") == text
    assert max((len(part) for word in broken.split() for part in word.split(BREAK)), default=0) <= 24
    assert all(word == word.replace(BREAK, "") for word in broken.split() if len(word) <= 24)


def test_a_long_name_is_wrapped_and_copied_as_it_is(qtbot: QtBot) -> None:
    label = WrappedLabel(f"{NAME}: no such file")
    qtbot.addWidget(label)
    assert label.text() == f"{NAME}: no such file"
    assert label.minimumSizeHint().width() < label.fontMetrics().horizontalAdvance(NAME) / 2
    label.copy()
    assert QApplication.clipboard().text() == label.text()
    label.setText("short")
    label.copy()
    assert QApplication.clipboard().text() == "short"


def test_a_long_name_in_one_line_needs_no_room_and_stands_in_the_tip(qtbot: QtBot) -> None:
    label = ElidedLabel(NAME)
    qtbot.addWidget(label)
    assert label.minimumSizeHint().width() == 0
    label.show()
    label.resize(label.sizeHint())
    assert label.toolTip() == "" and super(ElidedLabel, label).text() == NAME, "nothing is left out"
    label.resize(200, label.height())
    shown = super(ElidedLabel, label).text()
    assert "…" in shown and shown.endswith("h5") and label.toolTip() == NAME == label.text()
    label.resize(2000, label.height())
    assert label.toolTip() == "" and super(ElidedLabel, label).text() == NAME


SENTENCE = "say which camera made this H, so that it can be judged fully; lfcal then checks the aperture."


def test_a_sentence_takes_two_lines_and_loses_its_end(qtbot: QtBot) -> None:
    label = ElidedLabel(SENTENCE, sentence=True, lines=2)
    qtbot.addWidget(label)
    label.show()
    whole = label.fontMetrics().horizontalAdvance(SENTENCE)
    label.resize(2 * whole, 40)
    assert super(ElidedLabel, label).text() == SENTENCE and not label.toolTip()
    label.resize(2 * whole // 3, 40)
    first, second = super(ElidedLabel, label).text().split("\n")
    assert f"{first} {second}" == SENTENCE and not label.toolTip()
    assert not flaws(label)
    label.resize(whole // 4, 40)
    first, second = super(ElidedLabel, label).text().split("\n")
    assert (
        second.endswith("…") and SENTENCE.startswith(f"{first} {second[:-1]}".rstrip()) and label.toolTip() == SENTENCE
    )
    assert label.text() == SENTENCE


def test_a_brief_text_takes_the_place_of_one_that_does_not_fit(qtbot: QtBot) -> None:
    label = ElidedLabel(sentence=True)
    qtbot.addWidget(label)
    label.show()
    seen: list[bool] = []
    label.elided.connect(seen.append)
    label.resize(1000, 20)
    label.setText(SENTENCE, "say which camera")
    assert super(ElidedLabel, label).text() == SENTENCE and not seen[-1]
    label.resize(200, 20)
    assert super(ElidedLabel, label).text() == "say which camera" and label.toolTip() == SENTENCE and seen[-1]


def test_a_line_does_not_end_between_a_number_and_its_unit(qtbot: QtBot) -> None:
    label, words = ElidedLabel(sentence=True, lines=2), "record 5,643 positions in 9 planes, about 4 min 19 s."
    qtbot.addWidget(label)
    label.show()
    room = label.fontMetrics().horizontalAdvance(words.rpartition(" min")[0]) + 4
    label.setText(words)
    label.resize(room, 40)
    assert super(ElidedLabel, label).text().replace("\u00a0", " ") == words.replace("about 4", "about\n4")
    wrapped = WrappedLabel("95 × 55 px")
    qtbot.addWidget(wrapped)
    assert " " not in QLabel.text(wrapped) and wrapped.text() == "95 × 55 px"


LINE = "words of a fault, of which there are as many as it takes. "


def test_the_width_of_lines_is_that_of_the_longest(qtbot: QtBot) -> None:
    view = QPlainTextEdit()
    qtbot.addWidget(view)
    view.setLineWrapMode(QPlainTextEdit.LineWrapMode.NoWrap)
    view.setPlainText(f"short\n{LINE * 2}\nshort")
    view.show()
    view.resize(lines_px(view), 200)
    QApplication.processEvents()
    assert not view.horizontalScrollBar().isVisible()
    view.setPlainText(LINE * 100)
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
