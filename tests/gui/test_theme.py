"""Themes: contrast of fields, boxes and the focus, and which widgets a change of theme restyles."""

from __future__ import annotations

from collections.abc import Callable
from itertools import product

import numpy as np
import pytest
from PySide6 import QtWidgets as qt
from PySide6.QtCore import Qt
from PySide6.QtGui import QColor
from PySide6.QtTest import QTest
from pytestqt.qtbot import QtBot
from shiboken6 import delete

from lfcal_gui.models.shot import Shot
from lfcal_gui.theme import DARK, LIGHT, NIGHT, THEMES, Theme, apply_theme, current_theme, style_sheet
from lfcal_gui.widgets.picture import Picture
from lfcal_gui.window import MainWindow
from tests.gui.layout_colours import of_other_themes
from tests.gui.waiting import GUARD_MS, idle


def luminance(colour: QColor) -> float:
    """Return the relative luminance of WCAG 2."""
    shares = (colour.redF(), colour.greenF(), colour.blueF())
    linear = [share / 12.92 if share <= 0.04045 else ((share + 0.055) / 1.055) ** 2.4 for share in shares]
    return float(np.dot((0.2126, 0.7152, 0.0722), linear))


def contrast(one: QColor, other: QColor) -> float:
    low, high = sorted((luminance(one), luminance(other)))
    return (high + 0.05) / (low + 0.05)


def drawn(part: qt.QWidget, theme: Theme, qtbot: QtBot) -> tuple[qt.QWidget, list[list[QColor]]]:
    """Return the pixels of a part on a panel, and the panel."""
    app = qt.QApplication.instance()
    assert isinstance(app, qt.QApplication)
    apply_theme(app, theme)
    panel = qt.QWidget()
    qtbot.addWidget(panel)
    panel.setStyleSheet(style_sheet())
    column = qt.QVBoxLayout(panel)
    first = qt.QPushButton("has the focus")
    for one in (first, part):
        column.addWidget(one)
    panel.resize(200, 200)
    panel.show()
    first.setFocus()
    qt.QApplication.processEvents()
    image = part.grab().toImage()
    apply_theme(app, LIGHT)
    return panel, [[image.pixelColor(x, y) for x in range(image.width())] for y in range(image.height())]


