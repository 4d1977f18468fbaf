from __future__ import annotations

import numpy as np
import pytest
from PySide6.QtCore import Qt
from PySide6.QtGui import QColor
from PySide6.QtTest import QTest
from PySide6.QtWidgets import (
    QAbstractButton,
    QApplication,
    QCheckBox,
    QComboBox,
    QDoubleSpinBox,
    QLabel,
    QLineEdit,
    QListWidget,
    QListWidgetItem,
    QPlainTextEdit,
    QPushButton,
    QSlider,
    QSpinBox,
    QTabBar,
    QTableWidget,
    QTextEdit,
    QToolButton,
    QTreeWidget,
    QVBoxLayout,
    QWidget,
)
from pytestqt.qtbot import QtBot

from lfcal_gui.models.shot import Shot
from lfcal_gui.theme import DARK, LIGHT, NIGHT, THEMES, Theme, apply_theme, current_theme, style_sheet
from lfcal_gui.widgets.picture import Picture
from lfcal_gui.window import MainWindow
from tests.gui.layout_colours import of_other_themes
from tests.gui.waiting import GUARD_MS


def luminance(colour: QColor) -> float:
    """Return the relative luminance of WCAG 2."""
    shares = (colour.redF(), colour.greenF(), colour.blueF())
    linear = [share / 12.92 if share <= 0.04045 else ((share + 0.055) / 1.055) ** 2.4 for share in shares]
    return float(np.dot((0.2126, 0.7152, 0.0722), linear))


def contrast(one: QColor, other: QColor) -> float:
    low, high = sorted((luminance(one), luminance(other)))
    return (high + 0.05) / (low + 0.05)


def drawn(part: QWidget, theme: Theme, qtbot: QtBot) -> tuple[QWidget, list[list[QColor]]]:
    """Return the pixels of a part on a panel, and the panel."""
    app = QApplication.instance()
    assert isinstance(app, QApplication)
    apply_theme(app, theme)
    panel = QWidget()
    qtbot.addWidget(panel)
    panel.setStyleSheet(style_sheet())
    column = QVBoxLayout(panel)
    first = QPushButton("has the focus")
    for one in (first, part):
        column.addWidget(one)
    panel.resize(200, 200)
    panel.show()
    first.setFocus()
    QApplication.processEvents()
    image = part.grab().toImage()
    apply_theme(app, LIGHT)
    return panel, [[image.pixelColor(x, y) for x in range(image.width())] for y in range(image.height())]


