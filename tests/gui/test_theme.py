from __future__ import annotations

import numpy as np
import pytest
from PySide6.QtWidgets import QApplication, QPushButton

from lfcal_gui.models.shot import Shot
from lfcal_gui.theme import DARK, LIGHT, apply_theme, current_theme, style_sheet
from lfcal_gui.widgets.picture import Picture
from lfcal_gui.window import MainWindow
from tests.gui.layout_colours import of_other_themes


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
        patched.setattr(QApplication, "setPalette", made.append)
        apply_theme(qapp, LIGHT)
        assert made == []
        apply_theme(qapp, DARK)
        assert len(made) == 1 and current_theme() is DARK
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
