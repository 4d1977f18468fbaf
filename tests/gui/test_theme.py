from __future__ import annotations

import pytest
from PySide6.QtWidgets import QApplication

from gui.theme import DARK, LIGHT, apply_theme, current_theme


def test_another_theme_leaves_the_style(qapp: QApplication, monkeypatch: pytest.MonkeyPatch) -> None:
    apply_theme(qapp, LIGHT)
    made: list[str] = []
    monkeypatch.setattr(QApplication, "setStyle", lambda _, name: made.append(name))
    apply_theme(qapp, DARK)
    assert made == [] and DARK.text in qapp.styleSheet()
    apply_theme(qapp, LIGHT)


def test_the_theme_it_has_already_is_not_worked_out_anew(qapp: QApplication, monkeypatch: pytest.MonkeyPatch) -> None:
    apply_theme(qapp, LIGHT)
    made: list[str] = []
    with monkeypatch.context() as patched:
        patched.setattr(QApplication, "setStyleSheet", lambda _, sheet: made.append(sheet))
        apply_theme(qapp, LIGHT)
        assert made == []
        apply_theme(qapp, DARK)
        assert len(made) == 1 and current_theme() is DARK
        apply_theme(qapp, LIGHT)
