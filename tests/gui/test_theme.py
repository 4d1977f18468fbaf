from __future__ import annotations

import pytest
from PySide6.QtWidgets import QApplication

from gui.theme import DARK, LIGHT, apply_theme


def test_another_theme_leaves_the_style(qapp: QApplication, monkeypatch: pytest.MonkeyPatch) -> None:
    apply_theme(qapp, LIGHT)
    made: list[str] = []
    monkeypatch.setattr(QApplication, "setStyle", lambda _, name: made.append(name))
    apply_theme(qapp, DARK)
    assert made == [] and DARK.text in qapp.styleSheet()
    apply_theme(qapp, LIGHT)