@pytest.mark.parametrize("kind", [QLineEdit, QPlainTextEdit, QTextEdit, QSpinBox, QDoubleSpinBox, QComboBox])
@pytest.mark.parametrize("theme", [LIGHT, DARK, NIGHT], ids=lambda theme: theme.name)
def test_the_edge_of_a_field_differs_from_its_panel(
    qapp: QApplication, qtbot: QtBot, theme: Theme, kind: type[QWidget]
) -> None:
    """It had a contrast of 1.4 or less; guidelines for accessibility ask for 3."""
    _, pixels = drawn(kind(), theme, qtbot)
    middle = [row[len(row) // 2] for row in pixels]
    for side in (middle[:3], middle[-3:], pixels[len(pixels) // 2][:3]):
        assert max(contrast(pixel, QColor(theme.panel)) for pixel in side) >= 3


@pytest.mark.parametrize("kind", [QLineEdit, QPlainTextEdit, QTextEdit, QSpinBox, QDoubleSpinBox, QComboBox])
@pytest.mark.parametrize("theme", [LIGHT, DARK, NIGHT], ids=lambda theme: theme.name)
def test_a_field_that_cannot_be_edited_has_a_fainter_edge(
    qapp: QApplication, qtbot: QtBot, theme: Theme, kind: type[QWidget]
) -> None:
    """In a dark lab, the positions of a stage in use looked as if they could be typed."""
    field = kind()
    field.setEnabled(False)
    _, pixels = drawn(field, theme, qtbot)
    middle = [row[len(row) // 2] for row in pixels]
    for side in (middle[:3], middle[-3:], pixels[len(pixels) // 2][:3]):
        assert max(contrast(pixel, QColor(theme.panel)) for pixel in side) < 2.5


@pytest.mark.parametrize("enabled", [True, False])
@pytest.mark.parametrize("theme", [LIGHT, DARK, NIGHT], ids=lambda theme: theme.name)
def test_a_checked_box_has_a_tick(qapp: QApplication, qtbot: QtBot, theme: Theme, enabled: bool) -> None:
    box = QCheckBox()
    box.setChecked(True)
    box.setEnabled(enabled)
    _, pixels = drawn(box, theme, qtbot)
    filled = [(y, x) for y, row in enumerate(pixels) for x, pixel in enumerate(row) if pixel == QColor(theme.accent)]
    low, high = np.min(filled, axis=0) + 1, np.max(filled, axis=0)
    inside = [pixel for row in pixels[low[0] : high[0]] for pixel in row[low[1] : high[1]]]
    tick = sum(contrast(pixel, QColor(theme.accent)) >= 3 for pixel in inside)
    assert 8 <= tick <= len(inside) / 3


@pytest.mark.parametrize("theme", [LIGHT, DARK, NIGHT], ids=lambda theme: theme.name)
def test_the_box_of_a_list_item_is_seen(qapp: QApplication, qtbot: QtBot, theme: Theme) -> None:
    """Unchecked boxes of lists were dark on dark: only those outside lists had a style."""
    entries = QListWidget()
    for state in (Qt.CheckState.Unchecked, Qt.CheckState.Checked):
        QListWidgetItem(entries).setCheckState(state)
    _, pixels = drawn(entries, theme, qtbot)
    high = entries.visualItemRect(entries.item(0)).height()
    top = entries.viewport().y()
    empty, ticked = ([row[4:40] for row in pixels[top + k * high : top + (k + 1) * high]] for k in (0, 1))
    assert sum(contrast(pixel, QColor(theme.panel)) >= 3 for row in empty for pixel in row) >= 40
    assert [any(QColor(theme.accent) in row for row in rows) for rows in (empty, ticked)] == [False, True]


def test_another_theme_leaves_the_style(qapp: QApplication, monkeypatch: pytest.MonkeyPatch) -> None:
    apply_theme(qapp, LIGHT)
    made: list[str] = []
    monkeypatch.setattr(QApplication, "setStyle", lambda _, name: made.append(name))
    apply_theme(qapp, DARK)
    assert made == [] and DARK.text in style_sheet()
    apply_theme(qapp, LIGHT)


def test_the_theme_it_has_already_is_not_worked_out_anew(qapp: QApplication, monkeypatch: pytest.MonkeyPatch) -> None:
    apply_theme(qapp, LIGHT)
    made: list[object] = []
    with monkeypatch.context() as patched:
        patched.setattr(QApplication, "setPalette", lambda *args: made.append(args))
        apply_theme(qapp, LIGHT)
        assert made == []
        apply_theme(qapp, DARK)
        assert made and current_theme() is DARK
        apply_theme(qapp, LIGHT)


def test_a_theme_is_taken_by_what_is_seen_and_by_the_rest_when_it_is(qapp: QApplication, window: MainWindow) -> None:
    """All widgets took it at once, thousands of which belong to menus that plots never show: 2.5 s."""
    window.go("frames")
    window.go("setup")
    setup, frames = window.page("setup"), window.page("frames")
    redrawn: list[str] = []
    setup.theme_changed.connect(lambda: redrawn.append("setup"))
    frames.theme_changed.connect(lambda: redrawn.append("frames"))
    window.set_theme("dark")
    assert qapp.styleSheet() == "" and DARK.text in setup.styleSheet() and DARK.text in window.menuBar().styleSheet()
    assert LIGHT.text in frames.styleSheet() and redrawn == ["setup"]
    window.go("frames")
    assert DARK.text in frames.styleSheet() and redrawn == ["setup", "frames"]
    window.set_theme("light")
    window.set_theme("dark")
    window.set_theme("light")
    window.go("setup")
    assert LIGHT.text in setup.styleSheet()


def test_icons_of_places_follow_theme_and_place(window: MainWindow) -> None:
    def colours(number: int) -> set[str]:
        image = window.rail.findChildren(QPushButton)[number].icon_label.pixmap().toImage()
        whole = [image.pixelColor(x, y) for x in range(image.width()) for y in range(image.height())]
        return {colour.name() for colour in whole if colour.alpha() == 255}

    for theme in (DARK, LIGHT):
        window.set_theme(theme.name)
        window.go("setup")
        assert theme.accent in colours(0) and theme.text in colours(1)
        window.go_place("record")
        assert theme.text in colours(0) and theme.accent in colours(1)


@pytest.mark.parametrize("theme", THEMES.values(), ids=lambda theme: theme.name)
def test_only_a_primary_button_is_filled_with_the_accent(window: MainWindow, theme: Theme) -> None:
    """A chosen segment looked like the primary button, so that three buttons seemed to be the next step."""
    window.set_theme(theme.name)
    window.go("frames")
    page = window.page("frames")
    chosen, other, primary = (QPushButton("One", page.panel) for _ in range(3))
    for one in (chosen, other):
        one.setCheckable(True)
    chosen.setChecked(True)
    primary.setProperty("role", "primary")
    fills = []
    for one in (chosen, other, primary):
        one.resize(80, 28)
        fills.append(one.grab().toImage().pixelColor(10, 6).name())
    assert fills[0] == theme.raised and fills[2] == theme.accent
    assert fills[1] not in (theme.accent, theme.raised)


def test_a_dialog_that_is_open_takes_another_theme(window: MainWindow) -> None:
    """Preferences, which change the theme, were white on white afterwards."""
    dialog = window.tools.preferences()
    assert LIGHT.text in dialog.styleSheet()
    dialog.theme.setCurrentIndex(dialog.theme.findData("dark"))
    assert DARK.text in dialog.styleSheet() and LIGHT.text not in dialog.styleSheet()
    dialog.close()


def test_a_window_that_measures_takes_the_theme(window: MainWindow) -> None:
    """Its plots stayed dark."""
    window.go("setup")
    view = Picture()
    view.setParent(window)
    view.set_shot(Shot(np.ones((8, 8))))
    view.show()
    measuring = view.measure()
    for theme in ("dark", "light"):
        window.set_theme(theme)
        QApplication.processEvents()
        assert not list(of_other_themes(measuring))
    measuring.close()


def in_role(part: QWidget, role: str) -> QWidget:
    part.setProperty("role", role)
    return part


KINDS = (
    *(QPushButton, QToolButton, QCheckBox, QComboBox, QSlider, QTabBar, QLineEdit, QPlainTextEdit, QSpinBox),
    *(QListWidget, QTableWidget, QTreeWidget, QLabel),
)
ROLES = {QPushButton: ("rail", "segment", "link", "row", "fold", "primary"), QToolButton: ("bare", "mark", "reset")}
FOCUSED = [(kind, role) for kind in KINDS for role in ("", *ROLES.get(kind, ()))]


@pytest.mark.parametrize(("kind", "role"), FOCUSED)
def test_what_has_the_keyboard_is_seen(qapp: QApplication, qtbot: QtBot, kind: type[QWidget], role: str) -> None:
    part = in_role(kind(), role)
    if isinstance(part, QTabBar):
        part.addTab("one")
    if isinstance(part, QAbstractButton | QLabel):
        part.setText("words")
    part.setFocusPolicy(Qt.FocusPolicy.StrongFocus)
    panel, before = drawn(part, DARK, qtbot)
    panel.activateWindow()
    apply_theme(qapp, DARK)
    QTest.keyClick(panel.focusWidget(), Qt.Key.Key_Tab)
    qtbot.waitUntil(part.hasFocus, timeout=GUARD_MS)
    image = part.grab().toImage()
    apply_theme(qapp, LIGHT)
    after = [[image.pixelColor(x, y) for x in range(image.width())] for y in range(image.height())]
    assert sum(one != other for rows in zip(before, after, strict=True) for one, other in zip(*rows, strict=True)) > 8