def edge_contrasts(field: qt.QWidget, theme: Theme, qtbot: QtBot) -> list[float]:
    """Return the largest contrast with the panel at the upper, lower and left edge of a field."""
    _, pixels = drawn(field, theme, qtbot)
    middle = [row[len(row) // 2] for row in pixels]
    sides = (middle[:3], middle[-3:], pixels[len(pixels) // 2][:3])
    return [max(contrast(pixel, QColor(theme.panel)) for pixel in side) for side in sides]


def test_the_edge_of_a_field_shows_whether_it_can_be_edited(qapp: qt.QApplication, qtbot: QtBot) -> None:
    """Guidelines for accessibility ask for a contrast of 3. In night, disabled fields looked editable."""
    kinds = (qt.QLineEdit, qt.QPlainTextEdit, qt.QTextEdit, qt.QSpinBox, qt.QDoubleSpinBox, qt.QComboBox)
    for theme, kind in product((LIGHT, DARK, NIGHT), kinds):
        assert min(edge_contrasts(kind(), theme, qtbot)) >= 3, (theme.name, kind)
        field = kind()
        field.setEnabled(False)
        assert max(edge_contrasts(field, theme, qtbot)) < 2.5, (theme.name, kind)


@pytest.mark.parametrize("theme", THEMES.values(), ids=lambda one: one.name)
def test_text_and_edges_are_told_from_every_ground(theme: Theme) -> None:
    """WCAG 2 AA: 4.5 for text, 3 for the edges of fields."""
    grounds = [QColor(getattr(theme, name)) for name in ("window", "panel", "raised")]
    pairs = [("edge", 3.0), *((name, 4.5) for name in ("text", "muted", "accent", "good", "fair", "bad"))]
    for (name, least), ground in product(pairs, grounds):
        assert contrast(QColor(getattr(theme, name)), ground) >= least, (name, ground.name())
    assert contrast(QColor(theme.accent_text), QColor(theme.accent)) >= 4.5
    assert contrast(QColor(theme.canvas_text), QColor(theme.canvas)) >= 4.5


def test_a_list_is_flat_with_an_arrow(qapp: qt.QApplication, qtbot: QtBot) -> None:
    for theme in (LIGHT, DARK, NIGHT):
        box = qt.QComboBox()
        box.addItem("")
        _, pixels = drawn(box, theme, qtbot)
        inside = [row[12] for row in pixels[3:-3]]
        assert len({one.rgb() for one in inside}) == 1, theme.name
        arrow = [one for row in pixels[3:-3] for one in row[-20:-4]]
        assert max(contrast(one, inside[0]) for one in arrow) >= 3, theme.name


def test_a_scroll_bar_is_slim_with_a_visible_handle(qapp: qt.QApplication, qtbot: QtBot) -> None:
    for theme in (LIGHT, DARK, NIGHT):
        area = qt.QScrollArea()
        inner = qt.QLabel("\n" * 60)
        area.setWidget(inner)
        _, pixels = drawn(area, theme, qtbot)
        middle = [row[-6] for row in pixels]
        assert area.verticalScrollBar().width() == 10
        assert max(contrast(one, QColor(theme.panel)) for one in middle) >= 3, theme.name


def test_checked_and_unchecked_boxes_are_visible(qapp: qt.QApplication, qtbot: QtBot) -> None:
    """Unchecked boxes of lists were dark on dark: only those outside lists had a style."""
    for theme, enabled in product((LIGHT, DARK, NIGHT), (True, False)):
        box = qt.QCheckBox()
        box.setChecked(True)
        box.setEnabled(enabled)
        _, pixels = drawn(box, theme, qtbot)
        accent = QColor(theme.accent)
        filled = [(y, x) for y, row in enumerate(pixels) for x, pixel in enumerate(row) if pixel == accent]
        low, high = np.min(filled, axis=0) + 1, np.max(filled, axis=0)
        inside = [pixel for row in pixels[low[0] : high[0]] for pixel in row[low[1] : high[1]]]
        tick = sum(contrast(pixel, accent) >= 3 for pixel in inside)
        assert 8 <= tick <= len(inside) / 3, (theme.name, enabled)
    for theme in (LIGHT, DARK, NIGHT):
        entries = qt.QListWidget()
        for state in (Qt.CheckState.Unchecked, Qt.CheckState.Checked):
            qt.QListWidgetItem(entries).setCheckState(state)
        _, pixels = drawn(entries, theme, qtbot)
        high = entries.visualItemRect(entries.item(0)).height()
        top = entries.viewport().y()
        empty, ticked = ([row[4:40] for row in pixels[top + k * high : top + (k + 1) * high]] for k in (0, 1))
        assert sum(contrast(pixel, QColor(theme.panel)) >= 3 for row in empty for pixel in row) >= 40, theme.name
        assert [any(QColor(theme.accent) in row for row in rows) for rows in (empty, ticked)] == [False, True]


def test_a_theme_is_applied_once_and_keeps_the_style(qapp: qt.QApplication, monkeypatch: pytest.MonkeyPatch) -> None:
    apply_theme(qapp, LIGHT)
    styles: list[str] = []
    palettes: list[object] = []
    monkeypatch.setattr(qt.QApplication, "setStyle", lambda _, name: styles.append(name))
    monkeypatch.setattr(qt.QApplication, "setPalette", lambda *args: palettes.append(args))
    apply_theme(qapp, LIGHT)
    assert palettes == []
    apply_theme(qapp, DARK)
    assert palettes and current_theme() is DARK and DARK.text in style_sheet() and styles == []
    monkeypatch.undo()
    apply_theme(qapp, LIGHT)


def test_a_theme_restyles_visible_widgets_first(qapp: qt.QApplication, window: MainWindow, qtbot: QtBot) -> None:
    """All widgets were restyled together, thousands of which belong to menus that plots never show: 2.5 s."""
    window.go("frames")
    window.go("setup")
    setup, frames = window.page("setup"), window.page("frames")
    idle(window.jobs, qtbot)
    redrawn: list[str] = []
    setup.theme_changed.connect(lambda: redrawn.append("setup"))
    frames.theme_changed.connect(lambda: redrawn.append("frames"))
    window.set_theme("dark")
    qtbot.waitUntil(lambda: DARK.text in window.menuBar().styleSheet(), timeout=GUARD_MS)
    assert qapp.styleSheet() == "" and DARK.text in setup.styleSheet()
    assert LIGHT.text in frames.styleSheet() and redrawn == ["setup"]
    window.go("frames")
    assert DARK.text in frames.styleSheet() and redrawn == ["setup", "frames"]
    for name in ("light", "dark", "light"):
        window.set_theme(name)
    window.go("setup")
    assert LIGHT.text in setup.styleSheet()
    # an open dialog that changes the theme was white on white afterwards, and plots of a measurement stayed dark
    dialog = window.tools.preferences()
    assert LIGHT.text in dialog.styleSheet()
    dialog.theme.setCurrentIndex(dialog.theme.findData("dark"))
    assert DARK.text in dialog.styleSheet() and LIGHT.text not in dialog.styleSheet()
    dialog.close()
    view = Picture()
    view.setParent(window)
    view.set_shot(Shot(np.ones((8, 8))))
    view.show()
    measuring = view.measure()
    for theme in ("dark", "light"):
        window.set_theme(theme)
        qt.QApplication.processEvents()
        assert not list(of_other_themes(measuring))
    measuring.close()


def test_each_window_takes_a_theme_in_a_turn_of_its_own(
    window: MainWindow, qtbot: QtBot, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The window was held for 90 ms while pages in other windows were restyled, too."""
    keys = ("accuracy", "sessions", "setup")
    for key in keys:
        window.go(key)
    idle(window.jobs, qtbot)
    left = list[Callable[[], None]]()
    monkeypatch.setattr(window.jobs, "later", left.append)

    def restyled() -> list[str]:
        parts: dict[str, qt.QWidget] = {"frame": window.header, **{key: window.page(key) for key in keys}}
        return [name for name, part in parts.items() if DARK.text in part.styleSheet()]

    window._to_front("setup")
    window.set_theme("dark")
    turns, drawn = [0], list[bool]()
    for step in left:
        step()
        turns.append(len(restyled()))
        drawn.append({"frame", "setup"} <= {*restyled()})
        assert window.updatesEnabled() == drawn[-1], "nothing is drawn half in the new colours"
    assert drawn[-1] and turns[-1] == 4 and max(np.diff(turns)) == 1


def test_a_dialog_that_is_closed_before_its_turn_is_left_out(window: MainWindow, qtbot: QtBot) -> None:
    dialog = qt.QDialog(window)
    dialog.setStyleSheet(style_sheet())
    window.set_theme("dark")
    window._style()  # leaves the hidden dialog for a later turn
    delete(dialog)
    idle(window.jobs, qtbot)
    assert window.header.styleSheet() == style_sheet()


def test_icons_of_places_and_the_primary_button_have_the_accent(window: MainWindow) -> None:
    """A chosen segment looked like the primary button, so that three buttons seemed to be the next step."""

    def colours(number: int) -> set[str]:
        image = window.rail.findChildren(qt.QPushButton)[number].icon_label.pixmap().toImage()
        whole = [image.pixelColor(x, y) for x in range(image.width()) for y in range(image.height())]
        return {colour.name() for colour in whole if colour.alpha() == 255}

    window.go("frames")
    chosen, other, primary = (qt.QPushButton("One", window.page("frames").panel) for _ in range(3))
    for one in (chosen, other):
        one.setCheckable(True)
    chosen.setChecked(True)
    primary.setProperty("role", "primary")
    for theme in THEMES.values():
        window.set_theme(theme.name)
        window.go("setup")
        assert theme.accent in colours(0) and theme.text in colours(1)
        window.go("frames")
        assert theme.text in colours(0) and theme.accent in colours(1)
        fills = []
        for one in (chosen, other, primary):
            one.resize(80, 28)
            fills.append(one.grab().toImage().pixelColor(10, 6).name())
        assert fills[0] == theme.raised and fills[2] == theme.accent
        assert fills[1] not in (theme.accent, theme.raised)


BUTTONS = (qt.QPushButton, qt.QToolButton, qt.QCheckBox, qt.QComboBox, qt.QSlider, qt.QTabBar)
TEXTS = (qt.QLineEdit, qt.QPlainTextEdit, qt.QSpinBox, qt.QLabel)
KINDS = (*BUTTONS, *TEXTS, qt.QListWidget, qt.QTableWidget, qt.QTreeWidget)
ROLES = {
    qt.QPushButton: ("rail", "segment", "link", "row", "fold", "primary"),
    qt.QToolButton: ("bare", "mark", "reset"),
}
FOCUSED = [(kind, role) for kind in KINDS for role in ("", *ROLES.get(kind, ()))]


def test_the_focus_is_visible(qapp: qt.QApplication, qtbot: QtBot) -> None:
    for kind, role in FOCUSED:
        part = kind()
        part.setProperty("role", role)
        if isinstance(part, qt.QTabBar):
            part.addTab("one")
        if isinstance(part, qt.QAbstractButton | qt.QLabel):
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
        changed = [one != other for rows in zip(before, after, strict=True) for one, other in zip(*rows, strict=True)]
        assert sum(changed) > 8, (kind, role)
        panel.hide()
